"""Settings of the driver for NAOqi: times, takeover, readiness."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.loading import STRICT, load, own_or_shipped
from pepper_driver.config.parts import NonNegative, Positive

Policy = Literal["off", "off if allowed", "keep"]
"""Policy for another source of motion: must be off, off if its owner allows it, or left alone."""

Simple = Literal["off", "keep"]
"""The same where no owner is asked."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TakeOverSettings:
    """Parts of NAOqi that are switched off while the robot is active; see ``naoqi_settings.yaml`` for each meaning."""

    autonomous_life: Simple
    touch: Simple
    idle: Simple
    smart_stiffness: Simple
    diagnosis_effect: Simple
    self_collision: Simple
    arm_obstacles: Simple
    base_obstacles: Policy
    fall_manager: Policy
    push_recovery: Policy


@dataclass(frozen=True, kw_only=True, config=STRICT)
class WheelTimes:
    """Dates of each wheel command, from the DCM cycle before it on [s]: dead-man's stop."""

    reach: Positive
    hold: Positive
    # Hazard: the base drives on for about this time [s] after a connection is lost.
    stop: Positive

    def __post_init__(self) -> None:
        """Check what spans fields: the order."""
        if not self.reach <= self.hold < self.stop:
            raise ValueError("'reach' must not be after 'hold', nor 'hold' at or after 'stop'")


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TimingSettings:
    """Execution times of commands and ages of samples; see ``naoqi_settings.yaml`` for the meaning of each."""

    response_delay: Annotated[int, Field(ge=0, le=20)]
    burst: Annotated[float, Field(ge=0.05, le=5.0)]
    max_round_trip: Positive
    lead_margin: NonNegative
    min_lead_time: Positive
    max_lead_time: Positive
    # Commands that wait while a robot hangs are all applied at once: this bounds the jump [rad].
    max_step: Positive
    wheels: WheelTimes
    ramp_up: Positive
    ramp_down: Positive
    leg_return_speed: Positive

    def __post_init__(self) -> None:
        """Check what spans fields: the smallest comes before the largest."""
        if self.min_lead_time > self.max_lead_time:
            raise ValueError("'min_lead_time' must not be above 'max_lead_time'")


@dataclass(frozen=True, kw_only=True, config=STRICT)
class AnglesSettings:
    """Motion of joints through ALMotion, without the DCM; see ``naoqi_settings.yaml`` for the meaning of each."""

    command_period: Annotated[int, Field(ge=2, le=4)]
    speed: Annotated[float, Field(gt=0, le=1)]
    response_delay: Annotated[int, Field(ge=0, le=20)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ForeignCommandSettings:
    """Detection of other programs that command joints or wheels; see ``naoqi_settings.yaml`` for each meaning."""

    action: Literal["stop", "ignore"]
    joint_tolerance: Positive
    wheel_tolerance: Positive
    check_time: Annotated[float, Field(ge=0.1, le=2.0)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class NaoqiSettings:
    """See ``naoqi_settings.yaml`` for the meaning of each; times in [s]."""

    connect_time: Positive
    probe_time: Positive
    call_time: Positive
    take_over_time: Positive
    switch_time: Positive
    alive_time: Positive
    end_silence: Positive
    wheel_stop_time: Positive
    wheel_stop_speed: Positive
    leg_tolerance: Positive
    posture_time: Positive
    tablet_time: Positive
    temperature_status: Annotated[int, Field(ge=0, le=3)]
    # A cable may be in the socket of an open flap.
    charging_flap: Literal["refuse", "stand"]
    # Hazard: with a brake key in, or a brake that does not close, a robot without stiffness bends or falls.
    release_legs: bool
    take_over: TakeOverSettings
    timing: TimingSettings
    foreign_commands: ForeignCommandSettings
    angles: AnglesSettings


def load_naoqi_settings(path: Path | str | None = None) -> NaoqiSettings:
    """Load settings from ``path``, by default the shipped ``naoqi_settings.yaml``."""
    return load(NaoqiSettings, own_or_shipped(path, "naoqi_settings.yaml"))
