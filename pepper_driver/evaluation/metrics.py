"""Metrics of many episodes: recall, false contacts, delay, direction, isolation, torque."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.special import betaincinv, gammaincinv

from pepper_driver.config import RobotConfig
from pepper_driver.evaluation.episode_score import (
    ISOLATION_TIMES,
    EpisodeScore,
    PushScore,
    TorqueSums,
)
from pepper_driver.observer import FitScore

PAPER_SUITE = "paper"
RECALL_BINS = {"1-1.5": (1.0, 1.5), "1.5-2": (1.5, 2.0), "2-3": (2.0, 3.0), "3-": (3.0, math.inf)}
"""[deg] Sizes of pushes, lower bound included."""
DELAY_DEGREES = 3.0
"""[deg] Delays are those of pushes that leave no doubt."""
ISOLATION_DEGREES = 2.0
CONFIDENCE = 0.95


@dataclass(frozen=True, kw_only=True)
class Counts:
    """False contacts, pushes missed, pushes detected."""

    fp: int
    fn: int
    tp: int


@dataclass(frozen=True, kw_only=True)
class FalseAlarms:
    """False contacts in a time, and the most per hour that agrees with them (Poisson, one-sided, CONFIDENCE)."""

    hours: float
    fp: int
    fp_per_hour_upper95: float


@dataclass(frozen=True, kw_only=True)
class DelayQuantiles:
    """Median and 90 % quantile [ms]."""

    median: float
    p90: float


@dataclass(frozen=True, kw_only=True)
class Delay(DelayQuantiles):
    """From the onset of the force to the alarm, and from 1 equivalent degree [ms]."""

    from_1deg: DelayQuantiles | None


@dataclass(frozen=True, kw_only=True)
class Torque:
    """Torque estimates within pushes: error in equivalent degrees, fractions explained and estimated."""

    rmse_over_k_deg: float
    r2: float | None
    estimated: float


@dataclass(frozen=True, kw_only=True)
class Rebound:
    """Fraction of the alarms after releases that were called rebounds, and of those during pushes."""

    recall: float | None
    mislabelled: float | None
    swings: int
    touches: int


@dataclass(frozen=True, kw_only=True)
class ThresholdSpread:
    """Quantiles."""

    p05: float
    p50: float
    p95: float


@dataclass(frozen=True, kw_only=True)
class Latency:
    """Wall time of the observer for one tick of all joints [us]."""

    median: float
    p99: float


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """Observed part of a run: joints that were not always blind, and their fraction of ticks that were not blind."""

    joints: int
    fraction: float | None


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """All figures of one observer; None, or no entry, where the episodes say nothing of it.

    Attributes:
        fit: By joint: means over runs; None without runs.
        fit_gap_closed: By joint, fraction of the gap from the affine tree to the oracle that its test fit closes.
        table1: Counts by experiment of the suite ``paper``, and ``total``.
        counts: Counts over all episodes.
        free_motion: False contacts in episodes without pushes.
        with_pushes: False contacts in episodes with pushes.
        recall: Fraction of pushes detected by RECALL_BINS of their size, without those scored apart.
        recall_overall: The same without regard to size.
        recall_saturated: Of pushes beyond what a motor board can hold.
        recall_axis: Of forces along an axis.
        recall_trunk: Of forces on trunk and base.
        recall_hands: Of pushes on fingers.
        recall_count: Number of pushes behind each of these.
        delay_ms: Of pushes from DELAY_DEGREES up.
        direction: Fraction of detected pushes with the right sign.
        isolation: Fraction of detected pushes with the right joint, or rightly on the trunk, by time after the alarm
            [ms]; of pushes on joints only those from ISOLATION_DEGREES up.
        torque: External torque estimates.
        rebound: Distinction of rebounds from touches.
        threshold_deg: Over time and joints, hands left out, while nothing touches the robot.
        threshold_nm: By joint, median threshold times stiffness of the plant [N m].
        latency_us: Of the observer.
        coverage: What it watched.
    """

    fit: dict[str, FitScore[float | None]]
    fit_gap_closed: dict[str, float]
    table1: dict[str, Counts]
    counts: Counts
    free_motion: FalseAlarms | None
    with_pushes: FalseAlarms | None
    recall: dict[str, float | None]
    recall_overall: float | None
    recall_saturated: float | None
    recall_axis: float | None
    recall_trunk: float | None
    recall_hands: float | None
    recall_count: dict[str, int]
    delay_ms: Delay | None
    direction: float | None
    isolation: dict[str, float | None]
    torque: Torque | None
    rebound: Rebound | None
    threshold_deg: ThresholdSpread | None
    threshold_nm: dict[str, float]
    latency_us: Latency
    coverage: Coverage

    def as_json(self) -> dict[str, Any]:
        """Keys are the names of the attributes."""
        return asdict(self)


def upper_bound(count: int, hours: float) -> float:
    """Largest rate [1/h] that ``count`` events in ``hours`` do not refute: exact Poisson, one-sided, CONFIDENCE."""
    return float(gammaincinv(count + 1, CONFIDENCE)) / hours


def fraction_interval(count: int, of: int) -> tuple[float, float]:
    """Interval of the probability behind ``count`` of at least one trials: Clopper-Pearson, two-sided, CONFIDENCE.

    Pushes of one episode are not independent trials, so the true interval is somewhat wider.
    """
    tail = (1.0 - CONFIDENCE) / 2.0
    low = float(betaincinv(count, of - count + 1, tail)) if count > 0 else 0.0
    high = float(betaincinv(count + 1, of - count, 1.0 - tail)) if count < of else 1.0
    return low, high


def summarise(scores: Sequence[EpisodeScore], robot: RobotConfig) -> Metrics:
    """Return the figures of one observer over episodes, at least one."""
    pushes = [push for score in scores for push in score.pushes]
    plain = _group(pushes, "plain")
    detected = [push for push in plain if push.detected]
    apart = {name: _group(pushes, name) for name in ("saturated", "axis", "trunk", "hand")}
    by_size = {
        name: [push for push in plain if low <= push.degrees < high]
        for name, (low, high) in RECALL_BINS.items()
    }
    isolated = [push.isolation for push in detected if push.degrees >= ISOLATION_DEGREES]
    isolated += [push.isolation for push in apart["trunk"] if push.detected]
    return Metrics(
        fit=_fit(scores),
        fit_gap_closed={},
        table1=_table1(scores),
        counts=_counts(scores),
        free_motion=_false_alarms([s for s in scores if s.free]),
        with_pushes=_false_alarms([s for s in scores if not s.free]),
        recall={name: _recall(group) for name, group in by_size.items()},
        recall_overall=_recall(plain),
        recall_saturated=_recall(apart["saturated"]),
        recall_axis=_recall(apart["axis"]),
        recall_trunk=_recall(apart["trunk"]),
        recall_hands=_recall(apart["hand"]),
        recall_count={
            **{name: len(group) for name, group in by_size.items()},
            "overall": len(plain),
            "saturated": len(apart["saturated"]),
            "axis": len(apart["axis"]),
            "trunk": len(apart["trunk"]),
            "hands": len(apart["hand"]),
        },
        delay_ms=_delay([push for push in detected if push.degrees >= DELAY_DEGREES]),
        direction=_fraction(push.direction for push in detected if push.direction is not None),
        isolation={
            f"{1e3 * after:.0f}": _fraction(answers[n] for answers in isolated)
            for n, after in enumerate(ISOLATION_TIMES)
        },
        torque=_torque(sum((s.torque for s in scores), TorqueSums())),
        rebound=_rebound(scores),
        latency_us=_latency(scores),
        coverage=_coverage(scores),
        **_thresholds(scores, robot),
    )


def with_gap_closed(metrics: Metrics, affine: Metrics | None, oracle: Metrics | None) -> Metrics:
    """Return the metrics, with the fraction of the gap from affine tree to oracle that each test fit closes."""
    closed = {}
    for joint, fit in metrics.fit.items():
        low = affine.fit[joint].test if affine and joint in affine.fit else None
        high = oracle.fit[joint].test if oracle and joint in oracle.fit else None
        if fit.test is not None and low is not None and high is not None and high > low:
            closed[joint] = (fit.test - low) / (high - low)
    return replace(metrics, fit_gap_closed=closed)


def _group(pushes: Sequence[PushScore], group: str) -> list[PushScore]:
    return [push for push in pushes if push.group == group]


def _fraction(answers: Iterable[bool]) -> float | None:
    answers = list(answers)
    return sum(answers) / len(answers) if answers else None


def _recall(pushes: Sequence[PushScore]) -> float | None:
    return _fraction(push.detected for push in pushes)


def _counts(scores: Sequence[EpisodeScore]) -> Counts:
    detected = [push.detected for score in scores for push in score.pushes]
    return Counts(
        fp=sum(s.false for s in scores), fn=detected.count(False), tp=detected.count(True)
    )


def _table1(scores: Sequence[EpisodeScore]) -> dict[str, Counts]:
    rows: dict[str, list[EpisodeScore]] = {}
    for score in scores:
        if score.suite == PAPER_SUITE:
            rows.setdefault(score.experiment, []).append(score)
    if not rows:
        return {}
    table = {experiment: _counts(group) for experiment, group in rows.items()}
    return {**table, "total": _counts([score for group in rows.values() for score in group])}


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


def _false_alarms(scores: Sequence[EpisodeScore]) -> FalseAlarms | None:
    if not scores:
        return None
    hours, count = sum(s.seconds for s in scores) / 3600.0, sum(s.false for s in scores)
    return FalseAlarms(hours=hours, fp=count, fp_per_hour_upper95=upper_bound(count, hours))


def _quantiles(seconds: Sequence[float]) -> DelayQuantiles | None:
    if not seconds:
        return None
    median, p90 = 1e3 * np.percentile(seconds, (50, 90))
    return DelayQuantiles(median=float(median), p90=float(p90))


def _delay(pushes: Sequence[PushScore]) -> Delay | None:
    delay = _quantiles([p.delay for p in pushes if p.delay is not None])
    if delay is None:
        return None
    later = _quantiles([p.delay_from_1deg for p in pushes if p.delay_from_1deg is not None])
    return Delay(median=delay.median, p90=delay.p90, from_1deg=later)


def _torque(sums: TorqueSums) -> Torque | None:
    n = sums.estimated
    if n == 0:
        return None
    spread = sums.squared_truth - sums.truth**2 / n
    return Torque(
        rmse_over_k_deg=math.degrees(math.sqrt(sums.squared_error / n)),
        r2=1.0 - sums.squared_error / spread if spread > 0.0 else None,
        estimated=n / sums.samples,
    )


def _rebound(scores: Sequence[EpisodeScore]) -> Rebound | None:
    swings, touches = sum(s.swings for s in scores), sum(s.touches for s in scores)
    if not swings and not touches:
        return None
    return Rebound(
        recall=sum(s.rebounds_reported for s in scores) / swings if swings else None,
        mislabelled=sum(s.contacts_misreported for s in scores) / touches if touches else None,
        swings=swings,
        touches=touches,
    )


def _thresholds(scores: Sequence[EpisodeScore], robot: RobotConfig) -> Mapping[str, Any]:
    """``threshold_deg`` and ``threshold_nm``."""
    names = [name for name in robot.joint_names if name not in robot.hands.joints]
    columns = [robot.joint_index(name) for name in names]
    threshold = np.concatenate([s.threshold for s in scores])[:, columns]
    torque = np.concatenate([s.threshold * s.stiffness_constant for s in scores])[:, columns]
    known = threshold[np.isfinite(threshold)]
    if not len(known):
        return {"threshold_deg": None, "threshold_nm": {}}
    p05, p50, p95 = np.degrees(np.percentile(known, (5, 50, 95)))
    return {
        "threshold_deg": ThresholdSpread(p05=float(p05), p50=float(p50), p95=float(p95)),
        "threshold_nm": {
            name: float(np.median(column[np.isfinite(column)]))
            for name, column in zip(names, torque.T, strict=True)
            if np.isfinite(column).any()
        },
    }


def _latency(scores: Sequence[EpisodeScore]) -> Latency:
    median, p99 = np.percentile(np.concatenate([s.step_us for s in scores]), (50, 99))
    return Latency(median=float(median), p99=float(p99))


def _coverage(scores: Sequence[EpisodeScore]) -> Coverage:
    seen, ticks = np.sum([s.seen for s in scores], axis=0), sum(s.ticks for s in scores)
    watched = seen[seen > 0]
    return Coverage(
        joints=len(watched), fraction=float(watched.mean() / ticks) if len(watched) else None
    )
