"""How well a drive does what recordings of real ones show, and which of several does best."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, log

import numpy as np

from pepper_driver.backends.mujoco_.testbench import opposite
from pepper_driver.calibrate import Measured, residual, statistics
from pepper_driver.config import Calibration, HoldStatistics, RobotConfig, TrackingTable
from pepper_driver.config.arrays import FloatArray

HOLD_SCATTER, RESIDUAL_SCATTER, CURRENT_SCATTER = 0.1, 0.02, 0.2
"""Relative standard deviations: of a quantile of 160 holds by its goals, of a table by what the fit leaves open
(assumed), of a current by the gear's unknown efficiency (assumed)."""

ENOUGH = 1.5
"""Room to each target, in standard deviations, beyond which the fit as a whole counts."""


@dataclass(frozen=True, kw_only=True)
class Target:
    """What one drive shall show: a table of either arm's joint, or none, and statistics of holds."""

    joint: str
    table_joint: str | None
    table: TrackingTable | None
    holds: HoldStatistics
    largest_residual: float
    largest_factor: float


@dataclass(frozen=True, kw_only=True)
class Score:
    """How well n sets of values do: (n,) room to the nearest target in standard deviations, sum of squares of all."""

    room: FloatArray
    squares: FloatArray


def targets(calibration: Calibration) -> tuple[Target, ...]:
    """One for each joint with holds; a table counts for the drive of both arms."""
    found, tables = [], calibration.recordings.tables
    for joint, holds in calibration.recordings.holds.items():
        name = next((n for n in (joint, opposite(joint)) if n in tables), None)
        limit = np.radians(calibration.settings.largest_residual_deg[name]) if name else inf
        found.append(
            Target(
                joint=joint,
                table_joint=name,
                table=tables[name] if name else None,
                holds=holds,
                largest_residual=float(limit),
                largest_factor=calibration.settings.largest_factor,
            )
        )
    return tuple(found)


def shown_of(target: Target, measured: Measured) -> tuple[float, HoldStatistics]:
    """Residual [rad] and statistics of holds that a measurement shows of one target."""
    shown = 0.0
    if target.table is not None and target.table_joint is not None:
        shown = residual(measured.tables[target.table_joint], target.table)
    return shown, statistics(measured.holds, target.joint)


def score(robot: RobotConfig, target: Target, shown: float, holds: HoldStatistics) -> Score:
    """Score of one measurement, arrays (1,).

    Args:
        robot: The robot.
        target: What is wanted.
        shown: Residual to the table [rad].
        holds: What the holds show.
    """
    quantiles = np.radians([[holds.median_deg], [holds.p90_deg]])
    return scores(robot, target, np.array([shown]), quantiles, np.array(holds.current)[:, None])


def scores(
    robot: RobotConfig,
    target: Target,
    shown: FloatArray,
    quantiles: FloatArray,
    current: FloatArray,
) -> Score:
    """Scores of n sets of values.

    Args:
        robot: The robot.
        target: What is wanted.
        shown: (n,) residual to the table [rad].
        quantiles: (2, n) median and 90th percentile of the error in holds [rad].
        current: (2, n) the same of the current [A].
    """
    real = np.radians([[target.holds.median_deg], [target.holds.p90_deg]])
    factors = np.log(np.maximum(quantiles, 1e-9) / real)
    room = ((log(target.largest_factor) - np.abs(factors)) / HOLD_SCATTER).min(axis=0)
    squares = np.square(factors / HOLD_SCATTER).sum(axis=0)
    if target.table is not None:
        relative = shown / target.largest_residual
        room = np.minimum(room, (1.0 - relative) / RESIDUAL_SCATTER)
        squares = squares + np.square(relative)
    if min(target.holds.current) > 0.0:
        ratios = np.log(np.maximum(current, 1e-3) / np.array(target.holds.current)[:, None])
        squares = squares + np.square(ratios / CURRENT_SCATTER).sum(axis=0)
    else:
        squares = squares + np.square(current / robot.sensors.current.step).sum(axis=0)
    return Score(room=room, squares=squares)


def pick(room: FloatArray, squares: FloatArray) -> int:
    """Of those with :data:`ENOUGH` room, or the most there is, the one with the least sum of squares."""
    enough = room >= min(ENOUGH, float(room.max()))
    return int(np.argmin(np.where(enough, squares, inf)))
