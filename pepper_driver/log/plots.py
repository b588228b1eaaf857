"""Figures of a log: positions, tracking errors and residuals of joints, with contacts, pushes and reflexes.

The red is the paper's; dashes distinguish it from the other line of its panel.

The limits of the panel are set before; what lies outside them in time is left out, in the legend too.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from pepper_driver.log import RunLog

if TYPE_CHECKING:
    from matplotlib.axes import Axes
from collections import Counter
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from numpy.typing import NDArray

from pepper_driver.config import MissingExtraError, PepperError, UnknownNameError
from pepper_driver.config.arguments import as_path, checked_arguments
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.errors import reason
from pepper_driver.log import LogError

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


BLACK, GREEN, ORANGE, BLUE, RED = "#000000", "#009E73", "#E69F00", "#0072B2", "#CC0000"
PINK, SKY, YELLOW, VERMILION = "#CC79A7", "#56B4E9", "#F0E442", "#D55E00"
PALE_BLUE, GREY, SHADE = "#7FBBE0", "#7F7F7F", "#E2E2E2"


REFLEX_COLORS = (PINK, SKY, YELLOW, VERMILION)

PUSHED = 1e-6
"""[N m] Contact torque that counts as none: rounding of J^T f."""
BAR = 0.035
"""Height of a bar at the top or bottom, as a fraction of the panel's."""


def make_room(log: RunLog, axes: Axes) -> None:
    """Widen the limits of a panel, so that bars at its top and bottom cover no line."""
    low, high = axes.get_ylim()
    bar = 1.3 * BAR * (high - low)
    below = 0 if log.truth is None else 1
    axes.set_ylim(low - below * bar, high + len(_reflex_names(log)) * bar)


def mark_contacts(log: RunLog, joint: str, axes: Axes) -> None:
    """Areas from onset to end; a contact put on another joint of the chain is drawn fainter, a rebound hatched."""
    chain = _chain(log, joint)
    for contact, end in log.lasting_contacts():
        onset = contact.onset_time
        if contact.joint is not None and contact.joint not in chain:
            continue
        if not _shown(onset, end, axes):
            continue
        style, color, label = "--", BLUE, "contact"
        area: dict[str, Any] = {"facecolor": color, "alpha": 0.2}
        if contact.kind == "rebound":
            style, color, label = ":", GREY, "rebound"
            area = {"facecolor": "none", "edgecolor": color, "hatch": "///"}
        elif contact.joint != joint:
            color, label = PALE_BLUE, "contact elsewhere on the chain or trunk"
            area = {"facecolor": color, "alpha": 0.2}
        axes.axvline(onset, color=color, linestyle=style, linewidth=1.3)
        axes.axvspan(onset, end, linewidth=0.0, zorder=0.5, label=label, **area)


def mark_pushes(log: RunLog, joint: str, axes: Axes) -> None:
    """Draw a bar at the bottom while something really touched the chain of a joint."""
    if log.truth is None:
        return
    time = log.truth["time"]
    chain = [log.joint_names.index(name) for name in _chain(log, joint)]
    pushed = (np.abs(log.truth["contact_torque"][:, chain]) > PUSHED).any(axis=1)
    left, right = axes.get_xlim()
    pushed &= (time >= left) & (time <= right)
    if pushed.any():
        axes.fill_between(
            time,
            0.0,
            BAR,
            where=pushed,
            transform=axes.get_xaxis_transform(),
            color=GREY,
            linewidth=0.0,
            label="true push (simulation only)",
        )


def mark_reflexes(log: RunLog, joint: str, axes: Axes) -> None:
    """Bars at the top while a reflex acts on a joint, a row for each reflex of the log."""
    names = _reflex_names(log)
    for name, begin, end in _reflexes(log, joint):
        row = names.index(name)
        if _shown(begin, end, axes):
            axes.axvspan(
                begin,
                end,
                ymin=1.0 - (row + 1) * BAR,
                ymax=1.0 - row * BAR,
                facecolor=REFLEX_COLORS[row % len(REFLEX_COLORS)],
                linewidth=0.0,
                label=f"reflex {name}",
            )


