"""``pepper identify``: drive joints in free motion, and fit their models."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from pepper_driver.backends import make_backend
from pepper_driver.cli.console import (
    ClusterOption,
    JsonOption,
    LineProgress,
    WorkersOption,
    check_outputs,
    chosen_workers,
    duration_text,
    finite,
    make_console,
    make_progress,
    save_json,
    show_line,
)
from pepper_driver.config import (
    ConfigError,
    Experiment,
    PepperError,
    load_experiment,
    load_robot,
)
from pepper_driver.config.population import parse_draws
from pepper_driver.identification import (
    MANIFEST,
    BlindModelError,
    Confirm,
    Identification,
    IdentificationRun,
    IdentifiedRobot,
    Progress,
    RecordingFolderError,
    RobotProgress,
    chosen_joints,
    finished,
    fit_folder,
    identify_joints,
    identify_population,
    read_manifest,
    record_joints,
)
from pepper_driver.identification.dataset import recording_path
from pepper_driver.identification.measurements.friction import HeldWeight
from pepper_driver.identification.measurements.program import Hand, held_weight
from pepper_driver.identification.sensitivity import PLACES, POSTURE
from pepper_driver.observer import ModelKind
from pepper_driver.observer.models.measured_robot import MeasuredRobot


def print_fits(console: Console, result: Identification) -> None:
    """Print the prediction error of each model, of the other tree and of the closed form, and the warnings."""
    table = Table(title="fit of the tracking error, NRMSE %", title_justify="left")
    for name in ("joint", "model", "estimation", "test"):
        table.add_column(name, justify="right" if name in ("estimation", "test") else "left")
    for joint in result.recorded:
        for method, fits in result.fits.items():
            fit = fits[joint]
            table.add_row(joint, method, f"{fit.estimation:.1f}", f"{fit.test:.1f}")
    console.print(table)
    mirrored = [joint for joint in result.models.models if joint not in result.recorded]
    if mirrored:
        console.print(f"fitted to mirrored recordings: {', '.join(mirrored)}")
    print_measured(console, result.models.measured)
    _print_sensitivities(console, result)
    _print_shared(console, result)
    for finding in (*result.findings, *result.blind):
        where = ", ".join(name for name in (finding.joint, finding.run) if name is not None)
        console.print(f"warning: {where}: {finding.text}")
    runs = sorted({finding.run for finding in result.findings if finding.run is not None})
    if runs:
        console.print(
            f"to record such a run again, delete its file ({', '.join(runs)}) and give the same command"
        )


def print_measured(console: Console, measured: MeasuredRobot | None) -> None:
    """Print the facts that were measured of the robot."""
    if measured is None:
        return
    earliest, latest = measured.delay_spread
    console.print(
        f"the robot answers {measured.response_delay} ticks after a command ({measured.reported_delay} reported; "
        f"single steps {measured.reported_delay + earliest:.0f} to {measured.reported_delay + latest:.0f}); "
        f"{measured.late:.1%} of the samples late, {measured.lost:.1%} lost"
    )
    table = Table(title="measured, torques by documented motors", title_justify="left")
    columns = [
        "joint",
        "noise deg",
        "noise A",
        "dead band deg",
        "friction N m",
        "torque/load",
        "rad/s",
    ]
    if measured.weight is not None:
        columns.append(f"torque/{measured.weight:g} kg")
    for name in columns:
        table.add_column(name, justify="left" if name == "joint" else "right")
    for joint, one in measured.joints.items():
        table.add_row(
            joint,
            "-" if one.encoder_noise is None else f"{math.degrees(one.encoder_noise):.3f}",
            "-" if one.current_noise is None else f"{one.current_noise:.3f}",
            "-" if one.dead_band is None else f"{math.degrees(one.dead_band):.2f}",
            "-" if one.friction is None else f"{one.friction:.3g}",
            "-" if one.load_scale is None else f"{one.load_scale:.2f}",
            "-" if one.speed is None else f"{'' if one.speed_limited else '>= '}{one.speed:.2f}",
            *(
                ["-" if one.torque_scale is None else f"{one.torque_scale:.2f}"]
                if measured.weight
                else []
            ),
        )
    console.print(table)


def _print_sensitivities(console: Console, result: Identification) -> None:
    """Print the thresholds from free motion; of models that know the stiffness also as torque and forces."""
    if not result.sensitivities:
        bounds = ", ".join(
            f"{joint} {math.degrees(result.models.threshold[joint]):.2f}"
            for joint in result.recorded
        )
        console.print(f"thresholds from free motion, degrees: {bounds}")
        return
    table = Table(title="touch that a joint detects, in free motion", title_justify="left")
    places = list(PLACES)
    for name in ("joint", "deg", "largest deg", "N m", *(f"N at the {place}" for place in places)):
        table.add_column(name, justify="left" if name == "joint" else "right")
    for joint, one in result.sensitivities.items():
        forces = (f"{one.forces[place]:.0f}" if place in one.forces else "-" for place in places)
        table.add_row(
            joint,
            f"{math.degrees(one.threshold):.2f}",
            f"{math.degrees(result.models.threshold[joint]):.2f}",
            f"{one.torque:.2f}",
            *forces,
        )
    console.print(table)
    console.print(
        f"deg, N m: median threshold in motion that lasts; N: force across the lever that reaches it in the posture "
        f"{POSTURE}; friction may hide more of a joint that rests"
    )


def _print_shared(console: Console, result: Identification) -> None:
    if not result.shared:
        return
    table = Table(title="what shared models cost, test fit in NRMSE %", title_justify="left")
    for name in ("joint", "model of", "shared", "own", "loss"):
        table.add_column(name, justify="left" if name in ("joint", "model of") else "right")
    for fit in result.shared:
        own, loss = "-", "-"
        if fit.own is not None and fit.loss is not None:
            own, loss = f"{fit.own:.1f}", f"{fit.loss:.1f}"
        table.add_row(
            fit.joint,
            fit.source,
            f"{fit.shared:.1f}",
            own,
            f"at most {loss}" if fit.halves and fit.loss is not None else loss,
        )
    console.print(table)
    if any(fit.halves for fit in result.shared):
        console.print("'at most': the own model was fitted to the other half of the test run")


BACKEND, EXPERIMENT, CALIBRATION = "mujoco", "identify", "calibration_motion"
NO_CALIBRATION = "none"


def identify(
    out: Annotated[
        Path,
        typer.Option(
            metavar="FILE", help="Model file to write; with --draws, the folder for them."
        ),
    ],
    backend: Annotated[
        str | None, typer.Option(metavar="URI", help=f"Robot to drive; {BACKEND} by default.")
    ] = None,
    joints: Annotated[
        str | None,
        typer.Option(
            metavar="A,B",
            help="Joints to identify, with commas between; by default those of the experiment.",
        ),
    ] = None,
    kind: Annotated[
        ModelKind,
        typer.Option(
            "--model-type", help="Type of the models; affine and cart are the paper's trees."
        ),
    ] = "fusion",
    mirror: Annotated[
        bool,
        typer.Option(
            "--mirror/--no-mirror",
            help="Models of the other side from mirrored recordings, or record both sides.",
        ),
    ] = True,
    share_types: Annotated[
        bool,
        typer.Option(
            "--share-types",
            help="One model per motor type, from its first joint; a test run of the others shows what that costs.",
        ),
    ] = False,
    recordings: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Where recordings are kept, and continued after an interruption; by default next to FILE.",
        ),
    ] = None,
    fit_only: Annotated[
        bool, typer.Option("--fit-only", help="Fit the recordings in DIR again, without a robot.")
    ] = False,
    draws: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="Draws of a simulated plant to identify, such as 0-19 or 0,3,7-9, a file each; by default one robot.",
        ),
    ] = None,
    measure: Annotated[
        bool,
        typer.Option(
            "--measure/--no-measure",
            help="Measure the robot before its models: delay, noise, friction, scale of torques, speed; "
            "with --draws only if there is a --weight.",
        ),
    ] = True,
    weight: Annotated[
        float | None,
        typer.Option(
            metavar="KG",
            help="Known weight, such as 0.5, that you hang into a hand when asked: it fixes the scale of torques.",
            callback=finite,
        ),
    ] = None,
    hand: Annotated[Hand, typer.Option(help="Hand that carries the weight.")] = "left",
    accept_blind: Annotated[
        bool,
        typer.Option(
            "--accept-blind", help="Write models also where joints notice hardly any touch."
        ),
    ] = False,
    yes: Annotated[
        bool,
        typer.Option(
            "--yes",
            help="Do not ask before a real robot moves its legs or its base, or its arms fast; not with --weight.",
        ),
    ] = False,
    seed: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Seed of the random motion; by default that of the experiment.",
            min=0,
        ),
    ] = None,
    experiment: Annotated[
        str | None,
        typer.Option(
            metavar="NAME_OR_FILE", help=f"The motion, of kind sweeps; {EXPERIMENT} by default."
        ),
    ] = None,
    calibration: Annotated[
        str | None,
        typer.Option(
            metavar="NAME_OR_FILE",
            help=f"Free motion to choose thresholds on, or {NO_CALIBRATION}; {CALIBRATION} by default.",
        ),
    ] = None,
    workers: WorkersOption = None,
    cluster: ClusterOption = None,
    json_file: JsonOption = None,
) -> int:
    """Drive joints in free motion, fit an expected-error model to each, write the model file."""
    console = make_console()
    check_outputs(None if draws is not None else out, json_file)
    folder = out.with_name(f"{out.stem}-recordings") if recordings is None else recordings
    if fit_only:
        _refuse_with(
            "fit-only",
            "all is as it was recorded",
            backend=backend,
            joints=joints,
            seed=seed,
            experiment=experiment,
            calibration=calibration,
            draws=draws,
            weight=weight,
        )
    else:
        robot = load_robot()
        chosen = load_experiment(experiment or EXPERIMENT, robot)
        named = None if joints is None else [name.strip() for name in joints.split(",")]
        full, tested = chosen_joints(robot, chosen, named, mirror=mirror, share_types=share_types)
        name = calibration or CALIBRATION
        body = None if name == NO_CALIBRATION else load_experiment(name, robot)
    held = None if weight is None else held_weight(weight, hand)
    if held is not None and not measure:
        raise ConfigError("option '--weight': it is for the measurement; leave '--no-measure' out")
    if yes:
        refuse_unattended(backend or BACKEND, held)
    if draws is not None:
        _refuse_with("draws", "each robot has a folder of its own", recordings=recordings)
        numbers = parse_draws(draws)
        with (
            chosen_workers(workers, cluster, console) as pool,
            _robots(console, len(numbers), out) as progress,
        ):
            robots = identify_population(
                backend or BACKEND,
                numbers,
                chosen,
                kind,
                out,
                joints=named,
                calibration=body,
                weight=held,
                seed=chosen.seed if seed is None else seed,
                mirror=mirror,
                share_types=share_types,
                workers=pool,
                progress=progress,
            )
        print_population(console, robots, kind)
        console.print(f"models: {out}")
        save_json(json_file, population_json(robots), console)
        return 1 if any(one.state == "failed" for one in robots) else 0
    with chosen_workers(workers, cluster, console) as pool:
        if not fit_only:
            with _resumable(folder, console), _progress(console) as (progress, confirm):
                record_joints(
                    backend or BACKEND,
                    full,
                    chosen,
                    folder,
                    tested=tested,
                    calibration=body,
                    measure=measure,
                    weight=held,
                    seed=chosen.seed if seed is None else seed,
                    workers=pool,
                    confirm=None if yes else confirm,
                    on_touch=lambda run, sensor: show_line(
                        console,
                        f"{sensor} is pressed in run {run.name}: if a person touches the robot, delete "
                        f"{recording_path(folder, run.name)} afterwards, and call again",
                    ),
                    progress=progress,
                )
        read_manifest(folder)  # where it is missing, that is the one line
        if not console.is_terminal:  # where a status shows nothing
            console.print("fitting models")
        with console.status("fitting models"):
            result = fit_folder(folder, kind, mirror=mirror, share_types=share_types, workers=pool)
    print_fits(console, result)
    save_json(json_file, result.as_json(), console)
    if not accept_blind:
        again = f"pepper identify --fit-only --recordings {folder} --out {out} --accept-blind"
        again += "" if mirror else " --no-mirror"
        again += " --share-types" if share_types else ""
        _refuse_blind(result, again)
    result.models.save(out)
    console.print(f"models: {out}; recordings: {folder}")
    return 0


def _refuse_blind(result: Identification, again: str) -> None:
    """Refuse models with blind joints, and say by which command to have them all the same."""
    try:
        result.refuse_blind()
    except BlindModelError as error:
        raise BlindModelError(
            f"{error}. Nothing is written; to write them all the same: {again}"
        ) from error


def identify_with_progress(
    console: Console,
    backend: str,
    joints: Sequence[str],
    experiment: Experiment,
    kind: ModelKind,
    *,
    seed: int | None,
) -> Identification:
    """Identify under a progress bar and keep no recordings; ``seed`` None is the experiment's."""
    with _progress(console) as (progress, _):
        return identify_joints(
            backend,
            joints,
            experiment,
            kind,
            seed=experiment.seed if seed is None else seed,
            progress=progress,
        )


