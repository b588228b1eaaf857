"""The threshold of mode ``fusion``: by phase of the motion, wider by all that is not known of the joint today."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.observer.forest import Forest
from pepper_driver.observer.fusion_model import FusionModel
from pepper_driver.observer.median import RecentLargest
from pepper_driver.observer.strays import START, Strays
from pepper_driver.observer.tree import FEATURES

RESTING = 0.05
"""[rad/s] Desired; a joint that shall move no faster can be held by its friction."""

SPEED_MEMORY = 0.5
"""[s] For which the largest desired speed is kept."""

THRESHOLD_MEMORY = 0.25
"""[s] For which a raised threshold stays."""

CHANGED_FACTOR = 2.0
"""While the safety gate alters a command: the load torque belongs to the command that was wanted."""

UNSETTLED = 0.5
"""By this share a threshold is higher just after a touch where a board sums errors up: it lets go of them later."""

UNCERTAINTY_FACTOR = 2.0
"""Standard deviations, of not knowing the constants better, that a threshold rises by."""

START_LEAST = np.radians(1.8)
"""[rad] Thresholds begin here at least: a worn joint strays so far, however quiet it was when it was identified."""

CALM = 0.5
"""Share of a threshold below which a residual may teach something."""


class FusionThreshold:
    """Bounds of the models, times what the session so far says, plus the uncertainty of the constants.

    Args:
        models: By joint, None for those without.
        cycle: Period of the ticks [s].
        adapt: Whether anything but the bounds of the models counts.

    Attributes:
        bounds: (n,) largest bound of each model [rad].
        speed: (n,) desired, of the last tick [rad/s].
        calm: (n,) size of a residual that may teach how a joint is today [rad].
        bearable: (n,) size of one that may teach what the hands hold: as large as joints stray today [rad].
    """

    def __init__(self, models: list[FusionModel | None], cycle: float, *, adapt: bool) -> None:
        self._cycle, self._adapt = cycle, adapt
        self._bounds = Forest([None if m is None else m.bound for m in models])
        self._phase = np.zeros((FEATURES, len(models)))
        self.bounds = np.array([np.nan if m is None else m.largest_bound for m in models])
        start = np.fmax(START, START_LEAST / self.bounds)
        self._strays = Strays(self.bounds, start)
        self.reset()

    def reset(self) -> None:
        """Forget the session."""
        n = len(self.bounds)
        self._strays.reset()
        self._speeds = RecentLargest(SPEED_MEMORY, self._cycle, n)
        self._recent = RecentLargest(THRESHOLD_MEMORY, self._cycle, n)
        self.speed, self.calm, self.bearable = np.zeros(n), np.zeros(n), np.zeros(n)

    def step(
        self,
        velocity: FloatArray,
        acceleration: FloatArray,
        changed: BoolArray,
        uncertainty: FloatArray,
        unsettled: FloatArray | None = None,
    ) -> FloatArray:
        """Take in one tick; returns (n,) thresholds [rad].

        Args:
            velocity: (n,) desired [rad/s].
            acceleration: (n,) desired [rad/s2].
            changed: (n,) where the safety gate altered the command.
            uncertainty: (n,) standard deviation of the expected error [rad].
            unsettled: (n,) 0..1, how lately the robot was let go; None for nowhere.
        """
        speed, size, largest = self._phase
        np.abs(velocity, out=speed)
        np.abs(acceleration, out=size)
        largest[:] = self._speeds.push(speed)
        self.speed = speed
        bound = self._bounds.predict(self._phase)
        self.calm = CALM * bound
        if self._adapt:
            doubt = UNCERTAINTY_FACTOR * uncertainty
            self.calm = CALM * (bound + doubt)
            bound = bound * self._strays.factor + doubt
        self.bearable = CALM * bound
        if np.count_nonzero(changed):
            bound = np.where(changed, CHANGED_FACTOR * bound, bound)
        if unsettled is not None:
            bound = bound * (1.0 + UNSETTLED * unsettled)
        return self._recent.push(bound)

    def learn(self, residual: FloatArray, seen: BoolArray | None) -> None:
        """Take in the residual (n,) [rad] of joints that can be judged (n,); None while something touches the robot."""
        if not self._adapt:
            return
        if seen is None:
            self._strays.touched()
        else:
            self._strays.learn(residual, seen, self.speed > RESTING)
