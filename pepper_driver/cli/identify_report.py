"""What ``pepper identify`` prints of the models it made."""

from __future__ import annotations

import math

from rich.console import Console
from rich.table import Table

from pepper_driver.identification import Identification


def print_fits(console: Console, result: Identification) -> None:
    """Print how well each model predicts, beside the other tree and the closed form, and what is wrong."""
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
    bounds = ", ".join(
        f"{joint} {math.degrees(result.models.threshold[joint]):.2f}" for joint in result.recorded
    )
    console.print(f"thresholds from free motion, degrees: {bounds}")
    _print_shared(console, result)
    for finding in result.findings:
        where = ", ".join(name for name in (finding.joint, finding.run) if name is not None)
        console.print(f"warning: {where}: {finding.text}")
    runs = sorted({finding.run for finding in result.findings if finding.run is not None})
    if runs:
        console.print(
            f"to record such a run again, delete its file ({', '.join(runs)}) and give the same command"
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
