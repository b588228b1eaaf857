"""Parameters of a simulated Pepper: ``plants/*.yaml``, or a file of the user's own."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.errors import ConfigError, UnknownNameError, suggestion
from pepper_driver.config.loading import STRICT, load, package_file
from pepper_driver.config.parts import FloatArray, NotNegative, Positive
from pepper_driver.config.robot import RobotConfig, check_joint_keys


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Physics:
    """Integration of the equations of motion.

    ``timestep`` [s] divides the 12 ms cycle; the mechanical stops lie ``stop_margin`` [rad] beyond the limits.
    """

    timestep: Annotated[float, Field(gt=0, le=0.002)]
    stop_margin: NotNegative


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Board:
    """Motor board: its law runs once a physics step on its own encoder and clips at ``voltage`` [V].

    ``derivative_time`` [s] is the time constant of the low-pass on the derivative of the error; ``brakes`` names the
    joints that hold when their stiffness is 0.
    """

    voltage: Positive
    encoder_bits: Annotated[int, Field(ge=8, le=24)]
    derivative_time: Positive
    brakes: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Transport:
    """What lies between the physics and the reader: ``encoder_delay`` in ticks, noise as standard deviations.

    ``encoder_noise`` [rad], ``current_noise`` [A]; ``current_time`` [s] and ``wheel_time`` [s] are the time constants
    of the current's low-pass and of the wheels' speed control.
    """

    encoder_delay: Annotated[int, Field(ge=0, le=20)]
    encoder_noise: NotNegative
    current_noise: NotNegative
    current_time: Positive
    wheel_time: Positive


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Actuator:
    """Drive of one or several joints, seen at the joint unless said otherwise.

    ``kp`` [V/rad], ``kd`` [V s/rad] board gains; ``current_limit`` [A] at stiffness 1; ``half_gap`` [rad] half the
    backlash; ``gear_stiffness`` [N m/rad] and ``gear_damping`` [N m s/rad] of teeth in contact; ``motor_friction``
    and ``link_friction`` [N m] Coulomb; ``link_damping`` [N m s/rad]; ``motor_damping`` [N m s/rad] at the shaft.
    """

    joints: tuple[str, ...]
    kp: Positive
    kd: NotNegative
    current_limit: Positive
    half_gap: NotNegative
    gear_stiffness: Positive
    gear_damping: NotNegative
    motor_friction: NotNegative
    link_friction: NotNegative
    link_damping: NotNegative
    motor_damping: NotNegative


@dataclass(frozen=True, kw_only=True, config=STRICT)
class PlantConfig:
    """One simulated robot. Every joint stands in exactly one entry of ``actuators``."""

    name: str
    description: str
    base: Literal["fixed"]
    physics: Physics
    board: Board
    transport: Transport
    actuators: tuple[Actuator, ...]

    def per_joint(self, field: str, robot: RobotConfig) -> FloatArray:
        """(17,) the values of one field of :class:`Actuator`, in joint order."""
        by_joint = {name: getattr(a, field) for a in self.actuators for name in a.joints}
        return np.array([by_joint[name] for name in robot.joint_names], dtype=np.float64)


def plant_names() -> tuple[str, ...]:
    """Names of the plants shipped with the package."""
    return tuple(sorted(path.stem for path in package_file("plants").glob("*.yaml")))


def load_plant(name: str, robot: RobotConfig) -> PlantConfig:
    """Load a plant by name, or from a path that ends in ``.yaml``.

    Raises:
        UnknownNameError: No shipped plant has this name.
        ConfigError: The file is wrong; the message names file and key.
    """
    if name.endswith((".yaml", ".yml")):
        path = Path(name)
    elif name in plant_names():
        path = package_file("plants", f"{name}.yaml")
    else:
        raise UnknownNameError("plant", name, plant_names())
    plant = load(PlantConfig, path)
    _check(plant, robot, str(path))
    return plant


def _check(plant: PlantConfig, robot: RobotConfig, source: str) -> None:
    """What a single field cannot know: joints complete, steps whole, gaps narrower than the joint's range."""
    for name in plant.board.brakes:
        if name not in robot.joint_names:
            raise ConfigError(
                f"{source}: key 'board.brakes': unknown joint '{name}'"
                f"{suggestion(name, robot.joint_names)}"
            )
    seen: set[str] = set()
    for index, actuator in enumerate(plant.actuators):
        where = f"{source}: key 'actuators.{index}"
        for name in actuator.joints:
            if name in seen:
                raise ConfigError(f"{where}.joints': joint {name} already has an actuator")
            if name not in robot.joint_names:
                raise ConfigError(
                    f"{where}.joints': unknown joint '{name}'{suggestion(name, robot.joint_names)}"
                )
            joint = robot.joints[robot.joint_index(name)]
            if 2 * actuator.half_gap >= joint.upper - joint.lower:
                raise ConfigError(
                    f"{where}.half_gap': the gap of {name} is wider than the joint's range"
                )
            seen.add(name)
    check_joint_keys(seen, set(robot.joint_names), f"{source}: key 'actuators'")
    steps = robot.cycle / plant.physics.timestep
    if abs(steps - round(steps)) > 1e-6:
        raise ConfigError(
            f"{source}: key 'physics.timestep': {plant.physics.timestep} s does not divide the cycle "
            f"of {robot.cycle} s into whole steps"
        )


def plant_hash(plant: PlantConfig, robot: RobotConfig) -> str:
    """Identity of a simulated robot: plant, URDF, motors, sensors, hands. Models carry it to be told from stale ones.

    Comments, name and description do not count.
    """
    parameters = asdict(plant)
    del parameters["name"], parameters["description"]
    content = {
        "plant": parameters,
        "motors": asdict(robot.motors),
        "sensors": asdict(robot.sensors),
        "hands": asdict(robot.hands),
        "urdf": hashlib.sha256(robot.urdf.read_bytes()).hexdigest(),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
