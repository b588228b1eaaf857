"""Scenarios: how the robot is moved and touched. One form for identification, calibration, evaluation, tests, demo."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.errors import ConfigError, suggestion
from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import (
    STRICT,
    by_kind,
    named_file,
    parse,
    read_yaml,
    shipped_names,
)
from pepper_driver.config.parts import NotNegative, Positive
from pepper_driver.config.robot import RobotConfig
from pepper_driver.config.scenario_contacts import (
    AnyContact,
    Hand,
    RandomForces,
    RandomPushes,
    RandomTouch,
)
from pepper_driver.config.scenario_motion import Holds, Motion, Name, Script, Setpoints, Sweeps


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Scenario:
    """A motion, and what touches the robot meanwhile.

    Attributes:
        version: Of this form of file.
        name: As it is called.
        description: What it is for, for people.
        seed: Of motion and contacts, where none other is given.
        plant, world: Of a simulated robot; None for the backend's own.
        posture: Where it begins, by name; None for where the robot stands.
        stiffness: Of the posture task [1/s2].
        settle: Time to reach the first posture [s]; times count from its end.
        motion: What the robot does.
        contacts: What touches it.
        largest_load: Share of what each motor board can hold that a contact and gravity together may take.
        largest_tipping: Share of the moment over an edge between the wheels that would lift the robot; on wheels only.
        source: The file it came from, for messages.
    """

    version: Literal[1]
    name: str
    description: str
    seed: Annotated[int, Field(ge=0)] = 0
    plant: str | None = None
    world: str | None = None
    posture: str | None = None
    stiffness: Positive
    settle: NotNegative = 0.0
    motion: Annotated[Motion, by_kind(Motion)]
    contacts: tuple[Annotated[AnyContact, by_kind(AnyContact)], ...] = ()
    largest_load: Annotated[float, Field(gt=0, le=1)] = 0.85
    largest_tipping: Annotated[float, Field(gt=0, le=1)] = 0.8
    source: str = ""

    @property
    def touched_joints(self) -> tuple[str, ...]:
        """The joints that contacts are meant for, each once, in the order of the file."""
        named = (joint for contact in self.contacts for joint in _joints(contact))
        return tuple(dict.fromkeys(named))


def _joints(contact: AnyContact) -> tuple[str, ...]:
    """The joints a contact may be meant for."""
    if isinstance(contact, RandomPushes):
        return contact.joints
    return () if isinstance(contact, RandomTouch) else (contact.joint,)


def scenario_names() -> tuple[str, ...]:
    """Names of the scenarios shipped with the package."""
    return shipped_names("scenarios")


@with_lines
def load_scenario(name: str | Path, robot: RobotConfig) -> Scenario:
    """Load a scenario by name, or from a path that ends in ``.yaml``.

    Raises:
        UnknownNameError: No shipped scenario has this name.
        ConfigError: The file is wrong; the message names file, key and cure.
    """
    path = named_file("scenario", name, "scenarios")
    source = str(path)
    scenario = parse(Scenario, {**read_yaml(path), "source": source}, source)
    _check_names(scenario, robot)
    _check_angles(scenario, robot)
    _check_base(scenario, robot)
    _check_trunk(scenario, robot)
    _check_contacts(scenario)
    return scenario


def _names(scenario: Scenario) -> Iterator[Name]:
    if scenario.posture is not None:
        yield "posture", "posture", scenario.posture
    yield from ((f"motion.{key}", kind, name) for key, kind, name in scenario.motion.names())
    for number, contact in enumerate(scenario.contacts):
        for key, kind, name in contact.names():
            yield f"contacts.{number}.{key}", kind, name


def _check_names(scenario: Scenario, robot: RobotConfig) -> None:
    known = {"joint": robot.joint_names, "link": robot.links, "posture": tuple(robot.postures)}
    for key, kind, name in _names(scenario):
        if name not in known[kind]:
            raise ConfigError(
                f"{scenario.source}: key '{key}': unknown {kind} '{name}'{suggestion(name, known[kind])}"
            )


def _check_angles(scenario: Scenario, robot: RobotConfig) -> None:
    if not isinstance(scenario.motion, Script):
        return
    for number, step in enumerate(scenario.motion.steps):
        for name, angle in step.joints.items():
            joint = robot.joints[robot.joint_index(name)]
            if not joint.lower <= angle <= joint.upper:
                raise ConfigError(
                    f"{scenario.source}: key 'motion.steps.{number}.joints.{name}': {angle:g} rad lies outside "
                    f"{joint.lower:g} to {joint.upper:g} rad"
                )


def _check_base(scenario: Scenario, robot: RobotConfig) -> None:
    motion = scenario.motion
    if not isinstance(motion, Setpoints) or motion.base is None:
        return
    limits = robot.limits.base
    for key, speed, limit, unit in (
        ("linear", motion.base.linear, limits.linear_velocity, "m/s"),
        ("angular", motion.base.angular, limits.angular_velocity, "rad/s"),
    ):
        if speed > limit:
            raise ConfigError(
                f"{scenario.source}: key 'motion.base.{key}': {speed:g} {unit} is more than the base may do, "
                f"{limit:g} {unit}"
            )


def _check_trunk(scenario: Scenario, robot: RobotConfig) -> None:
    """Random forces act on trunk and base only: what an arm or the head carries is pushed by joint."""
    carried = {
        joint.child: name for name, joint in zip(robot.joint_names, robot.joints, strict=True)
    }
    for number, contact in enumerate(scenario.contacts):
        for place in contact.points if isinstance(contact, RandomForces) else ():
            joint = carried.get(place.link)
            if joint is not None and joint not in robot.chains["legs"]:
                raise ConfigError(
                    f"{scenario.source}: key 'contacts.{number}.points': {place.link} is carried by {joint}; "
                    "push it with random_pushes"
                )


def _check_contacts(scenario: Scenario) -> None:
    """Contacts within the motion, from a known posture, and no two hands on one link at a time."""
    if not scenario.contacts:
        return
    if isinstance(scenario.motion, Sweeps):
        raise ConfigError(
            f"{scenario.source}: key 'contacts': motion of kind sweeps is free motion; leave them out"
        )
    if scenario.posture is None:
        raise ConfigError(
            f"{scenario.source}: key 'posture' is missing: contacts are planned from a known posture"
        )
    hands = sorted(_hands(scenario), key=lambda hand: (hand.link, hand.begin))
    for hand in hands:
        if hand.end > scenario.motion.length:
            raise ConfigError(
                f"{scenario.source}: key '{hand.key}': ends at {hand.end:g} s, after the motion, which is over "
                f"at {scenario.motion.length:g} s"
            )
    for earlier, later in pairwise(hands):
        if earlier.link == later.link and later.begin < earlier.end:
            raise ConfigError(
                f"{scenario.source}: key '{later.key}': a hand on {later.link} at {later.begin:g} s, where that of "
                f"'{earlier.key}' may be until {earlier.end:g} s"
            )


def _hands(scenario: Scenario) -> Iterator[Hand]:
    """All times at which a hand may be on a link."""
    motion = scenario.motion
    for number, contact in enumerate(scenario.contacts):
        key = f"contacts.{number}"
        if not isinstance(contact, RandomTouch):
            end = contact.start + contact.duration
            yield Hand(key=key, link=contact.link, begin=contact.start, end=end)
            continue
        if not isinstance(motion, Setpoints | Holds):
            raise ConfigError(
                f"{scenario.source}: key '{key}': random contacts need a motion of kind setpoints or holds"
            )
        for hand in contact.hands(key):
            if hand.end > motion.period:
                raise ConfigError(
                    f"{scenario.source}: key '{hand.key}': a push may last until {hand.end:g} s, beyond the next "
                    f"goal after {motion.period:g} s"
                )
            for goal in range(motion.count):
                shift = goal * motion.period
                yield Hand(
                    key=hand.key,
                    link=hand.link,
                    begin=hand.begin + shift,
                    end=hand.end + shift,
                )
