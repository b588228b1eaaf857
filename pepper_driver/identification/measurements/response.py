"""Delay from a command to the current that answers it, from small steps of several joints at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepper_driver.config import PepperError, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer import Recording

STEP = 1e-3
"""[rad] in a tick: a command that changes by more begins a step, if it was still before."""

STILL = 5e-4
"""[rad] in a tick: a command that changes by less is still."""

STILL_TICKS = 30
"""Ticks for which it must have been."""

BEFORE = 40
"""Ticks before a step, from which the noise and the drift of a current are known."""

MAX_LEAD = 9
"""Ticks by which a current may answer before the command that its sample was paired with: the reported delay is too
long by so much at most."""

AFTER = 30
"""Ticks after a step in which the current must have answered."""

CLEAR = 50.0
"""Mean square of the currents, in units of their noise, that no noise reaches."""

RISE = 3.0
"""Factor over the ticks before by which that mean square is higher in the first tick of an answer."""

COMPARED = 6
"""Ticks before, of which the median counts: single ones differ by chance."""

MIN_STEPS = 6
"""In one direction: with fewer, noise hides the begin."""


class ResponseError(PepperError, ValueError):
    """A recording does not show when currents answer."""


@dataclass(frozen=True, kw_only=True)
class MeasuredResponse:
    """Time from a command to its effect.

    Attributes:
        lead: Ticks by which currents answer later than the samples that they are paired with; below 0 for earlier.
        steps: Number of steps that were used.
        earliest, latest: The same as ``lead`` of single steps, 10th and 90th percentile.
    """

    lead: int
    steps: int
    earliest: float
    latest: float


def measure_response(
    recording: Recording, joints: Sequence[str], robot: RobotConfig
) -> MeasuredResponse:
    """Measure when currents answer small steps of their joints' commands.

    A motor board answers a new target at once, whatever friction holds the joint: its current changes in the first tick
    after the transport. That change is small, so the mean over all steps in one direction is taken, which leaves little
    of the noise, and its square is summed over joints, in units of what noise is left.

    Args:
        recording: Of a robot whose joints all step at the same time, again and again, and rest in between.
        joints: Those that step.
        robot: Its description.

    Raises:
        ResponseError: There are too few steps, or no current answers them.
    """
    responses = []
    single: dict[int, list[FloatArray]] = {}
    steps = 0
    for joint in joints:
        index = robot.joint_index(joint)
        begins = step_begins(recording.sent_position[:, index])
        commands = recording.sent_position[:, index]
        for sign in (1.0, -1.0):
            same = [k for k in begins if (commands[k] - commands[k - 1]) * sign > 0.0]
            if len(same) < MIN_STEPS:
                continue
            steps = max(steps, len(same))
            answers = np.array([_answer(recording.current[:, index], k) for k in same])
            responses.append(_in_noise(answers.mean(axis=0)))
            for k, answer in zip(same, answers, strict=True):
                single.setdefault(k, []).append(_in_noise(answer))
    if not responses:
        raise ResponseError(
            f"there are fewer than {MIN_STEPS} steps in one direction: nothing shows the delay of the robot"
        )
    together = np.mean(np.square(responses), axis=0)
    lead = _onset(together)
    if lead is None:
        raise ResponseError(
            "no current answers the steps: are the motors stiff, and do their currents arrive?"
        )
    # All joints step at the same time.
    onsets = [_onset(np.mean(np.square(answers), axis=0)) for answers in single.values()]
    found = [onset for onset in onsets if onset is not None] or [lead]
    earliest, latest = np.percentile(found, [10, 90])
    return MeasuredResponse(
        lead=lead, steps=2 * steps, earliest=float(earliest), latest=float(latest)
    )


def step_begins(command: FloatArray) -> list[int]:
    """Return the samples at which the (n,) command of a joint steps after a rest, with room before and after."""
    change = np.abs(np.diff(command, prepend=command[0]))
    return [
        int(k)
        for k in np.flatnonzero(change > STEP)
        if k >= BEFORE and k + AFTER <= len(command) and change[k - STILL_TICKS : k].max() < STILL
    ]


def _answer(current: FloatArray, begin: int) -> FloatArray:
    """Return the (BEFORE + AFTER,) change of a current around a step, without its level and drift before."""
    values, ticks = current[begin - BEFORE : begin + AFTER], np.arange(BEFORE + AFTER)
    quiet = ticks < BEFORE - MAX_LEAD
    line = np.polynomial.Polynomial.fit(ticks[quiet], values[quiet], 1)
    change: FloatArray = values - line(ticks)
    return change


def _in_noise(change: FloatArray) -> FloatArray:
    """Return a change in units of the noise before the step."""
    quiet = change[: BEFORE - MAX_LEAD]
    # The sensor counts in steps: without any change there is still half a step of doubt.
    return change / max(float(np.sqrt(np.mean(quiet**2))), 1e-4)


def _onset(square: FloatArray) -> int | None:
    """Return the tick, from the step on, at which a mean square begins to rise; None if it stays within noise."""
    clear = np.flatnonzero(square[BEFORE - MAX_LEAD :] > CLEAR)
    if not len(clear):
        return None
    tick = int(clear[0]) + BEFORE - MAX_LEAD
    while square[tick] > RISE * np.median(square[tick - COMPARED : tick]):
        tick -= 1
    # This one does not stand out any more: it is the last before the answer.
    return tick + 1 - BEFORE
