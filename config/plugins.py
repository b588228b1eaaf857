"""Parts chosen by name: those of the project, loaded when asked for, and those of other packages."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from pepper_driver.config.errors import PepperError, UnknownNameError


class PluginError(PepperError, ImportError):
    """A registered part exists, but cannot be loaded."""


def load_plugin(kind: str, group: str, name: str, builtin: Mapping[str, str]) -> Any:  # noqa: ANN401 the group says what
    """The object registered as ``name``.

    Args:
        kind: What it is, for messages, for example ``"backend"``.
        group: Entry-point group where other packages register theirs.
        name: Name asked for. A name of the project wins over a registered one.
        builtin: Names of the project, to ``"module:attribute"``.

    Raises:
        UnknownNameError: Nobody registered this name.
        PluginError: The package that registered it fails to import.
        MissingExtraError: The part needs an extra that is not installed.
    """
    registered = {point.name: point for point in entry_points(group=group)}
    if name in builtin:
        module, _, attribute = builtin[name].partition(":")
        return getattr(import_module(module), attribute)
    if name not in registered:
        raise UnknownNameError(kind, name, [*builtin, *registered])
    point = registered[name]
    try:
        return point.load()
    except PepperError:
        raise
    except Exception as error:
        raise PluginError(
            f"{kind} '{name}' of {point.value} cannot be loaded: {type(error).__name__}: {error}"
        ) from error
