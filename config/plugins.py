"""Parts chosen by name: those of the project, loaded when asked for, and those of other packages."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path

from pepper_driver.config.errors import PepperError, UnknownNameError


class PluginError(PepperError, ImportError):
    """A registered part exists, but cannot be loaded or made."""


class PluginInterfaceError(PepperError, TypeError):
    """A plug-in that is no object of the kind asked for, or does not keep to the interface of its kind."""


def load_plugin(
    kind: str, group: str, name: str, builtin: Mapping[str, str]
) -> Callable[..., object]:
    """Return the class or factory registered as ``name``.

    Args:
        kind: What it is, for messages, for example ``"backend"``.
        group: Entry-point group where other packages register theirs.
        name: Name asked for. A name of the project wins over a registered one.
        builtin: Names of the project, to ``"module:attribute"``.

    Raises:
        UnknownNameError: This name is not registered.
        PluginError: The package that registered it fails to import, or it cannot be called.
        MissingExtraError: The part needs an extra that is not installed.
    """
    if name in builtin:
        module, _, attribute = builtin[name].partition(":")
        own: Callable[..., object] = getattr(import_module(module), attribute)
        return own
    registered = {point.name: point for point in entry_points(group=group)}
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


def plugin_names(group: str, builtin: Mapping[str, str]) -> tuple[str, ...]:
    """Names that :func:`load_plugin` finds: those of the project, then those of other packages."""
    return tuple(dict.fromkeys([*builtin, *(point.name for point in entry_points(group=group))]))


def make_part(kind: str, name: str, factory: Callable[..., object], *arguments: object) -> object:
    """Return what a factory of :func:`load_plugin` makes of its arguments.

    Raises:
        PluginError: The factory of another package raises anything but a PepperError, which comes out as it is.
    """
    # An error of the project's own part is a defect, and keeps its type and traceback.
    if getattr(factory, "__module__", "").partition(".")[0] == __name__.partition(".")[0]:
        return factory(*arguments)
    try:
        return factory(*arguments)
    except PepperError:
        raise
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(frame.filename).name} line {frame.lineno}"
        raise PluginError(
            " ".join(f"{kind} '{name}' fails ({where}): {type(error).__name__}: {error}".split())
        ) from error
