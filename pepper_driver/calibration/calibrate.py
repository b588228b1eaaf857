"""Distance of a simulated robot from recordings of real ones: ``pepper calibrate --check``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from pepper_driver.calibration.as_recorded import (
    ChaseReport,
    chase_figures,
    false_contacts,
    gravity_at_goals,
    play_chases,
)
from pepper_driver.calibration.testbench import (
    HoldEnds,
    hold_errors,
    integration_error,
    ramp_errors,
    real_time_factor,
)
from pepper_driver.config import (
    Calibration,
    HoldStatistics,
    PlantConfig,
    RobotConfig,
    RobotIdentity,
    TrackingTable,
    load_plant,
    plant_hash,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.workers import Workers
from pepper_driver.observer import ModelSet, load_shipped
from pepper_driver.observer.contact_observer import ObserverParts
from pepper_driver.observer.residuals.fusion import FusionParts

Law = Literal["pd", "integral"]
Progress = Callable[[float], None]
"""Called with the fraction done, 0..1."""

MEASURED, PLAYED = 0.7, 0.8
"""Fraction of a check that ramps and holds take, and of the rest the one that commands take, for the progress."""

AS_COUNTED = ObserverParts(residual=FusionParts(law=False))
"""The false contacts of the real robot were counted before there was the law of the boards. With it, joints whose
boards fall behind are blind instead, and a plant has hardly any to compare."""


@dataclass(frozen=True, kw_only=True)
class BenchResult:
    """Results of the bench for one plant: by joint (torques, moving velocities) ramp errors [rad], and holds."""

    tables: dict[str, FloatArray]
    holds: HoldEnds


@dataclass(frozen=True, kw_only=True)
class CalibrationMetric:
    """One metric and its counterpart of real robots.

    Attributes:
        joint: Whose.
        quantity: ``residual``, ``median`` or ``p90`` of the error in holds [deg]; ``current median``, ``current p90``
            in holds [A].
        real: None where the simulated value itself is judged.
        simulated: In the same unit.
        limit: Upper bound of ``simulated``, or of the factor between the two in either direction; None: only reported.
    """

    joint: str
    quantity: str
    real: float | None
    simulated: float
    limit: float | None

    @property
    def factor(self) -> float | None:
        """Simulated over real, where there is a real value other than 0."""
        return self.simulated / self.real if self.real else None

    @property
    def passed(self) -> bool | None:
        """True while the limit is kept; None without a limit."""
        if self.limit is None:
            return None
        if self.real is None:
            return self.simulated <= self.limit
        factor = self.simulated / self.real
        return 1 / self.limit <= factor <= self.limit


@dataclass(frozen=True, kw_only=True)
class CalibrationReport:
    """Distance of one plant from the recordings.

    Attributes:
        plant: Its name.
        law: Whether any of its boards has an integral part.
        measured: By the bench.
        chases: Under the commands as recorded.
        reference_error: Root mean square error of the integration of motion [rad].
        real_time_factor: Speed of the simulation.
        calibration: What it is compared with, and how.
    """

    plant: str
    law: Law
    measured: BenchResult
    chases: ChaseReport
    reference_error: float
    real_time_factor: float
    calibration: Calibration

    @property
    def metrics(self) -> tuple[CalibrationMetric, ...]:
        """Everything that has a real counterpart or a limit."""
        metrics = []
        for joint, errors in self.measured.tables.items():
            metrics.append(
                CalibrationMetric(
                    joint=joint,
                    quantity="residual",
                    real=None,
                    simulated=float(
                        np.degrees(residual(errors, self.calibration.recordings.tables[joint]))
                    ),
                    limit=self.calibration.settings.largest_residual_deg.get(joint),
                )
            )
        for joint, real in self.calibration.recordings.holds.items():
            simulated = statistics(self.measured.holds, joint)
            factor = self.calibration.settings.largest_factor
            for quantity, a, b, limit in (
                ("median", real.median_deg, simulated.median_deg, factor),
                ("p90", real.p90_deg, simulated.p90_deg, factor),
                ("current median", real.current[0], simulated.current[0], None),
                ("current p90", real.current[1], simulated.current[1], None),
            ):
                metrics.append(
                    CalibrationMetric(
                        joint=joint, quantity=quantity, real=a, simulated=b, limit=limit
                    )
                )
        return tuple(metrics)

    @property
    def passed(self) -> bool:
        """True if every limit of ramps and holds is kept; the commands as recorded have cells of their own."""
        return all(metric.passed is not False for metric in self.metrics)

    def as_json(self) -> dict[str, Any]:
        """``residual_deg.<joint>``, ``hold_deg.<joint>.{median,p90}``, and more; see ``docs/plant.md``."""
        metrics = {(f.joint, f.quantity): f for f in self.metrics}

        def holds(what: str, pick: Callable[[CalibrationMetric], float | None]) -> dict[str, Any]:
            return {
                joint: {key: pick(metrics[joint, f"{what}{key}"]) for key in ("median", "p90")}
                for joint in self.calibration.recordings.holds
            }

        return {
            "plant": self.plant,
            "law": self.law,
            "passed": self.passed,
            "residual_deg": {
                f.joint: f.simulated for f in self.metrics if f.quantity == "residual"
            },
            "hold_deg": holds("", lambda f: f.simulated),
            "hold_current_a": holds("current ", lambda f: f.simulated),
            "as_recorded": self.chases.as_json(),
            "reference_error_mrad": 1e3 * self.reference_error,
            "real_time_factor": self.real_time_factor,
            "hold_factor": holds("", lambda f: f.factor),
            "real": {
                "hold_deg": holds("", lambda f: f.real),
                "hold_current_a": holds("current ", lambda f: f.real),
            },
            "target": {
                "residual_deg": dict(self.calibration.settings.largest_residual_deg),
                "hold_factor": self.calibration.settings.largest_factor,
            },
        }


def residual(errors: FloatArray, table: TrackingTable) -> float:
    """Root mean square difference to a table [rad], over all torques and all velocities but 0, with equal weights.

    Args:
        errors: (torques, moving velocities) [rad].
        table: Of a real robot.
    """
    return float(np.sqrt(np.mean(np.square(errors - table.error))))


def statistics(holds: HoldEnds, joint: str) -> HoldStatistics:
    """Return the statistics of one joint, computed as those of the recordings."""
    column = holds.joints.index(joint)
    error, current = np.degrees(holds.error[:, column]), holds.current[:, column]
    median, p90 = np.percentile(np.abs(error), [50, 90])
    low, middle, high = np.percentile(error, [5, 50, 95])
    p50_current, p90_current = np.percentile(current, [50, 90])
    return HoldStatistics(
        median_deg=float(median),
        p90_deg=float(p90),
        max_deg=float(np.abs(error).max()),
        signed_deg=(float(low), float(middle), float(high)),
        current=(float(p50_current), float(p90_current)),
    )


def law_of(plant: PlantConfig) -> Law:
    """``integral`` if any board has an integral part."""
    return "integral" if any(drive.ki for drive in plant.actuators) else "pd"


def measure(
    robot: RobotConfig,
    plant: PlantConfig,
    calibration: Calibration,
    seed: int,
    *,
    workers: Workers = -1,
    progress: Progress | None = None,
) -> BenchResult:
    """Tables and holds of a plant on the bench.

    Args:
        robot: The robot.
        plant: Its parameters.
        calibration: Which velocities and torques, and the protocols.
        seed: Of goals and noise in the holds.
        workers: Processes, -1 for one per core; or a cluster.
        progress: Called with the fraction done, 0..1.
    """
    # Simulated time decides how long each part takes.
    recordings, ramps, holds = calibration.recordings, calibration.settings.ramps, calibration.holds
    cells = {name: len(t.torque) * len(t.moving) / 2 for name, t in recordings.tables.items()}
    weights = [n * (ramps.arrival_time + ramps.wait + ramps.time) for n in cells.values()]
    weights.append(holds.count * holds.period)
    done = 0.0

    def report_progress(part: int, of: int) -> None:
        if progress is not None:
            progress((done + weight * part / of) / sum(weights))

    tables = {}
    for (name, table), weight in zip(recordings.tables.items(), weights[:-1], strict=True):
        tables[name] = ramp_errors(
            robot,
            plant,
            name,
            table.moving,
            table.torque,
            ramps,
            workers=workers,
            progress=report_progress,
        )
        done += weight
    weight = weights[-1]
    held = hold_errors(robot, plant, holds, seed, workers=workers, progress=report_progress)
    return BenchResult(tables=tables, holds=held)


def check_chases(
    robot: RobotConfig,
    plant: PlantConfig,
    calibration: Calibration,
    *,
    models: ModelSet | None = None,
    workers: Workers = -1,
    progress: Progress | None = None,
) -> ChaseReport:
    """Measure a plant under the commands as recorded; arguments as for :func:`measure`.

    ``models`` are those of the observer. None is for the shipped ones of ``nominal``, which know nothing of this robot,
    and for the observer AS_COUNTED: as on the real robot.
    """
    settings, real = calibration.settings, calibration.recordings.chases

    def part(begin: float, end: float) -> Callable[[int, int], None]:
        def report_progress(done: int, of: int) -> None:
            if progress is not None:
                progress(begin + (end - begin) * done / of)

        return report_progress

    runs = play_chases(
        robot,
        plant,
        settings.chases,
        calibration.seed,
        workers=workers,
        progress=part(0.0, PLAYED),
    )
    loads = gravity_at_goals(robot, plant, runs)
    parts = None
    if models is None:
        parts = AS_COUNTED
        nominal = load_plant("nominal", robot)
        identity = RobotIdentity(name=nominal.name, identity=plant_hash(nominal, robot))
        models = load_shipped("fusion", [identity])
    return ChaseReport(
        figures={
            joint: chase_figures(robot, joint, runs, loads, real.stiffness[joint])
            for joint in settings.chases.joints
        },
        false_contacts=false_contacts(
            robot,
            runs,
            models,
            plant.response_delay,
            parts=parts,
            workers=workers,
            progress=part(PLAYED, 1.0),
        ),
        identified_on=str(models.identity),
        real=real,
        settings=settings,
    )


def check(
    robot: RobotConfig,
    plant: PlantConfig,
    calibration: Calibration,
    *,
    models: ModelSet | None = None,
    workers: Workers = -1,
    progress: Progress | None = None,
) -> CalibrationReport:
    """Measure a plant and compare it with the recordings; arguments as for :func:`check_chases`."""

    def part(begin: float, end: float) -> Progress:
        def report_progress(fraction: float) -> None:
            if progress is not None:
                progress(begin + (end - begin) * fraction)

        return report_progress

    speed = real_time_factor(robot, plant)  # first, while nothing else runs
    integration = integration_error(robot, plant)
    measured = measure(
        robot,
        plant,
        calibration,
        calibration.seed,
        workers=workers,
        progress=part(0.0, MEASURED),
    )
    chases = check_chases(
        robot, plant, calibration, models=models, workers=workers, progress=part(MEASURED, 1.0)
    )
    return CalibrationReport(
        plant=plant.name,
        law=law_of(plant),
        measured=measured,
        chases=chases,
        reference_error=integration,
        real_time_factor=speed,
        calibration=calibration,
    )
