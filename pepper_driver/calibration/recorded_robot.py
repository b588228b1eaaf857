"""Fit of a simulated robot to the recordings of one robot: its own simulated copy.

Facts that were measured are taken as they are: delay, noise, late and lost samples, the speed limit of targets, and
how much of the motors' torque arrives. Gains of the boards and friction are fitted: the recorded commands are replayed
on the simulated robot, and each joint takes the values with which its errors and currents are nearest to the recorded
ones. All joints are tried at once, since what one shows hardly depends on the values of the others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf, isfinite
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pepper_driver.calibration.drive import (
    DriveValues,
    changed_drive,
    values_with_lead,
    with_origin,
)
from pepper_driver.calibration.replayed import RecordedRun, ReplayedRun, load_runs, replay
from pepper_driver.config import PepperError, PlantConfig, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.plant_parts import MAX_TICKS, BodyParameters
from pepper_driver.config.workers import Workers, run_jobs
from pepper_driver.identification.dataset import load_measurement, read_manifest
from pepper_driver.identification.measurements.program import MEASUREMENTS, measure_robot
from pepper_driver.observer import nrmse_fit
from pepper_driver.observer.models.measured_robot import MeasuredJoint, MeasuredRobot

Value = Literal["stiffness", "friction", "lead", "dead_band", "integral_time"]

STEPS = (1.6, 1.6, 1.3, 1.3, 1.12, 1.06)
"""Factors by which each value is tried up and down, one round each."""

LEAD_STEPS = 2.0
"""Power of these factors for the lead: it is known least."""

CURRENT_WEIGHT = 0.5
"""Weight of the misfit of currents compared with that of errors, each as a fraction of what is to be explained."""

MIN_ROWS = 200
"""Samples of a joint without which it keeps its values, or is not judged on held-out runs."""

MIN_EFFICIENCY = 0.2
"""Smallest fraction of a motor's torque that reaches the joint."""

ARMS = ("left_arm", "right_arm")
"""Chains whose masses a weight in a hand shows."""

Progress = Callable[[float], None]
"""Called with the fraction done, 0..1."""


class RobotCalibrationError(PepperError, ValueError):
    """Recordings of a robot do not say enough to fit a simulated one."""


@dataclass(frozen=True, kw_only=True)
class Tracking:
    """Tracking errors of one joint of a simulated robot and of the robot under the same commands.

    Attributes:
        median_deg, p90_deg: Quantiles of the simulated abs(error) [deg].
        fit: NRMSE fit of the robot's error by the simulated one [%]; 100 is perfect, 0 as good as its mean.
        rms_deg: Root mean square of the difference of the two [deg].
    """

    median_deg: float
    p90_deg: float
    fit: float
    rms_deg: float


@dataclass(frozen=True, kw_only=True)
class JointCalibration:
    """One joint of a fitted robot.

    Attributes:
        before, after: Its values in the plant that was begun with, and in the fitted one.
        efficiency: Fraction of the motor's torque that reaches the joint.
        held_out: True if errors are of runs that nothing was fitted to, False where there are none.
        median_deg, p90_deg: Quantiles of abs(error) of the robot itself [deg].
        tracking_before, tracking_after: Of both plants.
    """

    before: DriveValues
    after: DriveValues
    efficiency: float
    held_out: bool
    median_deg: float
    p90_deg: float
    tracking_before: Tracking
    tracking_after: Tracking


