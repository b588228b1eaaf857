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
from pepper_driver.config.plant_variants import Randomisation, randomise, resolve
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
        return self.transport.command_delay + self.transport.encoder_delay

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
def load_plant(name: str, robot: RobotConfig, *, draw: int | None = None) -> PlantConfig:
    """Load a plant by name, or from a path that ends in ``.yaml``.

    Args:
        name: Of a shipped plant, or a path.
        robot: The robot it simulates.
        draw: Which robot of a plant with a ``randomise`` section; None for the first. Equal draws give equal robots.

    Raises:
        UnknownNameError: No shipped plant has this name.
        ConfigError: The file is wrong, the message names file and key; or ``draw`` is given and nothing is drawn.
    """
    path = _plant_path(name)
    data, _ = resolve(path, _plant_path, robot)
    source = str(path)
    drawing = data.pop("randomise", None)
    if drawing is not None:
        if draw is not None and draw < 0:
            raise ConfigError(f"{source}: draw takes a whole number from 0, got {draw}")
        if not isinstance(drawing, dict):
            raise ConfigError(f"{source}: key 'randomise': expected a mapping of keys to values")
        ranges = parse(Randomisation, drawing, f"{source}: key 'randomise'")
        randomise(data, ranges, robot, draw or 0, source)
    elif draw is not None:
        raise ConfigError(
            f"{source}: draws nothing (no key 'randomise'), so draw={draw} says nothing"
        )
    plant = parse(PlantConfig, {**data, "source": source}, source)
    _check(plant, robot, source)
    return plant


def draws(name: str, robot: RobotConfig) -> bool:
    """Return true if a plant, by name or path, is drawn again for each ``draw``."""
    data, _ = resolve(_plant_path(name), _plant_path, robot)
    return "randomise" in data


@with_lines
def parent_plants(
    name: str, robot: RobotConfig, *, draw: int | None = None
) -> tuple[RobotIdentity, ...]:
    """Return the plants of which a plant is a variant, nearest first.

    They are those that it extends, and of a plant that is drawn its first draw before these.

    Args:
        name: Of a shipped plant, or a path.
        robot: The robot it simulates.
        draw: Which robot of a plant with a ``randomise`` section; the same draw of what it extends comes first.

    Raises:
        UnknownNameError: No shipped plant has this name.
        ConfigError: A file cannot be read, or names a joint, key or plant that does not exist.
    """
    path = _plant_path(name)
    _, extended = resolve(path, _plant_path, robot)
    candidates: list[tuple[Path, int | None]] = [(path, None)] if draw else []
    candidates += [(file, number) for file in extended for number in dict.fromkeys((draw, None))]
    parents = []
    for file, number in candidates:
        with suppress(ConfigError):  # it draws nothing, or is no robot without what extends it
            plant = load_plant(str(file), robot, draw=number)
            parents.append(RobotIdentity(name=plant.name, identity=plant_hash(plant, robot)))
    return tuple(dict.fromkeys(parents))


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