def mark_faults(log: RunLog, axes: Axes) -> None:
    """Lines where the robot was stopped."""
    for event in log.events:
        if event.kind == "fault" and _shown(event.time, event.time, axes):
            axes.axvline(event.time, color=RED, linewidth=2.0, label="stopped")


def _shown(begin: float, end: float, axes: Axes) -> bool:
    left, right = axes.get_xlim()
    return begin <= right and end >= left


def _reflex_names(log: RunLog) -> list[str]:
    return list(dict.fromkeys(event.name for event in log.events if event.kind == "reflex"))


def _reflexes(log: RunLog, joint: str) -> Iterator[tuple[str, float, float]]:
    """Name, begin and end [s] of each time that a reflex acted on a joint; one for no joint acts on all."""
    since: dict[str, float] = {}
    for event in log.events:
        if event.kind != "reflex" or (event.joints and joint not in event.joints):
            continue
        if event.phase == "begin":
            since.setdefault(event.name, event.time)
        elif event.phase == "end" and event.name in since:
            yield event.name, since.pop(event.name), event.time
    for name, begin in since.items():
        yield name, begin, float(log["time"][-1])


def _chain(log: RunLog, joint: str) -> tuple[str, ...]:
    return next((chain for chain in log.chains.values() if joint in chain), (joint,))


FORMATS = ("png", "svg", "pdf")
COLUMNS = 3
"""Joints side by side; more go into further rows of panels."""
BLOCK_SIZE = (16.0, 9.0)
"""[inch] One row of joints, at 100 dots per inch."""


class PlotError(PepperError, OSError):
    """A figure cannot be written."""


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
        raise UnknownNameError("figure format", path.suffix.removeprefix("."), FORMATS)
    if find_spec("matplotlib") is None:
        raise MissingExtraError("plotting", "plot")


@checked_arguments
def plot_contacts(
    log: RunLog,
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
    log: RunLog,
    joints: Sequence[str] | None = None,
    *,
    start: float | None = None,
    stop: float | None = None,
) -> Figure:
    """Per joint three panels over time: position, tracking error, contact observer signal r.

    Blue areas are contacts as they were reported, from the onset, a dashed line, to the end; bars at the top are
    reflexes, bars at the bottom the simulation's ground truth, where the log has it. Hands are shown in percent of
    their aperture, all other joints in degrees.

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
    rows = rows_between(log, start, stop)
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


def rows_between(log: RunLog, start: float | None, stop: float | None) -> BoolArray:
    """(n,) which ticks to draw.

    Args:
        log: What was recorded.
        start: From when on, on the clock of the robot [s]; None from the first tick.
        stop: Until when [s]; None to the last tick.

    Raises:
        LogError: There is none.
    """
    if len(log) == 0:
        raise LogError("the log holds no tick to draw")
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


def _choose(log: RunLog) -> list[str]:
    """Return the joints worth a look, at most as many as fit side by side, in joint order."""
    lasting = Counter(c.joint for c, _ in log.lasting_contacts() if c.joint is not None)
    best = [joint for joint, _ in lasting.most_common(COLUMNS) if joint in log.joint_names]
    if not best:
        travel = np.ptp(log["sent_position"], axis=0)
        best = [log.joint_names[i] for i in np.argsort(-travel, kind="stable")[:COLUMNS]]
    return sorted(best, key=log.joint_names.index)


def _draw_joint(log: RunLog, rows: BoolArray, joint: str, panels: NDArray[np.object_]) -> None:
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
    if log["limited"][rows, index].any():
        reference = of("reference_position")
        top.plot(
            time, reference, color=ORANGE, linewidth=1.2, label="reference, before the safety gate"
        )
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
    """Return the limits of the axis of time [s]; as wide as a tick for a single one."""
    first, last = float(np.nanmin(time)), float(np.nanmax(time))
    return first, max(last, first + 0.012)


def _title(log: RunLog) -> str:
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
