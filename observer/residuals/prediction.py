"""Expected positions of mode ``fusion`` in a tick: stick-slip models, and integrals of their motor boards."""

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
from pepper_driver.observer.residuals.joint_tick import JointCommand

MAX_LATE_TICKS = 3
"""Ticks by which a sample may be late and still be compared with the prediction for its time."""


@dataclass(slots=True)
class Prediction:
    """Prediction of one tick; (n,) records.

    Attributes:
        command: Commands of the joints.
        model: States of the stick-slip models.
    """

    command: Records[JointCommand]
    model: Records[StickSlipState]


class PredictedJoint:
    """Constants and state of one joint, without those of its stick-slip model.

    Attributes:
        no_model: True for a joint without a model.
        load_gain: g = 1 / K as identified [rad/(N m)].
        band_unloaded: Range from friction at rest in one direction to that in the other, without load [rad].
        band_per_load: Its increase with the size of the load [rad/rad].
        integrates: True if its motor board integrates errors, which its current shows.
        integral_rate: ki / kp of the motor board [1/s].
        board_integral: Estimated integral of the motor board, of the measured error [rad].
        bias: Of its residual [rad].
    """

    no_model: bool
    load_gain: float
    band_unloaded: float
    band_per_load: float
    integrates: bool
    integral_rate: float
    board_integral: float
    bias: float


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
def rest(
    joints: Records[PredictedJoint],
    states: Out[Records[StickSlipState]],
    j: int,
    residual: float,
    pace: float,
) -> None:
    """Move the model of a joint at rest without touch by a fraction ``pace`` of its residual [rad]."""
    joint, state = joints[j], states[j]
    # Exactly 0.0: the model sticks, it is not only slow.
    if state.velocity == 0.0:
        state.position -= pace * residual
        if joint.integrates:
            state.integral += pace * (joint.board_integral - state.integral)


@kernel
def friction_band(
    joints: Records[PredictedJoint], j: int, load_torque: float, moving: bool
) -> float:
    """Return the largest error at which friction can hold a joint [rad], 0 for one that slides.

    It is the range from friction at rest in one direction to that in the other, under a load [N m].
    """
    joint = joints[j]
    # Friction cannot hold a joint that is to move.
    if moving:
        return 0.0
    return joint.band_unloaded + joint.band_per_load * abs(joint.load_gain * load_torque)


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
        p = self.identified
        # Motion in one direction, then break-away in the other.
        both = 1.0 + p["breakaway"]
        self.joints = make_records(
            PredictedJoint,
            len(models),
            no_model=[m is None for m in models],
            load_gain=p["load_gain"],
            band_unloaded=p["friction"] * both,
            band_per_load=p["load_friction"] * both,
            integrates=self.integrates,
            integral_rate=p["integral_rate"],
        )
        self.reset()

    def reset(self) -> None:
        """Forget everything but the models."""
        self.joints["board_integral"] = self.joints["bias"] = 0.0
        self._past: deque[Prediction] = deque(maxlen=MAX_LATE_TICKS + 1)

    @property
    def states(self) -> Records[StickSlipState]:
        """States of the stick-slip models."""
        return self._models.states

    @property
    def position(self) -> FloatArray | None:
        """(n,) positions of the stick-slip models [rad]; None before the first tick."""
        return self.states["position"] if self._past else None

    def step(self, command: Records[JointCommand], measured: FloatArray) -> None:
        """Take in one tick; all values finite.

        Args:
            command: (n,) commands; a copy is kept.
            measured: (n,) measured positions [rad], where the stick-slip models start in the first tick.
        """
        if not self._past:
            self._start(command, measured)
        model = self._models.step(command["target"], command["load_torque"])
        self._past.append(Prediction(command=command.copy(), model=model))

    def _start(self, command: Records[JointCommand], measured: FloatArray) -> None:
        """Start the stick-slip models at rest."""
        p, integrates, target = self.identified, self.integrates, command["target"]
        self._models.start(measured, target)
        # At rest, the integral of a motor board has settled to the load that its error does not explain.
        summed = p["load_gain"] * command["load_torque"] + p["offset"] - (target - measured)
        for integral in (self.joints["board_integral"], self.states["integral"]):
            integral[integrates] = summed[integrates]

    def before(self, ticks: int) -> Prediction:
        """Return the prediction of ``ticks`` ticks ago, or of the oldest tick available."""
        return self._past[max(-1 - ticks, -len(self._past))]

    def put(self, where: BoolArray, measured: FloatArray) -> None:
        """Reset models to the measured positions: with the desired velocity, or held by friction where it is low."""
        velocity = self._past[-1].command["velocity"]
        integral = self.states["integral"]
        self._models.put(
            where,
            measured,
            np.where(np.abs(velocity) > REST_SPEED, velocity, 0.0),
            np.where(self.integrates, self.joints["board_integral"], integral),
        )
