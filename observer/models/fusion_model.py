"""Models of mode ``fusion``: of one joint in free motion, with its momentum channel, and of the base."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import ConfigDict, Field

from pepper_driver.config import PepperError
from pepper_driver.config.loading import STRICT
from pepper_driver.observer.models.stick_slip import StickSlipParameters
from pepper_driver.observer.models.tree import Triple

OUTPUTS = ("vx", "vy", "wz", "yaw rate", "ax", "ay")
"""Of the base: twist by the wheels [m/s], [m/s], [rad/s]; by the inertial unit [rad/s], [m/s2], [m/s2]."""

Six = tuple[float, float, float, float, float, float]

TAPS = 25
"""Ticks of the impulse response: 0.3 s, after which the wheels have settled."""


UNSEEN_SPREAD = 1e6
"""Spread of an output that no recording of the identification shows: it is never judged."""


class BaseModelError(PepperError, ValueError):
    """Invalid values of a base model."""


@dataclass(frozen=True, kw_only=True)
class BaseModel:
    """Model of the motion of the base: OUTPUTS.

    Attributes:
        coefficients: One row of six outputs per input: first the inputs of this tick, then of the previous one, and so
            on.
        still: Spread of the residuals while neither base nor joints move, or joints move slowly.
        moving: Spread while joints move.
        shaking: Spread while joints move with large accelerations.
        driving: Spread while the base is commanded to drive.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    coefficients: Annotated[tuple[Six, ...], Field(min_length=1)]
    still: Six
    moving: Six
    shaking: Six
    driving: Six

    def __post_init__(self) -> None:
        if len(self.coefficients) % TAPS:
            raise BaseModelError(f"'coefficients' must be a multiple of {TAPS} rows")
        values = [*self.still, *self.moving, *self.shaking, *self.driving]
        if not (np.isfinite(self.coefficients).all() and np.isfinite(values).all()):
            raise BaseModelError("a value is not finite")
        if min(values) <= 0.0:
            raise BaseModelError("a spread must be above 0")

    @property
    def has_inertial_unit(self) -> bool:
        """True if the identification has seen an inertial unit that works."""
        return min(self.still[3:]) < UNSEEN_SPREAD


MotorTorque = Literal["current", "voltage"]


class MomentumError(PepperError, ValueError):
    """Invalid parameters of a momentum channel."""


@dataclass(frozen=True, kw_only=True)
class MomentumParameters:
    """Constants of the momentum residual of one joint.

    Attributes:
        source: Source of the motor torque.
        torque_per_ampere: Motor torque / K per current [rad/A]; 0 where the source is the voltage.
        inertia: J / K [s2].
        lag: d / K [s]; back-EMF and viscous friction for the voltage, viscous friction for the current.
        offset: [rad]
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    source: MotorTorque
    torque_per_ampere: float
    inertia: float
    lag: float
    offset: float

    def __post_init__(self) -> None:
        if not np.isfinite(astuple(self)[1:]).all():
            raise MomentumError("a parameter is not finite")
        if self.source == "current" and self.torque_per_ampere <= 0.0:
            raise MomentumError("'torque_per_ampere' of a current must be above 0")


class FusionModelError(PepperError, ValueError):
    """Invalid values of a model."""


@dataclass(frozen=True, kw_only=True)
class FusionModel:
    """Models of one joint. The names are keys of model files.

    Attributes:
        twin: Constants of its stick-slip model.
        momentum: Its momentum channel.
        spread: Size of the residual that 99 of 100 samples of free motion do not exceed [rad]: at rest, just after the
            joint broke away, and sliding (:mod:`~pepper_driver.observer.detection.threshold`).
        momentum_bound: Threshold of the baseline ``momentum``: the largest residual of the calibration [rad].
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    twin: StickSlipParameters
    momentum: MomentumParameters
    spread: Triple
    momentum_bound: float

    def __post_init__(self) -> None:
        if not np.isfinite(self.spread).all():
            raise FusionModelError("a value is not finite")
        if not all(spread > 0.0 for spread in self.spread):
            raise FusionModelError(f"'spread' must be above 0, got {self.spread}")
        if not self.momentum_bound > 0.0:
            raise FusionModelError("'momentum_bound' must be above 0")
