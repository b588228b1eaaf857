"""Parameters of a simulated Pepper: ``plants/*.yaml``, or a file of the user's own."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict
from functools import reduce
from math import isfinite
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic.dataclasses import dataclass

from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import ConfigError, suggestion
from pepper_driver.config.files import content_hash
from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import STRICT, named_file, parse, shipped_names
from pepper_driver.config.plant_parts import (
    Actuator,
    Battery,
    Board,
    BodyParameters,
    Flexibility,
    Heat,
    Physics,
    Targets,
    Transport,
    WheelDrive,
)
from pepper_driver.config.plant_variants import Randomisation, Tree, randomise, resolve
from pepper_driver.config.population import check_draw
from pepper_driver.config.robot import RobotConfig, check_joint_keys
from pepper_driver.config.visuals import without_visuals


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RobotIdentity:
    """A robot as models and people know it.

    Attributes:
        name: Human-readable: plant of a simulated robot, or address of a real one.
        identity: Hash of the simulated robot, or the body id of a real one. Models carry it.
    """

    name: str
    identity: str


@dataclass(frozen=True, kw_only=True, config=STRICT)
class PlantConfig:
    """One simulated robot. Every joint stands in exactly one entry of ``actuators``.

    On a ``fixed`` base the wheels hang in the air; a ``rolling`` one stands on them, drives and tips.
    ``source`` is the file it came from, for messages.
    """

    name: str
    description: str
    base: Literal["fixed", "rolling"]
    physics: Physics
    board: Board
    targets: Targets
    transport: Transport
    battery: Battery
    heat: Heat
    wheels: WheelDrive
    flexibilities: tuple[Flexibility, ...]
    body: BodyParameters
    actuators: tuple[Actuator, ...]
    source: str = ""

    @property
    def response_delay(self) -> int:
        """Whole ticks from a command to the sample that shows the joint at the time it was to be reached."""
        return self.transport.command_delay + self.transport.sensor_delay

    def actuator(self, joint: str) -> Actuator:
        """Return the drive of a joint."""
        return next(entry for entry in self.actuators if joint in entry.joints)

    def per_joint(self, field: str, robot: RobotConfig) -> FloatArray:
        """(17,) the values of one field of :class:`Actuator`, dotted where nested, in joint order."""
        parts = field.split(".")
        by_joint = {name: reduce(getattr, parts, a) for a in self.actuators for name in a.joints}
        return np.array([by_joint[name] for name in robot.joint_names], dtype=np.float64)


def plant_names() -> tuple[str, ...]:
    """Names of the plants shipped with the package."""
    return shipped_names("plants")


@checked_arguments
@with_lines
def load_plant(
    name: str, robot: RobotConfig, *, draw: int | None = None, day: int | None = None
) -> PlantConfig:
    """Load a plant by name, or from a path that ends in ``.yaml``.

    Args:
        name: Of a shipped plant, or a path.
        robot: The robot it simulates.
        draw: Which robot of a plant with a ``randomise`` section; None for the first. Equal draws give equal robots.
        day: Which day of this robot, where the section has ``days``; 0 or None for the first, the draw itself.

    Raises:
        UnknownNameError: No shipped plant has this name.
        HeldOutDrawError: The draw is for tests only.
        ConfigError: The file is wrong, the message names file and key; or ``draw`` or ``day`` is given and there is
            nothing to draw.
    """
    path = _plant_path(name)
    source = str(path)
    data, _, drawing = _read(path, robot, draw, day)
    if drawing is not None:
        randomise(data, drawing, robot, source, draw=draw or 0, day=day or 0)
    plant = parse(PlantConfig, {**data, "source": source}, source)
    _check(plant, robot, source)
    return plant


def _read(
    path: Path, robot: RobotConfig, draw: int | None, day: int | None
) -> tuple[Tree, tuple[Path, ...], Randomisation | None]:
    """Return the mapping of a plant before anything is drawn, the files it extends, and what is to be drawn."""
    source = str(path)
    for what, number in (("draw", draw), ("day", day)):
        if number is not None and number < 0:
            raise ConfigError(f"{source}: {what} takes a whole number from 0, got {number}")
    data, extended = resolve(path, _plant_path, robot, draw or 0)
    section = data.pop("randomise", None)
    drawing = None
    if section is not None:
        where = f"{source}: key 'randomise'"
        if not isinstance(section, dict):
            raise ConfigError(f"{where}: expected a mapping of keys to values")
        drawing = parse(Randomisation, section, where)
        check_draw(draw or 0, source)
    elif draw is not None:
        raise ConfigError(
            f"{source}: draws nothing (no key 'randomise'), so draw={draw} says nothing"
        )
    if day is not None and (drawing is None or drawing.days is None):
        raise ConfigError(
            f"{source}: all days of its robots are alike (no key 'randomise.days'), so day={day} says nothing"
        )
    return data, extended, drawing


def draws(name: str, robot: RobotConfig) -> bool:
    """Return true if a plant, by name or path, is drawn again for each ``draw``."""
    data, _ = resolve(_plant_path(name), _plant_path, robot)
    return "randomise" in data


@with_lines
def parent_plants(
    name: str, robot: RobotConfig, *, draw: int | None = None, day: int | None = None
) -> tuple[RobotIdentity, ...]:
    """Return the plants of which a plant is a variant, nearest first.

    A robot on another day is a variant of itself on the first one, then of what its plant extends. Where draws are
    not robots with days of their own, they are the same robot, and the first draw comes before what the plant extends.

    Args:
        name: Of a shipped plant, or a path.
        robot: The robot it simulates.
        draw: Which robot of a plant with a ``randomise`` section; the same draw of what it extends comes first.
        day: Which day of this robot.

    Raises:
        UnknownNameError: No shipped plant has this name.
        HeldOutDrawError: The draw is for tests only.
        ConfigError: A file cannot be read, or names a joint, key or plant that does not exist.
    """
    path = _plant_path(name)
    _, extended, drawing = _read(path, robot, draw, day)
    candidates = [(path, draw)] if day else []
    if draw and not _has_days(drawing):
        candidates.append((path, None))
    candidates += [(file, number) for file in extended for number in _draws_of(file, robot, draw)]
    parents = []
    for file, number in candidates:
        with suppress(ConfigError):  # it draws nothing, or is no robot without what extends it
            plant = load_plant(str(file), robot, draw=number)
            parents.append(RobotIdentity(name=plant.name, identity=plant_hash(plant, robot)))
    return tuple(dict.fromkeys(parents))


def _draws_of(path: Path, robot: RobotConfig, draw: int | None) -> tuple[int | None, ...]:
    """Return the draws of a plant of which one is a variant that extends it: the same, then the first."""
    try:
        _, _, drawing = _read(path, robot, draw, None)
    except ConfigError:  # it draws nothing
        return (None,)
    return (draw,) if _has_days(drawing) else tuple(dict.fromkeys((draw, None)))


def _has_days(drawing: Randomisation | None) -> bool:
    return drawing is not None and drawing.days is not None


def _plant_path(name: str) -> Path:
    return named_file("plant", name, "plants")


def _check(plant: PlantConfig, robot: RobotConfig, source: str) -> None:
    """Check what spans fields: joints complete, steps whole, gaps narrower than the joint's range."""
    for key, names, known in (
        ("board.brakes", plant.board.brakes, robot.joint_names),
        ("targets.fast_joints", plant.targets.fast_joints, robot.joint_names),
        ("flexibilities", [f.joint for f in plant.flexibilities], robot.joint_names),
        ("heat.rise", plant.heat.rise, robot.motors.types),
        ("body.masses", plant.body.masses, robot.links),
        ("body.coms", plant.body.coms, robot.links),
        ("body.payloads", [p.link for p in plant.body.payloads], robot.links),
    ):
        _check_names(names, known, f"{source}: key '{key}'")
    missing = sorted(set(robot.motors.types) - set(plant.heat.rise))
    if missing:
        raise ConfigError(
            f"{source}: key 'heat.rise': no entry for motor type {', '.join(missing)}"
        )
    for number, flexibility in enumerate(plant.flexibilities):
        if not any(flexibility.axis):
            raise ConfigError(
                f"{source}: key 'flexibilities.{number}.axis': the axis has no length"
            )
    if plant.targets.stray[0] > plant.targets.stray[1]:
        raise ConfigError(f"{source}: key 'targets.stray': the largest size is below the smallest")
    if plant.battery.empty_voltage >= plant.battery.full_voltage:
        raise ConfigError(
            f"{source}: key 'battery.empty_voltage': not below 'battery.full_voltage'"
        )
    _check_actuators(plant, robot, source)
    steps = robot.cycle / plant.physics.timestep
    # The quotient of two decimal fractions is rarely exact.
    if not isfinite(steps) or abs(steps - round(steps)) > 1e-6:
        raise ConfigError(
            f"{source}: key 'physics.timestep': {plant.physics.timestep} s does not divide the cycle "
            f"of {robot.cycle} s into whole steps"
        )


