"""Parts of the robot description, as typed objects: motors, sensors, limits, wheels, hands, names of the DCM."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.loading import STRICT

MAX_TASK_STIFFNESS = 3000.0
"""[1/s2] Of a task. Beyond about twice this, a cycle of 12 ms is too long for its law: it would never come to rest."""

Positive = Annotated[float, Field(gt=0)]
TaskStiffness = Annotated[float, Field(gt=0, le=MAX_TASK_STIFFNESS)]
NonNegative = Annotated[float, Field(ge=0)]
Vector3 = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class MotorType:
    """Data of one motor, at its shaft: [rad/s], [N m/A], [N m], [ohm], [kg m2]."""

    model: str
    no_load_speed: Positive
    torque_constant: Positive
    stall_torque: Positive
    nominal_torque: Positive
    # Follows from values that NAOqi documents; rotor_inertia is assumed.
    resistance: Positive
    rotor_inertia: Positive


@dataclass(frozen=True, kw_only=True, config=STRICT)
class JointDrive:
    """Motor and reduction of a joint."""

    type: str
    ratio: Positive


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Motors:
    """Motor types by name, and the drive of each joint."""

    types: dict[str, MotorType]
    joints: dict[str, JointDrive]

    def of(self, joint: str) -> MotorType:
        """Return the motor type that drives ``joint``."""
        return self.types[self.joints[joint].type]

    def joint_torque_constant(self, joint: str) -> float:
        """Return the torque at a joint by the current of its motor, N Kt [N m/A]."""
        return self.of(joint).torque_constant * self.joints[joint].ratio


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Frame:
    """A frame fixed to a link: ``xyz`` [m], ``rpy`` [rad] in the parent link."""

    parent: str
    xyz: Vector3
    rpy: Vector3


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TouchSensor(Frame):
    """A surface or switch that answers 0 or 1.

    It answers to contact on ``parent``, or on a link it ``covers``, nearer to its frame than ``radius`` [m], where the
    mean force of a cycle is above ``threshold`` [N].
    """

    radius: Positive
    threshold: NonNegative
    covers: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Encoder:
    """Joint position sensor."""

    bits: Annotated[int, Field(ge=6, le=24)]

    @property
    def step(self) -> float:
        """One count [rad]."""
        return float(2 * np.pi / 2**self.bits)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CurrentSensor:
    """Absolute motor current; ``step`` is its resolution [A]."""

    step: Positive


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Sensors:
    """Sensors of the robot."""

    encoder: Encoder
    current: CurrentSensor
    imu: Frame
    touch: dict[str, TouchSensor]
    bumpers: dict[str, TouchSensor]
    buttons: dict[str, TouchSensor]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CoupledLimit:
    """Limits of one joint that depend on another: rows of (driver, driven lower, driven upper) [rad]."""

    driver: str
    driven: str
    # Linear between rows: the NAOqi page "Joints" does not say.
    table: tuple[Vector3, ...]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class BaseLimits:
    """Limits of the base: [m/s], [rad/s], [m/s2], [rad/s2], [m/s3], [rad/s3]."""

    linear_velocity: Positive
    angular_velocity: Positive
    linear_acceleration: Positive
    angular_acceleration: Positive
    linear_jerk: Positive
    angular_jerk: Positive


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Limits:
    """Limits beyond those of single joints."""

    coupled: tuple[CoupledLimit, ...]
    base: BaseLimits


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Wheels:
    """The three omni-wheels; order of every wheel vector is ``names``."""

    names: tuple[str, str, str]
    radius: Positive
    speed_limit: Positive
    ratio: Positive
    motor_type: str
    positions: tuple[Vector3, Vector3, Vector3]
    twist_to_wheel: tuple[Vector3, Vector3, Vector3]

    @cached_property
    def matrix(self) -> FloatArray:
        """(3, 3): wheel speeds [rad/s] = matrix @ base twist (vx, vy, wz) in base axes."""
        return np.array(self.twist_to_wheel)

    @cached_property
    def inverse(self) -> FloatArray:
        """(3, 3): base twist (vx, vy, wz) in base axes = inverse @ wheel speeds [rad/s]."""
        return np.asarray(np.linalg.inv(self.matrix), dtype=np.float64)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class NaoqiNames:
    """Keys of the DCM, with ``{joint}``, ``{wheel}``, ``{touch}``, ``{bumper}``, ``{button}`` to fill in."""

    prefix: str
    position_command: str
    position: str
    current: str
    temperature: str
    temperature_status: str
    stiffness_command: str
    wheel_speed_command: str
    wheel_speed: str
    wheel_stiffness_command: str
    accelerometer: tuple[str, str, str]
    gyroscope: tuple[str, str, str]
    attitude: tuple[str, str, str]
    touch: str
    bumper: str
    button: str
    battery_charge: str
    charging_flap: str
    time: str


@dataclass(frozen=True, kw_only=True, config=STRICT)
class HandGeometry:
    """LHand and RHand measure aperture: 0 closed, 1 open, carried as if it were radians.

    ``finger_angle`` [rad] is what each phalanx turns per unit of aperture, ``finger_inertia`` [kg m2] the
    (assumed) inertia of all fingers on the aperture coordinate.
    """

    joints: tuple[str, ...]
    finger_angle: Positive
    # The public URDFs give the fingers 2 mg; pepper.yaml explains the value in its place.
    finger_inertia: Positive


def check_bounds(key: str, bounds: tuple[float, float]) -> None:
    """Raise a ValueError unless the first bound is the smaller one."""
    if bounds[0] > bounds[1]:
        raise ValueError(
            f"'{key}': the lower bound {bounds[0]:g} is above the upper, {bounds[1]:g}"
        )
