"""Reflexes as text: ``{on: {link: LForeArm}, do: retract, distance: 0.3}``, in files and in the log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from pepper_driver.config import ConfigError, PepperError, suggestion
from pepper_driver.config.loading import read_yaml
from pepper_driver.config.plugins import load_plugin
from pepper_driver.reflexes.assist import Assist
from pepper_driver.reflexes.comply import Comply
from pepper_driver.reflexes.follow_hand import FollowHand
from pepper_driver.reflexes.hold import Hold
from pepper_driver.reflexes.ignore import Ignore
from pepper_driver.reflexes.reflex import Reflex, ReflexError, kind_of
from pepper_driver.reflexes.retract import Retract
from pepper_driver.reflexes.soften import Soften
from pepper_driver.reflexes.stop_base import StopBase

REFLEX_GROUP = "pepper_driver.reflexes"
"""Entry-point group for reflexes of other packages: ``name = "module:Class"``, the name as :func:`kind_of` makes it."""

ON = ("link", "joint", "kind", "min_intensity")
"""Which contacts a reflex is for; the other arguments say what it does."""

_REFLEXES = {
    kind_of(reflex): f"{reflex.__module__}:{reflex.__name__}"
    for reflex in (Assist, Comply, FollowHand, Hold, Ignore, Retract, Soften, StopBase)
}


def declared(reflex: Reflex) -> dict[str, Any]:
    """A reflex with all its arguments. One of a class that is not registered has its ``class`` with it."""
    cls = type(reflex)
    values = {f.name: getattr(reflex, f.name) for f in fields(reflex) if f.init}
    on = {key: value for key in ON if (value := values.pop(key)) is not None}
    declaration = {"do": kind_of(cls), "on": on, **values}
    try:
        registered = load_plugin("reflex", REFLEX_GROUP, kind_of(cls), _REFLEXES) is cls
    except PepperError:
        registered = False
    return declaration if registered else {**declaration, "class": cls.__qualname__}


def make_reflex(declaration: Mapping[str, Any]) -> Reflex:
    """The reflex that is declared.

    Raises:
        ReflexError: Not to be understood, an unknown argument, or a class that is not registered.
        UnknownNameError: No such reflex.
    """
    values = dict(declaration) if isinstance(declaration, Mapping) else {}
    do, on = values.pop("do", None), values.pop("on", None) or {}
    if not isinstance(do, str) or not isinstance(on, Mapping):
        raise ReflexError(
            f"a reflex is declared as {{on: {{link: LForeArm}}, do: retract}}, got {declaration!r}"
        )
    if "class" in values:
        raise ReflexError(
            f"reflex '{do}' is of a class of its program, {values['class']}, that is not registered "
            f"under '{REFLEX_GROUP}'"
        )
    cls: type[Reflex] = load_plugin("reflex", REFLEX_GROUP, do, _REFLEXES)
    own = {f.name for f in fields(cls) if f.init} - set(ON)
    for keys, known, where in ((on, ON, "on."), (values, own, "")):
        for key in keys:
            if key not in known:
                raise ReflexError(f"{do}: unknown key '{where}{key}'{suggestion(str(key), known)}")
    if not isinstance(values.get("name", ""), str):
        raise ReflexError(f"{do}: a name is text, got {values['name']!r}")
    return cls(**on, **values)


def load_reflexes(path: Path) -> list[Reflex]:
    """The reflexes in a YAML file: its only key is ``reflexes``, a list of declarations.

    Raises:
        ConfigError: The file is missing or wrong; the message says where.
    """
    data = read_yaml(path)
    declarations = data.pop("reflexes", None)
    if data or not isinstance(declarations, list):
        raise ConfigError(f"{path}: has one key, 'reflexes', with a list of reflexes")
    reflexes = []
    for number, declaration in enumerate(declarations):
        try:
            reflexes.append(make_reflex(declaration))
        except PepperError as error:
            raise ConfigError(f"{path}: reflexes.{number}: {error}") from error
    return reflexes