def print_population(console: Console, robots: Sequence[IdentifiedRobot], kind: ModelKind) -> None:
    """Print what became of each robot, why some failed, and a line that counts them."""
    table = Table(title="robots, test fit in NRMSE %", title_justify="left")
    for name in ("robot", "", "median", "worst", "joint", "warnings"):
        table.add_column(
            name, justify="right" if name in ("median", "worst", "warnings") else "left"
        )
    for one in robots:
        if one.file is None:
            table.add_row(one.name, one.state, "-", "-", "-", "-")
            continue
        fits = {joint: fit["test"] for joint, fit in one.report["fit"][kind].items()}
        worst = min(fits, key=lambda joint: fits[joint])
        middle, least = f"{median(fits.values()):.1f}", f"{fits[worst]:.1f}"
        warnings = str(len(one.warnings))
        table.add_row(one.name, one.state, middle, least, worst, warnings)
    console.print(table)
    for one in robots:
        for warning in one.warnings:
            console.print(f"warning: {one.name}: {warning}")
    failed = [one for one in robots if one.state == "failed"]
    for one in failed:
        console.print(f"failed: {one.name}: {one.reason}")
    kept = sum(one.state == "kept" for one in robots)
    counted = f"{len(robots) - len(failed)} of {len(robots)} robots identified"
    if kept:
        counted += f", {kept} of them earlier"
    warned = sum(bool(one.warnings) for one in robots)
    if warned:
        counted += f"; {warned} with warnings"
    if failed:
        counted += f"; {len(failed)} failed: {', '.join(one.name for one in failed)}"
    console.print(counted)


