"""The residual of mode ``momentum``: Eq. 10 with measured motion and lumped constants, a baseline to compare with."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.fusion_model import FusionModel
from pepper_driver.observer.median import RunningMedian
from pepper_driver.observer.momentum import ErrorDerivatives
from pepper_driver.observer.recording import STALE_AGE
from pepper_driver.observer.signal import FULL_STIFFNESS, Signal, Unchanging

SIGN_VELOCITY = 0.03
"""[rad/s] Below which the sign of the friction is smoothed."""


class MomentumSignal(Unchanging):
    """What a momentum observer without memory makes of the same sensors and constants.

    r = eps - (J a + d v + F sign(v) + g tau_ld + offset), as in Eq. 10 over the stiffness, with measured velocity and
    acceleration: friction at rest is unknown to it. Running median and a constant threshold as in mode ``paper``.

    Args:
        models: By joint, None for those without.
        cycle: Period of the ticks [s].
        threshold: (n,) constant [rad].
        window: Samples of the median.
    """

    def __init__(
        self,
        models: list[FusionModel | None],
        cycle: float,
        threshold: FloatArray,
        window: int,
    ) -> None:
        twins = [None if m is None else m.twin for m in models]

        def each(name: str) -> FloatArray:
            return np.array([np.nan if t is None else getattr(t, name) for t in twins])

        self._inertia, self._lag, self._friction = each("inertia"), each("lag"), each("friction")
        self._load_gain, self._offset = each("load_gain"), each("offset")
        self._derivatives = ErrorDerivatives(cycle)
        self._median = RunningMedian(window, len(models))
        self._window = window
        self.no_model = np.array([m is None for m in models])
        self.bounds = threshold
        self._nothing = np.zeros(len(models))
        self.reset()

    def reset(self) -> None:
        """Forget everything but the models."""
        self._derivatives.reset()
        self._median.reset()
        self._blind_ticks = np.zeros(len(self.no_model), dtype=np.int64)

    def step(self, tick: Tick) -> Signal:
        """Take in one tick; never raises for bad sensor values."""
        measurement, reference = tick.measurement, tick.reference
        with np.errstate(invalid="ignore", over="ignore"):
            error = tick.sent.position - measurement.position
            inputs = error + reference.velocity + reference.acceleration + reference.load_torque
            bad = tick.changed | ~np.isfinite(inputs) | ~(tick.sent.stiffness >= FULL_STIFFNESS)
        if not measurement.age <= STALE_AGE:
            bad[:] = True
        error = np.where(bad, 0.0, error)
        change, curvature = self._derivatives.step(error)
        velocity = np.where(bad, 0.0, reference.velocity) - change
        acceleration = np.where(bad, 0.0, reference.acceleration) - curvature
        expected = (
            self._inertia * acceleration
            + self._lag * velocity
            + self._friction * np.tanh(velocity / SIGN_VELOCITY)
            + self._load_gain * np.where(bad, 0.0, reference.load_torque)
            + self._offset
        )
        raw = error - expected
        raw[bad] = np.nan
        residual = self._median.push(raw)
        self._blind_ticks = np.where(bad, self._window, np.maximum(self._blind_ticks - 1, 0))
        blind = (self._blind_ticks > 0) | self.no_model
        threshold = self.bounds.copy()
        torque = -residual / self._load_gain
        for values in (expected, residual, threshold, torque):
            values[blind] = np.nan
        return Signal(
            expected=expected,
            raw=raw,
            residual=residual,
            threshold=threshold,
            torque=torque,
            torque_std=np.full(len(blind), np.nan),
            band=self._nothing,
            blind=blind,
        )
