"""Makes the recordings of an identification: those runs that are not in the folder yet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from pepper_driver.config import ConfigError, RobotConfig, load_controller_settings
from pepper_driver.config.workers import run_jobs
from pepper_driver.identification.folder import finished, recording_path
from pepper_driver.identification.rehearsal import rehearse
from pepper_driver.identification.runs import Run, perform, seeded_uri

Progress = Callable[[str, float, float], None]
"""Called with (what is under way, seconds of runs done, seconds in all)."""

Confirm = Callable[[Run], None]
"""Called before a run that somebody must watch; raises to end the recording there."""


def record_missing(
    uri: str,
    runs: Sequence[Run],
    folder: Path,
    robot: RobotConfig,
    *,
    real_time: bool,
    takes_seed: bool,
    workers: int = -1,
    confirm: Confirm | None = None,
    progress: Progress | None = None,
) -> None:
    """Make the runs whose file is not in the folder. Each is there as soon as it is over, whatever comes after it.

    Simulated backends run in parallel, each run on a robot and with a random sequence of its own; the result does not
    depend on ``workers``, nor on what was there. A backend in real time runs one after the other, after a rehearsal of
    all runs.

    Args:
        uri: The backend.
        runs: All runs.
        folder: Where their recordings are.
        robot: Its description.
        real_time: True for a real robot.
        takes_seed: True where the URI takes a seed of the noise.
        workers: Processes for simulated runs and rehearsals; -1 for one per core.
        confirm: Asked before each run of a real robot in which legs or base move.
        progress: Told how far it is.

    Raises:
        PepperError: A robot that refuses, a run that would not go well, a folder that cannot be written to.
    """
    there = finished(folder, [run.name for run in runs])
    todo = [run for run in runs if run.name not in there]
    if not todo:
        return
    if any(run.watched for run in todo):
        _check_balance(robot)
    tell = progress or (lambda what, done, total: None)
    total = sum(run.seconds for run in runs)
    done = total - sum(run.seconds for run in todo)
    if not real_time:
        tell("recording in simulation", done, total)
        uris = [seeded_uri(uri, run) if takes_seed else uri for run in todo]
        jobs = (partial(_make, uri, run, folder) for uri, run in zip(uris, todo, strict=True))
        for run in run_jobs(jobs, workers=workers, ordered=False):
            done += run.seconds
            tell(f"recording in simulation: {run.name}", done, total)
        return
    _rehearse_all(todo, workers, tell)
    for run in todo:
        if confirm is not None and run.watched:
            confirm(run)
        before = done

        def advance(share: float, run: Run = run, before: float = before) -> None:
            tell(run.name, before + share * run.seconds, total)

        advance(0.0)
        perform(uri, run, on_progress=advance).save(recording_path(folder, run.name))
        done += run.seconds
        tell(run.name, done, total)


def _make(uri: str, run: Run, folder: Path) -> Run:
    """Perform one run and keep it; returns the run."""
    perform(uri, run).save(recording_path(folder, run.name))
    return run


def _rehearse_all(runs: Sequence[Run], workers: int, tell: Progress) -> None:
    total, done = sum(run.seconds for run in runs), 0.0
    tell("rehearsing", done, total)
    jobs = (partial(_rehearse, run) for run in runs)
    for seconds in run_jobs(jobs, workers=workers, ordered=False):
        done += seconds
        tell("rehearsing", done, total)


def _rehearse(run: Run) -> float:
    rehearse(run)
    return run.seconds


def _check_balance(robot: RobotConfig) -> None:
    if not load_controller_settings(robot).constraints.balance:
        raise ConfigError(
            "controller.yaml: key 'constraints.balance' is false: legs and base are moved only with the balance "
            "constraint; switch it on, or give --joints without legs and --calibration none"
        )
