"""What is evaluated: the takes of the frozen suites, or labelled recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from pepper_driver.backends.replay import parents_in
from pepper_driver.config import RobotConfig, load_robot
from pepper_driver.config.evaluation import Evaluation, Run
from pepper_driver.evaluation.contestants import RECORDED, reference_plant
from pepper_driver.evaluation.take_score import FASTEST_ESTIMATION
from pepper_driver.evaluation.takes import Take, perform
from pepper_driver.log import read_log
from pepper_driver.recording.labels import pushes_of, recording_of

LOG_SUITE = "log"
INTEGRAL = "-integral"
"""Ending of the part of a suite whose robots have boards with an integral part: they are another reading of what a real
Pepper is, and are never pooled with the others."""
QUICK = 1 / 9
"""Share of a suite for a first look. Every ninth run of a fit: its five task stiffnesses take turns."""
FIT_JOINT = "LShoulderRoll"
EXPERIMENT_JOINTS = {"LSRoll": FIT_JOINT, "RERoll": "RElbowRoll", "RSRoll": "RShoulderRoll"}
"""The joint that each experiment of the paper is about."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """One take to evaluate: ``make`` performs or loads it, and can be sent to another process.

    Attributes:
        suite: That its figures are summed up in.
        title: For people.
        make: Performs or loads the take.
        pictured: The joint to keep data of for a picture, if any.
    """

    suite: str
    title: str
    make: Callable[[], Take]
    pictured: str | None = None


def suite_jobs(
    evaluation: Evaluation,
    suites: Sequence[str],
    robot: RobotConfig,
    *,
    quick: bool = False,
    cache: Path | None = None,
) -> tuple[Job, ...]:
    """The takes of suites.

    Args:
        evaluation: The frozen suites.
        suites: Names.
        robot: Its description.
        quick: Only a part of each.
        cache: Folder that keeps takes.

    Raises:
        UnknownNameError: No such suite.
    """
    jobs = []
    drawn: set[str] = set()
    for suite in suites:
        for run in evaluation.runs(suite, share=QUICK if quick else 1.0):
            joint = _pictured(run, robot)
            if joint is not None and (run.suite + joint) in drawn:
                joint = None
            if joint is not None:
                drawn.add(run.suite + joint)
            jobs.append(
                Job(
                    suite=suite_of(run, robot),
                    title=run.label,
                    make=partial(perform, run, cache),
                    pictured=joint,
                )
            )
    return tuple(jobs)


def suite_of(run: Run, robot: RobotConfig) -> str:
    """The suite of a run, with its ending."""
    return run.suite + (INTEGRAL if reference_plant(run.plant, robot) == "integral" else "")


def _pictured(run: Run, robot: RobotConfig) -> str | None:
    """The joint that a picture shows of a run; the pictures are the paper's."""
    if suite_of(run, robot) == "paper":
        return EXPERIMENT_JOINTS.get(run.entry)
    swept = run.entry == FIT_JOINT and run.task_stiffness > FASTEST_ESTIMATION
    return FIT_JOINT if suite_of(run, robot) == "fit" and swept else None


def log_jobs(paths: Sequence[Path]) -> tuple[Job, ...]:
    """Recordings of ``pepper record --label``."""
    return tuple(
        Job(suite=LOG_SUITE, title=str(path), make=partial(take_of_log, path)) for path in paths
    )


def take_of_log(path: Path) -> Take:
    """A labelled recording as a take whose pushes have no size and whose torques nobody knows.

    Raises:
        PepperError: The log is damaged, of another robot, or has no labels.
    """
    robot = load_robot()
    log = read_log(path)
    recording = recording_of(log, robot)
    unknown = np.full(recording.position.shape, np.nan)
    return Take(
        suite=LOG_SUITE,
        experiment=path.stem,
        plant=RECORDED,
        draw=None,
        identity=log.metadata.get("identity", "unknown"),
        parents=parents_in(path, log.metadata),
        seed=0,
        task_stiffness=0.0,
        recording=recording,
        pushes=pushes_of(log),
        contact_torque=unknown,
        saturated=np.zeros(recording.position.shape, dtype=np.bool_),
        stiffness_constant=unknown[0],
    )
