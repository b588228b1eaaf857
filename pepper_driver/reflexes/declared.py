"""Reflexes as files and logs declare them: ``{on: {link: LForeArm, kind: collision}, do: retract, distance: 0.3}``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields
from itertools import combinations
from pathlib import Path
from typing import Any

from pepper_driver.config import ConfigError, PepperError, RobotConfig, UnknownNameError, suggestion
from pepper_driver.config.contact_selector import SELECTOR_FIELDS, ContactSelector, SelectorError
from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import read_yaml
from pepper_driver.config.plugins import load_plugin, plugin_names
from pepper_driver.reflexes.basic import Hold, Ignore, Soften, StopBase
from pepper_driver.reflexes.comply import Assist, Comply
from pepper_driver.reflexes.follow_hand import FollowHand
from pepper_driver.reflexes.reflex import Reflex, kind_of
from pepper_driver.reflexes.retract import Retract

REFLEX_GROUP = "pepper_driver.reflexes"
"""Entry-point group for reflexes: ``name = "module:Class"``, a dataclass derived from ``Reflex``."""

MAX_NAME = 80

_REFLEXES = {
    kind_of(cls): f"{cls.__module__}:{cls.__name__}"
    for cls in (Assist, Comply, FollowHand, Hold, Ignore, Retract, Soften, StopBase)
}


def reflex_kinds() -> dict[str, str]:
    """Return the kinds of reflex that can be declared, those of other packages too, each with its purpose."""
    kinds = {}
    for kind in plugin_names(REFLEX_GROUP, _REFLEXES):
        doc = load_plugin("reflex", REFLEX_GROUP, kind, _REFLEXES).__doc__ or ""
        first = doc.strip().partition("\n")[0]
        kinds[kind] = re.sub(r":\w+:|`", "", first)
    return kinds


@with_lines
def make_reflexes(
    declared: Mapping[str, Mapping[str, Any]], robot: RobotConfig, source: str
) -> tuple[Reflex, ...]:
    """Make reflexes from the entries of a file, in their order.

    Args:
        declared: By key: ``on``, which contacts, ``do``, the kind of reflex, and the other arguments of this kind.
        robot: Its description.
        source: Name of the file, for messages.

    Raises:
        ConfigError: An unknown kind, argument, link or joint, a value that makes no sense, or two reflexes of which
            it is undefined which one gets the robot; the message names the key.
    """
    made = {key: make_reflex(entry, robot, source, key) for key, entry in declared.items()}
    for (first, one), (second, other) in combinations(made.items(), 2):
        if one.priority == other.priority and overlap(one, other, robot):
            what = _contended(one, other)
            if what:
                raise ConfigError(
                    f"{source}: key '{second}': '{other.name}' and '{one.name}' of '{first}' answer"
                    f" the same contacts with the same priority, {one.priority}, and both claim {what}; give one of"
                    " them another 'priority', or other contacts"
                )
    return tuple(made.values())


def overlap(one: Reflex, other: Reflex, robot: RobotConfig) -> bool:
    """Return True where one contact may start both, of any kind: a contact may grow into a collision."""
    for first, second in (
        (one.selector.link, other.selector.link),
        (one.selector.joint, other.selector.joint),
    ):
        if first and second and set(first).isdisjoint(second):
            return False
    return not one.selector.limbs_in(robot).isdisjoint(other.selector.limbs_in(robot))


def _contended(one: Reflex, other: Reflex) -> str:
    """Return what only one of them can have, in words; empty for nothing."""
    if ("contacts" in one.resources) != ("contacts" in other.resources):
        return "the contact, which one of them hides from others"
    parts = {"joints": "the same joints", "base": "the base"}
    return " and ".join(
        text for part, text in parts.items() if part in one.resources & other.resources
    )


def make_reflex(entry: Mapping[str, Any], robot: RobotConfig, source: str, key: str) -> Reflex:
    """One reflex from its entry; ``key`` is where it stands.

    Raises:
        ConfigError: As :func:`make_reflexes`.
    """
    where = f"{source}: key '{key}"
    rest = dict(entry)
    on, kind = rest.pop("on", {}), rest.pop("do", None)
    if not isinstance(kind, str):
        raise ConfigError(f"{where}.do' is missing: {suggestion('', _REFLEXES).strip(' ()')}")
    if not isinstance(on, dict):
        raise ConfigError(
            f"{where}.on': which contacts: a mapping with any of {', '.join(SELECTOR_FIELDS)}"
        )
    try:
        cls = load_plugin("reflex", REFLEX_GROUP, kind, _REFLEXES)
    except PepperError as error:
        raise ConfigError(f"{where}.do': {error}") from error
    if not (isinstance(cls, type) and issubclass(cls, Reflex)):
        raise ConfigError(f"{where}.do': what is registered as '{kind}' is no reflex")
    known = [
        field.name for field in fields(cls) if field.init and field.name not in SELECTOR_FIELDS
    ]
    for given, allowed, part in ((on, SELECTOR_FIELDS, ".on"), (rest, known, "")):
        for name in given:
            if name not in allowed:
                raise ConfigError(
                    f"{source}: unknown key '{key}{part}.{name}'{suggestion(name, allowed)}"
                )
    name = rest.get("name", kind)
    if not (isinstance(name, str) and 0 < len(name) <= MAX_NAME and name.isprintable()):
        raise ConfigError(f"{where}.name': a name of up to {MAX_NAME} letters, got {name!r}")
    try:
        ContactSelector.from_arguments(**on).check(robot)
        reflex = cls(**on, **rest)
        reflex.setup(robot)
    except UnknownNameError as error:
        raise ConfigError(f"{where}.on.{error.kind}': {error}") from error
    except SelectorError as error:
        raise ConfigError(
            f"{where}.{'.'.join(filter(None, ('on', error.field)))}': {error}"
        ) from error
    except (PepperError, TypeError, ValueError) as error:
        raise ConfigError(f"{where}': {error}") from error
    return reflex


def declare(reflex: Reflex) -> dict[str, Any]:
    """Return the entry of a reflex, with all its arguments, and ``class`` if its kind is not registered."""
    cls = type(reflex)
    rest = {field.name: getattr(reflex, field.name) for field in fields(reflex) if field.init}
    on = {}
    for key in SELECTOR_FIELDS:
        del rest[key]
        value = getattr(reflex.selector, key)
        if isinstance(value, tuple):
            value = value[0] if len(value) == 1 else list(value)
        if value not in (None, []):
            on[key] = value
    entry = {"do": kind_of(cls), "on": on, **rest}
    try:
        registered = load_plugin("reflex", REFLEX_GROUP, kind_of(cls), _REFLEXES) is cls
    except PepperError:
        registered = False
    return entry if registered else {**entry, "class": cls.__qualname__}


@with_lines
def load_reflexes(path: Path, robot: RobotConfig) -> tuple[Reflex, ...]:
    """Return the reflexes of a YAML file that has nothing but the key ``reflexes``.

    Raises:
        ConfigError: The file is missing, or wrong as for :func:`make_reflexes`.
    """
    data = read_yaml(path)
    declared = data.pop("reflexes", None)
    for key in data:
        raise ConfigError(f"{path}: unknown key '{key}'{suggestion(str(key), ['reflexes'])}")
    if not (isinstance(declared, list) and all(isinstance(entry, dict) for entry in declared)):
        raise ConfigError(f"{path}: key 'reflexes': a list such as [{{do: hold}}]")
    keyed = {f"reflexes.{number}": entry for number, entry in enumerate(declared)}
    return make_reflexes(keyed, robot, str(path))
