"""The figures of an observer over many takes: those of the paper, and those it leaves out."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

PAPER_SUITE = "paper"
RECALL_BINS = {"1-1.5": (1.0, 1.5), "1.5-2": (1.5, 2.0), "2-3": (2.0, 3.0), "3-": (3.0, math.inf)}
"""[deg] Sizes of pushes, lower bound included."""
DELAY_DEGREES = 3.0
"""[deg] Delays are those of pushes that leave no doubt."""
ISOLATION_DEGREES = 2.0
CONFIDENCE = 0.95


@dataclass(frozen=True, kw_only=True)
class Fit:
    """NRMSE of the expected tracking error [%]: mean over estimation runs, mean over test runs; None without runs."""

    estimation: float | None
    test: float | None


@dataclass(frozen=True, kw_only=True)
class Counts:
    """False contacts, pushes missed, pushes felt."""

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
class Quantiles:
    """Median and 90 % quantile."""

    median: float
    p90: float


@dataclass(frozen=True, kw_only=True)
class Delay:
    """From the onset of the force to the alarm, and from 1 equivalent degree [ms]."""

    median: float
    p90: float
    from_1deg: Quantiles | None


@dataclass(frozen=True, kw_only=True)
class Torque:
    """Torque estimates within pushes: error in equivalent degrees, share explained, share of samples that have one."""

    rmse_over_k_deg: float
    r2: float | None
    estimated: float


@dataclass(frozen=True, kw_only=True)
class Rebound:
    """Share of the alarms after releases that were called rebounds, and of those during pushes."""

    recall: float | None
    mislabelled: float | None
    swings: int
    touches: int


@dataclass(frozen=True, kw_only=True)
class Spread:
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
    """How much was watched at all: joints that ever were not blind, and their share of ticks not blind."""

    joints: int
    share: float | None


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """All figures of one observer; None, or no entry, where the takes say nothing of it.

    Attributes:
        fit: By joint.
        fit_gap_closed: By joint, how far its test fit is on the way from the affine tree to the oracle.
        table1: Counts by experiment of the suite ``paper``, and ``total``.
        counts: Counts over all takes.
        free_motion: False contacts in takes without pushes.
        with_pushes: False contacts in takes with pushes.
        recall: Share of pushes felt by RECALL_BINS of their size, those scored apart left out.
        recall_overall: The same without regard to size.
        recall_saturated: Of pushes beyond what a motor board can hold.
        recall_axis: Of forces along an axis.
        recall_trunk: Of forces on trunk and base.
        recall_hands: Of pushes on fingers.
        recall_count: How many pushes each of these is taken from.
        delay_ms: Of pushes from DELAY_DEGREES up.
        direction: Share of felt pushes with the right sign.
        isolation: Share of felt pushes with the right joint, or put on the trunk rightly, by time after the alarm [ms];
            of pushes on joints only those from ISOLATION_DEGREES up.
        torque: External torque estimates.
        rebound: Whether swinging back is told from being touched.
        threshold_deg: Over time and joints, hands left out, while nothing touches the robot.
        threshold_nm: By joint, median threshold times stiffness of the plant [N m].
        latency_us: Of the observer.
        coverage: What it watched.
    """

    fit: dict[str, Fit]
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
    threshold_deg: Spread | None
    threshold_nm: dict[str, float]
    latency_us: Latency
    coverage: Coverage

    def as_json(self) -> dict[str, Any]:
        """Keys are the names of the attributes."""
        return asdict(self)
