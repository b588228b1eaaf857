"""``pepper bench``: time of ticks, speed of the simulation, start-up, throughput, other controllers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import typer
from rich.console import Console
from rich.table import Table

from pepper_driver.bench.callbacks import run_callback_bench
from pepper_driver.bench.loop import run_loop_bench
from pepper_driver.bench.machine import machine_as_json
from pepper_driver.bench.peers import OURS, run_peer_bench
from pepper_driver.bench.soak import run_soak
from pepper_driver.bench.startup import run_startup_bench
from pepper_driver.bench.throughput import run_throughput_bench
from pepper_driver.bench.ticks import run_tick_bench
from pepper_driver.cli.console import (
    JsonOption,
    check_outputs,
    make_console,
    make_progress,
    save_json,
)
from pepper_driver.config import ConfigError
from pepper_driver.realtime import Statistics

Part = Literal["loop", "startup", "throughput"]
"""Of the measurements that are made where nothing else is asked for."""


def bench(
    seconds: Annotated[
        float,
        typer.Option(
            metavar="SECONDS",
            help="Time: simulated for each plant and run, real for --tick and for each kind of --callbacks; "
            "for --peers of the ticks of each controller.",
            min=2.0,
            max=600.0,
        ),
    ] = 20.0,
    plants: Annotated[
        list[str] | None,
        typer.Option(
            "--plant",
            metavar="NAME_OR_FILE",
            help="Plant to simulate, by default nominal; may be given again. Not with --tick, --callbacks or --peers.",
        ),
    ] = None,
    part: Annotated[
        Part | None,
        typer.Option(
            help="Only this: stages and cost of the loop, compared with bare physics; start-up and memory; robot-hours "
            "identified and evaluated in a core-hour; by default all three.",
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
    peers: Annotated[
        bool,
        typer.Option(
            "--peers",
            help="Instead, time the controller and pink and mink, with the same five tasks.",
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
) -> int:
    """Time ticks, the simulation compared with bare physics, start-up and throughput."""
    console = make_console()
    check_outputs(json_file)
    kinds = {
        "--tick": tick,
        "--callbacks": callbacks,
        "--peers": peers,
        "--soak": soak is not None,
    }
    given = [name for name, value in kinds.items() if value]
    if len(given) > 1:
        raise ConfigError(f"options {' and '.join(given)}: give one of them")
    if plants and (tick or callbacks):
        raise ConfigError(f"option '--plant': {given[0]} has a plant of its own; leave it out")
    if plants and peers:
        raise ConfigError("option '--plant': --peers simulates no robot; leave it out")
    if plants and len(plants) > 1 and soak is not None:
        raise ConfigError("option '--plant': --soak takes one plant")
    if part and given:
        raise ConfigError(f"option '--part': does not go with {given[0]}")
    if plants and part not in (None, "loop"):
        raise ConfigError(f"option '--plant': --part {part} has plants of its own; leave it out")
    if busy and not tick:
        raise ConfigError("option '--busy': goes with --tick")
    plants = plants or ["nominal"]
    if soak is not None:
        _soak(console, plants[0], soak, json_file)
    elif tick:
        _tick(console, seconds, busy, json_file)
    elif callbacks:
        _callbacks(console, seconds, json_file)
    elif peers:
        return _peers(console, seconds, json_file)
    else:
        _parts(console, seconds, plants, {part} if part else set(get_args(Part)), json_file)
    return 0


def _parts(
    console: Console, seconds: float, plants: list[str], parts: set[str], json_file: Path | None
) -> None:
    figures: dict[str, Any] = {}
    if "loop" in parts:
        with _bar(console, "loop") as advance:
            loop = run_loop_bench(seconds, plants=plants, on_progress=advance)
        console.print(_stages(loop.ticks))
        if loop.observer_us is not None:
            console.print(f"observer alone, with the same ticks again: {loop.observer_us:.1f} us")
        for plant, speed in loop.speed.items():
            console.print(
                f"simulation of {plant}: {speed.loop:.1f} times real time with controller, observer and log, "
                f"{speed.plant:.1f} times alone; a tick takes {speed.loop_over_physics:.2f} and "
                f"{speed.plant_over_physics:.2f} times its bare physics of {speed.physics_us:.0f} us"
            )
        figures |= loop.as_json()
    if "startup" in parts:
        with _bar(console, "start-up") as advance:
            startup = run_startup_bench(on_progress=advance)
        console.print(
            f"start-up: import {startup.import_s:.2f} s, pepper --help {startup.cli_help_s:.2f} s, "
            f"robot active after {startup.start_s:.2f} s; memory {startup.memory_mb:.0f} MB"
        )
        figures |= startup.as_json()
    if "throughput" in parts:
        with _bar(console, "throughput") as advance:
            throughput = run_throughput_bench(on_progress=advance)
        console.print(
            f"robot-hours in a core-hour: {throughput.identify:.1f} identified, "
            f"{throughput.evaluate:.1f} evaluated with fusion"
        )
        figures |= throughput.as_json()
    save_json(json_file, figures | machine_as_json(), console)


@contextmanager
def _bar(console: Console, what: str) -> Iterator[Callable[[float], None]]:
    """Yield a function that moves a progress bar to a fraction, 0..1."""
    progress = make_progress(console)
    progress.live.auto_refresh = False  # a thread that draws would take time from what is measured
    with progress:
        bar = progress.add_task(what, total=1.0)
        yield lambda fraction: progress.update(bar, completed=fraction, refresh=True)


def _peers(console: Console, seconds: float, json_file: Path | None) -> int:
    with _bar(console, "measuring") as advance:
        result = run_peer_bench(seconds, on_progress=advance)
    table = Table(title="one tick of the controller, five tasks", title_justify="left")
    table.add_column("controller")
    for name in ("median us", "p99 us", "ratio", "by turns", "error mm"):
        table.add_column(name, justify="right")
    for name, times in result.times.items():
        low, high = times.turns
        span = "" if name == OURS else f"{low:.2f} to {high:.2f}"
        figures = (f"{times.median:.1f}", f"{times.p99:.1f}", f"{times.ratio:.2f}", span)
        table.add_row(name, *figures, f"{1e3 * times.error:.1f}")
    console.print(table)
    console.print("pink and mink compute neither accelerations nor the load torque.")
    save_json(json_file, result.as_json(), console)
    lost = [name for name, times in result.times.items() if not times.reached]
    if lost:
        console.print(f"failed: {', '.join(lost)}: not at its targets; such times say nothing")
    return 1 if lost else 0


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
    with _bar(console, "measuring") as advance:
        ticks = run_tick_bench(seconds, busy=busy, on_progress=advance)
    console.print(str(ticks))
    save_json(json_file, {"ticks": ticks.as_json()}, console)


def _callbacks(console: Console, seconds: float, json_file: Path | None) -> None:
    with _bar(console, "measuring") as advance:
        costs = run_callback_bench(seconds, on_progress=advance)
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
    with _bar(console, "soaking") as advance:
        result = run_soak(f"mujoco://?plant={plant}", seconds, on_progress=advance)
    energies = ", ".join(f"{energy:.2f}" for energy in result.largest_energy)
    console.print(
        f"{result.seconds:.0f} s of {plant} at {result.real_time_factor:.1f} times real time: "
        f"{'all finite' if result.finite else 'NOT FINITE'}, {'fell over' if result.fallen else 'stands'}; "
        f"largest kinetic energy by quarter {energies} J; battery {result.charge:.2f}, "
        f"warmest motor {result.hottest:.0f} deg C"
    )
    save_json(json_file, {"soak": result.as_json()}, console)
