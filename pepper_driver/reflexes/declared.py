"""Reflexes as files and logs declare them: ``{on: {link: LForeArm, kind: collision}, do: retract, distance: 0.3}``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from itertools import combinations
from pathlib import Path
from typing import Any

from pepper_driver.config import ConfigError, PepperError, RobotConfig, UnknownNameError, suggestion
from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import read_yaml
from pepper_driver.config.plugins import load_plugin
from pepper_driver.reflexes.assist import Assist
from pepper_driver.reflexes.comply import Comply
from pepper_driver.reflexes.follow_hand import FollowHand
from pepper_driver.reflexes.hold import Hold
from pepper_driver.reflexes.ignore import Ignore
from pepper_driver.reflexes.reflex import Reflex, kind_of
from pepper_driver.reflexes.retract import Retract
from pepper_driver.reflexes.soften import Soften
from pepper_driver.reflexes.stop_base import StopBase

REFLEX_GROUP = "pepper_driver.reflexes"
"""Entry-point group for reflexes: ``name = "module:Class"``, a dataclass derived from ``Reflex``."""

LONGEST_NAME = 80

_REFLEXES = {
    kind_of(cls): f"{cls.__module__}:{cls.__name__}"
    for cls in (Assist, Comply, FollowHand, Hold, Ignore, Retract, Soften, StopBase)
}
_ON: tuple[str, ...] = ("link", "joint", "kind", "min_intensity")


@with_lines
def make_reflexes(
    declared: Sequence[Mapping[str, Any]], robot: RobotConfig, source: str
) -> tuple[Reflex, ...]:
    """Reflexes from the entries of a file's key ``reflexes``, in their order.

    Args:
        declared: Each with ``on``, which contacts, ``do``, the kind of reflex, and what this kind takes besides.
        robot: Its description.
        source: Name of the file, for messages.

    Raises:
        ConfigError: An unknown kind, argument, link or joint, a value that makes no sense, or two reflexes of which
            nobody could say who gets the robot; the message names the key.
    """
    made = [
        make_reflex(entry, robot, source, f"reflexes.{number}")
        for number, entry in enumerate(declared)
    ]
    for (first, one), (second, other) in combinations(enumerate(made), 2):
        if one.priority == other.priority and overlap(one, other, robot):
            what = _contended(one, other)
            if what:
                raise ConfigError(
                    f"{source}: key 'reflexes.{second}': '{other.name}' and '{one.name}' of 'reflexes.{first}' answer"
                    f" the same contacts with the same priority, {one.priority}, and both want {what}; give one of"
                    " them another 'priority', or other contacts"
                )
    return tuple(made)


def overlap(one: Reflex, other: Reflex, robot: RobotConfig) -> bool:
    """Return True where both may answer one contact, of whatever kind: a contact may grow into a collision."""
    for key in ("link", "joint"):
        first, second = getattr(one, key), getattr(other, key)
        if first is not None and second is not None and first != second:
            return False
    link, joint = one.link or other.link, one.joint or other.joint
    return link is None or joint is None or _may_feel(joint, link, robot)


def _may_feel(joint: str, link: str, robot: RobotConfig) -> bool:
    """Return True where a joint may detect a contact on a link: none of another limb does."""
    carrier = next((j.name for j in robot.joints if j.child == link), None)
    return carrier is None or carrier in robot.chain_of(joint)


def _contended(one: Reflex, other: Reflex) -> str:
    """Return what only one of them can have, in words; empty for nothing."""
    if ("contacts" in one.takes) != ("contacts" in other.takes):
        return "the contact, which one of them hides from others"
    parts = {"joints": "the same joints", "base": "the base"}
    return " and ".join(text for part, text in parts.items() if part in one.takes & other.takes)


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
        raise ConfigError(f"{where}.on': which contacts: a mapping with any of {', '.join(_ON)}")
    try:
        cls = load_plugin("reflex", REFLEX_GROUP, kind, _REFLEXES)
    except PepperError as error:
        raise ConfigError(f"{where}.do': {error}") from error
    if not (isinstance(cls, type) and issubclass(cls, Reflex)):
        raise ConfigError(f"{where}.do': what is registered as '{kind}' is no reflex")
    known = [field.name for field in fields(cls) if field.init and field.name not in _ON]
    for given, allowed, part in ((on, _ON, ".on"), (rest, known, "")):
        for name in given:
            if name not in allowed:
                raise ConfigError(
                    f"{source}: unknown key '{key}{part}.{name}'{suggestion(name, allowed)}"
                )
    name = rest.get("name", kind)
    if not (isinstance(name, str) and 0 < len(name) <= LONGEST_NAME and name.isprintable()):
        raise ConfigError(f"{where}.name': a name of up to {LONGEST_NAME} letters, got {name!r}")
    try:
        reflex = cls(**on, **rest)
        reflex.prepare(robot)
    except UnknownNameError as error:
        place = next((f".on.{key}" for key in _ON if on.get(key) == error.name), "")
        raise ConfigError(f"{where}{place}': {error}") from error
    except (PepperError, TypeError, ValueError) as error:
        raise ConfigError(f"{where}': {error}") from error
    return reflex


def declare(reflex: Reflex) -> dict[str, Any]:
    """The entry of a reflex, with all its arguments; ``class`` is there only where it is of none that is registered."""
    cls = type(reflex)
    rest = {field.name: getattr(reflex, field.name) for field in fields(reflex) if field.init}
    on = {key: value for key in _ON if (value := rest.pop(key)) is not None}
    entry = {"do": kind_of(cls), "on": on, **rest}
    try:
        registered = load_plugin("reflex", REFLEX_GROUP, kind_of(cls), _REFLEXES) is cls
    except PepperError:
        registered = False
    return entry if registered else {**entry, "class": cls.__qualname__}


@with_lines
def load_reflexes(path: Path, robot: RobotConfig) -> tuple[Reflex, ...]:
    """The reflexes of a YAML file that has nothing but the key ``reflexes``.

    Raises:
        ConfigError: The file is missing, or wrong as for :func:`make_reflexes`.
    """
    data = read_yaml(path)
    declared = data.pop("reflexes", None)
    for key in data:
        raise ConfigError(f"{path}: unknown key '{key}'{suggestion(str(key), ['reflexes'])}")
    if not (isinstance(declared, list) and all(isinstance(entry, dict) for entry in declared)):
        raise ConfigError(f"{path}: key 'reflexes': a list such as [{{do: hold}}]")
    return make_reflexes(declared, robot, str(path))
