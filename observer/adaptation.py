"""Follows how a joint differs today from when it was identified: friction, lag, load, offset, while nothing touches."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.observer.twin import TwinParameters

PRIOR = np.array([0.25, 0.25, 0.1, 1.0])
"""Standard deviation before anything is known, as shares of the identified values; the offset in OFFSET_UNIT."""

LEARN_PERIOD = 10
"""Ticks between two updates."""

WANDER = np.array([0.04, 0.02, 0.02, 0.1])
"""By how much each may change in a minute."""

OFFSET_UNIT = np.radians(0.1)
NOISE = 3.0
"""Times the spread of the free residual: its errors last for many samples, and count once."""

WORN = 0.4
"""Friction or lag beyond this share of what was identified: the joint is worn, and should be identified anew."""


class Adaptation:
    """Recursive least squares with forgetting (a Kalman filter on a random walk), four numbers a joint.

    Args:
        models: Of the joints; None where there is none.
        spread: (n,) standard deviation of the residual in free motion [rad].
        cycle: Period of the ticks [s].

    Attributes:
        share: (n, 4) deviation from the identified values, in the units of PRIOR.
    """

    def __init__(
        self,
        models: list[TwinParameters | None],
        spread: FloatArray,
        cycle: float,
    ) -> None:
        self._prior = np.tile(PRIOR, (len(models), 1))
        self._lag = np.array([np.nan if m is None else m.lag for m in models])
        self._noise = (NOISE * spread) ** 2
        self._wander = np.diag(WANDER**2 * LEARN_PERIOD * cycle / 60.0)
        self._count = len(models)
        self.reset()

    def reset(self) -> None:
        """Back to the identified values."""
        self.share = np.zeros((self._count, 4))
        self._covariance = self._prior[:, :, None] ** 2 * np.eye(4)

    def effects(self, friction: FloatArray, velocity: FloatArray, load: FloatArray) -> FloatArray:
        """(n, 4) what a full share of each would add to the tracking error [rad].

        Args:
            friction: (n,) on the twins [rad].
            velocity: (n,) of the twins [rad/s].
            load: (n,) g tau_ld [rad].
        """
        effects = np.empty((len(load), 4))
        effects[:, 0] = friction
        np.multiply(self._lag, velocity, out=effects[:, 1])
        effects[:, 2] = load
        effects[:, 3] = OFFSET_UNIT
        return effects

    def variance(self, effects: FloatArray) -> FloatArray:
        """(n,) of the expected tracking error, for not knowing the shares better [rad2]."""
        seen = (self._covariance @ effects[:, :, None])[:, :, 0]
        variance: FloatArray = (seen * effects).sum(axis=1)
        return variance

    def update(
        self, residual: FloatArray, effects: FloatArray, other: FloatArray | float, free: BoolArray
    ) -> None:
        """Learn from the last tick.

        Args:
            residual: (n,) [rad].
            effects: (n, 4) of each quantity.
            other: (n,) variance of the residual for what else is not known [rad2].
            free: (n,) joints that nothing touches.
        """
        effects = np.where(free[:, None], effects, 0.0)
        seen = np.einsum("nij,nj->ni", self._covariance, effects)
        scale = self._noise + other + np.einsum("ni,ni->n", effects, seen)
        free = free & np.isfinite(scale)
        gain = np.where(free[:, None], seen / scale[:, None], 0.0)
        self.share += gain * np.where(free, residual, 0.0)[:, None]
        np.clip(self.share, -3.0 * self._prior, 3.0 * self._prior, out=self.share)
        self._covariance -= gain[:, :, None] * seen[:, None, :]
        self._covariance += self._wander
        # No quantity gets less certain than at the start.
        known = np.einsum("nii->ni", self._covariance)
        shrink = np.sqrt(np.minimum(1.0, self._prior**2 / np.maximum(known, 1e-12)))
        self._covariance *= shrink[:, :, None] * shrink[:, None, :]

    @property
    def worn(self) -> BoolArray:
        """(n,) where friction or lag has surely grown beyond WORN: by two standard deviations of what is known."""
        spread = np.sqrt(np.maximum(np.einsum("nii->ni", self._covariance)[:, :2], 0.0))
        grown: BoolArray = (self.share[:, :2] - 2.0 * spread > WORN).any(axis=1)
        return grown
