"""Performs takes, steps every observer over each, sums up: ``pepper evaluate``."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version

from pepper_driver.config import PepperError, RobotConfig, load_robot
from pepper_driver.config.workers import run_jobs
from pepper_driver.evaluation.contestants import ORACLE, Contestants
from pepper_driver.evaluation.jobs import LOG_SUITE, Job
from pepper_driver.evaluation.metrics import Metrics
from pepper_driver.evaluation.results import Evaluation, Failure, TakeInfo
from pepper_driver.evaluation.summary import summarise, with_gap_closed
from pepper_driver.evaluation.take_score import TakeScore, score_take
from pepper_driver.evaluation.trace import Trace, trace_of
from pepper_driver.evaluation.watching import watch

Progress = Callable[[int, int], None]
"""Called with (takes done, takes in all)."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What one job brought; ``take`` is None when it could not be made."""

    suite: str
    take: TakeInfo | None
    scores: dict[str, TakeScore]
    traces: tuple[Trace, ...]
    failures: tuple[Failure, ...]


def evaluate(
    jobs: Sequence[Job],
    contestants: Contestants,
    *,
    workers: int = -1,
    digest: str | None = None,
    share: float = 1.0,
    progress: Progress | None = None,
) -> Evaluation:
    """Evaluate the observers on all takes, which run in parallel; the result does not depend on ``workers``.

    A take that cannot be performed or read is listed among the failures, and the others go on.

    Args:
        jobs: The takes.
        contestants: The observers.
        workers: Processes; -1 for one per core.
        digest: Of the frozen suites that the takes are of; None for recordings.
        share: Of the suites that the takes are.
        progress: Told after each take.
    """
    robot = load_robot()
    outcomes = []
    for outcome in run_jobs((partial(run_job, job, contestants) for job in jobs), workers=workers):
        outcomes.append(outcome)
        if progress is not None:
            progress(len(outcomes), len(jobs))
    suites = tuple(dict.fromkeys(job.suite for job in jobs))
    return Evaluation(
        suites=suites,
        modes=_by_mode(outcomes, suites, contestants.modes, robot),
        takes=tuple(o.take for o in outcomes if o.take is not None),
        failures=tuple(failure for o in outcomes for failure in o.failures),
        notes=contestants.notes,
        traces=tuple(trace for o in outcomes for trace in o.traces),
        date=datetime.now(UTC).date().isoformat(),
        versions={p: version(p) for p in ("pepper-driver", "mujoco", "numpy", "pin")},
        digest=digest,
        share=share,
    )


def run_job(job: Job, contestants: Contestants) -> Outcome:
    """Make one take and show it to every observer of its suite."""
    robot = load_robot()
    try:
        take = job.make()
    except Exception as error:  # one take that fails must not cost the others
        return Outcome(
            suite=job.suite, take=None, scores={}, traces=(), failures=(_failure(job.title, error),)
        )
    swept = take.experiment in robot.joint_names and not take.pushes
    tested = take.experiment if swept else None
    scores: dict[str, TakeScore] = {}
    traces: list[Trace] = []
    failures: list[Failure] = []
    for mode in contestants.of_suite(take.suite):
        try:
            with _unwarned(job):
                watched = watch(contestants.observer(mode, take, robot), take.recording, tested)
            scores[mode] = score_take(take, watched, robot)
            if job.pictured is not None:
                traces.append(trace_of(mode, take, watched, job.pictured))
        except Exception as error:
            failures.append(_failure(f"{job.title}, {mode}", error))
    info = TakeInfo(
        suite=job.suite,
        experiment=take.experiment,
        plant=take.plant if take.draw is None else f"{take.plant} {take.draw}",
        seed=take.seed,
        seconds=len(take.recording) * robot.cycle,
    )
    return Outcome(
        suite=job.suite, take=info, scores=scores, traces=tuple(traces), failures=tuple(failures)
    )


@contextmanager
def _unwarned(job: Job) -> Iterator[None]:
    """Simulated robots are worn on purpose: nobody needs to be told to identify them anew."""
    log = logging.getLogger("pepper_driver.observer")
    level = log.level
    if job.suite != LOG_SUITE:
        log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)


def _failure(title: str, error: Exception) -> Failure:
    text = " ".join(str(error).split())
    if not isinstance(error, PepperError):
        text = f"{type(error).__name__}: {text}"
    return Failure(title=title, reason=text)


def _by_mode(
    outcomes: Iterable[Outcome],
    suites: Sequence[str],
    modes: Sequence[str],
    robot: RobotConfig,
) -> dict[str, dict[str, Metrics]]:
    scores: dict[str, dict[str, list[TakeScore]]] = {mode: {} for mode in modes}
    for outcome in outcomes:
        for mode, score in outcome.scores.items():
            scores[mode].setdefault(outcome.suite, []).append(score)
    metrics = {
        mode: {s: summarise(by_suite[s], robot) for s in suites if s in by_suite}
        for mode, by_suite in scores.items()
    }
    affine, oracle = metrics.get("paper-affine", {}), metrics.get(ORACLE, {})
    return {
        mode: {
            suite: with_gap_closed(figures, affine.get(suite), oracle.get(suite))
            for suite, figures in by_suite.items()
        }
        for mode, by_suite in metrics.items()
        if by_suite
    }
