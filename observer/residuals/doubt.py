"""Doubt about errors of joints that are no sign of touch: at rest without work of the motor, and far behind a command.

A motor board answers an error by a current, whatever causes the error: a hand, friction or a load. Recorded joints
sometimes rest degrees away from their command with hardly any current, or with the current that their load takes and no
error. The board then follows another target than the command, and the error says nothing about touch.

A joint whose command runs faster than the board lets its target run falls behind it. Recorded joints then run at one of
two speeds, and no model says at which: a residual of fractions of a radian may follow.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import Out, Records, kernel, make_records
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.stick_slip import beyond
from pepper_driver.observer.residuals.prediction import PredictedJoint, Prediction

MIN_DIFFERENCE = np.radians(0.5)
"""[rad] Difference between an error and the one that the current answers, below which no joint is in doubt."""

MIN_INTEGRAL_DIFFERENCE = np.radians(1.0)
"""[rad] The same where the board integrates errors: its integral is an estimate."""

DIFFERENCE_RATIO = 0.5
"""Fraction of the larger one by which they must differ. Where nothing is wrong, they differ by 0.3 at most."""

FULL_CURRENT = 1.0
"""[A] Enough to answer any error: boards limit their currents, and warm motors have less."""

DOUBT_TICKS = 3
"""For which a free joint must show the difference: single samples may be lost."""

TOUCHED_DOUBT_TICKS = 25
"""The same for a joint in contact. One whose board integrates is not: a long touch makes its integral unknown."""

RECENT_TICKS = 8
"""For which such a difference counts: as the target moves off, it comes before the filtered residual."""

TOUCHED_RATIO = 0.5
"""Fraction of its threshold above which a residual is in doubt: a smaller one is no contact anyway."""

MAX_TARGET_ERROR = 0.02
"""[rad] between a command and the limited target of its board, beyond which a joint falls behind."""

MAX_EXPECTED_ERROR = 0.2
"""[rad] Expected error beyond which it does, of joints whose limit was not measured: the models' working range."""

BEHIND_TICKS = 50
"""After it has caught up, in which it settles."""

LINGER_TICKS = 25
"""After the command moves on, in which doubt remains: the board's target returns."""


class Doubt:
    """Constants and state of one joint.

    Attributes:
        torque_per_ampere: Motor torque / K per current [rad/A]; 0 for a joint that is never in doubt.
        dead_band: Error that the motor board ignores [rad].
        lag: Back-EMF of the motor, and other torque that follows the speed, over K [s].
        ticks: For which the current has not answered the error.
        recent: Ticks for which this still counts.
        linger: Ticks for which this doubt remains; 0 without it.
        behind: Ticks for which the doubt of a joint that falls behind remains; 0 without it.
    """

    torque_per_ampere: float
    dead_band: float
    lag: float
    ticks: int
    recent: int
    linger: int
    behind: int


@kernel
def _doubt(
    doubts: Out[Records[Doubt]],
    joints: Records[PredictedJoint],
    target: FloatArray,
    board_target: FloatArray,
    position: FloatArray,
    measured: FloatArray,
    velocity: FloatArray,
    current: FloatArray,
    residual: FloatArray,
    threshold: FloatArray,
    resting: BoolArray,
    free: BoolArray,
    doubtful: Out[BoolArray],
) -> None:
    for j in range(len(doubtful)):
        state, joint = doubts[j], joints[j]
        if state.torque_per_ampere > 0.0:
            asked = beyond(board_target[j] - measured[j], state.dead_band) + joint.board_integral
            asked = abs(asked - state.lag * velocity[j])
            answered = state.torque_per_ampere * abs(current[j])
            due = min(asked, FULL_CURRENT * state.torque_per_ampere)
            difference = max(due - answered, answered - asked)
            bound = MIN_INTEGRAL_DIFFERENCE if joint.integrates else MIN_DIFFERENCE
            bound = max(bound, DIFFERENCE_RATIO * max(due, answered))
            state.ticks = state.ticks + 1 if resting[j] and difference > bound else 0
            large = resting[j] and abs(residual[j]) > TOUCHED_RATIO * threshold[j]
            if state.ticks >= (DOUBT_TICKS if free[j] else TOUCHED_DOUBT_TICKS):
                state.recent = RECENT_TICKS
            elif state.recent > 0:
                state.recent -= 1
            begins = state.recent > 0 and (free[j] or not joint.integrates)
            if large and (begins or state.linger > 0):
                state.linger = LINGER_TICKS
            elif state.linger > 0:
                state.linger -= 1
        behind = abs(target[j] - board_target[j]) > MAX_TARGET_ERROR
        if behind or abs(target[j] - position[j]) > MAX_EXPECTED_ERROR:
            state.behind = BEHIND_TICKS
        elif state.behind > 0:
            state.behind -= 1
        doubtful[j] = state.linger > 0 or state.behind > 0


class DoubtDetector:
    """Detector of joints in doubt.

    Doubt begins where a command rests, the residual is large, and the current is not that of the error for DOUBT_TICKS
    or, in a contact, TOUCHED_DOUBT_TICKS. It ends LINGER_TICKS after the command moves on, or the residual returns.
    Where the current does not show the torque of the motor, no joint at rest is in doubt. A joint in motion is while
    its command runs away from it, and until it has settled.

    Args:
        models: By joint, None for those without.
    """

    def __init__(self, models: Sequence[FusionModel | None]) -> None:
        self._doubts = make_records(
            Doubt,
            len(models),
            torque_per_ampere=[
                0.0 if m is None or m.momentum.source != "current" else m.momentum.torque_per_ampere
                for m in models
            ],
            dead_band=[0.0 if m is None else m.twin.dead_band for m in models],
            lag=[0.0 if m is None else m.twin.lag for m in models],
        )
        self._doubt = _doubt.load()
        self.reset()

    def reset(self) -> None:
        """Forget the session."""
        for name in ("ticks", "recent", "linger", "behind"):
            self._doubts[name] = 0

    def step(
        self,
        joints: Records[PredictedJoint],
        prediction: Prediction,
        measured: FloatArray,
        velocity: FloatArray,
        current: FloatArray,
        residual: FloatArray,
        threshold: FloatArray,
        resting: BoolArray,
        free: BoolArray,
    ) -> BoolArray:
        """Take in one tick; return the (n,) joints in doubt.

        Args:
            joints: Their estimated integrals of the board.
            prediction: Of the tick.
            measured: (n,) positions, finite [rad].
            velocity: (n,) of the joints as measured [rad/s].
            current: (n,) measured, finite [A].
            residual: (n,) filtered [rad].
            threshold: (n,) of a contact [rad].
            resting: (n,) joints whose command rests.
            free: (n,) joints without contact.
        """
        doubtful = np.empty(len(measured), np.bool_)
        self._doubt(
            self._doubts,
            joints,
            prediction.target,
            prediction.board_target,
            prediction.position,
            measured,
            velocity,
            current,
            residual,
            threshold,
            resting,
            free,
            doubtful,
        )
        return doubtful
