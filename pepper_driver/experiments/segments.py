"""Steps as they are planned, each with the posture it leads to; random goals are drawn from a seed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_specs import GrabSpec
from pepper_driver.config.steps import BaseMotion, Holds, Setpoints, Step, Sweeps
from pepper_driver.config.task_specs import BaseVelocitySpec
from pepper_driver.experiments.push_planning import PlannedPush

ARRIVAL = 6.0
"""A joint counts as moving for this many time constants 1/sqrt(stiffness) of the posture task after a new goal."""


@dataclass(frozen=True, kw_only=True)
class PlannedContact:
    """A contact that a simulated robot is given.

    Attributes:
        planned: Its force; of a grab the pull of its spring while the link stays in place.
        delay: Time after the beginning of its step, or of the experiment [s].
        duration: Its length [s].
        moving: True where its joint is moving then.
        grab: The hand that grabs; None for a push.
        rise: Time in which a push rises [s]; None for that of the backend.
    """

    planned: PlannedPush
    delay: float
    duration: float
    moving: bool
    grab: GrabSpec | None = None
    rise: float | None = None

    @property
    def end(self) -> float:
        """Its end, counted as ``delay`` is [s]."""
        return self.delay + self.duration

    def __str__(self) -> str:
        planned = self.planned
        how = "pushed" if self.grab is None else "grabbed"
        text = f"{how} with {planned.newtons:.1f} N for {self.duration:.2g} s"
        if planned.joint is None:
            return text
        return f"{text}, {planned.degrees:.1f} equivalent degrees on {planned.joint}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Segment:
    """A step that is played, and the contacts that begin with it.

    Attributes:
        key: Its place in the file.
        number: Of the step, from 0, in the order of the file; goals of one step have one number.
        step: The motion; a random goal is one too.
        name: Of the step, or its number.
        start: When it is first played, if all before takes its longest [s].
        ticks: Its longest time, in cycles.
        stiffness: Of the posture task [1/s2].
        posture: (17,) where it leads [rad], NaN where no step has said; tasks count as moving nothing.
        arrival: (17,) when each joint has come to rest there [s].
        origin: (17,) where it begins [rad].
        is_timed: True where nothing before it may end early.
        is_random: True for a goal that was drawn.
        is_settling: True during the motion to the first posture of random goals.
        contacts: They begin with it, each time.
    """

    key: str
    number: int
    step: Step
    name: str
    start: float
    ticks: int
    stiffness: float
    posture: FloatArray
    arrival: FloatArray
    origin: FloatArray
    is_timed: bool = True
    is_random: bool = False
    is_settling: bool = False
    contacts: list[PlannedContact] = field(default_factory=list)

    @classmethod
    def before(cls, posture: FloatArray, stiffness: float) -> Segment:
        """Make a segment of no length that leads to a posture (17,): what is before the first."""
        return cls(
            key="",
            number=-1,
            step=Step(hold=1.0),
            name="",
            start=0.0,
            ticks=0,
            stiffness=stiffness,
            posture=posture,
            arrival=np.full_like(posture, -np.inf),
            origin=posture,
        )

    def end(self, robot: RobotConfig) -> float:
        """Return its longest end [s]."""
        return self.start + self.ticks * robot.cycle

    def at_rest(self, time: float) -> bool:
        """Return True where all joints have come to rest by then [s]."""
        return bool(self.arrival.max() <= time)

    def shifted(self, end: float, robot: RobotConfig, *, is_timed: bool) -> Segment:
        """Return it as it is when it ends at another time [s]."""
        start = end - self.ticks * robot.cycle
        return replace(self, start=start, is_timed=self.is_timed and is_timed)

    def expected(self, time: float) -> FloatArray:
        """Return (17,) where joints should be ``time`` [s] after a goal was set: the law of the posture task."""
        rate = np.sqrt(self.stiffness) * time
        away: FloatArray = self.origin - self.posture
        there: FloatArray = self.posture + away * (1.0 + rate) * np.exp(-rate)
        return there

    def moves(self, joint: str | None, delay: float, robot: RobotConfig) -> bool:
        """Return True where a joint, or any for None, is still moving ``delay`` [s] after the beginning."""
        arrival = self.arrival.max() if joint is None else self.arrival[robot.joint_index(joint)]
        return bool(self.start + delay < arrival)


def goal_posture(step: Step, before: FloatArray, robot: RobotConfig) -> FloatArray:
    """Return (17,) where a step sends the joints that were sent to ``before`` (17,) [rad]."""
    posture = before.copy() if step.posture is None else robot.posture(step.posture)
    for name, angle in {**step.joints, **step.hands}.items():
        posture[robot.joint_index(name)] = angle
    return posture


def segment_after(
    last: Segment,
    step: Step,
    robot: RobotConfig,
    *,
    key: str,
    number: int,
    is_random: bool = False,
    is_settling: bool = False,
) -> Segment:
    """Make the segment of a step that follows ``last``."""
    start, stiffness = last.end(robot), step.stiffness or last.stiffness
    posture, arrival = goal_posture(step, last.posture, robot), last.arrival.copy()
    moved = np.isfinite(last.posture) & (posture != last.posture)
    arrival[moved] = start + (step.duration or 0.0) + ARRIVAL / np.sqrt(stiffness)
    return Segment(
        key=key,
        number=number,
        step=step,
        name=step.name or str(number),
        start=start,
        ticks=round(step.max_duration / robot.cycle),
        stiffness=stiffness,
        posture=posture,
        arrival=arrival,
        origin=last.posture,
        is_timed=last.is_timed and not last.step.is_open,
        is_random=is_random,
        is_settling=is_settling,
    )


def goal_step(goals: Setpoints | Holds, robot: RobotConfig, rng: np.random.Generator) -> Step:
    """Draw a step to a random goal."""
    if isinstance(goals, Holds):
        joints = {name: _angle(robot, name, goals.range, rng) for name in goals.joints}
        return Step(joints=joints, duration=goals.move, hold=goals.hold)
    fractions = dict.fromkeys(goals.joints, goals.range)
    fractions |= dict.fromkeys(goals.secondary_joints, goals.secondary_range)
    fractions |= goals.ranges
    joints = {name: _angle(robot, name, fraction, rng) for name, fraction in fractions.items()}
    twist = None if goals.base is None else _twist(goals.base, rng)
    return Step(joints=joints, hold=goals.period, base_velocity=twist)


def sweep_steps(
    goals: Sweeps, robot: RobotConfig, rng: np.random.Generator
) -> Iterator[tuple[Step, bool]]:
    """Draw the sequence of each joint twice, with other postures of its neighbours.

    Yields:
        A step, and True where the robot settles in it.
    """
    posture = dict(zip(robot.joint_names, robot.posture(goals.posture).tolist(), strict=True))
    for joint in goals.joints:
        sequence = _sequence(goals, joint, posture, robot, rng)
        neighbours = _neighbours(goals, joint, posture, robot, rng)
        yield Step(posture=goals.posture, joints=neighbours, hold=goals.settle), True
        yield from ((Step(joints={joint: target}, hold=dwell), False) for target, dwell in sequence)
        neighbours = _neighbours(goals, joint, posture, robot, rng)
        for target, dwell in sequence:
            yield Step(joints={**neighbours, joint: target}, hold=dwell), False
            neighbours = {}


def swept_range(
    goals: Sweeps, joint: str, posture: Mapping[str, float], robot: RobotConfig
) -> tuple[float, float]:
    """Range of the targets of a joint [rad], from the first posture [rad]."""
    config = robot.joints[robot.joint_index(joint)]
    fraction = goals.ranges.get(joint)
    if fraction is None:
        return config.lower, config.upper
    start = posture.get(joint, (config.lower + config.upper) / 2)
    return start - fraction * (start - config.lower), start + fraction * (config.upper - start)


def _sequence(
    goals: Sweeps,
    joint: str,
    posture: Mapping[str, float],
    robot: RobotConfig,
    rng: np.random.Generator,
) -> list[tuple[float, float]]:
    """Draw targets [rad] and dwell times [s]: sweeps between the limits with small or big offsets, then set-points."""
    lower, upper = swept_range(goals, joint, posture, robot)
    offset = goals.max_offset * (upper - lower)
    targets = []
    for _ in range(goals.sweeps):
        targets.append(lower + rng.uniform(0.0, offset))
        targets.append(upper - rng.uniform(0.0, offset))
    targets.extend(rng.uniform(lower, upper, goals.setpoints))
    dwells = rng.uniform(*goals.dwell, len(targets))
    return [(float(target), float(dwell)) for target, dwell in zip(targets, dwells, strict=True)]


def _neighbours(
    goals: Sweeps,
    joint: str,
    posture: Mapping[str, float],
    robot: RobotConfig,
    rng: np.random.Generator,
) -> dict[str, float]:
    """Draw new angles [rad] for the joints before and after ``joint`` in its chain."""
    chain = robot.chain_of(joint)
    place = chain.index(joint)
    angles = {}
    for name in (*chain[max(0, place - 1) : place], *chain[place + 1 : place + 2]):
        lower, upper = swept_range(goals, name, posture, robot)
        middle, span = (lower + upper) / 2, upper - lower
        reach = goals.neighbour_range * span / 2
        angles[name] = float(rng.uniform(middle - reach, middle + reach))
    return angles


def _angle(robot: RobotConfig, joint: str, fraction: float, rng: np.random.Generator) -> float:
    """Draw an angle in the middle ``fraction`` of a joint's range [rad]."""
    limits = robot.joints[robot.joint_index(joint)]
    middle, half = (limits.lower + limits.upper) / 2, (limits.upper - limits.lower) / 2
    return float(middle + fraction * half * rng.uniform(-1.0, 1.0))


def _twist(motion: BaseMotion, rng: np.random.Generator) -> BaseVelocitySpec:
    """Draw a twist of the base, or none."""
    moves = rng.uniform() < motion.share
    speed, heading = rng.uniform(0.0, motion.linear), rng.uniform(-np.pi, np.pi)
    turn = rng.uniform(-motion.angular, motion.angular)
    if not moves:
        return BaseVelocitySpec()
    return BaseVelocitySpec(
        vx=float(speed * np.cos(heading)), vy=float(speed * np.sin(heading)), wz=float(turn)
    )
