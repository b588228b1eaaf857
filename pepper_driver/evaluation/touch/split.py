"""Judging the robots of a split: each is identified as by its owner, touched and left alone, and its record kept."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol

from pepper_driver.backends import make_backend
from pepper_driver.config import Experiment, PepperError, RobotConfig, load_plant, load_robot
from pepper_driver.config.cluster import SOURCES, Cluster, environment
from pepper_driver.config.evaluation_baselines import load_evaluation_baselines
from pepper_driver.config.experiment import load_experiment
from pepper_driver.config.file_lock import lock_folder
from pepper_driver.config.files import content_hash, file_hash, make_folder
from pepper_driver.config.population import with_same_draws
from pepper_driver.config.settings import AttentiveSettings
from pepper_driver.config.touch_suites import TouchSuites
from pepper_driver.config.workers import Workers, one_core, run_jobs
from pepper_driver.evaluation.touch.ledger import code_hash, constants_hash
from pepper_driver.evaluation.touch.observers import ModelFiles, make, watch_all
from pepper_driver.evaluation.touch.records import (
    BoardLaw,
    ObserverRecord,
    RecordError,
    RobotRecord,
    Take,
    load_robot_record,
    load_take,
    save_robot,
    save_take,
)
from pepper_driver.evaluation.touch.takes import TakeSpec, perform, plan_takes
from pepper_driver.identification import (
    IdentifiedRobot,
    identify_population,
    plan_measurements,
    plan_runs,
    sweeps_of,
)
from pepper_driver.identification.measurements.program import held_weight
from pepper_driver.observer import ModelKind, Observer

PART = 2
"""Minimum number of robots that are judged and kept together: some 40 minutes of two cores. With more processes as
many robots as these, so that each identifies one."""

EXPERIMENT, CALIBRATION = "identify", "calibration_motion"
"""Motions by which an owner identifies a robot: those of ``pepper identify``."""

KNOWN_WEIGHT = held_weight(0.5, "left")
"""0.5 kg in the left hand, with which each robot is measured; the torques of the other arm keep an assumed scale."""

IN_FLIGHT_ROBOTS = 20
"""Of a part on a cluster, whose workers may come later."""

QUICK_STRIDE, QUICK_TOUCHES = 9, 5
"""Of a quick check: each ninth take, with so many touches."""

TREES: tuple[ModelKind, ...] = ("affine", "cart")

Progress = Callable[[str, float, float], None]
"""Called with (what was done, robot time done, robot time in all) [s]."""

Kept = Callable[[RobotRecord], None]
"""Called with the record of a robot once it is complete."""


@dataclass(frozen=True, kw_only=True)
class Judging:
    """Rules by which robots are judged.

    Attributes:
        suites: Frozen.
        free: Time in which no one touches each robot [s]; 0 for none.
        observers: Names.
        quick: True for a tenth of the takes, and of the free time: to try, not to quote.
        touch: False to leave out the takes with touches.
        folder: For models and takes of robots that are not complete.
        records: For the record of each robot that is.
        keep_recordings: Whether those of the identifications stay in ``folder``, for the next observer.
    """

    suites: TouchSuites
    free: float
    observers: tuple[str, ...]
    folder: Path
    records: Path
    quick: bool = False
    touch: bool = True
    keep_recordings: bool = False

    def specs(self, draw: int) -> tuple[TakeSpec, ...]:
        """Return the takes of a robot."""
        takes = plan_takes(self.suites, draw, self.free)
        if self.quick:
            takes = tuple(
                replace(take, acts=take.acts[:QUICK_TOUCHES], seconds=take.seconds / 10.0)
                for take in takes[::QUICK_STRIDE]
            )
        return tuple(take for take in takes if take.suite == "free" or self.touch)

    def key(self) -> str:
        """Hash of all that records depend on except the robot."""
        return content_hash(
            [
                self.suites.frozen,
                [self.free, self.quick, self.touch],
                self.observers,
                _versions(),
            ]
        )


def _versions() -> dict[str, str]:
    """Code, constants, interpreter and libraries that records depend on."""
    return {**environment(), SOURCES: code_hash(), "constants": constants_hash()}


def judge(
    judging: Judging,
    draws: Sequence[int],
    *,
    workers: Workers = -1,
    progress: Progress | None = None,
    kept: Kept | None = None,
) -> tuple[RobotRecord, ...]:
    """Judge robots, in parts; what an earlier call has done is taken. The records do not depend on ``workers``.

    Args:
        judging: Rules.
        draws: Numbers of the robots. Those for tests are allowed only inside
            :func:`pepper_driver.config.population.allow_test_draws`.
        workers: Processes, -1 for one per core; or a cluster, whose workers share the folders.
        progress: Called as jobs end.
        kept: Called as robots are complete, also with those of an earlier call.

    Returns:
        The records, in the order of ``draws``. A robot that could not be identified has its touches, and its failure.

    Raises:
        HeldOutDrawError: A draw for tests.
        InUseError: Another run judges in the same folders.
        OutputError: A folder cannot be written to.
    """
    for draw in draws:  # those for tests are refused before anything is written
        load_plant(judging.suites.population, load_robot(), draw=draw)
    for folder in (judging.folder, judging.records):
        make_folder(folder)
    key = judging.key()
    done: dict[int, RobotRecord] = {}
    with lock_folder(judging.records), lock_folder(judging.folder):
        for draw in draws:
            if (record := _kept_record(judging, draw, key)) is not None:
                done[draw] = record
                if kept is not None:
                    kept(record)
        left = [draw for draw in draws if draw not in done]
        size, identifying = _part_size(workers), _identification_time()
        total = sum(identifying + sum(spec.seconds for spec in judging.specs(d)) for d in left)
        ended = 0.0

        def report(what: str, seconds: float = identifying) -> None:
            nonlocal ended
            ended += seconds
            if progress is not None:
                progress(what, ended, total)

        for start in range(0, len(left), size):
            part = left[start : start + size]
            for record in _judge_part(judging, part, key, workers, report):
                assert record.draw is not None
                save_robot(record, _record_path(judging, record.draw))
                done[record.draw] = record
                if kept is not None:
                    kept(record)
    return tuple(done[draw] for draw in draws)


class ProgressReporter(Protocol):
    """Function that reports a job that is done; without its time, an identification."""

    def __call__(self, what: str, seconds: float = ...) -> None:
        """Report what was done, and how long it takes a robot [s]."""
        ...


def _identification_time() -> float:
    """Return how long the identification of a robot takes it [s]."""
    robot = load_robot()
    experiment, body = load_experiment(EXPERIMENT, robot), load_experiment(CALIBRATION, robot)
    joints = sweeps_of(experiment).joints
    runs = plan_runs(robot, joints, experiment, calibration=body)
    return sum(run.seconds for run in (*plan_measurements(robot, weight=KNOWN_WEIGHT), *runs))


def _part_size(workers: Workers) -> int:
    if isinstance(workers, Cluster):
        return IN_FLIGHT_ROBOTS
    return max(PART, workers if workers > 0 else os.cpu_count() or 1)


def _record_path(judging: Judging, draw: int) -> Path:
    return judging.records / f"{judging.suites.population}-{draw}.json.gz"


def _kept_record(judging: Judging, draw: int, key: str) -> RobotRecord | None:
    """Return the record of an earlier call; None where there is none, or one of other code, suites or observers."""
    try:
        record = load_robot_record(_record_path(judging, draw))
    except RecordError:
        return None
    return record if record.key == key else None


def _judge_part(
    judging: Judging,
    draws: Sequence[int],
    key: str,
    workers: Workers,
    report: ProgressReporter,
) -> Iterator[RobotRecord]:
    """Identify robots, perform their takes, and yield their records; ``report`` each job that is done."""
    robot, versions = load_robot(), _versions()
    specs = {draw: judging.specs(draw) for draw in draws}
    identified = _identify(
        judging, draws, robot, workers, lambda one: report(f"{one.name}, identified")
    )
    takes: dict[tuple[int, str], Take] = {}
    jobs = []
    for draw in draws:
        owner = identified[draw]
        folder = judging.folder / f"{judging.suites.population}-{draw}"
        make_folder(folder)
        models = _models(owner)
        for spec in specs[draw]:
            path = folder / f"{spec.name}-{_take_key(key, spec, models)}.json.gz"
            jobs.append(
                with_same_draws(partial(_perform, spec, models, judging.observers, path, versions))
            )
    for spec, take in run_jobs(jobs, workers=workers, ordered=False):
        takes[spec.draw, spec.name] = take
        report(f"{spec.population}-{spec.draw}, {spec.name}", spec.seconds)
    for draw in draws:
        owner = identified[draw]
        fits: dict[str, dict[str, float]] = next(iter(owner.report.get("fit", {}).values()), {})
        yield RobotRecord(
            key=key,
            robot=f"{judging.suites.population} {draw}",
            draw=draw,
            law=board_law(judging.suites.population, draw, robot),
            identity=_identity(judging, draw),
            failure="" if owner.file is not None else owner.reason,
            fit={joint: fit["test"] for joint, fit in fits.items()},
            warnings=owner.warnings,
            takes=tuple(takes[draw, spec.name] for spec in specs[draw]),
        )


def _identify(
    judging: Judging,
    draws: Sequence[int],
    robot: RobotConfig,
    workers: Workers,
    progress: Callable[[IdentifiedRobot], None],
) -> dict[int, IdentifiedRobot]:
    experiment: Experiment = load_experiment(EXPERIMENT, robot)
    robots = identify_population(
        f"mujoco://?plant={judging.suites.population}",
        draws,
        experiment,
        "fusion",
        judging.folder / "models",
        other_kinds=TREES,
        calibration=load_experiment(CALIBRATION, robot),
        weight=KNOWN_WEIGHT,
        seed=experiment.seed,
        keep_recordings=judging.keep_recordings,
        workers=workers,
        progress=lambda one, done, all_: progress(one),
    )
    return {one.draw: one for one in robots}


def _models(owner: IdentifiedRobot) -> ModelFiles | None:
    """Return the model files of a robot; None where it could not be identified."""
    if owner.file is None:
        return None
    affine, cart = owner.other_files
    return ModelFiles(fusion=owner.file, affine=affine, cart=cart)


def _take_key(key: str, spec: TakeSpec, models: ModelFiles | None) -> str:
    files = () if models is None else (models.fusion, models.affine, models.cart)
    return content_hash([key, spec.seed, [file_hash(f) for f in files if f is not None]])


class ChangedError(PepperError, RuntimeError):
    """Code or constants changed while robots were judged."""


def _perform(
    spec: TakeSpec,
    models: ModelFiles | None,
    names: Sequence[str],
    path: Path,
    versions: Mapping[str, str],
) -> tuple[TakeSpec, Take]:
    """Perform a take and show it to the observers, or read it where that was done before."""
    try:
        return spec, load_take(path)
    except RecordError:
        pass
    with one_core(1):
        take = perform_and_observe(spec, models, names)
    if _versions() != versions:
        raise ChangedError(
            "code, settings or libraries have changed since the robots began to be judged: undo that to continue, or "
            "begin again"
        )
    save_take(take, path)
    return spec, take


def perform_and_observe(
    spec: TakeSpec,
    models: ModelFiles | None,
    names: Sequence[str],
    *,
    attentive: AttentiveSettings | None = None,
) -> Take:
    """Perform a take and show it to observers.

    Args:
        spec: The take.
        models: Of the robot; None for no observers.
        names: Of the observers.
        attentive: Oscillation of an attentive robot; None for the shipped one.
    """
    robot = load_robot()
    done = perform(spec, None if models is None else models.fusion, attentive=attentive)
    take = done.take
    if models is None or done.recording is None:
        return take
    baselines = load_evaluation_baselines()
    observers: dict[str, Observer] = {}
    failed: dict[str, ObserverRecord] = {}
    for name in names:
        try:
            observers[name] = make(
                name,
                robot,
                models,
                baselines=baselines,
                recording=done.recording,
                uri=spec.uri,
            )
        except Exception as error:  # one observer that fails must not cost the others
            failed[name] = ObserverRecord(
                failure=f"{type(error).__name__}: {error}".splitlines()[0]
            )
    reported = watch_all(
        observers,
        done.recording,
        take.touches,
        robot,
        true_torque=done.true_torque if len(done.true_torque) else None,
    )
    return replace(take, hearings={name: {**reported, **failed}[name] for name in names})


def board_law(population: str, draw: int, robot: RobotConfig) -> BoardLaw:
    """Return the law of the motor boards of a robot of a population of plants."""
    plant = load_plant(population, robot, draw=draw)
    return "integral" if any(drive.ki for drive in plant.actuators) else "nominal"


def _identity(judging: Judging, draw: int) -> str:
    return make_backend(f"mujoco://?plant={judging.suites.population}&draw={draw}").info.identity