@dataclass(frozen=True, kw_only=True)
class RobotCalibration:
    """A simulated robot that was fitted to recordings of one robot.

    Attributes:
        plant: The fitted one.
        facts: That were measured of the robot.
        delay_before: Ticks from command to sample of the plant that was begun with.
        joints: By name; only those that were fitted.
        kept: Joints that the recordings say too little of: their values are those of the plant that was begun with.
        simulated: Whether the recordings are of a simulated robot.
        identity: Of the robot.
    """

    plant: PlantConfig
    facts: MeasuredRobot
    delay_before: int
    joints: Mapping[str, JointCalibration]
    kept: tuple[str, ...]
    simulated: bool
    identity: str

    def as_json(self) -> dict[str, Any]:
        """``delay_ticks``, ``joints.<joint>`` with ``before`` and ``after``, ``kept``, ``simulated``, ``identity``."""

        def one(values: DriveValues, tracking: Tracking) -> dict[str, Any]:
            return {
                "stiffness": values.stiffness,
                "friction": values.friction,
                "lead": values.lead,
                "dead_band_deg": float(np.degrees(values.dead_band)),
                "integral_time": values.integral_time if isfinite(values.integral_time) else None,
                "median_deg": tracking.median_deg,
                "p90_deg": tracking.p90_deg,
                "fit": tracking.fit,
                "rms_deg": tracking.rms_deg,
            }

        return {
            "identity": self.identity,
            "simulated": self.simulated,
            "delay_ticks": {"before": self.delay_before, "after": self.plant.response_delay},
            "joints": {
                name: {
                    "held_out": joint.held_out,
                    "efficiency": joint.efficiency,
                    "real": {"median_deg": joint.median_deg, "p90_deg": joint.p90_deg},
                    "before": one(joint.before, joint.tracking_before),
                    "after": one(joint.after, joint.tracking_after),
                }
                for name, joint in self.joints.items()
            },
            "kept": list(self.kept),
        }


def calibrate_to(
    folder: Path,
    start: PlantConfig,
    robot: RobotConfig,
    *,
    workers: Workers = -1,
    progress: Progress | None = None,
) -> RobotCalibration:
    """Fit a simulated robot to the recordings of one robot.

    Args:
        folder: Recordings of an identification that began with measurements of the robot.
        start: Plant to begin from; it says what is not fitted, and which law the boards run.
        robot: Its description.
        workers: Processes, -1 for one per core; or a cluster. The result does not depend on them.
        progress: Called after each replay.

    Raises:
        RobotCalibrationError: The robot was not measured, or hardly moved.
        PepperError: Recordings that are missing, damaged or of another robot; no current answers a command.
    """
    manifest = read_manifest(folder)
    measurement = load_measurement(folder, robot)
    if missing := [name for name in MEASUREMENTS if name not in measurement]:
        raise RobotCalibrationError(
            f"{folder}: this robot was not measured ({', '.join(missing)}); 'pepper identify' does so unless it is "
            "called with --no-measure"
        )
    facts = measure_robot(measurement, manifest.response_delay, robot, manifest.weight)
    runs = load_runs(folder, manifest, facts.response_delay, robot)
    fitted_to = [run for run in runs if not run.held_out]
    moved = _moved(fitted_to, robot)
    if not moved:
        raise RobotCalibrationError(f"{folder}: no joint moves enough to say anything of itself")
    measured_plant = with_facts(start, facts, fitted_to, robot)
    count = len(runs) * 2 + len(fitted_to) * (1 + 2 * len(STEPS) * len(_fitted(start)))
    done = 0

    def replay_all(
        plants: Sequence[PlantConfig], some: Sequence[RecordedRun]
    ) -> list[list[ReplayedRun]]:
        nonlocal done
        jobs = [partial(replay, robot, plant, run) for plant in plants for run in some]
        found = []
        for one in run_jobs(jobs, workers=workers):
            found.append(one)
            done += 1
            if progress is not None:
                progress(min(1.0, done / count))
        return [found[i : i + len(some)] for i in range(0, len(found), len(some))]

    plant = _search(measured_plant, facts, fitted_to, moved, robot, replay_all)
    before, after = replay_all([start, plant], runs)
    return RobotCalibration(
        plant=plant,
        facts=facts,
        delay_before=start.response_delay,
        joints={
            joint: _compare(robot, joint, runs, (start, before), (plant, after)) for joint in moved
        },
        kept=tuple(name for name in robot.joint_names if name not in moved),
        simulated=manifest.simulated,
        identity=manifest.identity,
    )


