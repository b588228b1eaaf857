"""Figures of a log: positions, tracking errors, residuals and torques of joints, with contacts, pushes and reflexes.

The limits in time of a panel are set before it is marked; what lies outside them is left out, in the legend too.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from pepper_driver.config import UnknownNameError
from pepper_driver.config.arguments import as_path, checked_arguments
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.figure_style import (
    BLUE,
    COMMANDED,
    GREY,
    MEASURED,
    NOTE_SIZE,
    PINK,
    PREDICTED,
    RED,
    REQUESTED,
    RESIDUAL,
    SKY,
    THRESHOLD,
    TITLE_SIZE,
    VERMILION,
    YELLOW,
    Style,
    add_legend,
    check_picture,
    counted,
    dress,
    in_words,
    joint_title,
    new_figure,
    same_limits,
    save_figure,
    shown_in,
    styled,
)
from pepper_driver.log import LogError, RunLog
from pepper_driver.log.touches import PUSHED, touches
from pepper_driver.observer import Contact

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

REFLEX_COLORS = (PINK, YELLOW, SKY, VERMILION)
REFLEX_HATCHES = ("", "///", "...")
"""One for each round of the colours."""

BAR = 0.035
"""Height of a bar at the top or bottom, as a fraction of the panel's."""

COLUMNS = 3
"""Joints side by side; more go into further rows of panels."""
PANEL_HEIGHT = 2.7
"""[inch]"""
COLUMN_WIDTH = (5.3, 10.0)
"""[inch] Narrowest and widest column of panels."""
TIME_SCALE = 0.22
"""[inch/s] Width of a second, where the column is neither too narrow nor too wide for it."""
MIN_WIDTH = 14.0
"""[inch] Of a figure: its legend and title fit."""
NAME_WIDTH, ONSET_WIDTH = 34.0, 8.0
"""Pixels that a contact needs in a panel for its name, and for the line of its onset."""
FEW_TICKS = 10
"""Lines of so few points get dots: a line of one point cannot be seen."""

MIN_SPANS = {"position": 4.0, "error": 1.0, "residual": 1.0, "torque": 0.5}
"""Heights that are not enlarged: [deg] or [%], torque [N m]. An encoder step is 0.09 deg."""
KINDS = tuple(MIN_SPANS)


def make_room(log: RunLog, axes: Axes) -> None:
    """Widen the limits of a panel, so that bars at its top and bottom cover no line."""
    low, high = axes.get_ylim()
    bar = 1.3 * BAR * (high - low)
    below = 0 if log.truth is None else 1
    axes.set_ylim(low - below * bar, high + len(reflex_names(log)) * bar)


def mark_contacts(log: RunLog, joint: str, axes: Axes) -> None:
    """Areas from onset to end; a contact that another joint of the chain shows is dotted, a rebound hatched."""
    contacts = _contacts_near(log, joint, axes.get_xlim())
    with_onsets = _fit(len(contacts), ONSET_WIDTH, axes)
    for contact, end in contacts:
        style, color, label, onset = "--", BLUE, "contact reported", "onset of contact, estimated"
        area: dict[str, Any] = {"facecolor": SKY, "alpha": 0.3}
        if contact.kind == "rebound":
            style, color, label, onset = ":", GREY, "rebound reported", "onset of rebound"
            area = {"facecolor": "none", "edgecolor": color, "hatch": "///"}
        elif contact.shown_by != joint:
            style, color = "-.", SKY
            label, onset = "contact elsewhere on limb, or trunk", "onset of contact elsewhere"
            area = {"facecolor": "none", "edgecolor": color, "hatch": "..."}
        axes.axvspan(
            contact.onset_time,
            end,
            linewidth=0.0,
            zorder=0.5,
            label=label,
            **area,
        )
        if with_onsets:
            axes.axvline(
                contact.onset_time,
                color=color,
                linestyle=style,
                linewidth=1.3,
                label=onset,
            )


def mark_pushes(log: RunLog, joint: str, axes: Axes) -> None:
    """Draw a bar at the bottom while something really touched the chain of a joint."""
    time, pushed = _pushed(log, joint, axes.get_xlim())
    if pushed.any():
        axes.fill_between(
            time,
            0.0,
            BAR,
            where=pushed.tolist(),
            transform=axes.get_xaxis_transform(),
            color=GREY,
            linewidth=0.0,
            label="true push that loads this limb",
        )


