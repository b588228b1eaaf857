"""``pepper demo``: the main job on the simulated robot."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from pepper_driver.cli.console import (
    JsonOption,
    ModelsOption,
    RealTimeOption,
    ViewOption,
    check_outputs,
    make_console,
    make_progress,
    save_json,
    show_line,
    show_timing,
    shown_in_browser,
)
from pepper_driver.cli.identify import identify_with_progress, print_fits
from pepper_driver.config import MissingExtraError, load_experiment, load_robot
from pepper_driver.config.file_lock import lock_folder
from pepper_driver.experiments.demo import (
    CONTACTS_NAME,
    FIGURE_NAME,
    LOG_NAME,
    DemoResult,
    demo_experiment,
    run_demo,
)
from pepper_driver.experiments.plan import experiment_uri
from pepper_driver.log import read_log
from pepper_driver.log.plots import plot_contacts
from pepper_driver.observer import RELEASE_GRACE, Contact, KnownPush


def demo(
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for the log, the contacts and the figure.")
    ] = Path("runs/demo"),
    experiment: Annotated[
        str, typer.Option(metavar="NAME_OR_FILE", help="Steps and contacts.")
    ] = "demo",
    seconds: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Time of the random goals: whole periods, which are 8 s; 48 s by default.",
            min=8.0,
            max=3600.0,
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Seed of motion, pushes and noise; by default that of the experiment.",
            min=0,
        ),
    ] = None,
    models: ModelsOption = None,
    fresh: Annotated[
        bool,
        typer.Option("--identify", help="Identify the models first; with --models, keep them."),
    ] = False,
    show: Annotated[
        bool, typer.Option("--show", help="Show the robot in a window, in real time.")
    ] = False,
    real_time: RealTimeOption = False,
    view: ViewOption = False,
    json_file: JsonOption = None,
) -> None:
    """Move a simulated Pepper's arms, push them, and print each contact that is detected."""
    console = make_console()
    check_outputs(json_file)
    robot = load_robot()
    chosen = demo_experiment(experiment, robot)
    joints = chosen.touched_joints
    with lock_folder(out), TemporaryDirectory() as folder:
        if fresh:
            models = models or Path(folder) / "models.json"
            check_outputs(models)
            result = identify_with_progress(
                console,
                experiment_uri("mujoco", chosen),
                joints,
                load_experiment("identify", robot),
                "fusion",
                seed=seed,
            )
            print_fits(console, result)
            result.models.save(models)
        with make_progress(console, lines=False) as progress:
            bar = progress.add_task("simulating", total=1.0)
            result_demo = run_demo(
                out,
                experiment=experiment,
                seconds=seconds,
                seed=seed,
                models=models,
                show=show,
                real_time=real_time,
                view=partial(shown_in_browser, console) if view else None,
                on_contact=lambda contact, pushes: show_line(
                    console, describe_contact(contact, pushes)
                ),
                on_progress=lambda done: progress.update(bar, completed=done),
            )
        _table(result_demo, console)
        if real_time or show or view:
            show_timing(console, result_demo.timing)
        console.print(f"results in {out}: {LOG_NAME}, {CONTACTS_NAME}")
        save_json(json_file, result_demo.summary, console)
        _figure(out, joints, console)


def describe_contact(contact: Contact, pushes: tuple[KnownPush, ...]) -> str:
    """Describe a settled contact; the delay is from the onset of the true push on its limb to the detection."""
    side, time = "+" if contact.direction > 0 else "-", contact.detection_time
    text = (
        f"{time:7.2f} s  {contact.kind:9s} {contact.joint or 'trunk':14s} {contact.link:10s} "
        f"direction {side}  intensity {_intensity(contact):>8s}"
    )
    for push in pushes:
        on_limb = contact.joint == push.joint or contact.joint in push.torques
        if on_limb and push.onset <= time <= push.release + RELEASE_GRACE:
            return f"{text}  {1e3 * (time - push.onset):4.0f} ms after the true onset"
    return text


def _intensity(contact: Contact) -> str:
    """Return the intensity of a contact on a joint; trunk and base have none in degrees."""
    return "-" if contact.joint is None else f"{contact.intensity_deg:.1f} deg"


def _figure(out: Path, joints: Sequence[str], console: Console) -> None:
    """Draw the figure as in Fig. 3 of the paper, or print what is missing for it."""
    try:
        plot_contacts(read_log(out / LOG_NAME), out / FIGURE_NAME, joints=joints)
        console.print(f"figure: {out / FIGURE_NAME}")
    except MissingExtraError as error:
        console.print(f"no figure: {error}")


def _table(result: DemoResult, console: Console) -> None:
    summary = result.summary
    table = Table(
        title=f"{result.simulated_seconds:.1f} s in simulation, {result.uri}", title_justify="left"
    )
    counts = ("pushes", "detected", "missed", "false", "rebounds", "saturated")
    for name in counts:
        table.add_column(name, justify="right", no_wrap=True)
    for name, width in (("right sign", 7), ("median delay", 6)):  # in all 80 columns
        table.add_column(name, justify="right", width=width)
    median = summary["delay_ms"]["median"]
    table.add_row(
        *(str(summary[name]) for name in counts),
        f"{summary['direction_right']}/{summary['detected']}",
        "-" if median is None else f"{median:.0f} ms",
    )
    console.print(table)
    for push in result.score.missed:
        console.print(
            f"missed: {push.joint} at {push.onset:.2f} s, {push.degrees:.1f} equivalent degrees"
        )
    for contact in result.score.false:
        console.print(
            f"false: {contact.joint or 'trunk'} at {contact.time:.2f} s, intensity {_intensity(contact)}"
        )
