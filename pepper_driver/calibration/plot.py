"""Figure of a calibration: recordings of real Peppers and the simulated one; needs the extra ``plot``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pepper_driver.calibration.calibrate import CalibrationReport, residual
from pepper_driver.config.arrays import FloatArray
from pepper_driver.figure_style import (
    BLUE,
    GREY,
    ORANGE,
    TITLE_SIZE,
    VERMILION,
    add_legend,
    check_picture,
    dress,
    joint_title,
    new_figure,
    same_limits,
    save_figure,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

LOADS = "cividis"
"""Colours of loads; they differ in brightness too."""
DIFFERENCES = "RdBu"
PANEL = 5.4, 4.6
"""[inch] Width and height of a panel."""


def plot_calibration(report: CalibrationReport, path: Path) -> None:
    """Write :func:`calibration_figure` to a file: PNG, SVG or PDF by suffix.

    Raises:
        MissingExtraError: matplotlib is not installed.
        UnknownNameError: No such file format.
        PlotError: The file cannot be written.
    """
    check_picture(path)
    save_figure(calibration_figure(report), path)


@styled
def calibration_figure(report: CalibrationReport) -> Figure:
    """For each table the error by velocity and load and the difference by cell; below, errors in holds by joint.

    Panels of one kind have the same limits and colours.
    """
    tables, holds = list(report.measured.tables), list(report.calibration.recordings.holds)
    parts = [part for part in (tables, holds) if part]
    columns = max(2 * len(tables), len(holds), 2)
    width, height = PANEL
    figure = new_figure(width * min(columns, 4), height * len(parts) + 1.0)
    figure.suptitle(
        f"Simulated plant {report.plant}, compared with recordings of real Peppers",
        fontsize=TITLE_SIZE,
    )
    halves = figure.subfigures(len(parts), 1, squeeze=False)[:, 0]
    for half, part in zip(halves, parts, strict=True):
        if part is tables:
            _draw_tables(report, tables, half)
        else:
            _draw_all_holds(report, holds, half)
    return figure


def _draw_tables(report: CalibrationReport, joints: Sequence[str], half: SubFigure) -> None:
    """Draw the tables, then their differences, with one colour bar for all loads and one for all differences."""
    half.suptitle("Tracking error of ramps in free motion")
    panels = half.subplots(1, 2 * len(joints), squeeze=False)[0]
    loads = [
        load for joint in joints for load in report.calibration.recordings.tables[joint].torque
    ]
    reach = max(float(np.abs(_difference(report, joint)).max()) for joint in joints)
    for number, joint in enumerate(joints):
        _draw_table(report, joint, (min(loads), max(loads)), panels[number])
        _draw_cells(report, joint, reach, panels[len(joints) + number])
    same_limits(panels[: len(joints)], min_span=1.0)
    _add_colour_bars(half, panels, (min(loads), max(loads)))


def _add_colour_bars(half: SubFigure, panels: Sequence[Axes], loads: tuple[float, float]) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    count = len(panels) // 2
    scale = ScalarMappable(Normalize(loads[0] - 1e-9, loads[1] + 1e-9), LOADS)
    half.colorbar(scale, ax=list(panels[:count]), label="load [N m]", location="bottom", shrink=0.5)
    half.colorbar(
        panels[count].images[0],
        ax=list(panels[count:]),
        label="simulated - real error [deg]",
        location="bottom",
        shrink=0.5,
    )


def _difference(report: CalibrationReport, joint: str) -> FloatArray:
    """Return the simulated minus the real error of each cell [deg]."""
    table = report.calibration.recordings.tables[joint]
    return np.asarray(np.degrees(report.measured.tables[joint] - table.error))


def _draw_table(
    report: CalibrationReport, joint: str, loads: tuple[float, float], axes: Axes
) -> None:
    import matplotlib as mpl

    table = report.calibration.recordings.tables[joint]
    colours = mpl.colormaps[LOADS]
    for row, load in enumerate(table.torque):
        real, simulated = (
            np.degrees(errors[row]) for errors in (table.error, report.measured.tables[joint])
        )
        colour = colours((load - loads[0]) / max(loads[1] - loads[0], 1e-9))
        axes.plot(table.moving, real, "o", color=colour, markersize=5, label="real Pepper")
        axes.plot(table.moving, simulated, "-", color=colour, linewidth=1.5, label="simulated")
    axes.set_title(f"{joint_title(joint)}\n{table.error.size} cells, dots: real, lines: simulated")
    axes.set_xlabel("velocity [rad/s]")
    axes.set_ylabel("tracking error [deg]")
    dress(axes)


def _draw_cells(report: CalibrationReport, joint: str, reach: float, axes: Axes) -> None:
    table, simulated = report.calibration.recordings.tables[joint], report.measured.tables[joint]
    axes.imshow(
        _difference(report, joint), cmap=DIFFERENCES, vmin=-reach, vmax=reach, aspect="auto"
    )
    places = range(0, len(table.moving), -(-len(table.moving) // 6))
    axes.set_xticks(places, [f"{table.moving[i]:g}" for i in places])
    axes.set_yticks(range(len(table.torque)), [f"{load:g}" for load in table.torque])
    axes.set_xlabel("velocity [rad/s]")
    axes.set_ylabel("load [N m]")
    limit = report.calibration.settings.largest_residual_deg.get(joint)
    rms = f"rms difference {np.degrees(residual(simulated, table)):.2f} deg"
    bound = "" if limit is None else f" (a match: at most {limit:.2f})"
    axes.set_title(f"{joint_title(joint)}\n{rms}{bound}")


def _draw_all_holds(report: CalibrationReport, joints: Sequence[str], half: SubFigure) -> None:
    settings, recordings = report.calibration.settings, report.calibration.recordings
    half.suptitle(
        f"Error after {recordings.hold_time:g} s of hold. A match: the simulated line crosses the bar, within a "
        f"factor of {settings.largest_factor:g} of the real value"
    )
    panels = half.subplots(1, len(joints), sharex=True, sharey=True, squeeze=False)[0]
    for axes, joint in zip(panels, joints, strict=True):
        _draw_holds(report, joint, axes)
    panels[0].set_ylabel("fraction of holds below")
    panels[0].set_xlim(left=0.0)
    add_legend(half)


def _draw_holds(report: CalibrationReport, joint: str, axes: Axes) -> None:
    """Fraction of holds below an error: simulated as a line, the two real quantiles with what counts as a match."""
    holds, recordings = report.measured.holds, report.calibration.recordings
    real = recordings.holds[joint]
    error = np.sort(np.degrees(np.abs(holds.error[:, holds.joints.index(joint)])))
    axes.plot(
        error,
        (np.arange(len(error)) + 1) / len(error),
        color=BLUE,
        linewidth=1.8,
        label="simulated",
    )
    factor = report.calibration.settings.largest_factor
    for fraction, value in ((0.5, real.median_deg), (0.9, real.p90_deg)):
        bounds = value / factor, value * factor
        axes.plot(bounds, [fraction, fraction], color=ORANGE, linewidth=5.0, label="a match")
        inside = bounds[0] <= float(np.quantile(error, fraction)) <= bounds[1]
        axes.plot(
            value,
            fraction,
            "o" if inside else "X",
            color=GREY if inside else VERMILION,
            markeredgecolor="black",
            markersize=9,
            label=f"real median and 90 %: {'matched' if inside else 'not matched'}",
        )
    axes.set_title(
        f"{joint_title(joint)}\nn = {len(error)} simulated, {recordings.hold_count} real"
    )
    axes.set_xlabel("absolute error [deg]")
    dress(axes)