def mark_reflexes(log: RunLog, joint: str, axes: Axes) -> None:
    """Bars at the top while a reflex acts on a joint, a row for each reflex of the log."""
    names = reflex_names(log)
    for name, begin, end in _reflexes(log, joint):
        row = names.index(name)
        if _shown(begin, end, axes.get_xlim()):
            turn, color = divmod(row, len(REFLEX_COLORS))
            axes.axvspan(
                begin,
                end,
                ymin=1.0 - (row + 1) * BAR,
                ymax=1.0 - row * BAR,
                facecolor=REFLEX_COLORS[color],
                hatch=REFLEX_HATCHES[turn % len(REFLEX_HATCHES)],
                linewidth=0.0,
                label=f"reflex {name} acts",
            )


def mark_faults(log: RunLog, axes: Axes) -> None:
    """Lines where the robot was stopped."""
    for event in log.events:
        if event.kind == "fault" and _shown(event.time, event.time, axes.get_xlim()):
            axes.axvline(event.time, color=RED, linewidth=2.0, label="robot stopped")


def _fit(count: int, width: float, axes: Axes) -> bool:
    """Return true if a panel is wide enough for a count of things of a width [pixels]."""
    return count * width <= _width(axes)


def _width(axes: Axes) -> float:
    """Return the width of a panel, roughly: it is not laid out yet [pixels]."""
    subplot = axes.get_subplotspec()
    columns = 1 if subplot is None else subplot.get_gridspec().ncols
    return 0.85 * axes.figure.bbox.width / columns


def _shown(begin: float, end: float, limits: tuple[float, float]) -> bool:
    return begin <= limits[1] and end >= limits[0]


def _contacts_near(
    log: RunLog, joint: str, limits: tuple[float, float]
) -> list[tuple[Contact, float]]:
    """Contacts on the chain of a joint and on the trunk within limits in time, with their ends [s]."""
    chain = _chain(log, joint)
    return [
        (contact, end)
        for contact, end in log.lasting_contacts()
        if (contact.shown_by is None or contact.shown_by in chain)
        and _shown(contact.onset_time, end, limits)
    ]


def _pushed(log: RunLog, joint: str, limits: tuple[float, float]) -> tuple[FloatArray, BoolArray]:
    """Return times of the ground truth [s], and where something touched the chain of a joint within limits in time."""
    if log.truth is None:
        return np.zeros(0), np.zeros(0, dtype=np.bool_)
    time = log.truth["time"]
    chain = [log.joint_names.index(name) for name in _chain(log, joint)]
    pushed = (np.abs(log.truth["contact_torque"][:, chain]) > PUSHED).any(axis=1)
    return time, np.asarray(pushed & (time >= limits[0]) & (time <= limits[1]), dtype=np.bool_)


def reflex_names(log: RunLog) -> list[str]:
    """Return the reflexes of a log that acted, in the order of their rows of bars."""
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
    save_figure(contact_figure(log, joints, start=start, stop=stop), path)


