"""Residual of the generalised momentum, from motor torques.

The motor torque minus the torques of motion, friction and load is the external torque. All torques are divided by the
stiffness K of the joint, so that the result is an angle and comparable with r = eps - eps_exp of Eq. 13:

    r = motor - (J a + friction + g tau_ld + offset)

The motor torque comes from the absolute current of the motor board. Velocity and acceleration are the desired ones
minus smoothed derivatives of the tracking error. The friction is that of the stick-slip model: a measured velocity near
zero has no sign, and that model has the direction from which the joint came to rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import Out, Records, kernel, make_records
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.constants import (
    MAX_TARGET_DRIFT,
    MIN_DRIVE,
    MIN_SPREAD,
    REVERSAL_RATIO,
    SETTLING_TICKS,
    SMOOTHING_TIME,
    UNSURE_FACTOR,
)
from pepper_driver.observer.interface import MIN_OBSERVED_STIFFNESS, Residuals, StaticGeneratorMixin
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.recording import STALE_AGE
from pepper_driver.observer.running_filters import RunningMedian


class DerivativeFilter:
    """State of the smoothed derivatives of one error: the ``error`` [rad] and ``velocity`` [rad/s] filtered so far."""

    error: float
    velocity: float


@kernel
def differentiate(
    filters: Out[Records[DerivativeFilter]], j: int, error: float, gain: float, cycle: float
) -> tuple[float, float]:
    """Take in one sample [rad]; return its smoothed derivatives [rad/s], [rad/s2]."""
    state, rate = filters[j], gain / cycle
    # Of the filter before its update: this is exact on a ramp.
    velocity = (error - state.error) * rate
    acceleration = (velocity - state.velocity) * rate
    state.error += gain * (error - state.error)
    state.velocity += gain * (velocity - state.velocity)
    return velocity, acceleration


@kernel
def _step(
    filters: Out[Records[DerivativeFilter]],
    error: FloatArray,
    gain: float,
    cycle: float,
    velocity: Out[FloatArray],
    acceleration: Out[FloatArray],
) -> None:
    for j in range(len(error)):
        velocity[j], acceleration[j] = differentiate(filters, j, error[j], gain, cycle)


@kernel
def _play(
    error: FloatArray,
    gain: float,
    cycle: float,
    filters: Out[Records[DerivativeFilter]],
    velocity: Out[FloatArray],
    acceleration: Out[FloatArray],
) -> None:
    for k in range(len(error)):
        velocity[k], acceleration[k] = differentiate(filters, 0, error[k], gain, cycle)


class ErrorDerivatives:
    """Smoothed first and second derivative of the tracking error, sample by sample.

    Args:
        width: Number of joints.
        cycle: Period of the ticks [s].

    Attributes:
        filters: States of the joints.
        gain: Fraction of a change that a filter takes in with one sample.
        started: False until the first sample, with which the filters start.
    """

    def __init__(self, width: int, cycle: float) -> None:
        self._cycle = cycle
        self.gain = 1.0 - float(np.exp(-cycle / SMOOTHING_TIME))
        self.filters = make_records(DerivativeFilter, width)
        self.started = False
        self._step, self._play = _step.load(), _play.load()

    def start(self, error: FloatArray) -> None:
        """Start from (n,) errors [rad] that do not change."""
        self.filters["error"], self.filters["velocity"] = error, 0.0
        self.started = True

    def step(self, error: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Take in one sample (n,) [rad]; return its derivatives [rad/s], [rad/s2], new arrays."""
        if not self.started:
            self.start(error)
        velocity, acceleration = np.empty(len(error)), np.empty(len(error))
        self._step(self.filters, error, self.gain, self._cycle, velocity, acceleration)
        return velocity, acceleration

    def play(self, error: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the derivatives of (n,) errors of one joint in a run [rad/s], [rad/s2], apart from ``filters``."""
        filters = make_records(DerivativeFilter, 1, error=error[0])
        velocity, acceleration = np.empty(len(error)), np.empty(len(error))
        self._play(error, self.gain, self._cycle, filters, velocity, acceleration)
        return velocity, acceleration

    def put(self, where: BoolArray, error: FloatArray) -> None:
        """Start again from ``error`` [rad], for the joints of ``where``."""
        if self.started:
            self.filters["error"][where] = error[where]
            self.filters["velocity"][where] = 0.0

    def reset(self) -> None:
        """Forget all samples."""
        self.started = False


class CurrentChannel:
    """Constants and state of the current of one joint; the constants of a joint without parameters are NaN.

    Attributes:
        inertia: J / K [s2].
        lag: d / K [s].
        offset: [rad]
        torque_per_ampere: Motor torque / K per current [rad/A].
        back_emf: Part of the law of the board per speed [s].
        by_current: True if the current shows the torque of the motor.
        answered: Sign of the output of the board's law that the current shows, 0 if it shows none.
        recent: Recent size of its torque / K [rad].
        steady: Ticks for which it has not fallen to MIN_SPREAD or REVERSAL_RATIO of this size.
    """

    inertia: float
    lag: float
    offset: float
    torque_per_ampere: float
    back_emf: float
    by_current: bool
    answered: int
    recent: float
    steady: int


def current_channels(models: Sequence[FusionModel | None]) -> Records[CurrentChannel]:
    """Return the channels of joints."""
    momenta = [None if m is None else m.momentum for m in models]
    return make_records(
        CurrentChannel,
        len(models),
        **{
            name: [np.nan if m is None else getattr(m, name) for m in momenta]
            for name in ("inertia", "lag", "offset", "torque_per_ampere")
        },
        back_emf=[np.nan if m is None else m.twin.lag for m in models],
        by_current=[m is not None and m.source == "current" for m in momenta],
    )


@kernel
def current_residual(
    channels: Out[Records[CurrentChannel]],
    j: int,
    current: float,
    drive: float,
    velocity: float,
    acceleration: float,
    resistance: float,
    pushed: bool,
) -> tuple[float, float, float]:
    """Return the external torque on the motor / K with the sign of r, its own torque / K, the output of the law [rad].

    The current has no sign. It takes that of the torque that a free motion needs, which makes the residual smaller than
    the other sign would. A touch that reverses the torque of the motor would then be lost: where the current shows the
    output of the board's law, it takes the sign of this output. It can only reverse through zero: one that has not
    fallen to MIN_SPREAD, or to REVERSAL_RATIO of its recent size, within SETTLING_TICKS drives the joint to another
    target than the command. A push that moves the base may reverse it between two samples, and to less. A board at the
    limit of its current cannot show an output beyond it: then the current need only be larger than without touch.

    Args:
        channels: Of the joints.
        j: Index of the joint.
        current: Absolute [A].
        drive: Output of the law of the motor board for the measured error: eps + I [rad].
        velocity: Of the joint, as measured [rad/s].
        acceleration: [rad/s2]
        resistance: Friction and load / K [rad].
        pushed: True while the base shows a push.
    """
    p = channels[j]
    needed = p.inertia * acceleration + p.lag * velocity + resistance + p.offset
    size, output = p.torque_per_ampere * current, drive - p.back_emf * velocity
    p.recent = max(size, p.recent * (1.0 - 1.0 / SETTLING_TICKS))
    min_size = MIN_DRIVE / UNSURE_FACTOR
    p.steady = p.steady + 1 if size > max(REVERSAL_RATIO * p.recent, MIN_SPREAD) else 0
    side, min_output = (1 if output > 0.0 else -1), (min_size if pushed else MIN_DRIVE)
    may_have_side = pushed or side == p.answered or p.steady <= SETTLING_TICKS
    follows = may_have_side and min_output < abs(output) < UNSURE_FACTOR * size
    at_limit = abs(output) > MAX_TARGET_DRIFT and size > UNSURE_FACTOR * abs(needed)
    answers = follows or at_limit
    p.answered = side if answers else 0
    motor = math.copysign(size, output if answers else needed)
    return motor - needed, motor, output


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
        self._derivatives = ErrorDerivatives(len(models), cycle)
        self._median = RunningMedian(window, len(models))
        self._window = window
        self.no_model = np.array([m is None for m in models])
        self.bounds = threshold
        self._no_band, self._no_doubt = np.zeros(len(models)), np.zeros(len(models), np.bool_)
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
            doubtful=self._no_doubt,
        )
