"""Residual of the generalised momentum, from motor torques.

The motor torque minus the torques of motion, friction and load is the external torque. All torques are divided by the
stiffness K of the joint, so that the result is an angle and comparable with r = eps - eps_exp of Eq. 13:

    r = motor - (J a + friction + g tau_ld + offset)

The motor torque comes from the absolute current of the motor board or from its law, eps + I - d v; identification
takes the one with the smaller error. Velocity and acceleration are the desired ones minus smoothed derivatives of the
tracking error. The friction is that of the stick-slip model: a measured velocity near zero has no sign, and that model
has the direction from which the joint came to rest.
"""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.interface import MIN_OBSERVED_STIFFNESS, Residuals, StaticGeneratorMixin
from pepper_driver.observer.models.fusion_model import FusionModel, MomentumParameters
from pepper_driver.observer.recording import STALE_AGE
from pepper_driver.observer.running_filters import RunningMedian

SMOOTHING_TIME = 0.03
"""[s] Time constant of the derivatives: an encoder step of 0.09 deg in one tick is 0.13 rad/s."""


class ErrorDerivatives:
    """Smoothed first and second derivative of the tracking error, sample by sample.

    Args:
        cycle: Period of the ticks [s].
    """

    def __init__(self, cycle: float) -> None:
        self._gain = 1.0 - float(np.exp(-cycle / SMOOTHING_TIME))
        self._rate = self._gain / cycle
        self._error: FloatArray | None = None

    def step(self, error: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Take in one sample [rad]; return its derivatives [rad/s], [rad/s2]."""
        if self._error is None:
            self._error, self._velocity = error.copy(), np.zeros_like(error)
        # Of the filter before its update: this is exact on a ramp.
        velocity = (error - self._error) * self._rate
        acceleration = (velocity - self._velocity) * self._rate
        self._error = self._error + self._gain * (error - self._error)
        self._velocity = self._velocity + self._gain * (velocity - self._velocity)
        return velocity, acceleration

    def put(self, where: BoolArray, error: FloatArray) -> None:
        """Start again from ``error`` [rad], for the joints of ``where``."""
        if self._error is not None:
            self._error = np.where(where, error, self._error)
            self._velocity = np.where(where, 0.0, self._velocity)

    def reset(self) -> None:
        """Forget all samples."""
        self._error = None


class MomentumChannel:
    """Momentum residual of several joints; NaN for those without parameters.

    Args:
        models: By joint.
        integrates: (n,) joints whose motor boards integrate errors: the integral also indicates the current's sign.
    """

    def __init__(self, models: list[MomentumParameters | None], integrates: BoolArray) -> None:
        def each(name: str) -> FloatArray:
            return np.array([np.nan if m is None else getattr(m, name) for m in models])

        self._inertia, self._lag, self._offset = each("inertia"), each("lag"), each("offset")
        self._per_ampere = each("torque_per_ampere")
        self._integrates = integrates
        self._by_current = np.array([m is not None and m.source == "current" for m in models])

    def residual(
        self,
        *,
        current: FloatArray,
        drive: FloatArray,
        velocity: FloatArray,
        acceleration: FloatArray,
        resistance: FloatArray,
        model_residual: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """External torque on the motor over K, with the sign of r.

        Args:
            current: Absolute [A].
            drive: Output of the law of the motor board for the measured error: eps + I [rad].
            velocity: Of the joint, as measured [rad/s].
            acceleration: [rad/s2]
            resistance: Friction and load / K [rad].
            model_residual: r of the stick-slip model [rad], for the sign of the current.

        Returns:
            The residual [rad]; the motor's torque / K [rad].
        """
        needed = self._inertia * acceleration + self._lag * velocity + resistance + self._offset
        size = self._per_ampere * current
        # The current has no sign. It takes that of the required torque and, where the board integrates errors, also of
        # the output of its law. Either of them alone is sometimes wrong for seconds.
        likely = needed + model_residual + np.where(self._integrates, drive, 0.0)
        motor = np.where(self._by_current, np.copysign(size, likely), drive)
        return motor - needed, motor


SIGN_VELOCITY = 0.03
"""[rad/s] Speed below which the sign of the friction is smoothed."""


class MomentumGenerator(StaticGeneratorMixin):
    """Residuals of a momentum observer without memory, from the same sensors and constants.

    r = eps - (J a + d v + F sign(v) + g tau_ld + offset), as in Eq. 10 over the stiffness, with measured velocity and
    acceleration: the friction at rest is not modelled. Running median and constant threshold as in mode ``paper``.

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
        parameters = [None if m is None else m.twin for m in models]

        def each(name: str) -> FloatArray:
            return np.array([np.nan if p is None else getattr(p, name) for p in parameters])

        self._inertia, self._lag, self._friction = each("inertia"), each("lag"), each("friction")
        self._load_gain, self._offset = each("load_gain"), each("offset")
        self._derivatives = ErrorDerivatives(cycle)
        self._median = RunningMedian(window, len(models))
        self._window = window
        self.no_model = np.array([m is None for m in models])
        self.bounds = threshold
        self._no_band = np.zeros(len(models))
        self.reset()

    def reset(self) -> None:
        """Forget everything but the models."""
        self._derivatives.reset()
        self._median.reset()
        self._blind_ticks = np.zeros(len(self.no_model), dtype=np.int64)

    def step(self, tick: Tick) -> Residuals:
        """Take in one tick; never raises for bad sensor values."""
        measurement, reference = tick.measurement, tick.reference
        with np.errstate(invalid="ignore", over="ignore"):
            error = tick.sent.position - measurement.position
            inputs = error + reference.velocity + reference.acceleration + reference.load_torque
            bad = (
                tick.limited
                | ~np.isfinite(inputs)
                | ~(tick.sent.stiffness >= MIN_OBSERVED_STIFFNESS)
            )
        if not measurement.age <= STALE_AGE:
            bad[:] = True
        # A value that is not finite would stay in the smoothed derivatives.
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
        return Residuals(
            expected=expected,
            raw=raw,
            residual=residual,
            threshold=threshold,
            torque=torque,
            torque_std=np.full(len(blind), np.nan),
            friction_band=self._no_band,
            blind=blind,
        )
