"""Figure of a calibration: recordings of real Peppers and the simulated one; needs the extra ``plot``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pepper_driver.calibration.calibrate import CalibrationReport, residual
from pepper_driver.config.errors import reason
from pepper_driver.log.plots import BLUE, GREEN, ORANGE, RED, PlotError, check_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def plot_calibration(report: CalibrationReport, path: Path) -> None:
    """Write :func:`calibration_figure` to a file: PNG, SVG or PDF by suffix.

    Raises:
        MissingExtraError: matplotlib is not installed.
        UnknownNameError: No such file format.
        PlotError: The file cannot be written.
    """
    check_picture(path)
    figure = calibration_figure(report)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)
    except OSError as error:
        raise PlotError(f"{path}: cannot be written ({reason(error)})") from error


def calibration_figure(report: CalibrationReport) -> Figure:
    """For each table the error by velocity and load and the difference by cell; below, errors in holds by joint."""
    from matplotlib.figure import Figure

    tables, holds = report.measured.tables, report.calibration.recordings.holds
    columns = max(2 * len(tables), 1)
    figure = Figure(figsize=(16.0, 9.0), dpi=100, layout="constrained")
    halves = figure.subfigures(2, 1, height_ratios=(1.2, 1.0), squeeze=False)
    top, bottom = halves[:, 0]
    panels = top.subplots(1, columns, squeeze=False)[0]
    for number, joint in enumerate(tables):
        _draw_table(report, joint, panels[2 * number])
        _draw_cells(report, joint, panels[2 * number + 1])
    lower = bottom.subplots(1, len(holds), squeeze=False)[0]
    for axes, joint in zip(lower, holds, strict=True):
        _draw_holds(report, joint, axes)
    figure.suptitle(
        f"plant {report.plant} compared with recordings of real Peppers: free motion and holds",
        parse_math=False,
    )
    return figure


def _draw_table(report: CalibrationReport, joint: str, axes: Axes) -> None:
    table = report.calibration.recordings.tables[joint]
    loads = np.array(table.torque)
    greys = np.linspace(0.75, 0.0, len(loads))
    for row, (load, grey) in enumerate(zip(loads, greys, strict=True)):
        real, simulated = (
            np.degrees(errors[row]) for errors in (table.error, report.measured.tables[joint])
        )
        axes.plot(table.moving, real, "o", color=str(grey), markersize=3, label=f"{load:g} N m")
        axes.plot(table.moving, simulated, "-", color=str(grey), linewidth=1.2)
    axes.set_title(f"{joint}: real (dots) and simulated", fontsize="medium")
    axes.set_xlabel("velocity [rad/s]")
    axes.set_ylabel("error [deg]")
    axes.legend(fontsize="x-small", title="load", title_fontsize="x-small")
    axes.grid(visible=True, color="#EEEEEE")


def _draw_cells(report: CalibrationReport, joint: str, axes: Axes) -> None:
    table, simulated = report.calibration.recordings.tables[joint], report.measured.tables[joint]
    difference = np.degrees(simulated - table.error)
    reach = float(np.abs(difference).max())
    picture = axes.imshow(difference, cmap="RdBu", vmin=-reach, vmax=reach, aspect="auto")
    places = range(0, len(table.moving), 4)
    axes.set_xticks(places, [f"{table.moving[i]:g}" for i in places])
    axes.set_yticks(range(len(table.torque)), [f"{load:g}" for load in table.torque])
    axes.set_xlabel("velocity [rad/s]")
    axes.set_ylabel("load [N m]")
    rms = np.degrees(residual(simulated, table))
    axes.set_title(f"{joint}: simulated - real, rms {rms:.2f} deg", fontsize="medium")
    axes.figure.colorbar(picture, ax=axes, label="deg", shrink=0.8)


def _draw_holds(report: CalibrationReport, joint: str, axes: Axes) -> None:
    """Fraction of holds below an error: simulated as a line, the two real quantiles with what counts as a match."""
    holds, real = report.measured.holds, report.calibration.recordings.holds[joint]
    error = np.sort(np.degrees(np.abs(holds.error[:, holds.joints.index(joint)])))
    axes.plot(error, (np.arange(len(error)) + 1) / len(error), color=BLUE, label="simulated")
    factor = report.calibration.settings.largest_factor
    for fraction, value in ((0.5, real.median_deg), (0.9, real.p90_deg)):
        bounds = [value / factor, value * factor]
        axes.plot(bounds, [fraction, fraction], color=ORANGE, linewidth=2.0, label="a match")
        inside = value / factor <= float(np.quantile(error, fraction)) <= value * factor
        axes.plot(
            value, fraction, "D", color=GREEN if inside else RED, label=f"real, {fraction:.0%}"
        )
    axes.set_title(joint, fontsize="medium")
    axes.set_xlabel("error after 2 s of hold [deg]")
    axes.set_ylabel("fraction of holds")
    axes.set_xlim(left=0.0)
    handles, labels = axes.get_legend_handles_labels()
    once = dict(zip(labels, handles, strict=True))
    axes.legend(list(once.values()), list(once), fontsize="x-small")
    axes.grid(visible=True, color="#EEEEEE")
