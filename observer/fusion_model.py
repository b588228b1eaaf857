"""What mode ``fusion`` knows of one joint in free motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import ConfigDict

from pepper_driver.config import PepperError
from pepper_driver.config.loading import STRICT
from pepper_driver.observer.momentum import MomentumParameters
from pepper_driver.observer.tree import AffineTree, CartTree
from pepper_driver.observer.twin import TwinParameters

Pair = tuple[float, float]


class FusionModelError(PepperError, ValueError):
    """Values that make no model."""


@dataclass(frozen=True, kw_only=True)
class FusionModel:
    """Models of one joint.

    Attributes:
        twin: Its stick-slip twin.
        remainder: What the twin leaves of the tracking error, as a tree on the desired motion (Eq. 12).
        momentum: Its momentum channel.
        weight: Of the twin beside the momentum channel, 0..1, at rest and in motion: by inverse covariance.
        spread: Standard deviation of the fused residual in free motion, at rest and in motion [rad].
        bound: Threshold of a contact, margin included, as a tree on desired speed [rad/s], size of the desired
            acceleration [rad/s2], and largest desired speed of the last half second [rad/s].
        momentum_bound: Threshold of the baseline ``momentum``: the largest residual of the calibration [rad].
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    twin: TwinParameters
    remainder: AffineTree
    momentum: MomentumParameters
    weight: Pair
    spread: Pair
    bound: CartTree
    momentum_bound: float

    def __post_init__(self) -> None:
        if not np.isfinite((*self.weight, *self.spread)).all():
            raise FusionModelError("a value is not finite")
        if not all(0.0 <= weight <= 1.0 for weight in self.weight):
            raise FusionModelError(f"'weight' must lie within 0 and 1, got {self.weight}")
        if not all(spread > 0.0 for spread in self.spread):
            raise FusionModelError(f"'spread' must be above 0, got {self.spread}")
        if not self.momentum_bound > 0.0:
            raise FusionModelError("'momentum_bound' must be above 0")
        leaves = [v for v, f in zip(self.bound.value, self.bound.feature, strict=True) if f < 0]
        if min(leaves) <= 0.0:
            raise FusionModelError("'bound' must be above 0 everywhere")

    @property
    def largest_bound(self) -> float:
        """Highest threshold of a contact [rad]."""
        return max(self.bound.value)
