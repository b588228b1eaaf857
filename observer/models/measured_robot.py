"""Facts about one robot that identification measures before it fits models; they are kept in the model file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import ConfigDict, Field

from pepper_driver.config.loading import STRICT
from pepper_driver.config.parts import NonNegative, Positive
from pepper_driver.config.settings import UnitInterval


@dataclass(frozen=True, kw_only=True)
class MeasuredJoint:
    """Facts about one joint; None where the runs do not show them. Torques are by the documented torque constant.

    Attributes:
        encoder_noise: Standard deviation at rest [rad]; None for a joint that never rests.
        current_noise: The same of the current [A].
        dead_band: Error that it needs before it moves, to either side [rad]: of its board, and of its friction.
        friction: Torque of the motor against friction in slow motion [N m].
        load_scale: Torque of the motor per torque of the load that the robot's description asks for.
        torque_scale: Torque of the motor per torque at the joint, by a known weight.
        speed: Speed that it reaches [rad/s]: its limit, or the fastest that was commanded.
        speed_limited: True where ``speed`` is its limit.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    encoder_noise: NonNegative | None = None
    current_noise: NonNegative | None = None
    dead_band: NonNegative | None = None
    friction: NonNegative | None = None
    load_scale: Positive | None = None
    torque_scale: Positive | None = None
    speed: Positive | None = None
    speed_limited: bool = False


@dataclass(frozen=True, kw_only=True)
class MeasuredRobot:
    """Facts about a robot.

    Attributes:
        reported_delay: Ticks from a command to the sample that answers it, as the backend said then.
        delay_error: Ticks by which currents answer later than that, earlier if negative.
        delay_spread: The same of single steps, 10th and 90th percentile.
        late: Fraction of samples that came late.
        lost: Fraction of samples of a joint in motion that repeat the one before.
        weight: That was held [kg]; None for none.
        weight_doubt: Reason for which a weight does not count: no joint has a scale of torques by it. None for none.
        joints: By name.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    reported_delay: Annotated[int, Field(ge=0)]
    delay_error: int
    delay_spread: tuple[float, float]
    late: UnitInterval
    lost: UnitInterval
    weight: Positive | None
    joints: Mapping[str, MeasuredJoint]
    weight_doubt: str | None = None

    @property
    def speeds(self) -> dict[str, float]:
        """Speed that joints reach, by those whose speed was measured [rad/s]."""
        return {name: one.speed for name, one in self.joints.items() if one.speed is not None}

    @property
    def target_speeds(self) -> dict[str, float]:
        """Speed at which the boards hold their targets, of joints whose board limits it [rad/s]."""
        return {
            name: one.speed
            for name, one in self.joints.items()
            if one.speed_limited and one.speed is not None
        }

    @property
    def response_delay(self) -> int:
        """Ticks from a command to the sample that answers it, as measured."""
        return max(0, self.reported_delay + self.delay_error)