def population_json(robots: Sequence[IdentifiedRobot]) -> dict[str, Any]:
    """``robots.<draw>.{name,state,file,reason,...}`` with what a single robot has, and ``identified``, ``failed``."""
    failed = sum(one.state == "failed" for one in robots)
    return {
        "identified": len(robots) - failed,
        "failed": failed,
        "robots": {
            str(one.draw): {
                "name": one.name,
                "state": one.state,
                "file": None if one.file is None else str(one.file),
                "reason": one.reason,
                **one.report,
            }
            for one in robots
        },
    }


@contextmanager
def _robots(console: Console, total: int, folder: Path) -> Iterator[RobotProgress]:
    """Yield a bar over the robots; print how to continue when it is interrupted."""
    before = ended = 0
    with make_progress(console, count=True) as bars:
        bar = bars.add_task("identifying robots", total=total, before=0)

        def report_progress(one: IdentifiedRobot, done: int, total: int) -> None:
            nonlocal before, ended
            before, ended = before + (one.state == "kept"), done
            what = f"identifying robots: {one.name} {one.state}"
            bars.update(bar, description=what, completed=done, total=total, before=before)

        try:
            yield report_progress
        except KeyboardInterrupt:
            console.print(
                f"{ended} of {total} robots are done; the same command continues with what is kept in {folder}"
            )
            raise


