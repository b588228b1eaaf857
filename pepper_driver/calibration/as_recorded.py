"""Commands as they were recorded on a real robot, and what a simulated one shows under them.

The right arm goes to random goals far faster than it can follow, and holds each for two seconds. What its encoders and
currents do then separated the plants from the recordings; see ``recordings.yaml``, key ``chases``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from pepper_driver.calibration.testbench import (
    GoalRun,
    Progress,
    divided,
    gravity_torque,
    play_goals,
    run_all,
)
from pepper_driver.config import (
    CalibrationSettings,
    ChaseProtocol,
    ChaseResults,
    Chases,
    PlantConfig,
    RobotConfig,
    load_observer_settings,
)
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.plant_parts import BodyParameters
from pepper_driver.config.workers import Workers
from pepper_driver.controller.model import RobotModel
from pepper_driver.observer import ContactObserver, JointState, ModelSet, Recording
from pepper_driver.observer.contact_observer import ObserverParts
from pepper_driver.observer.scoring import group_events

DOCUMENTED_BODY = BodyParameters(masses={}, coms={}, payloads=())
"""Masses as the URDF has them: gravity of a recorded arm can only be computed with these."""

CHASE_STREAM = 2
"""Of the random sequences of a seed: holds have the first. The values of the plants were chosen on others."""

CURRENT_ONSET, ENCODER_ONSET = 0.1, np.radians(0.25)
"""[A] and [rad] by which current and encoder have moved at their onset; the yardsticks of the recordings."""

MIN_TRAVEL = np.radians(5.0)
"""[rad] of a move whose onset counts, and whose hold has a side of approach."""

CHASING = 0.3
"""[rad] of error beyond which a joint chases its command."""

SPEED_TICKS = 5
"""Ticks over which a speed is measured: 60 ms."""

SETTLED_TIME, LAST_TIME = 0.5, 0.048
"""[s] after which a hold counts for creep, and at its end over which noise is measured."""

CREEP = 0.1
"""[A] by which the current of a still joint has changed."""

UNEXPLAINED, WORKING_FRACTION = np.radians(0.6), 0.25
"""[rad] of error that no current works against: below this fraction of what K times the error asks for."""


JUDGED = {
    "hold median": ("median_deg",),
    "hold p90": ("p90_deg",),
    "gravity current": ("gravity_torque",),
    "latency": ("current_onset_ms", "encoder_onset_ms"),
    "R2 by side": ("r2_side",),
}
"""Results by which a plant is judged; all of a cell must match."""


@dataclass(frozen=True, kw_only=True)
class ChaseCell:
    """One judged figure of one joint.

    Attributes:
        joint: Name.
        quantity: Key of :data:`JUDGED`.
        passed: True if it matches the real one.
    """

    joint: str
    quantity: str
    passed: bool


@dataclass(frozen=True, kw_only=True)
class FalseContacts:
    """Contacts of an observer where nothing touches the robot.

    Attributes:
        count: Number of them.
        minutes: In which they came.
        by_joint: The same count, by the joint that was named, or else the link.
        blind: Fraction of this time in which a joint that moves at all was blind, mean over these joints.
    """

    count: int
    minutes: float
    by_joint: dict[str, int]
    blind: float

    @property
    def per_hour(self) -> float:
        """Rate [1/h]."""
        return 60.0 * self.count / self.minutes


@dataclass(frozen=True, kw_only=True)
class ChaseReport:
    """A plant under the commands as recorded.

    Attributes:
        figures: By joint.
        false_contacts: Of the observer.
        identified_on: Robot whose models the observer has.
        real: The same of the real robot.
        settings: Limits of a match.
    """

    figures: dict[str, ChaseResults]
    false_contacts: FalseContacts
    identified_on: str
    real: Chases
    settings: CalibrationSettings

    @property
    def cells(self) -> tuple[ChaseCell, ...]:
        """Judged figures of all joints whose side of approach was recorded."""
        return tuple(
            ChaseCell(joint=joint, quantity=quantity, passed=self._matches(joint, names))
            for joint, real in self.real.figures.items()
            if real.r2_side is not None
            for quantity, names in JUDGED.items()
        )

    def _matches(self, joint: str, names: tuple[str, ...]) -> bool:
        pairs = [
            (getattr(self.figures[joint], name), getattr(self.real.figures[joint], name))
            for name in names
        ]
        if names == ("r2_side",):
            return all(abs(a - b) <= self.settings.largest_r2_difference for a, b in pairs)
        factor = self.settings.largest_factor
        return all(a is not None and _within(a, b, factor) for a, b in pairs)

    def as_json(self) -> dict[str, Any]:
        """``figures.<joint>``, ``real.<joint>``, ``cells``, ``false_contacts``, and more."""
        return {
            "figures": {joint: asdict(found) for joint, found in self.figures.items()},
            "real": {joint: asdict(real) for joint, real in self.real.figures.items()},
            "cells": [asdict(cell) for cell in self.cells],
            "identified_on": self.identified_on,
            "false_contacts": {
                "per_hour": self.false_contacts.per_hour,
                **asdict(self.false_contacts),
            },
        }


def _within(value: float, real: float, factor: float) -> bool:
    return real / factor <= value <= real * factor


def play_chases(
    robot: RobotConfig,
    plant: PlantConfig,
    protocol: ChaseProtocol,
    seed: int,
    *,
    workers: Workers = -1,
    progress: Progress | None = None,
) -> tuple[GoalRun, ...]:
    """Have robots play the commands as recorded; the base is fixed, several robots divide the goals among them.

    Args:
        robot: The robot.
        plant: Its parameters.
        protocol: Joints, ranges and times.
        seed: Of goals and noise.
        workers: Processes, -1 for one per core; or a cluster.
        progress: Called after each part.
    """
    fixed = replace(plant, base="fixed")
    jobs = [
        partial(_play_part, robot, fixed, part, (CHASE_STREAM, seed, first))
        for first, part in divided(protocol)
    ]
    return tuple(run_all(jobs, workers, progress))


def _play_part(
    robot: RobotConfig, plant: PlantConfig, protocol: ChaseProtocol, seed: tuple[int, ...]
) -> GoalRun:
    rng = np.random.default_rng(seed)
    times = rng.uniform(*protocol.move, protocol.count)
    ramps = [trapezoid(max(1, round(time / robot.cycle)), protocol.ease) for time in times]
    return play_goals(
        robot, plant, protocol.joints, ramps, rng, part=protocol.range, hold=protocol.hold
    )


def trapezoid(ticks: int, ease: float) -> FloatArray:
    """Return (ticks,) the fraction of a move that is done after each tick: constant speed between two ramps of it.

    Args:
        ticks: Of the move.
        ease: Fraction of the time that each ramp takes, above 0 and at most 0.5.
    """
    time = np.arange(1, ticks + 1) / ticks
    begin, end = time**2 / (2 * ease), (1 - ease) - (1 - time) ** 2 / (2 * ease)
    way = np.where(time < ease, begin, np.where(time > 1 - ease, end, time - ease / 2))
    return np.asarray(way / (1 - ease))


@dataclass(frozen=True, kw_only=True)
class _Hold:
    """Ends of the holds of one joint, arrays (count,) over all runs.

    ``error`` [rad]; ``current`` without sign [A]; ``side`` from which the goal was approached, -1 or 1, 0 where it
    hardly moved; ``load`` that gravity asks for [N m]; ``torque`` of the motor by its current and the documented
    constant, with the sign of the error [N m].
    """

    error: FloatArray
    current: FloatArray
    side: FloatArray
    load: FloatArray
    torque: FloatArray


def gravity_at_goals(
    robot: RobotConfig, plant: PlantConfig, runs: Sequence[GoalRun]
) -> tuple[FloatArray, ...]:
    """Return for each run the (count, 17) torque that gravity asks for at its goals, by the documented masses [N m]."""
    documented = replace(plant, base="fixed", body=DOCUMENTED_BODY)
    goals = [run.command[np.array(run.ends) - 1] for run in runs]
    loads = gravity_torque(robot, documented, np.concatenate(goals))
    return tuple(np.split(loads, np.cumsum([len(g) for g in goals])[:-1]))


def chase_figures(
    robot: RobotConfig,
    joint: str,
    runs: Sequence[GoalRun],
    loads: Sequence[FloatArray],
    stiffness: float,
) -> ChaseResults:
    """Return what one joint shows in runs of the commands as recorded.

    Args:
        robot: The robot.
        joint: Whose.
        runs: All.
        loads: Of gravity at their goals, from :func:`gravity_at_goals`.
        stiffness: By which errors without current are counted [N m/rad].
    """
    index, constant = robot.joint_index(joint), robot.motors.joint_torque_constant(joint)
    step = robot.sensors.encoder.step
    holds = [
        _ends(robot, run, load[:, index], index, constant)
        for run, load in zip(runs, loads, strict=True)
    ]
    hold = _Hold(
        **{
            name: np.concatenate([getattr(part, name) for part in holds])
            for name in _Hold.__annotations__
        }
    )
    size = np.abs(hold.error)
    came = hold.side != 0.0
    towards = hold.error[came] * hold.side[came]
    unexplained = (size > UNEXPLAINED) & (np.abs(hold.torque) < WORKING_FRACTION * stiffness * size)
    current_onset, encoder_onset = _onsets(robot, runs, index)
    creeps = np.concatenate([_creeps(robot, run, index) for run in runs])
    encoder_noise, current_noise = _noise(robot, runs, index)
    errors = np.concatenate([(run.command - run.position)[:, index] for run in runs])
    moving = np.concatenate([_moving(run) for run in runs])
    speeds = np.concatenate([_speeds(robot, run, index) for run in runs])
    median, p90 = np.degrees(np.percentile(size, [50, 90]))
    far = np.abs(speeds[np.abs(errors) > CHASING])
    chase_speed = np.percentile(far, [50, 90]).tolist() if len(far) else (None, None)
    return ChaseResults(
        median_deg=float(median),
        p90_deg=float(p90),
        max_deg=float(np.degrees(size.max())),
        short=float(np.mean(towards > step / 2)),
        beyond=float(np.mean(towards < -step / 2)),
        r2_side=explained(hold.side[came], hold.error[came]),
        r2_gravity=explained(hold.load, hold.error),
        r2_current=explained(hold.torque, hold.error),
        droop_deg=float(np.degrees(slope(hold.load, hold.error))),
        gravity_torque=slope(hold.load, hold.torque),
        without_current=float(np.mean(unexplained)),
        current_median=float(np.median(hold.current)),
        current_p90=float(np.percentile(hold.current, 90)),
        current_onset_ms=current_onset,
        encoder_onset_ms=encoder_onset,
        creep=float(np.mean(creeps)) if len(creeps) else None,
        encoder_noise_mdeg=1e3 * float(np.degrees(encoder_noise)),
        current_noise_ma=1e3 * current_noise,
        rms_deg=float(np.degrees(np.sqrt(np.mean(errors[moving] ** 2)))),
        chase_speed=chase_speed[0],
        chase_speed_p90=chase_speed[1],
        max_speed=float(np.abs(speeds).max()),
    )


def slope(x: FloatArray, y: FloatArray) -> float:
    """Return the slope of the straight line through (n,) points by least squares."""
    centred = x - x.mean()
    return float(centred @ y / max(float(centred @ centred), 1e-12))


def explained(x: FloatArray, y: FloatArray) -> float:
    """Return R2 of a straight line: the fraction of the variance of (n,) ``y`` that ``x`` explains."""
    if np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return 0.0
    return float(np.corrcoef(x, y)[0, 1] ** 2)


def _ends(robot: RobotConfig, run: GoalRun, load: FloatArray, index: int, constant: float) -> _Hold:
    last = np.array(run.ends) - 1
    goals = run.command[last]
    before = np.concatenate((robot.posture("Stand")[None, index], goals[:-1, index]))
    travel = goals[:, index] - before
    error = goals[:, index] - run.position[last, index]
    mean = max(1, round(LAST_TIME / robot.cycle))
    current = np.array([run.current[end - mean : end, index].mean() for end in run.ends])
    return _Hold(
        error=error,
        current=current,
        side=np.where(np.abs(travel) > MIN_TRAVEL, np.sign(travel), 0.0),
        load=load,
        # Sensors measure no sign; a motor works against its error.
        torque=np.sign(error) * current * constant,
    )


def _onsets(
    robot: RobotConfig, runs: Sequence[GoalRun], index: int
) -> tuple[float | None, float | None]:
    """Return medians of the times from a command to the onset of current and encoder [ms]; None without any."""
    step = robot.sensors.encoder.step
    found: tuple[list[int], list[int]] = ([], [])
    for run in runs:
        for begin, end in zip(run.begins[1:], run.ends[1:], strict=True):
            command = run.command[begin - 1 : end, index]
            moved = np.abs(command - command[0])
            if moved[-1] < MIN_TRAVEL:
                continue
            start = int(np.argmax(moved > step))
            for signal, least, onsets in (
                (run.current, CURRENT_ONSET, found[0]),
                (run.position, ENCODER_ONSET, found[1]),
            ):
                values = signal[begin - 1 : end, index]
                moved_away = np.abs(values - values[0])[start:] > least
                if moved_away.any():
                    onsets.append(int(np.argmax(moved_away)))
    current, encoder = (1e3 * robot.cycle * float(np.median(o)) if o else None for o in found)
    return current, encoder


def _creeps(robot: RobotConfig, run: GoalRun, index: int) -> BoolArray:
    """Return of each hold in which the joint stands still whether its current changes by more than CREEP."""
    step, mean = robot.sensors.encoder.step, max(1, round(LAST_TIME / robot.cycle))
    found = []
    for begin, end in zip(run.begins, run.ends, strict=True):
        goal = run.command[end - 1, index]
        resting = begin + int(np.argmax(run.command[begin:end, index] == goal))
        first = resting + round(SETTLED_TIME / robot.cycle)
        if first >= end or np.ptp(run.position[first:end, index]) > 1.5 * step:
            continue
        change = run.current[end - mean : end, index].mean()
        change -= run.current[first : first + mean, index].mean()
        found.append(abs(change) > CREEP)
    return np.array(found, dtype=np.bool_)


def _noise(robot: RobotConfig, runs: Sequence[GoalRun], index: int) -> tuple[float, float]:
    """Return the spread of the encoder [rad], and the mean step of the current [A], at the ends of holds."""
    ticks = max(2, round(LAST_TIME / robot.cycle))
    ends = [(run, end) for run in runs for end in run.ends]
    encoder = [run.position[end - ticks : end, index].std() for run, end in ends]
    current = [np.abs(np.diff(run.current[end - ticks : end, index])).mean() for run, end in ends]
    return float(np.mean(encoder)), float(np.mean(current))


def _moving(run: GoalRun) -> BoolArray:
    """(n,) True from the begin of a move to the tick in which its command is at the goal."""
    moving = np.zeros(len(run.command), dtype=np.bool_)
    moving[1:] = (np.diff(run.command, axis=0) != 0.0).any(axis=1)
    return moving


def _speeds(robot: RobotConfig, run: GoalRun, index: int) -> FloatArray:
    """(n,) measured speed over SPEED_TICKS [rad/s]."""
    position = run.position[:, index]
    speeds = np.zeros(len(position))
    speeds[SPEED_TICKS:] = (position[SPEED_TICKS:] - position[:-SPEED_TICKS]) / (
        SPEED_TICKS * robot.cycle
    )
    return speeds


def as_recording(robot: RobotConfig, run: GoalRun, model: RobotModel, delay: int) -> Recording:
    """Return a run as an observer is given it: the desired motion is that of the command.

    Args:
        robot: The robot.
        run: Of the bench.
        model: For the desired load torque.
        delay: Whole ticks from a command to the sample that answers it.
    """
    n, cycle = len(run.command) - delay, robot.cycle
    command = run.command[:n]
    velocity = np.diff(command, axis=0, prepend=command[:1]) / cycle
    acceleration = np.diff(velocity, axis=0, prepend=velocity[:1]) / cycle
    rates = np.zeros((2, n, model.nv))
    rates[0][:, model.joint_columns] = velocity
    rates[1][:, model.joint_columns] = acceleration
    load = [
        model.load_torque(model.configuration(q), v, a)
        for q, v, a in zip(command, *rates, strict=True)
    ]
    still, upright = np.zeros((n, 3)), np.tile([0.0, 0.0, 9.81], (n, 1))
    return Recording(
        joint_names=robot.joint_names,
        time=cycle * np.arange(1.0, n + 1.0),
        age=run.age[delay:],
        sent_position=command,
        stiffness=np.ones_like(command),
        limited=np.zeros(command.shape, dtype=np.bool_),
        position=run.position[delay:],
        current=run.current[delay:],
        reference_position=command,
        velocity=velocity,
        acceleration=acceleration,
        load_torque=np.array(load),
        base_twist=still,
        sent_wheel_speed=still,
        wheel_speed=still,
        linear_acceleration=upright,
        angular_velocity=still,
        attitude=still,
    )


def false_contacts(
    robot: RobotConfig,
    runs: Sequence[GoalRun],
    models: ModelSet,
    delay: int,
    *,
    parts: ObserverParts | None = None,
    workers: Workers = -1,
    progress: Progress | None = None,
) -> FalseContacts:
    """Count the contacts that an observer raises in runs without touch, each run from its first tick on.

    Args:
        robot: The robot.
        runs: Of the bench.
        models: Of kind ``fusion``.
        delay: Whole ticks from a command to the sample that answers it.
        parts: Of the observer; None for all.
        workers: Processes, -1 for one per core; or a cluster.
        progress: Called after each run.
    """
    # The base of the bench is fixed.
    models = replace(models, base=None)
    jobs = [partial(_watch, robot, run, models, delay, parts or ObserverParts()) for run in runs]
    watched = run_all(jobs, workers, progress)
    named = [joint for joints, _ in watched for joint in joints]
    ticks = [len(run.command) - delay for run in runs]
    return FalseContacts(
        count=len(named),
        minutes=sum(ticks) * robot.cycle / 60.0,
        by_joint=dict(Counter(named)),
        blind=float(np.average([blind for _, blind in watched], weights=ticks)),
    )


def _watch(
    robot: RobotConfig, run: GoalRun, models: ModelSet, delay: int, parts: ObserverParts
) -> tuple[list[str], float]:
    """Return the joints, or else the links, of contacts that begin in a run, not rebounds; and the blind fraction."""
    observer = ContactObserver(robot, models, load_observer_settings(), parts=parts)
    recording = as_recording(robot, run, RobotModel(robot), delay)
    seen = [observer.step(tick) for tick in recording.ticks()]
    begins = [track.begin for track in group_events([c for one in seen for c in one.contacts])]
    moves = np.ptp(recording.sent_position, axis=0) > 0.0
    blind = np.array([one.state for one in seen])[:, moves] == JointState.BLIND
    named = [begin.joint or begin.link for begin in begins if begin.kind != "rebound"]
    return named, float(blind.mean())
