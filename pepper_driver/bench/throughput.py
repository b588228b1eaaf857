"""Robot-hours that one core simulates and works through in an hour: identification and evaluation."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pepper_driver.bench.machine import one_core
from pepper_driver.config import load_experiment, load_robot
from pepper_driver.config.evaluation import load_evaluation
from pepper_driver.evaluation.evaluate import evaluate, suite_jobs
from pepper_driver.evaluation.observers_under_test import contestants
from pepper_driver.identification import fit_folder, record_joints

RUNS = 5

JOINT = "LShoulderRoll"

SUITE = "paper"
"""Half a minute of free motion, then contacts."""

OBSERVER = "fusion"


@dataclass(frozen=True, kw_only=True)
class Throughput:
    """Robot time over processor time, the best of several runs.

    Attributes:
        identify: Of runs that are recorded and fitted, as ``pepper identify`` does.
        evaluate: Of an episode that is performed, shown to ``fusion`` and scored, as ``pepper evaluate`` does.
    """

    identify: float
    evaluate: float

    def as_json(self) -> dict[str, Any]:
        """``robot_hours_per_core_hour.{identify,evaluate}``."""
        return {"robot_hours_per_core_hour": asdict(self)}


def run_throughput_bench(*, on_progress: Callable[[float], None] | None = None) -> Throughput:
    """Identify one joint and evaluate one episode, again and again, on one core.

    Args:
        on_progress: Called with the fraction done, 0..1.
    """
    report_progress = on_progress or (lambda fraction: None)
    best = {"identify": 0.0, "evaluate": 0.0}
    parts = {"identify": _identify, "evaluate": _evaluate}
    with one_core():
        for run in range(RUNS):
            for place, (name, part) in enumerate(parts.items()):
                begin = _processor_time()
                seconds = part()
                best[name] = max(best[name], seconds / (_processor_time() - begin))
                report_progress((run + (place + 1) / len(parts)) / RUNS)
    return Throughput(**best)


def _identify() -> float:
    """Record and fit one joint, with fewer and shorter runs than the shipped experiment; returns the robot time [s]."""
    robot = load_robot()
    sweeps = load_experiment("identify", robot).with_goals(
        sweeps=1, setpoints=2, estimation_stiffness=(3.0,)
    )
    calibration = load_experiment("calibration_motion", robot).with_goals(count=2)
    recorded = 0.0

    def note(what: str, done: float, total: float) -> None:
        nonlocal recorded
        recorded = done

    with TemporaryDirectory() as folder:
        record_joints(
            "mujoco",
            (JOINT,),
            sweeps,
            Path(folder),
            calibration=calibration,
            workers=1,
            progress=note,
        )
        fit_folder(Path(folder), "fusion")
    return recorded


def _evaluate() -> float:
    """Perform the first episode of a suite and evaluate one observer on it; returns the robot time [s]."""
    robot = load_robot()
    frozen = load_evaluation(robot)
    jobs = suite_jobs(frozen, (SUITE,), robot, quick=True)[:1]
    observers = contestants((OBSERVER,), (), robot)
    result = evaluate(jobs, observers, digest=frozen.digest, workers=1)
    return sum(episode.seconds for episode in result.episodes)


def _processor_time() -> float:
    """Processor time of this process and of those that it has started [s]."""
    return sum(os.times()[:4])
