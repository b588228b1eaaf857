"""The motion of a scenario, drawn from its seed: what the joints are told, one leg after the other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from pepper_driver.config import RobotConfig, Scenario
from pepper_driver.config.scenario_motion import Holds, Script, Setpoints, Sweeps


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A stretch of motion with one goal.

    Attributes:
        joints: Angles to go to [rad]; joints that are not named keep theirs.
        ticks: Length of the stretch, in cycles of the robot.
        move: The goal is reached on a minimum-jerk way over this many of them; at 0 it is given at once.
        stiffness: Of the posture task from here on [1/s2]; None leaves it.
        settling: On the way to a first posture: before the motion proper.
    """

    joints: Mapping[str, float]
    ticks: int
    move: int = 0
    stiffness: float | None = None
    settling: bool = False


def legs(
    scenario: Scenario, robot: RobotConfig, rng: np.random.Generator, *, count: int | None = None
) -> Iterator[Leg]:
    """The legs of a scenario, each drawn when it is asked for: contacts share the generator.

    Args:
        scenario: Whose motion.
        robot: Its description.
        rng: Source of all that is random.
        count: How many goals, for motion of kind setpoints or holds, in place of the scenario's own number.
    """
    motion = scenario.motion
    posture = {} if scenario.posture is None else _named(robot, scenario.posture)
    settling = Leg(
        joints=posture,
        ticks=_ticks(scenario.settle, robot),
        stiffness=scenario.stiffness,
        settling=True,
    )
    if isinstance(motion, Sweeps):
        for joint in motion.joints:
            yield from _sweeps(motion, joint, settling, robot, rng)
        return
    yield settling
    if isinstance(motion, Script):
        yield from _script(motion, robot)
        return
    for _ in range(motion.count if count is None else count):
        goal = {name: _angle(robot, name, motion.range, rng) for name in motion.joints}
        if isinstance(motion, Setpoints):
            goal |= {name: _angle(robot, name, motion.also_range, rng) for name in motion.also_move}
        move = _ticks(motion.move, robot) if isinstance(motion, Holds) else 0
        yield Leg(joints=goal, ticks=_ticks(motion.period, robot), move=move)


def _ticks(seconds: float, robot: RobotConfig) -> int:
    """A time in whole cycles."""
    return round(seconds / robot.cycle)


def _named(robot: RobotConfig, posture: str) -> dict[str, float]:
    return dict(zip(robot.joint_names, robot.posture(posture).tolist(), strict=True))


def _sweeps(
    motion: Sweeps, joint: str, settling: Leg, robot: RobotConfig, rng: np.random.Generator
) -> Iterator[Leg]:
    """The sequence of one joint twice, with other postures of its neighbours."""
    sequence = _sequence(motion, joint, robot, rng)
    for part in range(2):
        neighbours = _neighbours(motion, joint, robot, rng)
        if part == 0:
            yield replace(settling, joints={**settling.joints, **neighbours})
        for number, (target, dwell) in enumerate(sequence):
            moved = neighbours if part == 1 and number == 0 else {}
            yield Leg(joints={**moved, joint: target}, ticks=_ticks(dwell, robot))


def _sequence(
    motion: Sweeps, joint: str, robot: RobotConfig, rng: np.random.Generator
) -> list[tuple[float, float]]:
    """Targets [rad] and dwell times [s]: sweeps between the limits with small or big offsets, then set-points."""
    config = robot.joints[robot.joint_index(joint)]
    offset = motion.largest_offset * (config.upper - config.lower)
    targets = []
    for _ in range(motion.sweeps):
        targets.append(config.lower + rng.uniform(0.0, offset))
        targets.append(config.upper - rng.uniform(0.0, offset))
    targets.extend(rng.uniform(config.lower, config.upper, motion.setpoints))
    dwells = rng.uniform(*motion.dwell, len(targets))
    return [(float(target), float(dwell)) for target, dwell in zip(targets, dwells, strict=True)]


def _neighbours(
    motion: Sweeps, joint: str, robot: RobotConfig, rng: np.random.Generator
) -> dict[str, float]:
    """New angles [rad] for the joints before and after ``joint`` in its chain."""
    chain = robot.chain_of(joint)
    place = chain.index(joint)
    angles = {}
    for name in (*chain[max(0, place - 1) : place], *chain[place + 1 : place + 2]):
        config = robot.joints[robot.joint_index(name)]
        middle, span = (config.lower + config.upper) / 2, config.upper - config.lower
        reach = motion.neighbour_range * span / 2
        angles[name] = float(rng.uniform(middle - reach, middle + reach))
    return angles


def _script(motion: Script, robot: RobotConfig) -> Iterator[Leg]:
    """A leg from each step to the next, and one before the first if that comes late."""
    if motion.steps[0].time > 0:
        yield Leg(joints={}, ticks=_ticks(motion.steps[0].time, robot))
    ends = (*(step.time for step in motion.steps[1:]), motion.length)
    for step, end in zip(motion.steps, ends, strict=True):
        joints = step.joints if step.posture is None else _named(robot, step.posture)
        yield Leg(
            joints=joints,
            ticks=_ticks(end, robot) - _ticks(step.time, robot),
            stiffness=step.stiffness,
        )


def _angle(robot: RobotConfig, joint: str, share: float, rng: np.random.Generator) -> float:
    """A random angle in the middle ``share`` of a joint's range [rad]."""
    limits = robot.joints[robot.joint_index(joint)]
    middle, half = (limits.lower + limits.upper) / 2, (limits.upper - limits.lower) / 2
    return float(middle + share * half * rng.uniform(-1.0, 1.0))
