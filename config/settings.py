"""Settings of the software, as opposed to facts of the robot: controller, observer, safety gate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import STRICT, load, own_or_shipped
from pepper_driver.config.parts import NonNegative, Positive
from pepper_driver.config.robot import RobotConfig, check_joint_keys

UnitInterval = Annotated[float, Field(ge=0, le=1)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TaskGains:
    """``stiffness`` [1/s2] of a task, with damping 2 sqrt(stiffness), and its ``weight`` in the cost."""

    # 2 sqrt(stiffness) is critical damping: a task arrives without overshoot.
    stiffness: NonNegative
    weight: NonNegative


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ConstraintSwitches:
    """Constraints that the controller starts with, beyond the limits of single joints."""

    coupled_limits: bool
    wheel_speed: bool
    self_collision: bool
    balance: bool


Wave = Literal["sine", "triangle", "glide"]
"""Wave forms of an attentive robot. A ``triangle`` has a constant speed between its turns, which are rounded. A
``glide`` crosses in each turn what the friction of the joint takes away: the joint slides nearly all the time."""

MAX_TURNING = 0.9
"""Part of a swing that a ``glide`` crosses in its turn, at most: the rest is for sliding."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class AttentiveSettings:
    """Oscillation of an attentive robot, on top of posture and motion.

    Attributes:
        joints: That oscillate; those of a limb never turn at the same time.
        wave: Its form.
        amplitude_deg: Of a joint whose friction is unknown [deg].
        slide_deg: Part of the amplitude beyond the friction of a joint, where it is known [deg].
        max_amplitude_deg: Of any joint [deg].
        period: [s]
        turn_time: Duration of a turn of ``triangle`` and ``glide`` [s].
        fade_time: From rest to the full amplitude, and back [s].
        max_temperature: Of a motor [deg C]; the joint of a hotter one stands still.
        friction_deg: By joint whose friction was identified, half of what it takes away from a swing [deg].
    """

    joints: list[str]
    wave: Wave
    amplitude_deg: Annotated[float, Field(ge=0, le=5)]
    slide_deg: Annotated[float, Field(ge=0, le=5)]
    max_amplitude_deg: Annotated[float, Field(ge=0, le=5)]
    period: Annotated[float, Field(ge=0.5, le=60)]
    turn_time: Annotated[float, Field(ge=0.1, le=10)]
    fade_time: Annotated[float, Field(ge=0.5, le=60)]
    max_temperature: float
    friction_deg: dict[str, NonNegative] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check what spans fields: two turns fit into a period, and some sliding between them."""
        if self.turn_time > 0.4 * self.period:
            raise ValueError("'turn_time' must not be above 0.4 of 'period'")

    def amplitude(self, joint: str) -> float:
        """Return the amplitude of a joint [rad]: more than its friction takes away."""
        if joint not in self.friction_deg:
            return float(np.radians(self.amplitude_deg))
        needed_deg = self.friction_deg[joint] + self.slide_deg
        return float(np.radians(min(needed_deg, self.max_amplitude_deg)))

    def turning(self, joint: str) -> float:
        """Return the part of a swing that a joint crosses in its turn, 0 to MAX_TURNING: what friction takes away.

        It is 0 for a joint whose friction is unknown: if it is less than assumed, the joint would jump.
        """
        amplitude = self.amplitude(joint)
        if self.wave != "glide" or joint not in self.friction_deg or amplitude == 0.0:
            return 0.0
        return min(float(np.radians(self.friction_deg[joint])) / amplitude, MAX_TURNING)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ControllerSettings:
    """Defaults of the whole-body controller; see ``controller.yaml`` for the meaning of each.

    Limits per joint are in [rad/s], [rad/s2] and [rad/s3], ``regularisation`` is a ratio.
    """

    solver: str
    feedback: Literal["none", "joints"]
    feedback_time: Positive
    posture: TaskGains
    base: TaskGains
    attentive: AttentiveSettings
    regularisation: Positive
    rest_rate: Positive
    return_speed: Positive
    min_return_time: Positive
    velocity: Literal["safe", "robot"]
    velocity_limit: dict[str, Positive]
    measured_velocity_ratio: Annotated[float, Field(gt=0, le=1)]
    measured_velocity_limit: Positive
    acceleration_limit: dict[str, Positive]
    jerk_limit: dict[str, Positive] | None
    position_limit: Literal["braking", "damper"]
    position_margin: NonNegative
    constraints: ConstraintSwitches

    def joint_velocity(self, robot: RobotConfig) -> FloatArray:
        """(17,) the joint speeds in force [rad/s]: the safe table, or the robot's own limits.

        Raises:
            ConfigError: The table lacks a joint.
        """
        if self.velocity == "robot":
            return np.array([joint.velocity for joint in robot.joints])
        return _of_joints("velocity_limit", self.velocity_limit, robot)

    def with_measured_speeds(self, speeds: Mapping[str, float]) -> Self:
        """Return the settings for a robot whose joints were measured to reach these speeds, by joint [rad/s]."""
        limits = {
            name: min(self.measured_velocity_ratio * speed, self.measured_velocity_limit)
            for name, speed in speeds.items()
        }
        return replace(self, velocity_limit=self.velocity_limit | limits)

    def with_friction(self, errors: Mapping[str, float]) -> Self:
        """Return the settings for a robot of which friction takes so much away from each swing, by joint [rad].

        Args:
            errors: Half of what it takes away from peak to peak.
        """
        friction = {name: float(np.degrees(error)) for name, error in errors.items()}
        return replace(self, attentive=replace(self.attentive, friction_deg=friction))

    def joint_acceleration(self, robot: RobotConfig) -> FloatArray:
        """(17,) limits [rad/s2].

        Raises:
            ConfigError: The table lacks a joint.
        """
        return _of_joints("acceleration_limit", self.acceleration_limit, robot)

    def joint_jerk(self, robot: RobotConfig) -> FloatArray | None:
        """(17,) limits [rad/s3]; None for none.

        Raises:
            ConfigError: The table lacks a joint.
        """
        if self.jerk_limit is None:
            return None
        return _of_joints("jerk_limit", self.jerk_limit, robot)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ObserverSettings:
    """Defaults of the contact observer; times in [s].

    Attributes:
        tree: Kind of the models of mode ``paper``.
        median_window: Samples of the filter of mode ``paper``.
        threshold: Of mode ``paper``, for all joints [rad]; None for each joint's own, which identification found in
            free motion.
        fusion_window: Samples of the filter of mode ``fusion``.
        false_contacts: That are allowed in an hour (mode ``fusion``); fewer raise its thresholds.
        adapt: True if mode ``fusion`` follows bias, spread and loads of the robot of today.
        collision_factor: A residual beyond so many thresholds is a collision (mode ``fusion``).
        merge_gap: A residual that returns with the same sign within this time continues the contact.
        rebound_window: After a contact, a residual of the other sign is the joint swinging back.
        update_period: At least, before the next update of a contact of which only intensity or torque change [s].
    """

    tree: Literal["cart", "affine"]
    median_window: Annotated[int, Field(ge=1, le=101)]
    threshold: Positive | None
    fusion_window: Annotated[int, Field(ge=1, le=101)]
    false_contacts: Positive
    adapt: bool
    collision_factor: Annotated[float, Field(gt=1)]
    merge_gap: NonNegative
    rebound_window: NonNegative
    update_period: Positive


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SafetySettings:
    """Limits of the gate; see ``safety.yaml`` for the meaning of each."""

    speed_margin: Annotated[float, Field(ge=1)]
    acceleration_margin: Annotated[float, Field(ge=1)]
    following_error: Positive
    following_error_time: Positive
    # 2 switches the check off, for a robot that never shows the stiffness of its command.
    stiffness_loss: Positive
    stiffness_time: NonNegative
    frozen_distance: Positive
    frozen_motion: Positive
    frozen_time: Positive
    stale_hold: Positive
    stale_fault: Positive
    stiffness_ramp: Positive
    temperature_warning: float
    temperature_fault: float
    battery_warning: UnitInterval
    battery_activate: UnitInterval
    battery_fault: UnitInterval
    limit_warning: Positive
    limit_activate: Positive
    bumper_release: NonNegative
    # Hazard: false takes away one of the ways to stop the robot.
    chest_button: bool
    check_period: Annotated[float, Field(ge=0.1, le=5.0)]
    confirmations: Annotated[int, Field(ge=1, le=20)]
    min_driven_stiffness: UnitInterval
    drive_time: Annotated[float, Field(ge=0.1, le=5.0)]
    caller_silence: Annotated[float, Field(ge=0.03, le=0.5)]
    callback_time: Annotated[float, Field(ge=0.1, le=60.0)]
    tick_time: Annotated[float, Field(gt=0.0, le=60.0)]
    close_time: Annotated[float, Field(gt=0.0, le=60.0)]

    def __post_init__(self) -> None:
        """Check what spans fields: warnings come before faults."""
        for less, more in (
            ("stale_hold", "stale_fault"),
            ("temperature_warning", "temperature_fault"),
            ("battery_fault", "battery_activate"),
            ("battery_activate", "battery_warning"),
            ("limit_warning", "limit_activate"),
        ):
            if getattr(self, less) > getattr(self, more):
                raise ValueError(f"'{less}' must not be above '{more}'")


@checked_arguments
@with_lines
def load_controller_settings(
    robot: RobotConfig, path: Path | str | None = None
) -> ControllerSettings:
    """Load controller settings from ``path``, by default the shipped ``controller.yaml``."""
    path = own_or_shipped(path, "controller.yaml")
    settings = load(ControllerSettings, path)
    for key in ("velocity_limit", "acceleration_limit", "jerk_limit"):
        table = getattr(settings, key)
        if table is not None:
            check_joint_keys(set(table), set(robot.joint_names), f"{path}: key '{key}'")
    return settings


def load_observer_settings(path: Path | str | None = None) -> ObserverSettings:
    """Load observer settings from ``path``, by default the shipped ``observer.yaml``."""
    return load(ObserverSettings, own_or_shipped(path, "observer.yaml"))


def load_safety_settings(path: Path | str | None = None) -> SafetySettings:
    """Load safety settings from ``path``, by default the shipped ``safety.yaml``."""
    return load(SafetySettings, own_or_shipped(path, "safety.yaml"))


def _of_joints(key: str, table: dict[str, float], robot: RobotConfig) -> FloatArray:
    """(17,) a table's values in joint order. Tables from files are complete, those of ``replace`` need not be."""
    check_joint_keys(set(table), set(robot.joint_names), f"controller settings: key '{key}'")
    return np.array([table[name] for name in robot.joint_names])
