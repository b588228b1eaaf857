"""Metrics of many episodes: Table I of the paper, and the fit of the expected tracking error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from pepper_driver.evaluation.episode_score import EpisodeScore
from pepper_driver.observer import FitScore

PAPER_SUITE = "paper"


@dataclass(frozen=True, kw_only=True)
class Counts:
    """False contacts, pushes missed, pushes detected."""

    fp: int
    fn: int
    tp: int


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """All results of one observer; no entry where the episodes say nothing of it.

    Attributes:
        table1: Counts by experiment of the suite ``paper``, and ``total``.
        fit: By joint: means over runs; None without runs.
        fit_gap_closed: By joint, fraction of the gap from the affine tree to the oracle that its test fit closes.
    """

    table1: dict[str, Counts]
    fit: dict[str, FitScore[float | None]]
    fit_gap_closed: dict[str, float]

    def as_json(self) -> dict[str, Any]:
        """Keys are the names of the attributes."""
        return asdict(self)


def summarise(scores: Sequence[EpisodeScore]) -> Metrics:
    """Return the results of one observer over episodes."""
    return Metrics(table1=_table1(scores), fit=_fit(scores), fit_gap_closed={})


def with_gap_closed(metrics: Metrics, affine: Metrics | None, oracle: Metrics | None) -> Metrics:
    """Return the metrics, with the fraction of the gap from affine tree to oracle that each test fit closes."""
    closed = {}
    for joint, fit in metrics.fit.items():
        low = affine.fit[joint].test if affine and joint in affine.fit else None
        high = oracle.fit[joint].test if oracle and joint in oracle.fit else None
        if fit.test is not None and low is not None and high is not None and high > low:
            closed[joint] = (fit.test - low) / (high - low)
    return replace(metrics, fit_gap_closed=closed)


def _table1(scores: Sequence[EpisodeScore]) -> dict[str, Counts]:
    rows: dict[str, list[EpisodeScore]] = {}
    for score in scores:
        if score.suite == PAPER_SUITE:
            rows.setdefault(score.experiment, []).append(score)
    if not rows:
        return {}
    table = {experiment: _counts(group) for experiment, group in rows.items()}
    return {**table, "total": _counts([score for group in rows.values() for score in group])}


def _counts(scores: Sequence[EpisodeScore]) -> Counts:
    return Counts(
        fp=sum(score.false for score in scores),
        fn=sum(score.missed for score in scores),
        tp=sum(score.detected for score in scores),
    )


def _fit(scores: Sequence[EpisodeScore]) -> dict[str, FitScore[float | None]]:
    runs: dict[str, dict[bool, list[float]]] = {}
    for score in scores:
        for joint, fit in score.fit.items():
            runs.setdefault(joint, {False: [], True: []})[score.fast].append(fit)
    return {
        joint: FitScore(
            estimation=float(np.mean(by_speed[False])) if by_speed[False] else None,
            test=float(np.mean(by_speed[True])) if by_speed[True] else None,
        )
        for joint, by_speed in runs.items()
    }
