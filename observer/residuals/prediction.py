"""Expected errors of mode ``fusion`` in a tick: stick-slip models, integrals of their boards, and remainders."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.observer.detection.threshold import REST_SPEED
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.stick_slip import PARAMETERS, StickSlipModel
from pepper_driver.observer.models.tree import FEATURES, BatchedTrees
from pepper_driver.observer.residuals.adaptation import OFFSET_UNIT

MAX_LATE_TICKS = 3
"""Ticks by which a sample may be late and still be compared with what was expected for its time."""

MIN_MOVING_SPEED = 0.02
"""[rad/s] Of the stick-slip model: a joint that is faster moves."""

BOARD_TIME = 1.0
"""[s] Within which the current corrects what a board is thought to have summed up: it tells no sign, and one that is
wrong for a moment must not confirm itself."""

REST_CORRECTION = 1.5
"""[s] Within which the stick-slip model of a free joint at rest moves to where the joint rests."""


@dataclass(slots=True)
class Prediction:
    """Prediction of one tick; arrays (n,).

    Attributes:
        target: Position sent [rad].
        position: Of the stick-slip models [rad].
        moves: Where the stick-slip models move.
        friction: On the stick-slip models / K, positive against positive motion [rad].
        load: g tau_ld as identified [rad].
        velocity: Desired [rad/s].
        acceleration: Desired [rad/s2].
        remainder: What the stick-slip models leave of the tracking error [rad].
    """

    target: FloatArray
    position: FloatArray
    moves: BoolArray
    friction: FloatArray
    load: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    remainder: FloatArray


class ErrorPredictor:
    """Lets the stick-slip models take every tick, and holds them to what is known of the joints.

    Args:
        models: By joint, None for those without.
        cycle: Period of the ticks [s].

    Attributes:
        identified: By name of ``StickSlipParameters``, (n,) constants as identified.
        integrates: (n,) joints whose boards have an integral part that currents tell of.
        board: (n,) what the boards have summed up of the measured error [rad].
    """

    def __init__(self, models: Sequence[FusionModel | None], cycle: float) -> None:
        self._cycle = cycle
        twins = [None if m is None else m.twin for m in models]
        self.identified = {
            name: np.array([np.nan if t is None else getattr(t, name) for t in twins])
            for name in PARAMETERS
        }
        self._twins = StickSlipModel(self.identified, cycle)
        self.integrates = np.array(
            [
                m is not None and m.twin.integral_rate > 0.0 and m.momentum.source == "current"
                for m in models
            ]
        )
        self._any_integrates = bool(self.integrates.any())
        self._remainders = BatchedTrees([None if m is None else m.remainder for m in models])
        self._features = np.zeros((FEATURES, len(models)))
        self._correction = cycle / REST_CORRECTION
        both = 1.0 + self.identified["breakaway"]
        self._band_unloaded = self.identified["friction"] * both
        self._band_per_load = self.identified["load_friction"] * both
        self.reset()

    def reset(self) -> None:
        """Forget everything but the models."""
        n = len(self.integrates)
        self.board = np.zeros(n)
        self._past: deque[Prediction] = deque(maxlen=MAX_LATE_TICKS + 1)
        self.adopt(np.zeros((n, 4)))

    @property
    def position(self) -> FloatArray | None:
        """(n,) of the stick-slip models [rad]; None before the first tick."""
        return self._twins.position if self._past else None

    @property
    def twin_velocity(self) -> FloatArray:
        """(n,) speed of the stick-slip models [rad/s]."""
        return self._twins.velocity

    def step(
        self,
        target: FloatArray,
        load_torque: FloatArray,
        velocity: FloatArray,
        acceleration: FloatArray,
        measured: FloatArray,
    ) -> None:
        """Take in one tick; all values finite.

        Args:
            target: (n,) sent [rad].
            load_torque: (n,) desired, with what the hands hold [N m].
            velocity: (n,) desired [rad/s].
            acceleration: (n,) desired [rad/s2].
            measured: (n,) where the joints are [rad]; in the first tick the stick-slip models start from there.
        """
        twins = self._twins
        load = self.identified["load_gain"] * load_torque
        if not self._past:
            twins.start(measured, target)
            # Boards with an integral part have taken up the load.
            summed = load + self.identified["offset"] - (target - measured)
            self.board = np.where(self.integrates, summed, 0.0)
            twins.integral = np.where(self.integrates, self.board, twins.integral)
        position = twins.step(target, load_torque)
        features = self._features
        features[0], features[1], features[2] = velocity, acceleration, load_torque
        self._past.append(
            Prediction(
                target=target,
                position=position,
                moves=np.abs(twins.velocity) > MIN_MOVING_SPEED,
                friction=twins.friction,
                load=load,
                velocity=velocity,
                acceleration=acceleration,
                remainder=self._remainders.predict(features),
            )
        )

    def before(self, ticks: int) -> Prediction:
        """Return the prediction of so many ticks ago, or of the oldest tick there is."""
        return self._past[max(-1 - ticks, -len(self._past))]

    def resistance(self, then: Prediction) -> FloatArray:
        """(n,) friction and load of today / K [rad]."""
        resistance: FloatArray = then.friction + then.load * self._load_factor + self._extra_load
        return resistance

    def band(self, then: Prediction) -> FloatArray:
        """(n,) from friction at rest in one direction to that in the other [rad]."""
        band: FloatArray = self._band_unloaded + self._band_per_load * np.abs(then.load)
        return band

    def beyond_friction(self, then: Prediction, measured: FloatArray) -> FloatArray:
        """(n,) part of the tracking error of joints that stand still which friction cannot hold [rad]."""
        error = then.target - measured - then.remainder
        return self._twins.beyond_friction(error, then.load * self._load_factor + self._offset)

    def update_integrals(self, error: FloatArray, motor: FloatArray, bad: BoolArray | None) -> None:
        """Take in what the boards sum up.

        Args:
            error: (n,) tracking error [rad].
            motor: (n,) torques of the motors / K [rad], which correct it.
            bad: (n,) joints whose values were made up: what their boards had summed up stays.
        """
        if not self._any_integrates:
            return
        summed = self.board + self.identified["integral_rate"] * self._cycle * error
        summed += self._cycle / BOARD_TIME * (motor - error - summed)
        known = self.integrates if bad is None else self.integrates & ~bad
        self.board = np.where(known, summed, self.board)

    def rest(self, where: BoolArray, residual: FloatArray) -> None:
        """Let the models of joints that rest untouched (n,) creep to where these are: residual (n,) [rad]."""
        resting = where & (self._twins.velocity == 0.0)
        if not np.count_nonzero(resting):
            return
        twins, pace = self._twins, self._correction
        twins.position = np.where(resting, twins.position - pace * residual, twins.position)
        if self._any_integrates:
            summed = twins.integral + pace * (self.board - twins.integral)
            twins.integral = np.where(resting & self.integrates, summed, twins.integral)

    def put(self, where: BoolArray, measured: FloatArray) -> None:
        """Put models where the joints are: those that shall move on their path, the others held by friction."""
        velocity = self._past[-1].velocity
        self._twins.put(
            where,
            measured,
            np.where(np.abs(velocity) > REST_SPEED, velocity, 0.0),
            np.where(self.integrates, self.board, self._twins.integral),
        )

    def shift(self, error: FloatArray) -> None:
        """Let the tracking error of the stick-slip models grow by (n,) [rad] at once."""
        self._twins.position = self._twins.position - error

    def adopt(self, share: FloatArray) -> None:
        """Give the stick-slip models the constants of today: (n, 4) shares of ``Adaptation``."""
        p = self.identified
        self._load_factor, self._extra_load = 1.0 + share[:, 2], share[:, 3] * OFFSET_UNIT
        self._offset = p["offset"] + self._extra_load
        self._twins.set(
            {
                **p,
                "friction": p["friction"] * np.maximum(1.0 + share[:, 0], 0.2),
                "lag": p["lag"] * np.maximum(1.0 + share[:, 1], 0.2),
                "load_gain": p["load_gain"] * self._load_factor,
                "offset": self._offset,
            }
        )
