"""Currents that the law of a motor board does not explain: its target jumps, or its motor is saturated.

The current of a board follows from the tracking error, and a touch shows in both. Where the current does something
else, the joint moves without a touch:

- The target of a board jumps: one that was off its command comes back within a few ticks. The current rises while the
  output of the law falls, or the output is there without a current. The thresholds of this joint, and of what it
  shakes, are then higher.
- A motor is saturated: a load takes all of its torque. The joint falls behind, farther than targets drift, and catches
  up with a jolt. No model of free motion describes that: the joints of its limb cannot be judged, nor trunk and base
  while it catches up.

A touch may saturate a motor too, but it is detected before that: joints of a limb that is touched are judged on. Boards
of wrists and hands are left out: too little is known of their dead band and stiffness.
"""

from __future__ import annotations

import math

from pepper_driver.config.arrays import BoolArray, IntArray
from pepper_driver.config.kernels import Matrix, Out, Records, kernel, make_records
from pepper_driver.observer.constants import (
    MAX_TARGET_DRIFT,
    MIN_DRIVE,
    PUSH_TICKS,
    SETTLING_TICKS,
    UNSURE_FACTOR,
)
from pepper_driver.observer.detection.threshold import ThresholdState
from pepper_driver.observer.residuals.joint_tick import JointCommand, JointTick

CATCHING_UP_TICKS = 2 * SETTLING_TICKS
"""In which a joint settles after its motor was saturated: as long as an identification leaves out."""


class LawState:
    """Current of one joint against the law of its board.

    Attributes:
        known: True if the current shows the torque of the motor, and the law of the board is known.
        started: False until the first sample that can be judged.
        motor: Size of this torque / K, smoothed [rad].
        output: Size of the output of the law, smoothed as well [rad].
        surplus: Usual difference of the two: a constant that is a little wrong, a target that drifted [rad].
        free_ticks: For which the joint has been judged, and its limb not touched.
        jump_ticks: For which the difference has been far from the usual one.
        short_ticks: For which the motor has given less than the law asks for.
        saturated_ticks: For which the joint still counts as saturated.
    """

    known: bool
    started: bool
    motor: float
    output: float
    surplus: float
    free_ticks: int
    jump_ticks: int
    short_ticks: int
    saturated_ticks: int


@kernel
def step_law(
    states: Out[Records[LawState]], j: int, motor: float, output: float, free: bool, gain: float
) -> None:
    """Take in one tick of a joint whose law is known.

    Args:
        states: Of the joints.
        j: Index of the joint.
        motor: Torque of the motor / K [rad].
        output: Of the law of the board, for the measured error [rad].
        free: True if the joint can be judged, and its limb is not touched.
        gain: Fraction of a change that the smoothed values take in.
    """
    p = states[j]
    if not p.started:
        p.started, p.free_ticks = True, SETTLING_TICKS
        p.motor, p.output = abs(motor), abs(output)
        p.surplus = p.motor - p.output
    p.motor += gain * (abs(motor) - p.motor)
    p.output += gain * (abs(output) - p.output)
    surplus = p.motor - p.output
    p.short_ticks = p.short_ticks + 1 if surplus < -MIN_DRIVE else 0
    p.free_ticks = p.free_ticks + 1 if free else 0
    if p.free_ticks <= SETTLING_TICKS:
        # A hand that lets go leaves a current that falls later than the output.
        p.surplus, p.jump_ticks = surplus, 0
        return
    p.surplus += (surplus - p.surplus) / SETTLING_TICKS
    change = surplus - p.surplus
    # A push raises the output first, and the current follows it.
    jumps = change > MIN_DRIVE or change < -UNSURE_FACTOR * MIN_DRIVE
    p.jump_ticks = p.jump_ticks + 1 if jumps else 0


@kernel
def _step(
    states: Out[Records[LawState]],
    limbs: IntArray,
    carries: Matrix[BoolArray],
    gain: float,
    jump_ticks: int,
    hands: IntArray,
    thresholds: Records[ThresholdState],
    commands: Records[JointCommand],
    ticks: Out[Records[JointTick]],
) -> tuple[int, bool, bool]:
    """Take in one tick, as :meth:`BoardLaw.step`."""
    jump, catches_up, count, n = False, False, 0, len(ticks)
    for j in range(n):
        state, tick = states[j], ticks[j]
        if not state.known:
            continue
        if not tick.good:
            state.started, tick.jumps = False, False
            state.jump_ticks = state.short_ticks = state.saturated_ticks = 0
            continue
        # A touch of the limb, or of anything that depends on the motion of the joint.
        limb_touched = touched = False
        for i in range(n):
            if carries[j, i] and (thresholds[i].touched or hands[i] != 0):
                touched = True
                limb_touched = limb_touched or limbs[i] == limbs[j]
        free = not (limb_touched or tick.blind)
        step_law(states, j, tick.motor, tick.output, free, gain)
        tick.jumps = state.jump_ticks >= jump_ticks
        jump = jump or tick.jumps
        begins = (
            not touched
            and state.short_ticks >= PUSH_TICKS
            and abs(tick.by_model) > MAX_TARGET_DRIFT
        )
        behind = (
            state.short_ticks > 0 and abs(commands[j].target - tick.measured) > MAX_TARGET_DRIFT
        )
        if begins or (state.saturated_ticks > 0 and behind):
            state.saturated_ticks = CATCHING_UP_TICKS
        else:
            state.saturated_ticks = max(state.saturated_ticks - 1, 0)
    for j in range(n):
        if states[j].saturated_ticks > 0:
            catching_up = states[j].saturated_ticks < CATCHING_UP_TICKS
            catches_up = catches_up or catching_up
            for i in range(n):
                if limbs[i] == limbs[j] or (catching_up and carries[j, i]):
                    ticks[i].good, ticks[i].raw = False, math.nan
    for j in range(n):
        count += ticks[j].good
    return count, jump, catches_up


class BoardLaw:
    """Comparison of the currents of all joints with the law of their boards.

    Args:
        known: (n,) True where the current shows the torque of the motor, and the law of the board is known.
        limbs: (n,) number of the limb of each joint, 0 for the trunk.
        carries: (n, n) True where the load on the joint of the column depends on the motion of the joint of the row.
        gain: Fraction of a change that the smoothed values take in with one sample.
        window: Samples of the median of the residuals: they show a change after half of it.
    """

    def __init__(
        self, known: BoolArray, limbs: IntArray, carries: BoolArray, gain: float, window: int
    ) -> None:
        self._known, self._limbs, self._carries = known, limbs, carries
        self._gain, self._jump_ticks = gain, window // 2 + 1
        self._step = _step.load_unchecked()
        self.reset()

    def reset(self) -> None:
        """Forget the session."""
        self.states = make_records(LawState, len(self._known), known=self._known)

    def step(
        self,
        commands: Records[JointCommand],
        thresholds: Records[ThresholdState],
        hands: IntArray,
        ticks: Records[JointTick],
    ) -> tuple[int, bool, bool]:
        """Take in one tick.

        Args:
            commands: Of the joints, for the time of the sample.
            thresholds: Of the joints, after the last tick: those that are touched.
            hands: (n,) signs of touches, 0 for none.
            ticks: With ``motor``, ``output`` and ``by_model``; ``jumps`` is set, and ``good`` is cleared where a joint
                cannot be judged.

        Returns:
            The number of joints that are good; True if a target jumps; True if a joint whose motor was saturated
            catches up.
        """
        return self._step(
            self.states,
            self._limbs,
            self._carries,
            self._gain,
            self._jump_ticks,
            hands,
            thresholds,
            commands,
            ticks,
        )