def with_facts(
    start: PlantConfig, facts: MeasuredRobot, runs: Sequence[RecordedRun], robot: RobotConfig
) -> PlantConfig:
    """Return a plant with what was measured of a robot: transport, noise, speed limit, efficiency, masses of arms.

    Where a known weight was held, the fraction of torque that arrives and the masses of the arms are known apart. Both
    arms then weigh as much more or less as the one that held it, since they are built alike. Without a weight, all that
    gravity asks for beyond the description counts as torque that does not arrive.

    Args:
        start: Everything that was not measured.
        facts: Of the robot.
        runs: Of the robot.
        robot: Its description.

    Raises:
        RobotCalibrationError: No plant answers as late, or brings no sample in time.
    """
    delay = facts.response_delay
    sensor = min(delay, max(1, start.transport.sensor_delay))
    if delay - sensor > MAX_TICKS:
        raise RobotCalibrationError(
            f"this robot answers {delay} ticks after a command; a plant does after {MAX_TICKS + sensor} at most"
        )
    if max(facts.late, facts.lost) >= 1.0:
        raise RobotCalibrationError(
            f"{facts.late:.0%} of the samples of this robot came late, {facts.lost:.0%} were lost: some must arrive in "
            "time. Measure again, by cable"
        )
    latest = max(float(run.recording.age.max()) for run in runs)
    limits = list(facts.target_speeds.values())
    transport = replace(
        start.transport,
        command_delay=delay - sensor,
        sensor_delay=sensor,
        late=facts.late,
        longest_late=min(round(latest / robot.cycle), MAX_TICKS),
        lost=facts.lost,
        encoder_noise=_without_steps(
            [joint.encoder_noise for joint in facts.joints.values()],
            robot.sensors.encoder.step,
            start.transport.encoder_noise,
        ),
        current_noise=_without_steps(
            [joint.current_noise for joint in facts.joints.values()],
            robot.sensors.current.step,
            start.transport.current_noise,
        ),
    )
    targets = start.targets
    if limits:
        targets = replace(targets, speed_limit=_rounded(float(np.median(limits))))
    elif targets.speed_limit and max(facts.speeds.values(), default=0.0) > targets.speed_limit:
        targets = replace(targets, speed_limit=None)
    arms = [name for chain in ARMS for name in robot.chains[chain]]
    factor = _mass_factor(facts, arms)
    drives = []
    for drive in start.actuators:
        for name in drive.joints:
            one = replace(drive, joints=(name,))
            efficiency = _efficiency(facts.joints.get(name), factor if name in arms else None)
            if efficiency is not None:
                origin = with_origin(drive, "calibrated", ("efficiency",))
                one = replace(one, efficiency=efficiency, origin=origin)
            drives.append(one)
    return replace(
        start,
        transport=transport,
        targets=targets,
        actuators=tuple(drives),
        body=start.body if factor is None else _heavier(start.body, arms, factor, robot),
    )


def _without_steps(noise: Sequence[float | None], step: float, unknown: float) -> float:
    """Return the noise of a sensor without that of its steps, median of the joints; ``unknown`` where none shows it."""
    known = [value for value in noise if value is not None]
    if not known:
        return unknown
    spread = float(np.median(known)) ** 2 - step**2 / 12.0
    return _rounded(float(np.sqrt(max(spread, 0.0))))


def _efficiency(joint: MeasuredJoint | None, mass_factor: float | None) -> float | None:
    """Return the fraction of a motor's torque that arrives; None where it was not measured.

    Args:
        joint: What was measured of it.
        mass_factor: On the masses that it carries; None where it is not known.
    """
    if joint is None:
        return None
    scale = joint.torque_scale
    if scale is None and joint.load_scale is not None:
        # Part of the load's current carries these masses.
        scale = joint.load_scale / (mass_factor or 1.0)
    return None if scale is None else _rounded(float(np.clip(1.0 / scale, MIN_EFFICIENCY, 1.0)))


