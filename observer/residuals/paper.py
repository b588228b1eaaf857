"""Residual of mode ``paper``: r = eps - eps_exp (Eq. 13) with eps_exp from trees (Eq. 12), and a running median."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.interface import MIN_OBSERVED_STIFFNESS, Residuals, StaticGeneratorMixin
from pepper_driver.observer.models.tree import BatchedTrees, Tree
from pepper_driver.observer.recording import STALE_AGE
from pepper_driver.observer.running_filters import RunningMedian


class PaperGenerator(StaticGeneratorMixin):
    """Residuals of Sec. III to V of the paper.

    A joint is blind

    - if it has no model;
    - if the safety gate altered its position;
    - if its stiffness is below MIN_OBSERVED_STIFFNESS;
    - if its sample is older than STALE_AGE;
    - if a value is not finite.

    It stays blind until the median window has none of these samples: ``window`` ticks in all.

    At the start the median is that of fewer samples.

    Args:
        trees: By joint, None for those without.
        threshold: (n,) constant [rad].
        window: Samples of the median.
    """

    def __init__(self, trees: list[Tree | None], threshold: FloatArray, window: int) -> None:
        self._trees = BatchedTrees(trees)
        self._threshold = self.bounds = threshold
        self._window = window
        self.no_model = np.array([tree is None for tree in trees])
        self._no_band, self._no_doubt = np.zeros(len(trees)), np.zeros(len(trees), np.bool_)
        self._no_torque = np.full(len(trees), np.nan)
        self._median = RunningMedian(window, len(trees))
        self.reset()

    def reset(self) -> None:
        """Forget everything but the models."""
        self._blind_ticks = np.zeros(len(self.no_model), dtype=np.int64)
        self._median.reset()

    def step(self, tick: Tick) -> Residuals:
        """Take in one tick; never raises for bad sensor values."""
        measurement, reference = tick.measurement, tick.reference
        # Eq. 12 of all joints.
        expected = self._trees.predict(
            reference.velocity,
            reference.acceleration,
            reference.load_torque,
        )
        with np.errstate(invalid="ignore", over="ignore"):
            error = tick.sent.position - measurement.position
            raw = error - expected
            inputs = error + reference.velocity + reference.acceleration + reference.load_torque
            bad = tick.limited | ~np.isfinite(inputs) | ~np.isfinite(raw)
        bad |= ~(tick.sent.stiffness >= MIN_OBSERVED_STIFFNESS)  # also for NaN
        if not measurement.age <= STALE_AGE:
            bad[:] = True
        raw[bad] = np.nan
        residual = self._median.push(raw)
        self._blind_ticks = np.where(bad, self._window, np.maximum(self._blind_ticks - 1, 0))
        blind = self._blind_ticks > 0
        threshold = self._threshold.copy()
        for values in (expected, residual, threshold):
            values[blind] = np.nan
        return Residuals(
            expected=expected,
            raw=raw,
            residual=residual,
            threshold=threshold,
            torque=self._no_torque.copy(),
            torque_std=self._no_torque.copy(),
            friction_band=self._no_band,
            blind=blind,
            doubtful=self._no_doubt,
        )
