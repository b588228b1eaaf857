"""The motion of a scenario, drawn from its seed: what the joints are told, one leg after the other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from pepper_driver.config import RobotConfig, Scenario
from pepper_driver.config.scenario_motion import BaseMotion, Holds, Script, Setpoints, Sweeps


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A stretch of motion with one goal.

    Attributes:
        joints: Angles to go to [rad]; joints that are not named keep theirs.
        ticks: Length of the stretch, in cycles of the robot.
        move: The goal is reached on a minimum-jerk way over this many of them; at 0 it is given at once.
        stiffness: Of the posture task from here on [1/s2]; None leaves it.
        settling: On the way to a first posture: before the motion proper.
        twist: Of the base from here on, vx, vy [m/s], wz [rad/s]; None leaves it.
    """

    joints: Mapping[str, float]
    ticks: int
    move: int = 0
    stiffness: float | None = None
    settling: bool = False
    twist: tuple[float, float, float] | None = None


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
        yield random_leg(motion, robot, rng)


def random_leg(motion: Setpoints | Holds, robot: RobotConfig, rng: np.random.Generator) -> Leg:
    """A leg to a random goal."""
    ticks = _ticks(motion.period, robot)
    if isinstance(motion, Holds):
        goal = {name: _angle(robot, name, motion.range, rng) for name in motion.joints}
        return Leg(joints=goal, ticks=ticks, move=_ticks(motion.move, robot))
    shares = dict.fromkeys(motion.joints, motion.range)
    shares |= dict.fromkeys(motion.also_move, motion.also_range)
    shares |= motion.ranges
    goal = {name: _angle(robot, name, share, rng) for name, share in shares.items()}
    twist = None if motion.base is None else _twist(motion.base, rng)
    return Leg(joints=goal, ticks=ticks, twist=twist)


def _ticks(seconds: float, robot: RobotConfig) -> int:
    """A time in whole cycles."""
    return round(seconds / robot.cycle)


def _named(robot: RobotConfig, posture: str) -> dict[str, float]:
    return dict(zip(robot.joint_names, robot.posture(posture).tolist(), strict=True))


def _sweeps(
    motion: Sweeps, joint: str, settling: Leg, robot: RobotConfig, rng: np.random.Generator
) -> Iterator[Leg]:
    """The sequence of one joint twice, with other postures of its neighbours."""
    sequence = _sequence(motion, joint, settling.joints, robot, rng)
    for part in range(2):
        neighbours = _neighbours(motion, joint, settling.joints, robot, rng)
        if part == 0:
            yield replace(settling, joints={**settling.joints, **neighbours})
        for number, (target, dwell) in enumerate(sequence):
            moved = neighbours if part == 1 and number == 0 else {}
            yield Leg(joints={**moved, joint: target}, ticks=_ticks(dwell, robot))


def swept_range(
    motion: Sweeps, joint: str, posture: Mapping[str, float], robot: RobotConfig
) -> tuple[float, float]:
    """Between which angles [rad] a joint may be told to go, from the first posture [rad]."""
    config = robot.joints[robot.joint_index(joint)]
    share = motion.ranges.get(joint)
    if share is None:
        return config.lower, config.upper
    start = posture.get(joint, (config.lower + config.upper) / 2)
    return start - share * (start - config.lower), start + share * (config.upper - start)


def _sequence(
    motion: Sweeps,
    joint: str,
    posture: Mapping[str, float],
    robot: RobotConfig,
    rng: np.random.Generator,
) -> list[tuple[float, float]]:
    """Targets [rad] and dwell times [s]: sweeps between the limits with small or big offsets, then set-points."""
    lower, upper = swept_range(motion, joint, posture, robot)
    offset = motion.largest_offset * (upper - lower)
    targets = []
    for _ in range(motion.sweeps):
        targets.append(lower + rng.uniform(0.0, offset))
        targets.append(upper - rng.uniform(0.0, offset))
    targets.extend(rng.uniform(lower, upper, motion.setpoints))
    dwells = rng.uniform(*motion.dwell, len(targets))
    return [(float(target), float(dwell)) for target, dwell in zip(targets, dwells, strict=True)]


def _neighbours(
    motion: Sweeps,
    joint: str,
    posture: Mapping[str, float],
    robot: RobotConfig,
    rng: np.random.Generator,
) -> dict[str, float]:
    """New angles [rad] for the joints before and after ``joint`` in its chain."""
    chain = robot.chain_of(joint)
    place = chain.index(joint)
    angles = {}
    for name in (*chain[max(0, place - 1) : place], *chain[place + 1 : place + 2]):
        lower, upper = swept_range(motion, name, posture, robot)
        middle, span = (lower + upper) / 2, upper - lower
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


def _twist(motion: BaseMotion, rng: np.random.Generator) -> tuple[float, float, float]:
    """A random twist of the base, or none: vx, vy [m/s], wz [rad/s]."""
    moves = rng.uniform() < motion.share
    speed, heading = rng.uniform(0.0, motion.linear), rng.uniform(-np.pi, np.pi)
    turn = rng.uniform(-motion.angular, motion.angular)
    if not moves:
        return 0.0, 0.0, 0.0
    return float(speed * np.cos(heading)), float(speed * np.sin(heading)), float(turn)
