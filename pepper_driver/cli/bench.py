"""``pepper bench``: time of each stage of a tick, speed of the simulation."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Table

from pepper_driver.bench import run_bench
from pepper_driver.cli.console import (
    JsonOption,
    check_outputs,
    make_console,
    make_progress,
    save_json,
)


def bench(
    seconds: Annotated[
        float, typer.Option(help="Simulated time for each plant.", min=2.0, max=600.0)
    ] = 20.0,
    json_file: JsonOption = None,
) -> None:
    """Time the stages of a tick and the simulation, on one core."""
    console = make_console()
    check_outputs(json_file)
    with make_progress(console) as progress:
        bar = progress.add_task("measuring", total=1.0)
        result = run_bench(seconds, on_progress=lambda share: progress.update(bar, completed=share))
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