def _mass_factor(facts: MeasuredRobot, arms: Sequence[str]) -> float | None:
    """Return the factor on the masses of arms, by joints that show load and torque apart; None where none does."""
    joints = [facts.joints[name] for name in arms if name in facts.joints]
    ratios = [j.load_scale / j.torque_scale for j in joints if j.load_scale and j.torque_scale]
    return float(np.median(ratios)) if ratios else None


def _heavier(
    body: BodyParameters, joints: Sequence[str], factor: float, robot: RobotConfig
) -> BodyParameters:
    """Return a body whose links behind these joints weigh ``factor`` times as much."""
    links = [robot.joints[robot.joint_index(name)].child for name in joints]
    heavier = {link: _rounded(factor * body.masses.get(link, 1.0)) for link in links}
    return replace(body, masses={**body.masses, **heavier})


def _fitted(plant: PlantConfig) -> tuple[Value, ...]:
    """Return the values that are fitted: those of the law that the boards of a plant run."""
    values: tuple[Value, ...] = ("stiffness", "friction", "lead")
    if any(drive.dead_band for drive in plant.actuators):
        values = (*values, "dead_band")
    return (*values, "integral_time") if any(drive.ki for drive in plant.actuators) else values


ReplayAll = Callable[[Sequence[PlantConfig], Sequence[RecordedRun]], list[list[ReplayedRun]]]


def _search(
    plant: PlantConfig,
    facts: MeasuredRobot,
    runs: Sequence[RecordedRun],
    moved: Sequence[str],
    robot: RobotConfig,
    replay_all: ReplayAll,
) -> PlantConfig:
    """Try each value up and down, in smaller and smaller steps; each joint keeps what does best."""
    best = {joint: _begin(robot, plant, joint, facts.joints.get(joint)) for joint in moved}
    plant = _with_values(robot, plant, best)
    (replayed,) = replay_all([plant], runs)
    least = {joint: misfit(robot, joint, runs, replayed) for joint in moved}
    for step in STEPS:
        for key in _fitted(plant):
            factor = step**LEAD_STEPS if key == "lead" else step
            tried = [
                {joint: _scaled(values, key, by) for joint, values in best.items()}
                for by in (1.0 / factor, factor)
            ]
            shown = replay_all([_with_values(robot, plant, values) for values in tried], runs)
            for values, replayed in zip(tried, shown, strict=True):
                for joint in moved:
                    found = misfit(robot, joint, runs, replayed)
                    if found < least[joint]:
                        least[joint], best[joint] = found, values[joint]
            plant = _with_values(robot, plant, best)
    return plant


def _begin(
    robot: RobotConfig, plant: PlantConfig, joint: str, fact: MeasuredJoint | None
) -> DriveValues:
    """Return the values that a search begins with: friction as measured, all else as in the plant."""
    values = values_with_lead(robot, plant, joint)
    if fact is None or not fact.friction:
        return values
    return replace(values, friction=fact.friction * plant.actuator(joint).efficiency)


def _scaled(values: DriveValues, key: Value, factor: float) -> DriveValues:
    value = getattr(values, key)
    return replace(values, **{key: value * factor}) if value and value < inf else values


def _with_values(
    robot: RobotConfig, plant: PlantConfig, values: Mapping[str, DriveValues]
) -> PlantConfig:
    """Return a plant whose drives, one of each joint, have these values."""
    return replace(
        plant,
        actuators=tuple(
            changed_drive(robot, drive, name, values[name], "calibrated")
            if (name := drive.joints[0]) in values
            else drive
            for drive in plant.actuators
        ),
    )


