"""Parts chosen by name: those of the project, loaded when asked for, and those of other packages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.metadata import entry_points

from pepper_driver.config.errors import PepperError, UnknownNameError


class PluginError(PepperError, ImportError):
    """A registered part exists, but cannot be loaded."""


def load_plugin(
    kind: str, group: str, name: str, builtin: Mapping[str, str]
) -> Callable[..., object]:
    """The class or factory registered as ``name``.

    Args:
        kind: What it is, for messages, for example ``"backend"``.
        group: Entry-point group where other packages register theirs.
        name: Name asked for. A name of the project wins over a registered one.
        builtin: Names of the project, to ``"module:attribute"``.

    Raises:
        UnknownNameError: Nobody registered this name.
        PluginError: The package that registered it fails to import, or it cannot be called.
        MissingExtraError: The part needs an extra that is not installed.
    """
    registered = {point.name: point for point in entry_points(group=group)}
    if name in builtin:
        module, _, attribute = builtin[name].partition(":")
        own: Callable[..., object] = getattr(import_module(module), attribute)
        return own
    if name not in registered:
        raise UnknownNameError(kind, name, [*builtin, *registered])
    point = registered[name]
    try:
        part: object = point.load()
    except PepperError:
        raise
    except Exception as error:
        raise PluginError(
            f"{kind} '{name}' of {point.value} cannot be loaded: {type(error).__name__}: {error}"
        ) from error
    if not callable(part):
        raise PluginError(
            f"{kind} '{name}': {point.value} is {type(part).__name__}, no class or factory"
        )
    return part