def refuse_unattended(backend: str, weight: HeldWeight | None) -> None:
    """Refuse to ask no person on a real robot that is measured with a weight.

    Raises:
        ConfigError: It is so.
    """
    if weight is not None and make_backend(backend).real_time:
        raise ConfigError(
            "option '--yes': a person hangs the weight into the hand and takes it out again, and must be asked; leave "
            "'--yes' or '--weight' out"
        )


def _refuse_with(option: str, why: str, **options: object) -> None:
    given = [name for name, value in options.items() if value is not None]
    if given:
        raise ConfigError(f"option '--{given[0]}': with '--{option}' {why}; leave it out")


@contextmanager
def recording_progress(console: Console) -> Iterator[tuple[Progress, LineProgress]]:
    """Yield what shows the progress of runs, and its bar."""
    with make_progress(console) as bars:
        bar = None
        begun = ""

        def report_progress(what: str, done: float, total: float) -> None:
            nonlocal bar, begun
            if bar is None or (what == "dry run") != (begun == "dry run"):
                if bar is None:
                    console.print(f"runs of {duration_text(total - done)} in robot time to record")
                else:
                    bars.remove_task(bar)
                bar = bars.add_task(what, total=total, completed=round(done), before=done)
            begun = what
            bars.update(bar, description=what, completed=done, total=total)

        yield report_progress, bars


@contextmanager
def _progress(console: Console) -> Iterator[tuple[Progress, Confirm]]:
    """Yield a bar over the time of the runs, and a question that makes room for itself."""
    with recording_progress(console) as (report_progress, bars):

        def confirm(run: IdentificationRun) -> None:
            bars.stop()
            typer.confirm(
                f"Next: {run.name}, {run.seconds:.0f} s: {run.watched}. Is the robot on level floor, with two metres "
                "of clear space, and a hand at the emergency stop?",
                abort=True,
            )
            bars.start()

        yield report_progress, confirm


@contextmanager
def _resumable(folder: Path, console: Console) -> Iterator[None]:
    """Print what is kept, and how to continue, at any end of the recording."""
    try:
        yield
    except RecordingFolderError:
        raise  # not the recordings this command asks for
    except (KeyboardInterrupt, typer.Abort, PepperError):
        if (kept := _kept(folder)) is not None:
            console.print(kept)
        raise


def _kept(folder: Path) -> str | None:
    """Describe in words the recordings of an incomplete set."""
    if not (folder / MANIFEST).exists():
        return None
    names = [run.name for run in read_manifest(folder).runs]
    done = len(finished(folder, names))
    if done == len(names):
        return None
    return (
        f"{done} of {len(names)} runs are kept in {folder}; the same command continues from there"
    )
