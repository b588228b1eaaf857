"""The residual of mode ``fusion``: twin and momentum channel together."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pepper_driver.controller.tick import Tick
from pepper_driver.observer.adaptation import OFFSET_UNIT, Adaptation
from pepper_driver.observer.base import BaseSignal
from pepper_driver.observer.fusion_model import FusionModel
from pepper_driver.observer.fusion_threshold import RESTING, FusionThreshold
from pepper_driver.observer.median import RunningMedian
from pepper_driver.observer.momentum import ErrorDerivatives, MomentumChannel
from pepper_driver.observer.signal import FULL_STIFFNESS, Signal
from pepper_driver.observer.torque import TorqueEstimate
from pepper_driver.observer.twin import PARAMETERS, Twins

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

LATEST = 3
"""Ticks by which a sample may be late and still be compared with what was expected for its time."""

MOVING = 0.02
"""[rad/s] Of the twin: a joint that is faster moves."""

SETTLING_TICKS = 40
"""After a contact has ended, within which its joint must have come to rest for its twin to start anew there."""

BOARD_TIME = 0.3
"""[s] Within which the current corrects what a board is thought to have summed up."""

REST_CORRECTION = 1.5
"""[s] Within which the twin of a free joint at rest moves to where the joint rests."""

LEARN_PERIOD = 10
"""Ticks between two updates of the constants."""


@dataclass(slots=True)
class _Expected:
    """What was expected for one tick; arrays (n,)."""

    target: FloatArray
    position: FloatArray
    moves: BoolArray
    friction: FloatArray
    load: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    remainder: FloatArray


class FusionSignal:
    """r = w r_twin + (1 - w) r_momentum, filtered by a short running median.

    A joint is blind

    - as long as it has no model;
    - in a tick whose stiffness is below FULL_STIFFNESS, whose sample is later than LATEST ticks, or whose values are
      not finite, and until the median window holds none of these samples any more. Its twin then starts from where
      the joint is.

    While the safety gate alters the command of a joint, and shortly after, its threshold rises by CHANGED_FACTOR.

    Args:
        models: By joint, None for those without.
        cycle: Period of the ticks [s].
        window: Samples of the median.
        adapt: Whether to follow the joints as they change.
        base: Residual of the base, if there is a model of it.
    """

    def __init__(
        self,
        models: list[FusionModel | None],
        cycle: float,
        *,
        window: int,
        adapt: bool,
        base: BaseSignal | None = None,
    ) -> None:
        self._cycle, self._window, self._adapt = cycle, window, adapt
        self._models = models
        self._base = base
        twins = [None if m is None else m.twin for m in models]
        self._identified = {
            name: np.array([np.nan if t is None else getattr(t, name) for t in twins])
            for name in PARAMETERS
        }
        self._twins = Twins(self._identified, cycle)
        self._integrates = np.array(
            [
                m is not None and m.twin.integral_rate > 0.0 and m.momentum.source == "current"
                for m in models
            ]
        )
        self._momentum = MomentumChannel(
            [None if m is None else m.momentum for m in models], self._integrates
        )
        self._derivatives = ErrorDerivatives(cycle)
        self._remainders = [None if m is None else m.remainder.predict_one for m in models]
        self.no_model = np.array([m is None for m in models])
        self._threshold = FusionThreshold(models, cycle, adapt=adapt)
        self.bounds = self._threshold.bounds

        def pairs(name: str) -> tuple[FloatArray, FloatArray]:
            both = np.array([(np.nan, np.nan) if m is None else getattr(m, name) for m in models])
            return both[:, 0], both[:, 1]

        self._weight, self._spread = pairs("weight"), pairs("spread")
        typical = np.array([np.nan if m is None else m.typical_load for m in models])
        self._adaptation = Adaptation(
            twins, np.maximum(*self._spread), typical, LEARN_PERIOD * cycle
        )
        self._torque = TorqueEstimate(
            1.0 / self._identified["load_gain"],
            self._identified["friction"],
            np.maximum(*self._spread),
        )
        self._correction = cycle / REST_CORRECTION
        self._median = RunningMedian(window, len(models))
        self.reset()

    def reset(self) -> None:
        """Forget everything but the models."""
        n = len(self._models)
        self._adaptation.reset()
        self._threshold.reset()
        self._torque.reset()
        self._twins.set(self._identified)
        self._derivatives.reset()
        self._median.reset()
        if self._base is not None:
            self._base.reset()
        self._past: deque[_Expected] = deque(maxlen=LATEST + 1)
        self._blind_ticks = np.zeros(n, dtype=np.int64)
        self._board = np.zeros(n)
        self._change = np.zeros(n)
        self._due = np.zeros(n, dtype=np.int64)
        self._count = 0

    def step(self, tick: Tick) -> Signal:
        """Take in one tick."""
        measurement, reference = tick.measurement, tick.reference
        target, load_torque = tick.sent.position, reference.load_torque
        with np.errstate(invalid="ignore", over="ignore"):
            inputs = (
                target
                + load_torque
                + reference.velocity
                + reference.acceleration
                + measurement.position
                + measurement.current
            )
            bad = ~np.isfinite(inputs) | ~(tick.sent.stiffness >= FULL_STIFFNESS)
        late = measurement.age / self._cycle
        lost = not 0.0 <= late < LATEST + 0.5  # NaN is lost too
        late_ticks = 0 if lost else round(late)
        bad |= lost
        measured = measurement.position
        if bad.any():
            target, load_torque, measured = self._mended(tick, bad)
        if not self._past:
            self._start(measured, target, load_torque)
        expected = self._expect(target, load_torque, tick, bad)
        self._past.append(expected)
        # A late sample answers an older command.
        then = self._past[max(-1 - late_ticks, -len(self._past))]
        residual = self._residual(then, measured, measurement.current, bad)
        raw = residual.copy()
        raw[bad] = np.nan
        filtered = self._median.push(np.where(bad, 0.0, residual))
        self._blind_ticks = np.where(bad, self._window, np.maximum(self._blind_ticks - 1, 0))
        blind = (self._blind_ticks > 0) | self.no_model
        waking = blind & ~bad & ~self.no_model
        self._relatch(bad | waking, measured)
        effects = self._adaptation.effects(then.friction, self._twins.velocity, then.load)
        threshold = self._threshold.step(
            reference.velocity,
            reference.acceleration,
            tick.changed,
            self._adaptation.strangeness,
            self._adaptation.uncertainty(effects),
        )
        torque, torque_std = self._torque.step(filtered, then.friction, threshold)
        expected_error = then.target - then.position + then.remainder
        self._now = (filtered, then, measured, effects, blind)
        for values in (expected_error, filtered, threshold, torque, torque_std):
            values[blind] = np.nan
        base = (np.nan, np.nan)
        if self._base is not None:
            base = self._base.step(tick, lost or late_ticks > 0)
        return Signal(
            expected=expected_error,
            raw=raw,
            residual=filtered,
            threshold=threshold,
            torque=torque,
            torque_std=torque_std,
            band=self._band(then.load),
            blind=blind,
            base_raw=base[0],
            base_residual=base[1],
        )

    def _start(self, measured: FloatArray, target: FloatArray, load_torque: FloatArray) -> None:
        """Put the twins where the joints are; boards with an integral part have taken up the load."""
        self._twins.start(measured, target)
        load = self._identified["load_gain"] * load_torque + self._identified["offset"]
        self._board = np.where(self._integrates, load - (target - measured), 0.0)
        self._twins.integral = np.where(self._integrates, self._board, self._twins.integral)

    def _mended(self, tick: Tick, bad: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Target, load torque and position with something harmless where they are not finite."""
        position, target = tick.measurement.position, tick.sent.position
        here = self._twins.position if self._past else np.zeros(len(bad))
        position = np.where(np.isfinite(position), position, np.nan_to_num(here))
        target = np.where(np.isfinite(target), target, position)
        return target, _finite(tick.reference.load_torque), position

    def _expect(
        self, target: FloatArray, load_torque: FloatArray, tick: Tick, bad: BoolArray
    ) -> _Expected:
        """Let the twins take the tick."""
        twins, reference = self._twins, tick.reference
        position = twins.step(target, load_torque)
        velocity, acceleration = reference.velocity, reference.acceleration
        if bad.any():
            velocity, acceleration = _finite(velocity), _finite(acceleration)
        remainder = np.array(
            [
                np.nan if predict is None else predict(v, a, load)
                for predict, v, a, load in zip(
                    self._remainders,
                    velocity.tolist(),
                    acceleration.tolist(),
                    load_torque.tolist(),
                    strict=True,
                )
            ]
        )
        return _Expected(
            target=target,
            position=position,
            moves=np.abs(twins.velocity) > MOVING,
            friction=twins.friction,
            load=self._identified["load_gain"] * load_torque,
            velocity=velocity,
            acceleration=acceleration,
            remainder=remainder,
        )

    def _residual(
        self, then: _Expected, measured: FloatArray, current: FloatArray, bad: BoolArray
    ) -> FloatArray:
        """Fused residual [rad]."""
        error = then.target - measured
        twin = then.position - measured - then.remainder
        change, curvature = self._derivatives.step(error)
        self._change = change
        velocity = then.velocity - change
        share = self._adaptation.share
        load = then.load * (1.0 + share[:, 2]) + share[:, 3] * OFFSET_UNIT
        momentum, motor = self._momentum.residual(
            current=np.where(bad, 0.0, current),
            drive=error + self._board,
            velocity=velocity,
            acceleration=then.acceleration - curvature,
            resistance=then.friction + load,
            expected=twin,
        )
        self._follow_boards(error, motor)
        weight = np.where(then.moves, self._weight[1], self._weight[0])
        return weight * twin + (1.0 - weight) * momentum

    def _follow_boards(self, error: FloatArray, motor: FloatArray) -> None:
        """What the boards have summed up of the measured error, held by their currents [rad]."""
        if not self._integrates.any():
            return
        summed = self._board + self._identified["integral_rate"] * self._cycle * error
        summed += self._cycle / BOARD_TIME * (motor - error - summed)
        self._board = np.where(self._integrates, summed, 0.0)

    def _band(self, load: FloatArray) -> FloatArray:
        """From friction at rest in one direction to that in the other [rad]; 0 for a joint that shall move."""
        p = self._identified
        band = (p["friction"] + p["load_friction"] * np.abs(load)) * (1.0 + p["breakaway"])
        return np.where(self._threshold.speed > RESTING, 0.0, band)

    @property
    def worn(self) -> BoolArray:
        """(n,) joints whose friction or lag has grown far beyond what was identified."""
        return self._adaptation.worn

    def learn(self, free: BoolArray, settled: BoolArray) -> None:
        """Take in what the events make of the last tick.

        Args:
            free: (n,) joints that nothing touches, nor has shortly before.
            settled: (n,) joints whose contact ended in this tick, and rest where friction holds them.
        """
        residual, then, measured, effects, blind = self._now
        self._due = np.where(settled, SETTLING_TICKS, np.maximum(self._due - 1, 0))
        rests = (self._threshold.speed <= RESTING) & (np.abs(self._change) <= RESTING)
        settles = (self._due > 0) & rests & ~blind
        self._due[settles] = 0
        self._relatch(settles, measured)
        calm = free & ~blind & (np.abs(residual) < self._threshold.calm)
        resting = calm & ~then.moves & (self._twins.velocity == 0.0)
        if resting.any():
            twins, pace = self._twins, self._correction
            twins.position = np.where(resting, twins.position - pace * residual, twins.position)
            twins.integral = np.where(
                resting & self._integrates,
                twins.integral + pace * (self._board - twins.integral),
                twins.integral,
            )
        if not self._adapt:
            return
        self._threshold.learn(residual, free & ~blind)
        self._count += 1
        if self._count % LEARN_PERIOD:
            return
        self._adaptation.update(np.nan_to_num(residual), np.nan_to_num(effects), calm)
        share = self._adaptation.share
        p = self._identified
        self._twins.set(
            {
                **p,
                "friction": p["friction"] * np.maximum(1.0 + share[:, 0], 0.2),
                "lag": p["lag"] * np.maximum(1.0 + share[:, 1], 0.2),
                "load_gain": p["load_gain"] * (1.0 + share[:, 2]),
                "offset": p["offset"] + share[:, 3] * OFFSET_UNIT,
            }
        )

    def _relatch(self, where: BoolArray, measured: FloatArray) -> None:
        """Put the twins where the joints are: those that shall move on their way, the others held there by friction."""
        if where.any():
            self._median.clear(where)
            self._derivatives.put(where, self._past[-1].target - measured)
            velocity = self._past[-1].velocity
            self._twins.put(
                where,
                measured,
                np.where(np.abs(velocity) > RESTING, velocity, 0.0),
                np.where(self._integrates, self._board, self._twins.integral),
            )


def _finite(values: FloatArray) -> FloatArray:
    """``values`` with 0 where they are not finite."""
    return np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
