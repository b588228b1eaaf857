"""Expected errors of mode ``fusion`` in a tick: stick-slip models, integrals of their motor boards, remainders."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import Out, Records, kernel, make_records
from pepper_driver.observer.constants import CORRECTION_TIME, REST_SPEED
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.stick_slip import (
    StickSlipModel,
    StickSlipState,
    stick_slip_constants,
)
from pepper_driver.observer.models.tree import BatchedTrees

MAX_LATE_TICKS = 3
"""Ticks by which a sample may be late and still be compared with the prediction for its time."""


@dataclass(slots=True)
class Prediction:
    """Prediction of one tick; arrays (n,).

    Attributes:
        target: Position sent [rad].
        board_target: The same, behind it where the board limits its speed [rad].
        load_torque: Desired [N m].
        velocity: Desired [rad/s].
        acceleration: Desired [rad/s2].
        position: Position of the stick-slip models [rad].
        speed: Their velocity [rad/s].
        friction: Their friction / K, positive against positive motion [rad].
        remainder: Part of the tracking error that the stick-slip models do not explain [rad].
    """

    target: FloatArray
    board_target: FloatArray
    load_torque: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    position: FloatArray
    speed: FloatArray
    friction: FloatArray
    remainder: FloatArray


class PredictedJoint:
    """Constants and state of one joint beside those of its stick-slip model.

    Attributes:
        load_gain: g = 1 / K as identified [rad/(N m)].
        band_unloaded: Range from friction at rest in one direction to that in the other, without load [rad].
        band_per_load: Its increase with the size of the load [rad/rad].
        integrates: True if its motor board integrates errors, which its current shows.
        integral_rate: ki / kp of the motor board [1/s].
        board_integral: Estimated integral of the motor board, of the measured error [rad].
    """

    load_gain: float
    band_unloaded: float
    band_per_load: float
    integrates: bool
    integral_rate: float
    board_integral: float


@kernel
def update_integral(
    joints: Out[Records[PredictedJoint]], j: int, error: float, motor: float, cycle: float
) -> None:
    """Update the estimated integral of a motor board by the error and the torque of the motor / K, both [rad]."""
    joint = joints[j]
    if joint.integrates:
        joint.board_integral += joint.integral_rate * cycle * error
        correction = cycle / CORRECTION_TIME
        joint.board_integral += correction * (motor - error - joint.board_integral)


@kernel
def _rest(
    joints: Records[PredictedJoint],
    states: Out[Records[StickSlipState]],
    where: BoolArray,
    residual: FloatArray,
    pace: float,
) -> None:
    for j in range(len(where)):
        state = states[j]
        # Exactly 0.0: the model sticks, it is not only slow.
        if where[j] and state.velocity == 0.0:
            state.position -= pace * residual[j]
            if joints[j].integrates:
                state.integral += pace * (joints[j].board_integral - state.integral)


@kernel
def _friction_band(
    joints: Records[PredictedJoint],
    load_torque: FloatArray,
    moving: BoolArray,
    band: Out[FloatArray],
) -> None:
    for j in range(len(band)):
        joint = joints[j]
        band[j] = joint.band_unloaded + joint.band_per_load * abs(joint.load_gain * load_torque[j])
        # Friction cannot hold a joint that is to move.
        if moving[j]:
            band[j] = 0.0


class ErrorPredictor:
    """Predictor of tracking errors: it steps the stick-slip models and corrects them by measurements of free joints.

    Args:
        models: By joint, None for those without.
        cycle: Period of the ticks [s].

    Attributes:
        identified: Constants of the stick-slip models as identified.
        integrates: (n,) joints whose motor boards integrate errors, which their currents show.
        joints: Constants and states of the joints.
    """

    def __init__(self, models: Sequence[FusionModel | None], cycle: float) -> None:
        self.identified = stick_slip_constants([None if m is None else m.twin for m in models])
        self.integrates = np.array(
            [
                m is not None and m.twin.integral_rate > 0.0 and m.momentum.source == "current"
                for m in models
            ]
        )
        self._models = StickSlipModel(self.identified, cycle)
        self._remainders = BatchedTrees([None if m is None else m.remainder for m in models])
        self._correction = cycle / CORRECTION_TIME
        p = self.identified
        # Motion in one direction, then break-away in the other.
        both = 1.0 + p["breakaway"]
        self.joints = make_records(
            PredictedJoint,
            len(models),
            load_gain=p["load_gain"],
            band_unloaded=p["friction"] * both,
            band_per_load=p["load_friction"] * both,
            integrates=self.integrates,
            integral_rate=p["integral_rate"],
        )
        self._rest, self._friction_band = _rest.load(), _friction_band.load()
        self.reset()

    def reset(self) -> None:
        """Forget everything but the models."""
        self.joints["board_integral"] = 0.0
        self._past: deque[Prediction] = deque(maxlen=MAX_LATE_TICKS + 1)

    @property
    def position(self) -> FloatArray | None:
        """(n,) positions of the stick-slip models [rad]; None before the first tick."""
        return self._models.states["position"] if self._past else None

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
            load_torque: (n,) desired [N m].
            velocity: (n,) desired [rad/s].
            acceleration: (n,) desired [rad/s2].
            measured: (n,) measured positions [rad], where the stick-slip models start in the first tick.
        """
        if not self._past:
            self._start(target, load_torque, measured)
        position, speed, friction = self._models.step(target, load_torque)
        self._past.append(
            Prediction(
                target=target,
                board_target=self._models.states["target"].copy(),
                load_torque=load_torque,
                velocity=velocity,
                acceleration=acceleration,
                position=position,
                speed=speed,
                friction=friction,
                remainder=self._remainders.predict(velocity, acceleration, load_torque),
            )
        )

    def _start(self, target: FloatArray, load_torque: FloatArray, measured: FloatArray) -> None:
        """Start the stick-slip models at rest."""
        p, integrates = self.identified, self.integrates
        self._models.start(measured, target)
        # At rest, the integral of a motor board has settled to the load that its error does not explain.
        summed = p["load_gain"] * load_torque + p["offset"] - (target - measured)
        for integral in (self.joints["board_integral"], self._models.states["integral"]):
            integral[integrates] = summed[integrates]

    def before(self, ticks: int) -> Prediction:
        """Return the prediction of ``ticks`` ticks ago, or of the oldest tick available."""
        return self._past[max(-1 - ticks, -len(self._past))]

    def friction_band(self, prediction: Prediction, moving: BoolArray) -> FloatArray:
        """Return the (n,) largest errors at which friction can hold the joints [rad], 0 for those that slide.

        It is the range from friction at rest in one direction to that in the other.

        Args:
            prediction: Of the tick.
            moving: (n,) joints that slide.
        """
        band = np.empty(len(moving))
        self._friction_band(self.joints, prediction.load_torque, moving, band)
        return band

    def rest(self, where: BoolArray, residual: FloatArray) -> None:
        """Move the models of joints (n,) at rest without touch slowly by their residual (n,) [rad]."""
        self._rest(self.joints, self._models.states, where, residual, self._correction)

    def put(self, where: BoolArray, measured: FloatArray) -> None:
        """Reset models to the measured positions: with the desired velocity, or held by friction where it is low."""
        velocity = self._past[-1].velocity
        integral = self._models.states["integral"]
        self._models.put(
            where,
            measured,
            np.where(np.abs(velocity) > REST_SPEED, velocity, 0.0),
            np.where(self.integrates, self.joints["board_integral"], integral),
        )
