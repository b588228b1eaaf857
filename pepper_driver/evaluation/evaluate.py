"""Evaluation of observers on suites, in parallel jobs; and logs as episodes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np

from pepper_driver.backends.replay import parents_in
from pepper_driver.config import PepperError, RobotConfig, load_robot
from pepper_driver.config.evaluation import EvaluationSuites, SuiteRun
from pepper_driver.config.workers import Workers, run_jobs
from pepper_driver.evaluation.episode_score import (
    FASTEST_ESTIMATION,
    EpisodeScore,
    Trace,
    score_episode,
    trace_of,
    watch,
)
from pepper_driver.evaluation.episodes import Episode, perform
from pepper_driver.evaluation.metrics import Metrics, summarise, with_gap_closed
from pepper_driver.evaluation.observers_under_test import (
    ORACLE,
    RECORDED,
    ObserversUnderTest,
    reference_plant,
)
from pepper_driver.evaluation.quiet import quiet
from pepper_driver.evaluation.results import EpisodeInfo, EvaluationResult, Failure
from pepper_driver.evaluation.true_pushes import true_pushes
from pepper_driver.log import RunLog, read_log
from pepper_driver.observer import KnownPush
from pepper_driver.recording.labels import pushes_of, recording_of

INTEGRAL = "-integral"
"""Ending of the part of a suite whose robots have boards with an integral part: they are another reading of what a real
Pepper is, and are never pooled with the others."""
QUICK = 1 / 9
"""Fraction of a suite for a quick check. Every ninth run of a fit: its five task stiffnesses alternate."""
FIT_JOINT = "LShoulderRoll"
EXPERIMENT_JOINTS = {"LSRoll": FIT_JOINT, "RERoll": "RElbowRoll", "RSRoll": "RShoulderRoll"}
"""The joint that each experiment of the paper is about."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """One episode to evaluate: ``make`` performs it, and can be sent to another process.

    Attributes:
        suite: That its results are summed up in.
        title: Human-readable name.
        make: Performs the episode, or loads one that was performed before.
        pictured: The joint to keep data of for a figure, if any.
    """

    suite: str
    title: str
    make: Callable[[], Episode]
    pictured: str | None = None


def suite_jobs(
    evaluation: EvaluationSuites,
    suites: Sequence[str],
    robot: RobotConfig,
    *,
    quick: bool = False,
    cache: Path | None = None,
) -> tuple[Job, ...]:
    """Return the episodes of suites.

    Args:
        evaluation: The frozen suites.
        suites: Names.
        robot: Its description.
        quick: Only a part of each.
        cache: Folder that keeps episodes.

    Raises:
        UnknownNameError: No such suite.
    """
    return tuple(
        Job(
            suite=suite_of(run, robot),
            title=run.label,
            make=partial(perform, run, cache),
            pictured=_pictured(run, robot),
        )
        for suite in suites
        for run in evaluation.runs(suite, fraction=QUICK if quick else 1.0)
    )


def suite_of(run: SuiteRun, robot: RobotConfig) -> str:
    """Return the suite of a run, with its ending."""
    return run.suite + (INTEGRAL if reference_plant(run.plant, robot) == "integral" else "")


def _pictured(run: SuiteRun, robot: RobotConfig) -> str | None:
    """Return the joint that a figure of the paper shows of a run."""
    if suite_of(run, robot) == "paper":
        return EXPERIMENT_JOINTS.get(run.entry)
    swept = run.entry == FIT_JOINT and run.task_stiffness > FASTEST_ESTIMATION
    return FIT_JOINT if suite_of(run, robot) == "fit" and swept else None


def episode_of_log(path: Path) -> Episode:
    """Return a log as an episode; see :func:`episode_of`.

    Raises:
        PepperError: The log is damaged, of another robot, or has neither labels nor ground truth.
    """
    return episode_of(read_log(path), path)


def episode_of(log: RunLog, path: Path, *, labels_only: bool = False) -> Episode:
    """Return a log as an episode.

    Labels count where there are any: torques are unknown. Without labels the pushes of a simulated run are those of its
    ground truth.

    Args:
        log: That was read.
        path: Its file.
        labels_only: True where there are no touches but those with labels, also in a simulated run.

    Raises:
        PepperError: The log is of another robot, or has neither labels nor ground truth.
    """
    robot = load_robot()
    recording = recording_of(log, robot)
    contact_torque = np.full(recording.position.shape, np.nan)
    if labels_only and not log.labels:
        pushes: tuple[KnownPush, ...] = ()
    elif log.labels or log.truth is None:
        pushes = pushes_of(log)
    else:
        pushes = true_pushes(log, robot)
        # Of a damaged log rows of the truth may be missing, or have no tick.
        _, rows, true_rows = np.intersect1d(recording.time, log.truth["time"], return_indices=True)
        contact_torque[rows] = log.truth["contact_torque"][true_rows]
    return Episode(
        suite="log",
        experiment=path.stem,
        plant=RECORDED,
        identity=log.metadata.get("identity", "unknown"),
        parents=parents_in(path, log.metadata),
        seed=0,
        task_stiffness=0.0,
        recording=recording,
        pushes=pushes,
        contact_torque=contact_torque,
    )


Progress = Callable[[int, int], None]
"""Called with (episodes done, episodes in all)."""


@dataclass(frozen=True, kw_only=True)
class JobResult:
    """Result of one job; ``episode`` is None when it could not be made."""

    suite: str
    episode: EpisodeInfo | None
    scores: dict[str, EpisodeScore]
    traces: tuple[Trace, ...]
    failures: tuple[Failure, ...]


def evaluate(
    jobs: Sequence[Job],
    contestants: ObserversUnderTest,
    *,
    digest: str,
    workers: Workers = -1,
    fraction: float = 1.0,
    progress: Progress | None = None,
) -> EvaluationResult:
    """Evaluate the observers on all episodes, which run in parallel; the result does not depend on ``workers``.

    An episode that cannot be performed is listed among the failures, and the others continue.

    Args:
        jobs: The episodes.
        contestants: The observers.
        digest: Of the frozen suites that the episodes are of.
        workers: Processes, -1 for one per core; or a cluster.
        fraction: Of the suites that the episodes are.
        progress: Called after each episode.
    """
    outcomes = []
    for outcome in run_jobs((partial(run_job, job, contestants) for job in jobs), workers=workers):
        outcomes.append(outcome)
        if progress is not None:
            progress(len(outcomes), len(jobs))
    suites = tuple(dict.fromkeys(job.suite for job in jobs))
    return EvaluationResult(
        suites=suites,
        modes=_by_mode(outcomes, suites, contestants.modes),
        episodes=tuple(o.episode for o in outcomes if o.episode is not None),
        failures=tuple(failure for o in outcomes for failure in o.failures),
        notes=contestants.notes,
        traces=tuple(trace for o in outcomes for trace in o.traces),
        date=datetime.now(UTC).date().isoformat(),
        versions={p: version(p) for p in ("pepper-driver", "mujoco", "numpy", "pin")},
        digest=digest,
        fraction=fraction,
    )


def run_job(job: Job, contestants: ObserversUnderTest) -> JobResult:
    """Make one episode and show it to every observer of its suite."""
    robot = load_robot()
    try:
        episode = job.make()
    except Exception as error:  # one episode that fails must not cost the others
        return JobResult(
            suite=job.suite,
            episode=None,
            scores={},
            traces=(),
            failures=(_failure(job.title, error),),
        )
    swept = episode.experiment in robot.joint_names and not episode.pushes
    tested = episode.experiment if swept else None
    scores: dict[str, EpisodeScore] = {}
    traces: list[Trace] = []
    failures: list[Failure] = []
    for mode in contestants.of_suite(episode.suite):
        try:
            # Advice to identify a robot again: robots and models of a suite are what they are meant to be.
            with quiet("pepper_driver.observer"):
                watched = watch(
                    contestants.observer(mode, episode, robot), episode.recording, tested
                )
            scores[mode] = score_episode(episode, watched, robot)
            if job.pictured is not None:
                traces.append(trace_of(mode, episode, watched, job.pictured))
        except Exception as error:
            failures.append(_failure(f"{job.title}, {mode}", error))
    info = EpisodeInfo(
        suite=job.suite,
        plant=episode.plant,
        seed=episode.seed,
        seconds=len(episode.recording) * robot.cycle,
    )
    return JobResult(
        suite=job.suite, episode=info, scores=scores, traces=tuple(traces), failures=tuple(failures)
    )


def _failure(title: str, error: Exception) -> Failure:
    text = " ".join(str(error).split())
    if not isinstance(error, PepperError):
        text = f"{type(error).__name__}: {text}"
    return Failure(title=title, reason=text)


def _by_mode(
    outcomes: Iterable[JobResult],
    suites: Sequence[str],
    modes: Sequence[str],
) -> dict[str, dict[str, Metrics]]:
    scores: dict[str, dict[str, list[EpisodeScore]]] = {mode: {} for mode in modes}
    for outcome in outcomes:
        for mode, score in outcome.scores.items():
            scores[mode].setdefault(outcome.suite, []).append(score)
    metrics = {
        mode: {s: summarise(by_suite[s]) for s in suites if s in by_suite}
        for mode, by_suite in scores.items()
    }
    affine, oracle = metrics.get("paper-affine", {}), metrics.get(ORACLE, {})
    return {
        mode: {
            suite: with_gap_closed(results, affine.get(suite), oracle.get(suite))
            for suite, results in by_suite.items()
        }
        for mode, by_suite in metrics.items()
        if by_suite
    }