def _check_actuators(plant: PlantConfig, robot: RobotConfig, source: str) -> None:
    seen: set[str] = set()
    for index, actuator in enumerate(plant.actuators):
        where = f"{source}: key 'actuators.{index}"
        _check_names(actuator.joints, robot.joint_names, f"{where}.joints'")
        for name in actuator.joints:
            if name in seen:
                raise ConfigError(f"{where}.joints': joint {name} already has an actuator")
            joint = robot.joints[robot.joint_index(name)]
            if 2 * actuator.half_gap >= joint.upper - joint.lower:
                raise ConfigError(
                    f"{where}.half_gap': the gap of {name} is wider than the joint's range"
                )
            seen.add(name)
    check_joint_keys(seen, set(robot.joint_names), f"{source}: key 'actuators'")


def _check_names(names: Iterable[str], known: Iterable[str], where: str) -> None:
    known = tuple(known)
    for name in names:
        if name not in known:
            raise ConfigError(f"{where}: unknown name '{name}'{suggestion(name, known)}")


def plant_hash(plant: PlantConfig, robot: RobotConfig) -> str:
    """Identity of a simulated robot: plant, URDF, motors, encoders, hands. Models carry it to detect stale ones.

    Visual geometry, name, description, source and origins do not count.
    """
    parameters: dict[str, Any] = asdict(plant)
    # A model must remain valid when only words of its plant change.
    for key in ("name", "description", "source"):
        del parameters[key]
    for actuator in parameters["actuators"]:
        del actuator["origin"]
    content = {
        "plant": parameters,
        "motors": asdict(robot.motors),
        "encoder": asdict(robot.sensors.encoder),
        "current": asdict(robot.sensors.current),
        "hands": asdict(robot.hands),
        "urdf": hashlib.sha256(without_visuals(robot.urdf.read_bytes())).hexdigest(),
    }
    return content_hash(content)
