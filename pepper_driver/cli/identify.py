"""``pepper identify``: learn what tracking error a free motion shows."""

from __future__ import annotations

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
from pepper_driver.config import UnknownNameError, load_identification_scenario
from pepper_driver.identify import Identification, identify_joints
from pepper_driver.observer import TREE_TYPES, TreeKind


def identify(
    out: Annotated[Path, typer.Option(metavar="FILE", help="Model file to write.")],
    backend: Annotated[str, typer.Option(metavar="URI", help="Robot to drive.")] = "mujoco",
    joints: Annotated[
        str, typer.Option(metavar="A,B", help="Joints to identify, with commas between.")
    ] = "LShoulderRoll,RElbowRoll",
    tree: Annotated[str, typer.Option(help="Kind of the models: affine or cart.")] = "affine",
    seed: Annotated[int, typer.Option(help="Of the random motion.", min=0)] = 0,
    json_file: JsonOption = None,
) -> None:
    """Drive joints in free motion, fit an expected-error model to each, write the model file."""
    console = make_console()
    check_outputs(out, json_file)
    kind = next((kind for kind in TREE_TYPES if kind == tree), None)
    if kind is None:
        raise UnknownNameError("tree", tree, TREE_TYPES)
    result = identify_with_progress(console, backend, joints.split(","), kind, seed=seed)
    result.models.save(out)
    print_fits(console, result)
    console.print(f"models: {out}")
    save_json(json_file, result.as_json(), console)


def identify_with_progress(
    console: Console, backend: str, joints: Sequence[str], kind: TreeKind, *, seed: int
) -> Identification:
    """Identify under a progress bar."""
    with make_progress(console, count=True) as progress:
        bar = progress.add_task("recording free motion", total=None)
        return identify_joints(
            backend,
            joints,
            load_identification_scenario(),
            kind,
            seed=seed,
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