def _moved(runs: Sequence[RecordedRun], robot: RobotConfig) -> tuple[str, ...]:
    """Return the joints that move enough to be fitted."""
    return tuple(
        name for index, name in enumerate(robot.joint_names) if _row_count(runs, index) >= MIN_ROWS
    )


def _row_count(runs: Sequence[RecordedRun], index: int) -> int:
    """Return the number of rows that say something of a joint."""
    return sum(int(run.counts[:, index].sum()) for run in runs)


def misfit(
    robot: RobotConfig, joint: str, runs: Sequence[RecordedRun], replayed: Sequence[ReplayedRun]
) -> float:
    """Return how far a simulated joint is from the recorded one; 0 is perfect.

    The mean size of the difference in errors, as a fraction of the mean size of the errors around their median, and
    the same for currents, with CURRENT_WEIGHT. Sizes, not squares: a real joint rests far off now and then, which no
    fit should follow.

    Args:
        robot: Its description.
        joint: Its name.
        runs: Of the robot.
        replayed: The same on the simulated one.
    """
    index = robot.joint_index(joint)
    real, simulated, current, current_simulated = _joined(index, runs, replayed)
    size = float(np.abs(real - np.median(real)).mean())
    size_of_current = float(np.abs(current - np.median(current)).mean())
    error = float(np.abs(real - simulated).mean()) / max(size, 1e-6)
    of_current = float(np.abs(current - current_simulated).mean()) / max(size_of_current, 1e-3)
    return error + CURRENT_WEIGHT * of_current


def _joined(
    index: int, runs: Sequence[RecordedRun], replayed: Sequence[ReplayedRun]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return (n,) errors [rad] of the robot and of the simulated one, and their currents [A], of rows that count."""
    parts = []
    for run, one in zip(runs, replayed, strict=True):
        rows, recording = run.counts[:, index], run.recording
        sent = recording.sent_position[rows, index]
        parts.append(
            (
                sent - recording.position[rows, index],
                sent - one.position[rows, index],
                recording.current[rows, index],
                one.current[rows, index],
            )
        )
    a, b, c, d = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return a, b, c, d


def _compare(
    robot: RobotConfig,
    joint: str,
    runs: Sequence[RecordedRun],
    before: tuple[PlantConfig, Sequence[ReplayedRun]],
    after: tuple[PlantConfig, Sequence[ReplayedRun]],
) -> JointCalibration:
    """Return how near a joint comes before and after: on held-out runs, where it moves enough in them."""
    index = robot.joint_index(joint)
    held_out = _row_count([run for run in runs if run.held_out], index) >= MIN_ROWS
    chosen = [k for k, run in enumerate(runs) if run.held_out == held_out]
    some = [runs[k] for k in chosen]

    def tracking(replayed: Sequence[ReplayedRun]) -> tuple[FloatArray, Tracking]:
        real, simulated, *_ = _joined(index, some, [replayed[k] for k in chosen])
        median, p90 = np.degrees(np.percentile(np.abs(simulated), [50, 90]))
        return real, Tracking(
            median_deg=float(median),
            p90_deg=float(p90),
            fit=nrmse_fit(real, simulated),
            rms_deg=float(np.degrees(np.sqrt(np.mean((real - simulated) ** 2)))),
        )

    real, tracking_before = tracking(before[1])
    _, tracking_after = tracking(after[1])
    median, p90 = np.degrees(np.percentile(np.abs(real), [50, 90]))
    return JointCalibration(
        before=values_with_lead(robot, before[0], joint),
        after=values_with_lead(robot, after[0], joint),
        efficiency=after[0].actuator(joint).efficiency,
        held_out=held_out,
        median_deg=float(median),
        p90_deg=float(p90),
        tracking_before=tracking_before,
        tracking_after=tracking_after,
    )


def _rounded(value: float) -> float:
    """To four digits, as it stands in a plant file."""
    return float(f"{value:.4g}")
