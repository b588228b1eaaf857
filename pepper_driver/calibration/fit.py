"""Fit of a simulated robot to the recordings of real ones: motor boards, friction, delay.

A joint without an integral part is fitted to a model of its bench results, in rounds: measure in the full plant, choose
the values that the model likes best, measure again. The model takes the closed form of Eq. 11 of the paper for the
change of the error in a ramp, and for a hold that the joint sticks at the same fraction of its friction as before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import inf, isinf
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from pepper_driver.calibration.calibrate import BenchResult, Progress, law_of, measure, residual
from pepper_driver.calibration.drive import (
    ENOUGH,
    CalibrationScore,
    DriveValues,
    Target,
    drag,
    pick,
    score,
    scores,
    shown_of,
    targets,
    torque_constant,
    values_of,
    with_values,
)
from pepper_driver.config import (
    Calibration,
    PlantConfig,
    RobotConfig,
    TrackingTable,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.workers import Workers

STIFFNESSES = np.geomspace(40.0, 250.0, 49)
"""[N m/rad] that are tried; stiffer than these would ask for three times the currents seen in holds."""


def ramp_error(values: DriveValues, drag: float, delay: float, table: TrackingTable) -> FloatArray:
    """Compute the error in a steady ramp under load in closed form, (torques, moving velocities) [rad].

    Eq. 11 of the paper at constant velocity v and load tau, with transport: delay v + (drag v + tau + F sign(v)) / K.

    Args:
        values: K and F; a dead band adds to the error, an integral part is not in the closed form.
        drag: Torque by speed [N m s/rad].
        delay: [s].
        table: Velocities and torques.
    """
    v, tau = np.array(table.moving), np.array(table.torque)[:, None]
    pull = drag * v + tau + values.friction * np.sign(v)
    return np.asarray(delay * v + pull / values.stiffness + values.dead_band * np.sign(pull))


def closed_form_fit(table: TrackingTable, drag: float, delay: float) -> DriveValues:
    """K and F of the closed form by least squares over a table, K within :data:`STIFFNESSES`, F not negative."""
    v, tau = np.array(table.moving), np.array(table.torque)[:, None]
    shape = table.error.shape
    columns = [np.broadcast_to(c, shape).ravel() for c in (drag * v + tau, np.sign(v))]
    bounds = ([1 / STIFFNESSES[-1], 0.0], [1 / STIFFNESSES[0], inf])
    by_k, by_f = lsq_linear(
        np.stack(columns, axis=1), (table.error - delay * v).ravel(), bounds=bounds
    ).x
    return DriveValues(stiffness=float(1 / by_k), friction=float(by_f / by_k))


def predict_holds(
    before: DriveValues,
    candidates: Sequence[DriveValues],
    error: FloatArray,
    load: FloatArray,
    constant: float,
) -> tuple[FloatArray, FloatArray]:
    """Predict the same holds for joints with other values.

    The motor gives K (|e| - dead band); friction balances its difference from the load. A joint with other
    values is assumed to stick at the same fraction of its friction, and to rest at the same fraction of its dead band.

    Args:
        before: The values with which the holds were made.
        candidates: m other sets of values.
        error: (n,) [rad].
        load: (n,) what gravity asks of the joint [N m].
        constant: N Kt [N m/A].

    Returns:
        (m, n) errors [rad] and currents [A], without sign.
    """
    beyond = np.maximum(np.abs(error) - before.dead_band, 0.0)
    fraction = (before.stiffness * np.sign(error) * beyond - load) / before.friction
    k, f, band = (
        np.array([[getattr(c, key)] for c in candidates])
        for key in ("stiffness", "friction", "dead_band")
    )
    inside = beyond == 0.0
    motor = np.where(inside, 0.0, load + f * fraction)
    rest = np.where(inside, error / max(before.dead_band, 1e-9) * band, np.sign(motor) * band)
    return np.asarray(rest + motor / k), np.abs(motor) / constant


DELAYS = range(7)
"""Ticks of transport that are tried."""

FRICTIONS = np.radians(np.arange(0.05, 1.3, 0.025))
"""F / K that are tried: how far friction alone holds a joint off its goal [rad]."""

DEAD_BANDS = np.radians(np.arange(0.0, 1.05, 0.1))
"""[rad] that are tried, on a joint that holds its posture without any current."""


@dataclass(frozen=True, kw_only=True)
class Fitted:
    """Result of a fit.

    Attributes:
        plant: The start plant with the fitted values.
        values: By joint.
        delay: Transport in ticks, all in all.
        room: By joint, the least distance to a target, in standard deviations; negative where one is missed.
    """

    plant: PlantConfig
    values: dict[str, DriveValues]
    delay: int
    room: dict[str, float]

    def as_json(self) -> dict[str, Any]:
        """``delay_ticks`` and by joint ``stiffness``, ``friction``, ``dead_band_deg``, ``integral_time``, ``room``."""
        return {
            "delay_ticks": self.delay,
            "joints": {
                joint: {
                    "stiffness": v.stiffness,
                    "friction": v.friction,
                    "dead_band_deg": float(np.degrees(v.dead_band)),
                    "integral_time": None if isinf(v.integral_time) else v.integral_time,
                    "room": self.room[joint],
                }
                for joint, v in self.values.items()
            },
        }


def start_values(
    robot: RobotConfig, plant: PlantConfig, required: Sequence[Target]
) -> tuple[dict[str, DriveValues], int]:
    """Values and delay before anything is simulated.

    A joint with a table: closed form, with the delay that fits all tables best. One with holds only: K is the ratio
    of holding torque (current times N Kt) to error, F what makes half the error. One that shows no current in holds
    keeps the plant's K; half its error is dead band.
    """
    tabled = [(t, t.table) for t in required if t.table is not None]

    def misfit(delay: int) -> float:
        late, total = delay * robot.cycle, 0.0
        for target, table in tabled:
            pull = drag(robot, plant, target.joint)
            errors = ramp_error(closed_form_fit(table, pull, late), pull, late, table)
            total += (residual(errors, table) / target.max_residual) ** 2
        return total

    delay = min(DELAYS, key=misfit) if tabled else plant.response_delay
    values = {}
    for target in required:
        half = np.radians(target.holds.median_deg) / 2
        if target.table is not None:
            late = delay * robot.cycle
            found = closed_form_fit(target.table, drag(robot, plant, target.joint), late)
            # A table may ask for no friction at all, holds never do.
            least = found.stiffness * half
            values[target.joint] = replace(found, friction=max(found.friction, float(least)))
        elif min(target.holds.current) > 0.0:
            current, error = target.holds.current, (target.holds.median_deg, target.holds.p90_deg)
            k = torque_constant(robot, plant, target.joint) * np.sqrt(
                np.prod(current) / np.prod(np.radians(error))
            )
            values[target.joint] = DriveValues(stiffness=float(k), friction=float(k * half))
        else:
            k = values_of(robot, plant, target.joint).stiffness
            values[target.joint] = DriveValues(
                stiffness=k, friction=float(k * half), dead_band=float(half)
            )
    return values, delay


def fit_pd(
    robot: RobotConfig,
    plant: PlantConfig,
    calibration: Calibration,
    *,
    rounds: int = 4,
    workers: Workers = -1,
    progress: Progress | None = None,
) -> Fitted:
    """Fit K, F, dead band and the common delay of boards without an integral part; see the module.

    The plant itself is measured last: no joint of the result does worse than it did.

    Args:
        robot: The robot.
        plant: Says everything that is not fitted.
        calibration: What the real robots showed, protocols, targets and the seed of the fit.
        rounds: Sets of values that are measured in the full plant; each joint gets its best.
        workers: Processes, -1 for one per core; or a cluster.
        progress: Called with the fraction done, 0..1.
    """
    required = targets(calibration)
    values, delay = start_values(robot, plant, required)
    tried: dict[int, list[_Trial]] = {}
    for number in range(rounds):
        trial = with_values(robot, plant, values, delay)
        measured = _measure(robot, trial, calibration, workers, progress, number, rounds + 1)
        tried.setdefault(delay, []).append(_trial(robot, trial, required, measured))
        if number < rounds - 1:
            values, delay = choose(robot, trial, required, measured)
    if plant.response_delay == delay and law_of(plant) == "pd":
        measured = _measure(robot, plant, calibration, workers, progress, rounds, rounds + 1)
        tried[delay].append(_trial(robot, plant, required, measured))
    return _best(robot, plant, required, tried[delay], delay)


_Trial = dict[str, tuple[DriveValues, CalibrationScore]]
"""By joint, values and what they reached in the full plant."""


def _trial(
    robot: RobotConfig, plant: PlantConfig, required: Sequence[Target], measured: BenchResult
) -> _Trial:
    return {
        t.joint: (values_of(robot, plant, t.joint), score(robot, t, *shown_of(t, measured)))
        for t in required
    }


def _best(
    robot: RobotConfig,
    plant: PlantConfig,
    required: Sequence[Target],
    tried: Sequence[_Trial],
    delay: int,
) -> Fitted:
    """Return the best trial of each joint: what one shows does not depend on the values of the others."""
    values, room = {}, {}
    for target in required:
        found, scores = zip(*(trial[target.joint] for trial in tried), strict=True)
        rooms = np.concatenate([s.room for s in scores])
        index = pick(rooms, np.concatenate([s.squares for s in scores]))
        values[target.joint], room[target.joint] = found[index], float(rooms[index])
    return Fitted(
        plant=with_values(robot, plant, values, delay), values=values, delay=delay, room=room
    )


def fit_integral(
    robot: RobotConfig,
    plant: PlantConfig,
    calibration: Calibration,
    *,
    workers: Workers = -1,
    progress: Progress | None = None,
) -> Fitted:
    """Improve K, F and Ti of the boards of ``plant`` that have an integral part; arguments as for :func:`fit_pd`.

    No closed form: what a joint shows depends on how it came to where it is. One round of pattern search on the bench:
    each value a step up and down, all joints at once, since what one shows does not depend on the others'.
    """
    required = [t for t in targets(calibration) if plant.actuator(t.joint).ki]
    start = {t.joint: values_of(robot, plant, t.joint) for t in required}
    keys = ("stiffness", "friction", "integral_time")
    steps = [("stiffness", 1.0), *product(keys, (0.8, 1.25))]
    tried = []
    for number, (key, factor) in enumerate(steps):
        values = {
            joint: replace(v, **{key: factor * getattr(v, key)}) for joint, v in start.items()
        }
        trial = with_values(robot, plant, values)
        measured = _measure(robot, trial, calibration, workers, progress, number, len(steps))
        tried.append(_trial(robot, trial, required, measured))
    return _best(robot, plant, required, tried, plant.response_delay)


def _measure(
    robot: RobotConfig,
    plant: PlantConfig,
    calibration: Calibration,
    workers: Workers,
    progress: Progress | None,
    number: int,
    rounds: int,
) -> BenchResult:
    def report_progress(fraction: float) -> None:
        if progress is not None:
            progress((number + fraction) / rounds)

    settings = calibration.settings
    more = replace(calibration, holds=replace(calibration.holds, count=settings.fit_count))
    return measure(robot, plant, more, settings.fit_seed, workers=workers, progress=report_progress)


def choose(
    robot: RobotConfig, plant: PlantConfig, required: Sequence[Target], measured: BenchResult
) -> tuple[dict[str, DriveValues], int]:
    """Return the values and the delay that should do best, given what the bench shows of ``plant``.

    For each joint, of all values that are tried: those with :data:`ENOUGH` room to every target, or the most there is;
    of them the one with the least sum of squares. The delay, at most one tick from what it was, is the one that leaves
    the joints most room; of equals the one with the least sum of squares.
    """
    options = []
    for delay in range(max(0, plant.response_delay - 1), plant.response_delay + 2):
        chosen = {t.joint: _choose_one(robot, plant, t, measured, delay) for t in required}
        room = sum(min(room, ENOUGH) for _, room, _ in chosen.values())
        squares = sum(squares for _, _, squares in chosen.values())
        options.append((round(room, 3), -squares, delay, chosen))
    _, _, delay, chosen = max(options, key=lambda option: option[:2])
    return {joint: values for joint, (values, _, _) in chosen.items()}, delay


def _choose_one(
    robot: RobotConfig, plant: PlantConfig, target: Target, measured: BenchResult, delay: int
) -> tuple[DriveValues, float, float]:
    """Values of one joint, with the room and the sum of squares that they should have."""
    joint = target.joint
    before = values_of(robot, plant, joint)
    draws_current = min(target.holds.current) > 0.0
    candidates = [
        DriveValues(stiffness=float(k), friction=float(k * f), dead_band=float(d))
        for k, f, d in product(
            STIFFNESSES if draws_current else [before.stiffness],
            FRICTIONS,
            [before.dead_band] if draws_current else DEAD_BANDS,
        )
    ]
    column = measured.holds.joints.index(joint)
    error, current = predict_holds(
        before,
        candidates,
        measured.holds.error[:, column],
        measured.holds.load[:, column],
        torque_constant(robot, plant, joint),
    )
    shown = np.zeros(len(candidates))
    if target.table is not None and target.table_joint is not None:
        pull, table = drag(robot, plant, joint), target.table
        base = measured.tables[target.table_joint] - ramp_error(
            before, pull, plant.response_delay * robot.cycle, table
        )
        shown = np.array(
            [
                residual(base + ramp_error(c, pull, delay * robot.cycle, table), table)
                for c in candidates
            ]
        )
    scored = scores(
        robot,
        target,
        shown,
        np.percentile(np.abs(error), [50, 90], axis=1),
        np.percentile(current, [50, 90], axis=1),
    )
    index = pick(scored.room, scored.squares)
    return candidates[index], float(scored.room[index]), float(scored.squares[index])
