"""``pepper bench``: time of each stage of a tick, speed of the simulation."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from pepper_driver.bench.callbacks import run_callback_bench
from pepper_driver.bench.soak import run_soak
from pepper_driver.bench.ticks import run_bench, run_tick_bench
from pepper_driver.cli.console import (
    JsonOption,
    check_outputs,
    make_console,
    make_progress,
    save_json,
)
from pepper_driver.config import ConfigError
from pepper_driver.realtime import Statistics


def bench(
    seconds: Annotated[
        float,
        typer.Option(
            metavar="SECONDS",
            help="Time: simulated for each plant, real for --tick and for each kind of --callbacks.",
            min=2.0,
            max=600.0,
        ),
    ] = 20.0,
    plants: Annotated[
        list[str] | None,
        typer.Option(
            "--plant",
            metavar="NAME_OR_FILE",
            help="Plant to simulate, by default nominal; may be given again. Not with --tick or --callbacks.",
        ),
    ] = None,
    tick: Annotated[
        bool,
        typer.Option(
            "--tick",
            help="Instead, time whole ticks in real time: five tasks, observer, reflex, gate and log.",
        ),
    ] = False,
    busy: Annotated[
        bool,
        typer.Option("--busy", help="With --tick: while the main thread computes in Python."),
    ] = False,
    callbacks: Annotated[
        bool,
        typer.Option(
            "--callbacks",
            help="Instead, time ticks in real time with callbacks that sleep, raise, flood or compute.",
        ),
    ] = False,
    soak: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Instead, run the plant for this simulated time, moved, pushed and held at random, "
            "and say whether it stays finite and its energy bounded.",
            min=60.0,
            max=1e6,
        ),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Time the stages of a tick and the simulation, on one core."""
    console = make_console()
    check_outputs(json_file)
    kinds = {"--tick": tick, "--callbacks": callbacks, "--soak": soak is not None}
    given = [name for name, value in kinds.items() if value]
    if len(given) > 1:
        raise ConfigError(f"options {' and '.join(given)}: give one of them")
    if plants and (tick or callbacks):
        raise ConfigError(f"option '--plant': {given[0]} has a plant of its own; leave it out")
    if plants and len(plants) > 1 and soak is not None:
        raise ConfigError("option '--plant': --soak takes one plant")
    if busy and not tick:
        raise ConfigError("option '--busy': goes with --tick")
    plants = plants or ["nominal"]
    if soak is not None:
        _soak(console, plants[0], soak, json_file)
        return
    if tick:
        _tick(console, seconds, busy, json_file)
        return
    if callbacks:
        _callbacks(console, seconds, json_file)
        return
    with make_progress(console) as progress:
        bar = progress.add_task("measuring", total=1.0)
        result = run_bench(
            seconds,
            plants=plants,
            on_progress=lambda fraction: progress.update(bar, completed=fraction),
        )
    console.print(_stages(result.ticks))
    for plant, factor in result.real_time_factor.items():
        console.print(
            f"simulation of {plant}: {factor:.1f} times real time with controller, observer and log; "
            f"{result.plant_alone[plant]:.1f} times alone"
        )
    save_json(json_file, result.as_json(), console)


def _stages(ticks: Statistics) -> Table:
    """Median and p99 of each stage, and of the tick without the physics."""
    table = Table(title="one tick of 12 ms, microseconds", title_justify="left")
    for name in ("stage", "median", "p99"):
        table.add_column(name, justify="left" if name == "stage" else "right")
    for stage, spread in ticks.stages.items():
        table.add_row(stage, f"{spread.median:.1f}", f"{spread.p99:.1f}")
    table.add_section()
    table.add_row("all but backend", f"{ticks.tick.median:.1f}", f"{ticks.tick.p99:.1f}")
    return table


def _tick(console: Console, seconds: float, busy: bool, json_file: Path | None) -> None:
    with make_progress(console) as progress:
        bar = progress.add_task("measuring", total=1.0)
        ticks = run_tick_bench(
            seconds,
            busy=busy,
            on_progress=lambda fraction: progress.update(bar, completed=fraction),
        )
    console.print(str(ticks))
    save_json(json_file, {"ticks": ticks.as_json()}, console)


def _callbacks(console: Console, seconds: float, json_file: Path | None) -> None:
    with make_progress(console) as progress:
        bar = progress.add_task("measuring", total=1.0)
        costs = run_callback_bench(
            seconds, on_progress=lambda fraction: progress.update(bar, completed=fraction)
        )
    table = Table(title="ticks in real time with one callback", title_justify="left")
    table.add_column("callback")
    for name in ("tick, median us", "ratio", "end, p99 ms", "missed"):
        table.add_column(name, justify="right")
    for kind, cost in costs.items():
        missed = f"{cost.missed} of {cost.ticks + cost.missed}"
        table.add_row(kind, f"{cost.tick:.1f}", f"{cost.ratio:.2f}", f"{cost.end:.2f}", missed)
    console.print(table)
    save_json(json_file, {"callbacks": {k: asdict(cost) for k, cost in costs.items()}}, console)


def _soak(console: Console, plant: str, seconds: float, json_file: Path | None) -> None:
    with make_progress(console) as progress:
        bar = progress.add_task("soaking", total=1.0)
        result = run_soak(
            f"mujoco://?plant={plant}",
            seconds,
            on_progress=lambda fraction: progress.update(bar, completed=fraction),
        )
    energies = ", ".join(f"{energy:.2f}" for energy in result.largest_energy)
    console.print(
        f"{result.seconds:.0f} s of {plant} at {result.real_time_factor:.1f} times real time: "
        f"{'all finite' if result.finite else 'NOT FINITE'}, {'fell over' if result.fallen else 'stands'}; "
        f"largest kinetic energy by quarter {energies} J; battery {result.charge:.2f}, "
        f"warmest motor {result.hottest:.0f} deg C"
    )
    save_json(json_file, {"soak": result.as_json()}, console)
