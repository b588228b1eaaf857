"""Settings of the stand-in's services: how ALMotion moves the robot, and how long speech takes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.errors import ConfigError, suggestion
from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import STRICT, load, own_or_shipped
from pepper_driver.config.parts import NonNegative, Positive, Vector3
from pepper_driver.config.robot import RobotConfig, check_joint_keys

UnitInterval = Annotated[float, Field(gt=0, le=1)]
Range = tuple[Positive, Positive, Positive]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Breathing:
    """A sine of ``period`` [s] and ``amplitude`` [rad], times the factor of each joint that takes part."""

    period: Positive
    amplitude: Positive
    joints: dict[str, float]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Glance:
    """The head looks elsewhere every ``period`` [s], by ``yaw`` and ``pitch`` [rad], at a ``fraction`` of its speed."""

    period: Positive
    yaw: Positive
    pitch: Positive
    fraction: UnitInterval


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Speech:
    """``start`` [s] until the first word, then so many ``characters`` a second at the voice's speed 100."""

    start: NonNegative
    characters: Positive


@dataclass(frozen=True, kw_only=True, config=STRICT)
class DriveDefaults:
    """Drive parameters of Pepper's base, by NAOqi's names: minimum, default, maximum."""

    MaxVelXY: Range
    MaxVelTheta: Range
    MaxAccXY: Range
    MaxAccTheta: Range
    MaxJerkXY: Range
    MaxJerkTheta: Range

    def __post_init__(self) -> None:
        """Check what spans fields."""
        for name, (least, usual, most) in vars(self).items():
            if not least <= usual <= most:
                raise ValueError(f"'{name}' must be minimum, default, maximum")


@dataclass(frozen=True, kw_only=True, config=STRICT)
class NaoqiServices:
    """See ``naoqi_services.yaml`` for the meaning of each."""

    # A text for clients: it does not change what the services do.
    version: str
    robot_name: str
    cycle: Positive
    # ALMotion is a user of the DCM: its commands need an execution time ahead, like those of any other.
    lead_time: Positive
    chains: dict[str, tuple[str, ...]]
    torso: Vector3
    hand: Vector3
    rise: Positive
    posture_speed: Positive
    # NAOqi describes its own posture of rest only in words.
    rest: str
    stiffness_ramp: Positive
    smart_stiffness: UnitInterval
    breathing: Breathing
    glance: Glance
    drive: DriveDefaults
    move_gain: NonNegative
    move_tolerance: tuple[Positive, Positive]
    move_patience: Positive
    speech: Speech


@with_lines
def load_naoqi_services(robot: RobotConfig, path: Path | str | None = None) -> NaoqiServices:
    """Load settings from ``path``, by default the shipped ``naoqi_services.yaml``.

    Raises:
        ConfigError: A mistake in the file, a joint that ``robot`` lacks or that is in no chain, an unknown posture.
    """
    path = own_or_shipped(path, "naoqi_services.yaml")
    settings = load(NaoqiServices, path)
    named = {joint for chain in settings.chains.values() for joint in chain}
    check_joint_keys(named, set(robot.joint_names), f"{path}: key 'chains'")
    for joint in settings.breathing.joints:
        if joint not in named:
            raise ConfigError(
                f"{path}: key 'breathing.joints': unknown joint '{joint}'{suggestion(joint, named)}"
            )
    if settings.rest not in robot.postures:
        raise ConfigError(
            f"{path}: key 'rest': unknown posture '{settings.rest}'"
            f"{suggestion(settings.rest, robot.postures)}"
        )
    return settings