@styled
def contact_figure(
    log: RunLog,
    joints: Sequence[str] | None = None,
    *,
    start: float | None = None,
    stop: float | None = None,
) -> Figure:
    """Per joint four panels over time: position, tracking error, residual r of the observer, external torque.

    Blue areas are contacts as they were reported, from the estimated onset, a dashed line, to the end; bars at the top
    are reflexes, bars at the bottom the simulation's ground truth, where the log has it. Hands are shown in percent of
    their aperture, all other joints in degrees. Panels of one quantity have the same limits. A panel without data is
    left out; the title says why.

    Args:
        log: What was recorded.
        joints: Which joints; by default those with most contacts, without any those that move most.
        start: From when on, on the clock of the robot [s]; None from the first tick.
        stop: Until when [s]; None to the last tick.

    Returns:
        A figure without a display; the longer the time, the wider it is, within bounds.

    Raises:
        MissingExtraError: matplotlib is not installed.
        UnknownNameError: No such joint.
        LogError: The log holds no tick, or none at that time, or no position of these joints.
    """
    rows = rows_between(log, start, stop)
    chosen = list(dict.fromkeys(joints)) if joints else _choose(log)
    for joint in chosen:
        if joint not in log.joint_names:
            raise UnknownNameError("joint", joint, log.joint_names)
    signals = [_signals(log, rows, joint) for joint in chosen]
    kinds = [kind for kind in KINDS if any(kind in of_joint.kinds for of_joint in signals)]
    if not kinds:
        raise LogError(f"the log holds no value of {', '.join(chosen)} there")

    columns = min(len(chosen), COLUMNS)
    blocks = -(-len(chosen) // COLUMNS)
    limits = _limits(log["time"][rows])
    width = float(np.clip(TIME_SCALE * (limits[1] - limits[0]), *COLUMN_WIDTH))
    figure = new_figure(max(columns * width, MIN_WIDTH), len(kinds) * blocks * PANEL_HEIGHT + 1.5)
    grid = figure.add_gridspec(len(kinds) * blocks, columns)
    panels: dict[tuple[str, str], Axes] = {}
    for place, of_joint in enumerate(signals):
        block, column = divmod(place, columns)
        for row, kind in enumerate(kinds):
            if kind in of_joint.kinds:
                axes = figure.add_subplot(grid[len(kinds) * block + row, column])
                axes.set_xlim(limits)
                panels[of_joint.joint, kind] = axes
        _draw_joint(log, of_joint, panels)
    for kind in kinds:
        for unit in dict.fromkeys(of_joint.units[kind] for of_joint in signals):
            alike = [
                panels[of_joint.joint, kind]
                for of_joint in signals
                if of_joint.units[kind] == unit and kind in of_joint.kinds
            ]
            same_limits(alike, min_span=MIN_SPANS[kind], symmetric=kind in ("residual", "torque"))
    for (joint, _), axes in panels.items():
        make_room(log, axes)
        mark_pushes(log, joint, axes)
        mark_contacts(log, joint, axes)
        mark_reflexes(log, joint, axes)
        mark_faults(log, axes)
        dress(axes)
    for of_joint in signals:
        for kind in ("torque", "residual"):  # the torque has no threshold in the way
            if kind in of_joint.kinds:
                _name_contacts(log, of_joint.joint, panels[of_joint.joint, kind], kind)
                break
    figure.suptitle("\n".join(_title(log, rows, signals)), fontsize=TITLE_SIZE)
    add_legend(figure)
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
    lasting = Counter(c.shown_by for c, _ in log.lasting_contacts() if c.shown_by is not None)
    best = [joint for joint, _ in lasting.most_common(COLUMNS) if joint in log.joint_names]
    if not best:
        travel = np.nan_to_num(np.ptp(log["sent_position"], axis=0))
        best = [log.joint_names[i] for i in np.argsort(-travel, kind="stable")[:COLUMNS]]
    return sorted(best, key=log.joint_names.index)


@dataclass(frozen=True, kw_only=True)
class _Signals:
    """Signals of one joint over n ticks, in degrees, percent or N m.

    Attributes:
        joint: Its name.
        kinds: Panels that there is data for, of KINDS.
        units: By kind.
        values: (n,) each, by name of the log's field; ``time`` too.
        limited: True where the safety gate altered a command.
    """

    joint: str
    kinds: tuple[str, ...]
    units: dict[str, str]
    values: dict[str, FloatArray]
    limited: bool


def _signals(log: RunLog, rows: BoolArray, joint: str) -> _Signals:
    index = log.joint_names.index(joint)
    scale, unit = shown_in(joint, log.hand_joints)

    def of(name: str, scale: float) -> FloatArray:
        return np.asarray(log[name][rows, index] * scale, dtype=np.float64)

    angles = (
        "sent_position",
        "reference_position",
        "position",
        "expected",
        "residual",
        "threshold",
    )
    values = {name: of(name, scale) for name in angles}
    values |= {name: of(name, 1.0) for name in ("torque", "torque_std")}
    values["error"] = values["sent_position"] - values["position"]
    needed = {
        "position": ("sent_position", "position"),
        "error": ("error",),
        "residual": ("residual",),
        "torque": ("torque",),
    }
    values["time"] = log["time"][rows]
    return _Signals(
        joint=joint,
        kinds=tuple(
            kind for kind in KINDS if any(np.isfinite(values[name]).any() for name in needed[kind])
        ),
        units={kind: "N m" if kind == "torque" else unit for kind in KINDS},
        values=values,
        limited=bool(log["limited"][rows, index].any()),
    )


def _draw_joint(log: RunLog, signals: _Signals, panels: dict[tuple[str, str], Axes]) -> None:
    """Draw the lines of one joint; its topmost panel has the title, its lowest one the time."""
    values, time = signals.values, signals.values["time"]
    dots: Style = {"marker": "o", "markersize": 4.0} if len(time) < FEW_TICKS else {}
    labels = {
        "position": "position",
        "error": "tracking error",
        "residual": "residual r",
        "torque": "external torque",
    }
    own = {kind: panels[signals.joint, kind] for kind in signals.kinds}

    def line(kind: str, name: str, style: Style) -> None:
        own[kind].plot(time, values[name], **style, **dots)

    if "position" in own:
        line("position", "position", MEASURED)
        line("position", "sent_position", COMMANDED)
        if signals.limited:
            line("position", "reference_position", REQUESTED)
    if "error" in own:
        line("error", "error", MEASURED)
        if np.isfinite(values["expected"]).any():
            line("error", "expected", PREDICTED)
    if "residual" in own:
        line("residual", "residual", RESIDUAL)
        line("residual", "threshold", THRESHOLD)
        own["residual"].plot(time, -values["threshold"], **{**THRESHOLD, **dots})
    if "torque" in own:
        _draw_torque(log, signals, own["torque"], dots)
    for kind, axes in own.items():
        axes.set_ylabel(f"{labels[kind]}\n[{signals.units[kind]}]")
        axes.tick_params(labelbottom=False)
    if own:
        first, *_, last = [*own.values(), *own.values()]
        last.tick_params(labelbottom=True)
        last.set_xlabel("time [s]")
        first.set_title("\n".join(_joint_remarks(log, signals)))


def _draw_torque(log: RunLog, signals: _Signals, axes: Axes, dots: Style) -> None:
    """Draw the estimate with twice its standard deviation, and the truth where the log has it."""
    time, torque, std = (signals.values[name] for name in ("time", "torque", "torque_std"))
    axes.plot(
        time, torque, color=VERMILION, linewidth=1.3, label="external torque, estimated", **dots
    )
    axes.fill_between(
        time,
        torque - 2.0 * std,
        torque + 2.0 * std,
        color=VERMILION,
        alpha=0.25,
        linewidth=0.0,
        label="± 2 standard deviations",
    )
    if log.truth is not None:
        true_time = log.truth["time"]
        rows = (true_time >= time[0]) & (true_time <= time[-1])
        true = log.truth["contact_torque"][rows, log.joint_names.index(signals.joint)]
        axes.plot(
            true_time[rows],
            true,
            color=BLUE,
            linestyle=":",
            linewidth=1.8,
            label="external torque, true",
            **dots,
        )


def _joint_remarks(log: RunLog, signals: _Signals) -> list[str]:
    """Return the title of a joint: its name, how often it was touched, and what is not known of it."""
    joint, limits = signals.joint, _limits(signals.values["time"])
    near = [contact for contact, _ in _contacts_near(log, joint, limits)]
    own = [contact.kind == "rebound" for contact in near if contact.shown_by == joint]
    remarks = [counted(own.count(False), "contact") + " reported on this joint"]
    if any(own):
        remarks.append(counted(own.count(True), "rebound"))
    if log.truth is not None:
        remarks.append(counted(_count_pushes(log, joint, limits), "true push") + " on this limb")
    missing = {
        "position": "no position known",
        "error": "no tracking error known",
        "residual": "not observed",
        "torque": "no torque estimated",
    }
    lacking = [text for kind, text in missing.items() if kind not in signals.kinds]
    if "residual" not in signals.kinds:
        remarks = [r for r in remarks if "true" in r]
        lacking = [text for text in lacking if text != missing["torque"]]
    return [joint_title(joint), "; ".join([*remarks, *lacking])]


def _count_pushes(log: RunLog, joint: str, limits: tuple[float, float]) -> int:
    time, pushed = _pushed(log, joint, limits)
    return len(touches(time, pushed))


def _name_contacts(log: RunLog, joint: str, axes: Axes, kind: str) -> None:
    """Write link and torque along the onset of each contact on a joint, as far as there is room for it."""
    first, last = axes.get_xlim()
    room = NAME_WIDTH * (last - first) / _width(axes)
    free_from = first
    named = [
        (contact, end)
        for contact, end in _contacts_near(log, joint, (first, last))
        if contact.shown_by == joint and contact.kind != "rebound"
    ]
    for contact, end in named if _fit(len(named), NAME_WIDTH, axes) else ():
        onset = max(contact.onset_time, first)
        if onset < free_from or onset + room > last:
            continue
        free_from = onset + room
        # The torque has the sign of the direction, the residual the other one: the other half of the panel is free.
        above = (contact.direction > 0) == (kind == "residual")
        axes.text(
            onset + 0.08 * room,
            0.95 - BAR * len(reflex_names(log)) if above else 0.05 + BAR,
            f"{in_words(contact.link)}\n{_size(log, contact, end)}",
            transform=axes.get_xaxis_transform(),
            rotation=90.0,
            ha="left",
            va="top" if above else "bottom",
            fontsize=NOTE_SIZE,
            linespacing=1.0,
            clip_on=True,
        )


def _size(log: RunLog, contact: Contact, end: float) -> str:
    """Return the largest torque on the joint that shows a contact, with two standard deviations, or the intensity."""
    rows = (log["time"] >= contact.onset_time) & (log["time"] <= end)
    index = log.joint_names.index(contact.shown_by or "")
    torque, std = (log[name][rows, index] for name in ("torque", "torque_std"))
    if not np.isfinite(torque).any():
        return f"{contact.intensity_deg:.1f} deg"
    largest = int(np.nanargmax(np.abs(torque)))
    return f"{torque[largest]:+.1f} ± {2.0 * std[largest]:.1f} N m"


def _limits(time: FloatArray) -> tuple[float, float]:
    """Return the limits of the axis of time [s]; those of a single tick are as wide as one, with the tick between."""
    first, last = float(np.nanmin(time)), float(np.nanmax(time))
    return (first, last) if last > first else (first - 0.006, last + 0.006)


def _title(log: RunLog, rows: BoolArray, signals: Sequence[_Signals]) -> list[str]:
    """Return which run it is; when, how long, by which observer, with how many contacts; what is missing."""
    first, last = _limits(log["time"][rows])
    remarks = [_date(log), _length(log, rows)]
    if any("residual" in of_joint.kinds for of_joint in signals):
        known = log.metadata.get("observer_name") or "of unknown name"
        contacts = [
            c.kind == "rebound"
            for c, end in log.lasting_contacts()
            if _shown(c.onset_time, end, (first, last))
        ]
        remarks += [f"observer {known}", counted(contacts.count(False), "contact") + " reported"]
    else:
        remarks.append("no observer watched these joints: no residual, no torque")
    if rows.sum() > 1 and not np.ptp(log["sent_position"][rows], axis=0).any():
        remarks.append("no joint was moved")
    lines = [_run(log), ", ".join(filter(None, remarks))]
    if not log.complete or log.missing:
        lines.append(f"log cut short: {log.missing}" if log.missing else "log cut short")
    return lines


def _length(log: RunLog, rows: BoolArray) -> str:
    """Return how much is drawn: of what there is, where it is not all."""
    time = log["time"]
    shown, whole = (float(np.ptp(t)) for t in (time[rows], time))
    if rows.sum() == 1:
        return "1 tick"
    return f"{shown:.1f} s" if rows.all() else f"{shown:.1f} of {whole:.1f} s"


def _date(log: RunLog) -> str:
    try:
        start = datetime.fromisoformat(log.metadata.get("start", ""))
    except ValueError:
        return ""
    return f"{start.astimezone(UTC):%Y-%m-%d %H:%M} UTC"


def _run(log: RunLog) -> str:
    """Return the robot of a log, human-readable: plant and seed of a simulation, the address of another backend."""
    uri = log.metadata.get("backend", "")
    robot = log.robot.capitalize()
    try:
        parts = urlsplit(uri)
    except ValueError:
        parts = urlsplit("")
    if parts.scheme != "mujoco" and uri != "mujoco":
        return f"{robot} at {uri}" if uri else f"{robot}, backend unknown"
    options = dict(parse_qsl(parts.query))
    options.setdefault("plant", "nominal")
    if "seed" in log.metadata:
        options["seed"] = log.metadata["seed"]
    named = ", ".join(f"{key} {value}" for key, value in sorted(options.items()))
    return f"{robot} in simulation ({named})"
