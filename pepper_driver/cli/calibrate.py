"""``pepper calibrate``: parameters of the simulated robot from recordings of real ones, and how near it comes."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from pepper_driver.calibration.as_recorded import JUDGED, ChaseReport
from pepper_driver.calibration.calibrate import CalibrationMetric, CalibrationReport, Law, check
from pepper_driver.calibration.drive import plant_text
from pepper_driver.calibration.fit import Fitted, fit_integral, fit_pd
from pepper_driver.calibration.plot import plot_calibration
from pepper_driver.cli.calibrate_robot import calibrate_robot, robot_plant_text
from pepper_driver.cli.console import (
    ClusterOption,
    JsonOption,
    WorkersOption,
    check_outputs,
    chosen_workers,
    make_console,
    make_progress,
    save_json,
)
from pepper_driver.config import (
    Calibration,
    ConfigError,
    PlantConfig,
    RobotConfig,
    draws,
    load_calibration,
    load_plant,
    load_robot,
    plant_names,
)
from pepper_driver.config.files import write_text
from pepper_driver.config.workers import Workers
from pepper_driver.figure_style import check_picture
from pepper_driver.observer import ModelSet

LABELS = {
    "residual": "residual deg",
    "median": "hold median deg",
    "p90": "hold p90 deg",
    "current median": "hold median A",
    "current p90": "hold p90 A",
}
CHASE_LABELS = {
    "median_deg": "hold median deg",
    "p90_deg": "hold p90 deg",
    "max_deg": "hold max deg",
    "short": "ends short",
    "beyond": "ends beyond",
    "r2_side": "R2 by side",
    "r2_gravity": "R2 by gravity",
    "r2_current": "R2 by current",
    "droop_deg": "droop deg/(N m)",
    "gravity_torque": "motor/gravity",
    "without_current": "no current",
    "current_median": "hold median A",
    "current_p90": "hold p90 A",
    "current_onset_ms": "to current ms",
    "encoder_onset_ms": "to encoder ms",
    "creep": "current creeps",
    "encoder_noise_mdeg": "encoder mdeg",
    "current_noise_ma": "current mA",
    "rms_deg": "moving rms deg",
    "chase_speed": "far p50 rad/s",
    "chase_speed_p90": "far p90 rad/s",
    "max_speed": "fastest rad/s",
}
"""Rows of the commands as recorded; see :class:`~.config.recordings.ChaseResults`."""

START = {"pd": "nominal", "integral": "integral"}
"""Plant that a fit of each law starts from."""


def calibrate(
    recordings: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="Fit a plant to one robot instead: bundle of 'pepper first-hour', or folder of 'pepper identify"
            " --recordings'.",
        ),
    ] = None,
    law: Annotated[
        Law, typer.Option("--control-law", help="Control law of the boards to fit.")
    ] = "pd",
    plant: Annotated[
        str | None,
        typer.Option(
            metavar="NAME_OR_FILE",
            help="Plant to check, or that says what is not fitted; by default the shipped one of the law.",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Plant file to write, name.yaml.")
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Also draw real and simulated figures: PNG, SVG or PDF by its ending.",
        ),
    ] = None,
    json_file: JsonOption = None,
    models: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Models by which false contacts are counted; by default those of 'nominal', which know nothing of"
            " the plant.",
        ),
    ] = None,
    only_check: Annotated[
        bool, typer.Option("--check", help="Measure the plant as it is, fit nothing.")
    ] = False,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
) -> None:
    """Fit the simulated robot to recordings of real ones, or check how near it comes. No robot is moved."""
    console = make_console()
    if recordings is not None:
        for option, given in (
            ("--check", only_check),
            ("--plot", plot is not None),
            ("--models", models is not None),
        ):
            if given:
                raise ConfigError(
                    f"{option} and --recordings exclude each other: it is about config/recordings.yaml"
                )
    if only_check and out is not None:
        raise ConfigError("--check fits nothing, so there is no plant for --out to write")
    if out is not None and out.suffix not in (".yaml", ".yml"):
        raise ConfigError(f"{out}: a plant file ends in .yaml")
    if plot is not None:
        check_picture(plot)
    check_outputs(out, plot, json_file)
    robot = load_robot()
    calibration = load_calibration(robot)
    own = None if models is None else _load_models(models, robot)
    name = plant or START[law]
    start = load_plant(name, robot)
    for drive in start.actuators:
        if not only_check and drive.friction.contact.motor + drive.friction.contact.link == 0.0:
            raise ConfigError(
                f"{start.source}: {', '.join(drive.joints)} have no friction that could be fitted; give them some"
            )
    if not only_check and draws(name, robot):
        raise ConfigError(
            f"{start.source}: each robot of this plant is drawn again; fit one that stays"
        )
    if out is not None and out.resolve() == Path(start.source).resolve():
        raise ConfigError(f"{out}: this is the plant to begin from; choose another file for --out")
    if law == "integral" and not only_check and not any(d.ki for d in start.actuators):
        raise ConfigError(f"{start.source}: no board has an integral part to fit")
    if recordings is not None:
        with chosen_workers(workers, cluster, console) as pool:
            named = out.stem if out else f"{start.name}, fitted"
            found = calibrate_robot(console, recordings, start, robot, named, pool)
        if out is not None:
            write_text(out, robot_plant_text(found, start, _extends(name)))
            console.print(f"plant: {out}")
        save_json(json_file, found.as_json(), console)
        return
    tested = start
    fitted: Fitted | None = None
    with chosen_workers(workers, cluster, console) as pool:
        if not only_check:
            fitted = _fit(console, law, robot, start, calibration, pool)
            tested = replace(fitted.plant, name=out.stem if out else f"{start.name}, fitted")
            _print_fit(console, fitted)
            if out is not None:
                write_text(out, _text(name, start, fitted, out))
                console.print(f"plant: {out}")
        with make_progress(console) as progress:
            bar = progress.add_task("measuring", total=1.0)
            report = check(
                robot,
                tested,
                calibration,
                models=own,
                workers=pool,
                progress=lambda fraction: progress.update(bar, completed=fraction),
            )
    _print_report(console, report)
    content = report.as_json() | ({"fit": fitted.as_json()} if fitted else {})
    save_json(json_file, content, console)
    if plot is not None:
        plot_calibration(report, plot)
        console.print(f"figure: {plot}")


def _load_models(file: Path, robot: RobotConfig) -> ModelSet:
    """Read models of kind ``fusion``."""
    models = ModelSet.load(file, robot)
    if models.kind != "fusion":
        raise ConfigError(
            f"{file}: models of kind {models.kind}; false contacts are counted with kind fusion"
        )
    return models


def _fit(
    console: Console,
    law: Law,
    robot: RobotConfig,
    start: PlantConfig,
    calibration: Calibration,
    workers: Workers,
) -> Fitted:
    fit = fit_pd if law == "pd" else fit_integral
    with make_progress(console) as progress:
        bar = progress.add_task("fitting", total=1.0)
        return fit(
            robot,
            start,
            calibration,
            workers=workers,
            progress=lambda fraction: progress.update(bar, completed=fraction),
        )


def _text(name: str, start: PlantConfig, fitted: Fitted, out: Path) -> str:
    return plant_text(
        start,
        fitted.plant,
        name=out.stem,
        extends=_extends(name),
        comment="Fitted by `pepper calibrate` to config/recordings.yaml, in simulation; see docs/plant.md.",
    )


def _extends(name: str) -> str:
    """Return how a plant file names the plant that it extends."""
    return name if name in plant_names() else str(Path(name).resolve())


def _print_fit(console: Console, fitted: Fitted) -> None:
    table = Table(title=f"fitted; {fitted.delay} ticks of transport", title_justify="left")
    for name in ("joint", "K N m/rad", "F N m", "dead band deg", "Ti s", "room"):
        table.add_column(name, justify="left" if name == "joint" else "right")
    for joint, row in fitted.as_json()["joints"].items():
        table.add_row(
            joint,
            f"{row['stiffness']:.4g}",
            f"{row['friction']:.3g}",
            f"{row['dead_band_deg']:.2f}",
            "-" if row["integral_time"] is None else f"{row['integral_time']:.3g}",
            f"{row['room']:.1f}",
        )
    console.print(table)
    console.print("room: standard deviations to the nearest target, on the goals of the fit")


def _print_report(console: Console, report: CalibrationReport) -> None:
    table = Table(
        title=f"plant {report.plant} ({report.law}) compared with recordings of real Peppers, in simulation",
        title_justify="left",
    )
    for name in ("joint", "metric", "real", "sim", "factor", "target", ""):
        table.add_column(name, justify="left" if name in ("joint", "metric", "") else "right")
    for metric in report.metrics:
        table.add_row(*_row(metric))
    console.print(table)
    console.print(
        "target: largest residual, or largest factor between simulated and real either way"
    )
    _print_chases(console, report.chases)
    console.print(
        f"integration error {1e3 * report.reference_error:.2f} mrad; "
        f"{report.real_time_factor:.1f} times real time on one core, without controller"
    )


def _print_chases(console: Console, report: ChaseReport) -> None:
    """Print every result under the commands as recorded with the real one in brackets, and what was judged."""
    table = Table(
        title="commands as recorded: simulated (real)",
        title_justify="left",
        box=None,
        pad_edge=False,
    )
    table.add_column("")
    for joint in report.figures:
        # In two lines: six columns in the width of a terminal.
        table.add_column(re.sub(r"(?<=[a-z])(?=[A-Z][a-z]+$)", "\n", joint), justify="right")
    for name, label in CHASE_LABELS.items():
        pairs = [
            (getattr(found, name), getattr(report.real.figures[joint], name))
            for joint, found in report.figures.items()
        ]
        table.add_row(label, *(f"{_shown(found)} ({_shown(real)})" for found, real in pairs))
    console.print(table)
    missed = [f"{cell.joint} {cell.quantity}" for cell in report.cells if not cell.passed]
    console.print(
        f"{len(report.cells) - len(missed)} of {len(report.cells)} judged cells hold ({', '.join(JUDGED)})"
        + (f"; missed: {', '.join(missed)}" if missed else "")
    )
    contacts = report.false_contacts
    joints = ", ".join(f"{joint} {count}" for joint, count in sorted(contacts.by_joint.items()))
    console.print(
        f"false contacts with models identified on {report.identified_on}: {contacts.count} in "
        f"{contacts.minutes:.1f} min, {contacts.per_hour:.0f} an hour: {joints or 'none'}; the joints were blind for "
        f"{100.0 * contacts.blind:.0f} % of the time"
    )


def _shown(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if abs(value) < 10.0 else f"{value:.0f}"


def _row(metric: CalibrationMetric) -> list[str]:
    target = "-"
    if metric.limit is not None:
        target = f"<= {metric.limit:.2f}" if metric.real is None else f"x/ {metric.limit:g}"
    word = {True: "pass", False: "MISS", None: ""}[metric.passed]
    return [
        metric.joint,
        LABELS[metric.quantity],
        "-" if metric.real is None else f"{metric.real:.2f}",
        f"{metric.simulated:.3f}",
        "-" if metric.factor is None else f"{metric.factor:.2f}",
        target,
        word,
    ]
