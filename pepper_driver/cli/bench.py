"""``pepper bench``: time of each stage of a tick, speed of the simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from pepper_driver.bench import run_bench
from pepper_driver.cli.console import (
    JsonOption,
    check_outputs,
    make_console,
    make_progress,
    save_json,
)
from pepper_driver.soak import run_soak


def bench(
    seconds: Annotated[
        float, typer.Option(help="Simulated time for each plant.", min=2.0, max=600.0)
    ] = 20.0,
    plants: Annotated[
        list[str] | None,
        typer.Option(
            "--plant",
            metavar="NAME|FILE",
            help="Plant to simulate, by default nominal; may be given again.",
        ),
    ] = None,
    soak: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Instead, run the first plant this long in simulated time, moved, pushed and held at random, "
            "and say whether it stays finite and its energy bounded.",
            min=60.0,
        ),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Time the stages of a tick and the simulation, on one core."""
    console = make_console()
    check_outputs(json_file)
    plants = plants or ["nominal"]
    if soak is not None:
        _soak(console, plants[0], soak, json_file)
        return
    with make_progress(console) as progress:
        bar = progress.add_task("measuring", total=1.0)
        result = run_bench(
            seconds,
            plants=plants,
            on_progress=lambda share: progress.update(bar, completed=share),
        )
    table = Table(title="one tick of 12 ms, microseconds", title_justify="left")
    for name in ("stage", "median", "p99"):
        table.add_column(name, justify="left" if name == "stage" else "right")
    for stage, duration in result.stages.items():
        table.add_row(stage, f"{duration.median:.1f}", f"{duration.p99:.1f}")
    table.add_section()
    table.add_row("all but backend", f"{result.tick.median:.1f}", f"{result.tick.p99:.1f}")
    console.print(table)
    for plant, factor in result.real_time_factor.items():
        console.print(
            f"simulation of {plant}: {factor:.1f} times real time with controller, observer and log; "
            f"{result.plant_alone[plant]:.1f} times alone"
        )
    save_json(json_file, result.as_json(), console)


def _soak(console: Console, plant: str, seconds: float, json_file: Path | None) -> None:
    with make_progress(console) as progress:
        bar = progress.add_task("soaking", total=1.0)
        result = run_soak(
            f"mujoco://?plant={plant}",
            seconds,
            on_progress=lambda share: progress.update(bar, completed=share),
        )
    energies = ", ".join(f"{energy:.2f}" for energy in result.largest_energy)
    console.print(
        f"{result.seconds:.0f} s of {plant} at {result.real_time_factor:.1f} times real time: "
        f"{'all finite' if result.finite else 'NOT FINITE'}, {'fell over' if result.fallen else 'stands'}; "
        f"largest kinetic energy by quarter {energies} J; battery {result.charge:.2f}, "
        f"warmest motor {result.hottest:.0f} deg C"
    )
    save_json(json_file, {"soak": result.as_json()}, console)
