"""``pepper identify``: learn what tracking error a free motion shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from pepper_driver.cli.console import (
    JsonOption,
    check_outputs,
    make_console,
    make_progress,
    save_json,
)
from pepper_driver.config import Scenario, UnknownNameError, load_robot, load_scenario
from pepper_driver.identify import Identification, identify_joints, sweeps_of
from pepper_driver.observer import TREE_TYPES, TreeKind


def identify(
    out: Annotated[Path, typer.Option(metavar="FILE", help="Model file to write.")],
    backend: Annotated[str, typer.Option(metavar="URI", help="Robot to drive.")] = "mujoco",
    joints: Annotated[
        str | None,
        typer.Option(
            metavar="A,B", help="Joints to identify, with commas between; else the scenario's."
        ),
    ] = None,
    tree: Annotated[str, typer.Option(help="Kind of the models: affine or cart.")] = "affine",
    seed: Annotated[
        int | None, typer.Option(help="Of the random motion; else the scenario's.", min=0)
    ] = None,
    scenario: Annotated[
        str, typer.Option(metavar="NAME_OR_FILE", help="The motion; of kind sweeps.")
    ] = "identify",
    json_file: JsonOption = None,
) -> None:
    """Drive joints in free motion, fit an expected-error model to each, write the model file."""
    console = make_console()
    check_outputs(out, json_file)
    kind = next((kind for kind in TREE_TYPES if kind == tree), None)
    if kind is None:
        raise UnknownNameError("tree", tree, TREE_TYPES)
    chosen = load_scenario(scenario, load_robot())
    names = sweeps_of(chosen).joints if joints is None else joints.split(",")
    result = identify_with_progress(console, backend, names, chosen, kind, seed=seed)
    result.models.save(out)
    print_fits(console, result)
    console.print(f"models: {out}")
    save_json(json_file, result.as_json(), console)


def identify_with_progress(
    console: Console,
    backend: str,
    joints: Sequence[str],
    scenario: Scenario,
    kind: TreeKind,
    *,
    seed: int | None,
) -> Identification:
    """Identify under a progress bar; ``seed`` None is the scenario's."""
    with make_progress(console, count=True) as progress:
        bar = progress.add_task("recording free motion", total=None)
        return identify_joints(
            backend,
            joints,
            scenario,
            kind,
            seed=scenario.seed if seed is None else seed,
            progress=lambda done, total: progress.update(bar, completed=done, total=total),
        )


def print_fits(console: Console, result: Identification) -> None:
    """Print how well each model predicts, beside the other tree and the closed form."""
    table = Table(title="fit of the tracking error, NRMSE %", title_justify="left")
    for name in ("joint", "model", "estimation", "test"):
        table.add_column(name, justify="right" if name in ("estimation", "test") else "left")
    for joint in result.models.models:
        for method, fits in result.fits.items():
            fit = fits[joint]
            table.add_row(joint, method, f"{fit.estimation:.1f}", f"{fit.test:.1f}")
    console.print(table)
    bounds = ", ".join(f"{j} {math.degrees(b):.2f}" for j, b in result.models.threshold.items())
    console.print(f"thresholds from free motion, degrees: {bounds}")
