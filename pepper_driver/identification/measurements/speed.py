"""Speed that a joint reaches, from moves that ask for more and more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.observer import Recording
from pepper_driver.observer.fitting.samples import stretches

MIDDLE = (0.3, 0.7)
"""Part of the way of a move over which its speed is taken: it no longer accelerates, and does not yet swing."""

FOLLOWING_TIME = 0.5
"""[s] in which a joint follows its command, at most."""

MIN_WAY = 0.3
"""[rad] of a move that counts."""

FASTEST = 0.9
"""Fraction of the largest commanded speed from which on a move counts as one of the fastest."""

STILL = 0.02
"""[rad/s] Slower, a command rests."""

REACHED = 0.92
"""Fraction of the commanded speed below which a joint is held at a limit: one that follows reaches more."""

MIN_LIMITED = 2
"""Moves in which a joint must run slower than that: a single one may be a sample that was lost."""


@dataclass(frozen=True, kw_only=True)
class ReachedSpeed:
    """Speeds of one joint in its fastest moves, medians.

    Recorded robots hold most moves at a limit, and let others run twice as fast. Where moves were held, they alone
    count: a command can rely on their speed.

    Attributes:
        commanded: Of the command in the middle of a move [rad/s].
        reached: Of the motion there [rad/s].
        moves: Number of moves.
    """

    commanded: float
    reached: float
    moves: int

    @property
    def limited(self) -> bool:
        """True where the joint runs slower than its command."""
        return self.reached < REACHED * self.commanded


def measure_speed(recording: Recording, joint: str, robot: RobotConfig) -> ReachedSpeed | None:
    """Measure the speeds of the fastest moves of a joint; None where it makes none.

    Args:
        recording: With moves that are followed by rests.
        joint: Its name.
        robot: Its description.
    """
    index = robot.joint_index(joint)
    command, position = recording.sent_position[:, index], recording.position[:, index]
    commanded, reached = [], []
    for begin, end in _moves(command, recording.cycle):
        start, goal = command[begin], command[end - 1]
        if abs(goal - start) < MIN_WAY:
            continue
        later = end + round(FOLLOWING_TIME / recording.cycle)
        fresh = recording.age[begin:later] < 0.5 * recording.cycle
        speeds = [
            _middle_speed((values[begin:later] - start) / (goal - start), used, recording.cycle)
            for values, used in ((command, np.ones_like(fresh)), (position, fresh))
        ]
        if np.isfinite(speeds).all():
            commanded.append(abs(goal - start) * speeds[0])
            reached.append(abs(goal - start) * speeds[1])
    if not commanded:
        return None
    counted = np.array(commanded) >= FASTEST * max(commanded)
    held = counted & (np.array(reached) < REACHED * np.array(commanded))
    if np.count_nonzero(held) >= MIN_LIMITED:
        counted = held
    return ReachedSpeed(
        commanded=float(np.median(np.array(commanded)[counted])),
        reached=float(np.median(np.array(reached)[counted])),
        moves=int(np.count_nonzero(counted)),
    )


def _moves(command: FloatArray, cycle: float) -> list[tuple[int, int]]:
    """Return begin and end of each motion of a command."""
    moving = np.abs(np.diff(command)) > STILL * cycle
    return [(begin, end + 1) for begin, end in stretches(moving)]


def _middle_speed(part: FloatArray, used: BoolArray, cycle: float) -> float:
    """Return the speed over the middle of a move of length 1 [1/s], of the samples used; NaN if it ends before."""
    ticks = np.flatnonzero(used)
    crossings = []
    for level in MIDDLE:
        beyond = np.flatnonzero(part[ticks] >= level)
        if not len(beyond) or beyond[0] == 0:
            return float("nan")
        before, after = ticks[beyond[0] - 1], ticks[beyond[0]]
        rest = (part[after] - level) / (part[after] - part[before])
        crossings.append(float(after - rest * (after - before)))
    first, second = crossings
    return (MIDDLE[1] - MIDDLE[0]) / max((second - first) * cycle, cycle)
