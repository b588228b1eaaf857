"""Expected errors of mode ``fusion`` in a tick: stick-slip models, integrals of their motor boards, remainders."""

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
"""Ticks by which a sample may be late and still be compared with the prediction for its time."""

MIN_MOVING_SPEED = 0.02
"""[rad/s] Speed of the stick-slip model above which a joint counts as moving."""

INTEGRAL_CORRECTION_TIME = 1.0
"""[s] Time constant with which the current corrects the estimated integral of a motor board. The current has no sign,
and a sign that is wrong for a moment must not confirm itself."""

REST_CORRECTION_TIME = 1.5
"""[s] Time constant with which the stick-slip model of a free joint at rest moves to the measured position."""


@dataclass(slots=True)
class Prediction:
    """Prediction of one tick; arrays (n,).

    Attributes:
        target: Position sent [rad].
        position: Position of the stick-slip models [rad].
        moves: True where the stick-slip models move.
        friction: Friction of the stick-slip models / K, positive against positive motion [rad].
        load: g tau_ld as identified [rad].
        velocity: Desired [rad/s].
        acceleration: Desired [rad/s2].
        remainder: Part of the tracking error that the stick-slip models do not explain [rad].
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
    """Predictor of tracking errors: it steps the stick-slip models and corrects them by measurements of free joints.

    Args:
        models: By joint, None for those without.
        cycle: Period of the ticks [s].

    Attributes:
        identified: By name of ``StickSlipParameters``, (n,) constants as identified.
        integrates: (n,) joints whose motor boards integrate errors, which their currents show.
        board_integral: (n,) estimated integral of the motor boards, of the measured error [rad].
    """

    def __init__(self, models: Sequence[FusionModel | None], cycle: float) -> None:
        self._cycle = cycle
        parameters = [None if m is None else m.twin for m in models]
        self.identified = {
            name: np.array([np.nan if p is None else getattr(p, name) for p in parameters])
            for name in PARAMETERS
        }
        self._models = StickSlipModel(self.identified, cycle)
        self.integrates = np.array(
            [
                m is not None and m.twin.integral_rate > 0.0 and m.momentum.source == "current"
                for m in models
            ]
        )
        self._any_integrates = bool(self.integrates.any())
        self._remainders = BatchedTrees([None if m is None else m.remainder for m in models])
        self._features = np.zeros((FEATURES, len(models)))
        self._correction = cycle / REST_CORRECTION_TIME
        # Motion in one direction, then break-away in the other.
        both = 1.0 + self.identified["breakaway"]
        self._band_unloaded = self.identified["friction"] * both
        self._band_per_load = self.identified["load_friction"] * both
        self.reset()

    def reset(self) -> None:
        """Forget everything but the models."""
        n = len(self.integrates)
        self.board_integral = np.zeros(n)
        self._past: deque[Prediction] = deque(maxlen=MAX_LATE_TICKS + 1)
        self.adopt(np.zeros((n, 4)))

    @property
    def position(self) -> FloatArray | None:
        """(n,) positions of the stick-slip models [rad]; None before the first tick."""
        return self._models.position if self._past else None

    @property
    def model_velocity(self) -> FloatArray:
        """(n,) speed of the stick-slip models [rad/s]."""
        return self._models.velocity

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
            load_torque: (n,) desired, including the loads of the hands [N m].
            velocity: (n,) desired [rad/s].
            acceleration: (n,) desired [rad/s2].
            measured: (n,) measured positions [rad], where the stick-slip models start in the first tick.
        """
        stick_slip = self._models
        load = self.identified["load_gain"] * load_torque
        if not self._past:
            stick_slip.start(measured, target)
            # At rest, the integral of a motor board has settled to the load that its error does not explain.
            summed = load + self.identified["offset"] - (target - measured)
            self.board_integral = np.where(self.integrates, summed, 0.0)
            stick_slip.integral = np.where(
                self.integrates, self.board_integral, stick_slip.integral
            )
        position = stick_slip.step(target, load_torque)
        features = self._features
        features[0], features[1], features[2] = velocity, acceleration, load_torque
        self._past.append(
            Prediction(
                target=target,
                position=position,
                moves=np.abs(stick_slip.velocity) > MIN_MOVING_SPEED,
                friction=stick_slip.friction,
                load=load,
                velocity=velocity,
                acceleration=acceleration,
                remainder=self._remainders.predict(features),
            )
        )

    def before(self, ticks: int) -> Prediction:
        """Return the prediction of ``ticks`` ticks ago, or of the oldest tick available."""
        return self._past[max(-1 - ticks, -len(self._past))]

    def resistance(self, prediction: Prediction) -> FloatArray:
        """Return (n,) friction and load / K with the adapted constants [rad]."""
        resistance: FloatArray = (
            prediction.friction + prediction.load * self._load_factor + self._extra_load
        )
        return resistance

    def friction_band(self, prediction: Prediction) -> FloatArray:
        """Return the (n,) range from friction at rest in one direction to that in the other [rad]."""
        band: FloatArray = self._band_unloaded + self._band_per_load * np.abs(prediction.load)
        return band

    def beyond_friction(self, prediction: Prediction, measured: FloatArray) -> FloatArray:
        """Return the (n,) part of the tracking error of joints at rest that friction cannot hold [rad]."""
        error = prediction.target - measured - prediction.remainder
        return self._models.beyond_friction(
            error, prediction.load * self._load_factor + self._offset
        )

    def update_integrals(self, error: FloatArray, motor: FloatArray, bad: BoolArray | None) -> None:
        """Update the estimated integrals of the motor boards.

        Args:
            error: (n,) tracking error [rad].
            motor: (n,) torques of the motors / K [rad], which correct the estimate.
            bad: (n,) joints whose values were replaced: their integrals stay.
        """
        if not self._any_integrates:
            return
        summed = self.board_integral + self.identified["integral_rate"] * self._cycle * error
        summed += self._cycle / INTEGRAL_CORRECTION_TIME * (motor - error - summed)
        known = self.integrates if bad is None else self.integrates & ~bad
        self.board_integral = np.where(known, summed, self.board_integral)

    def rest(self, where: BoolArray, residual: FloatArray) -> None:
        """Move the models of joints (n,) at rest without touch slowly by their residual (n,) [rad]."""
        # Exactly 0.0: the model sticks, it is not only slow.
        resting = where & (self._models.velocity == 0.0)
        if not np.count_nonzero(resting):
            return
        stick_slip, pace = self._models, self._correction
        stick_slip.position = np.where(
            resting, stick_slip.position - pace * residual, stick_slip.position
        )
        if self._any_integrates:
            summed = stick_slip.integral + pace * (self.board_integral - stick_slip.integral)
            stick_slip.integral = np.where(resting & self.integrates, summed, stick_slip.integral)

    def put(self, where: BoolArray, measured: FloatArray) -> None:
        """Reset models to the measured positions: with the desired velocity, or held by friction where it is low."""
        velocity = self._past[-1].velocity
        self._models.put(
            where,
            measured,
            np.where(np.abs(velocity) > REST_SPEED, velocity, 0.0),
            np.where(self.integrates, self.board_integral, self._models.integral),
        )

    def shift(self, error: FloatArray) -> None:
        """Increase the tracking error of the stick-slip models by (n,) [rad] at once."""
        self._models.position = self._models.position - error

    def adopt(self, deviation: FloatArray) -> None:
        """Set the adapted constants of the stick-slip models: (n, 4) deviations of ``Adaptation``."""
        p = self.identified
        self._load_factor, self._extra_load = 1.0 + deviation[:, 2], deviation[:, 3] * OFFSET_UNIT
        self._offset = p["offset"] + self._extra_load
        self._models.set(
            {
                **p,
                # At least a fifth of the identified values: both must stay positive.
                "friction": p["friction"] * np.maximum(1.0 + deviation[:, 0], 0.2),
                "lag": p["lag"] * np.maximum(1.0 + deviation[:, 1], 0.2),
                "load_gain": p["load_gain"] * self._load_factor,
                "offset": self._offset,
            }
        )
