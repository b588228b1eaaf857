"""Pictures of a log in the manner of the paper's Fig. 3; needs the extra ``plot``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config import MissingExtraError, PepperError, UnknownNameError
from pepper_driver.config.arguments import as_path, checked_arguments
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.errors import reason
from pepper_driver.log import LogData, LogError
from pepper_driver.palette import BLACK, GREEN, ORANGE, RED
from pepper_driver.plot_marks import (
    make_room,
    mark_contacts,
    mark_faults,
    mark_pushes,
    mark_reflexes,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = ("png", "svg", "pdf")
COLUMNS = 3
"""Joints side by side; more go into further rows of panels."""
BLOCK_SIZE = (16.0, 9.0)
"""[inch] One row of joints, at 100 dots per inch."""


class PlotError(PepperError, OSError):
    """A picture cannot be written."""


def check_picture(path: Path) -> None:
    """Refuse what cannot be drawn, before the work for it is done.

    Raises:
        MissingExtraError: matplotlib is not installed.
        UnknownNameError: No such file format.
        PlotError: It is a folder.
    """
    if path.is_dir():
        raise PlotError(f"{path}: cannot be written (it is a folder)")
    if path.suffix.lower().removeprefix(".") not in FORMATS:
        raise UnknownNameError("picture format", path.suffix.removeprefix("."), FORMATS)
    if find_spec("matplotlib") is None:
        raise MissingExtraError("plotting", "plot")


@checked_arguments
def plot_contacts(
    log: LogData,
    path: Path | str,
    joints: Sequence[str] | None = None,
    *,
    start: float | None = None,
    stop: float | None = None,
) -> None:
    """Write :func:`contact_figure` to a file.

    Args:
        log: What was recorded.
        path: PNG, SVG or PDF by suffix; missing folders are made, an existing file is replaced.
        joints: See :func:`contact_figure`.
        start: The same.
        stop: The same.

    Raises:
        MissingExtraError: matplotlib is not installed.
        UnknownNameError: No such joint, or no such file format.
        LogError: The log holds no tick, or none at that time.
        PlotError: The file cannot be written.
    """
    path = as_path("path", path)
    check_picture(path)
    figure = contact_figure(log, joints, start=start, stop=stop)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)
    except OSError as error:
        raise PlotError(f"{path}: cannot be written ({reason(error)})") from error


def contact_figure(
    log: LogData,
    joints: Sequence[str] | None = None,
    *,
    start: float | None = None,
    stop: float | None = None,
) -> Figure:
    """Per joint three panels over time: position, tracking error, contact observer signal r.

    Blue areas are contacts as they were felt, from the onset, a dashed line, to the end; bars at the top are reflexes,
    bars at the bottom the simulation's ground truth, where the log has it. Hands are shown in percent of their
    aperture, all other joints in degrees.

    Args:
        log: What was recorded.
        joints: Which joints; by default those with most contacts, without any those that move most.
        start: From when on, on the clock of the robot [s]; None from the first tick.
        stop: Until when [s]; None to the last tick.

    Returns:
        A figure without a display, 1600 x 1000 dots for up to three joints.

    Raises:
        MissingExtraError: matplotlib is not installed.
        UnknownNameError: No such joint.
        LogError: The log holds no tick, or none at that time.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("plotting", "plot") from error
    rows = _rows(log, start, stop)
    chosen = list(dict.fromkeys(joints)) if joints else _choose(log)
    for joint in chosen:
        if joint not in log.joint_names:
            raise UnknownNameError("joint", joint, log.joint_names)

    columns = min(len(chosen), COLUMNS)
    blocks = -(-len(chosen) // COLUMNS)
    width, height = BLOCK_SIZE
    figure = Figure(figsize=(width, height * blocks + 1.0), dpi=100, layout="constrained")
    panels = figure.subplots(3 * blocks, columns, sharex=True, squeeze=False)
    for place in range(blocks * columns):
        block, column = divmod(place, columns)
        three = panels[3 * block : 3 * block + 3, column]
        if place < len(chosen):
            _draw_joint(log, rows, chosen[place], three)
        else:
            for axes in three:
                axes.set_visible(False)
    figure.suptitle(_title(log), fontsize="large", parse_math=False)
    _legend(figure)
    return figure


def _rows(log: LogData, start: float | None, stop: float | None) -> BoolArray:
    """(n,) which ticks to draw."""
    if len(log) == 0:
        raise LogError("the log holds no tick to plot")
    time = log["time"]
    first = -np.inf if start is None else start
    last = np.inf if stop is None else stop
    if not first < last:
        raise LogError(
            f"from {first:g} s to {last:g} s is no stretch of time: give the earlier first"
        )
    rows: BoolArray = (time >= first) & (time <= last)
    if not rows.any():
        raise LogError(
            f"the log holds no tick there: it goes from {np.nanmin(time):.2f} s to {np.nanmax(time):.2f} s"
        )
    return rows


def _choose(log: LogData) -> list[str]:
    """The joints worth a look, at most as many as fit side by side, in joint order."""
    felt = Counter(c.joint for c, _ in log.lasting_contacts() if c.joint is not None)
    best = [joint for joint, _ in felt.most_common(COLUMNS) if joint in log.joint_names]
    if not best:
        travel = np.ptp(log["sent_position"], axis=0)
        best = [log.joint_names[i] for i in np.argsort(-travel, kind="stable")[:COLUMNS]]
    return sorted(best, key=log.joint_names.index)


def _draw_joint(log: LogData, rows: BoolArray, joint: str, panels: NDArray[np.object_]) -> None:
    index = log.joint_names.index(joint)
    scale, unit = (
        (100.0, "% of aperture") if joint in log.hand_joints else (float(np.rad2deg(1.0)), "deg")
    )
    time = log["time"][rows]

    def of(name: str) -> FloatArray:
        return np.asarray(log[name][rows, index] * scale, dtype=np.float64)

    top: Axes
    middle: Axes
    bottom: Axes
    top, middle, bottom = panels
    sent, measured = of("sent_position"), of("position")
    top.plot(
        time,
        sent,
        color=BLACK,
        linestyle="--",
        linewidth=1.2,
        zorder=2.5,
        label="desired, as sent",
    )
    if log["changed"][rows, index].any():
        wanted = of("reference_position")
        top.plot(time, wanted, color=ORANGE, linewidth=1.2, label="wanted, before the safety gate")
    top.plot(time, measured, color=GREEN, linewidth=1.5, label="measured")
    middle.plot(time, of("expected"), color=ORANGE, linewidth=2.5, label="expected in free motion")
    middle.plot(time, sent - measured, color=GREEN, linewidth=1.1, label="measured")
    residual, threshold = of("residual"), of("threshold")
    bottom.plot(time, residual, color=BLACK, linewidth=1.2, label="contact observer signal r")
    for sign in (1.0, -1.0):
        bottom.plot(
            time, sign * threshold, color=RED, linestyle="--", linewidth=1.2, label="threshold"
        )
    both = np.abs(np.concatenate((residual, threshold)))
    reach = np.max(both, initial=0.0, where=np.isfinite(both))
    if reach > 0:
        bottom.set_ylim(-1.15 * reach, 1.15 * reach)
    if np.isnan(residual).all():
        bottom.text(0.5, 0.5, "not observed", transform=bottom.transAxes, ha="center", va="center")
    top.set_title(joint, parse_math=False)
    top.set_ylabel(f"position [{unit}]")
    middle.set_ylabel(f"tracking error [{unit}]")
    bottom.set_ylabel(f"r [{unit}]")
    bottom.set_xlabel("time [s]")
    bottom.tick_params(labelbottom=True)
    for axes in (top, middle, bottom):
        axes.set_xlim(_limits(time))
        axes.grid(visible=True, color="#EEEEEE", linewidth=0.8)
        axes.set_axisbelow(True)
        make_room(log, axes)
        mark_pushes(log, joint, axes)
        mark_contacts(log, joint, axes)
        mark_reflexes(log, joint, axes)
        mark_faults(log, axes)


def _limits(time: FloatArray) -> tuple[float, float]:
    """Of the axis of time [s]; as wide as a tick where there is but one."""
    first, last = float(np.nanmin(time)), float(np.nanmax(time))
    return first, max(last, first + 0.012)


def _title(log: LogData) -> str:
    parts = [log.metadata.get("backend", "unknown backend")]
    if "seed" in log.metadata and "seed=" not in parts[0]:
        parts.append(f"seed {log.metadata['seed']}")
    if not log.complete:
        parts.append("log cut short")
    return ", ".join(parts)


def _legend(figure: Figure) -> None:
    """One legend for all panels, every label once."""
    entries: dict[str, Artist] = {}
    for axes in figure.axes:
        if axes.get_visible():
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
                entries.setdefault(label, handle)
    figure.legend(
        list(entries.values()), list(entries), loc="outside lower center", ncols=5, frameon=False
    )
