"""Pictures of a log in the manner of the paper's Fig. 3; needs the extra ``plot``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config import MissingExtraError, PepperError, UnknownNameError
from pepper_driver.log import LogData, LogError

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = ("png", "svg", "pdf")
COLUMNS = 3
"""Joints side by side; more go into further rows of panels."""
BLOCK_SIZE = (16.0, 9.0)
"""[inch] One row of joints, at 100 dots per inch."""

# Okabe and Ito's palette, told apart by every kind of colour vision. The red is the paper's; dashes
# tell it from the other line of its panel.
BLACK, GREEN, ORANGE, BLUE, RED = "#000000", "#009E73", "#E69F00", "#0072B2", "#CC0000"
PALE_BLUE, GREY, SHADE = "#7FBBE0", "#7F7F7F", "#E2E2E2"
PUSHED = 1e-6
"""[N m] Contact torque that counts as none: rounding of J^T f."""


class PlotError(PepperError, OSError):
    """A picture cannot be written."""


def plot_contacts(log: LogData, path: Path, joints: Sequence[str] | None = None) -> None:
    """Write :func:`contact_figure` to a file.

    Args:
        log: What was recorded.
        path: PNG, SVG or PDF by suffix; missing folders are made, an existing file is replaced.
        joints: See :func:`contact_figure`.

    Raises:
        MissingExtraError: matplotlib is not installed.
        UnknownNameError: No such joint, or no such file format.
        LogError: The log holds no tick.
        PlotError: The file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower().removeprefix(".") not in FORMATS:
        raise UnknownNameError("picture format", path.suffix.removeprefix("."), FORMATS)
    figure = contact_figure(log, joints)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)
    except OSError as error:
        raise PlotError(f"{path}: cannot be written ({error.strerror or error})") from error


def contact_figure(log: LogData, joints: Sequence[str] | None = None) -> Figure:
    """Per joint three panels over time: position, tracking error, contact observer signal r.

    Dashed lines mark where contacts begin. Grey areas are the simulation's ground truth, where the
    log has it. Hands are shown in percent of their aperture, all other joints in degrees.

    Args:
        log: What was recorded.
        joints: Which joints; by default those with most contacts, without any those that move most.

    Returns:
        A figure without a display, 1600 x 1000 dots for up to three joints.

    Raises:
        MissingExtraError: matplotlib is not installed.
        UnknownNameError: No such joint.
        LogError: The log holds no tick.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("plotting", "plot") from error
    if len(log) == 0:
        raise LogError("the log holds no tick to plot")
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
            _draw_joint(log, chosen[place], three)
        else:
            for axes in three:
                axes.set_visible(False)
    figure.suptitle(_title(log), fontsize="large", parse_math=False)
    _legend(figure)
    return figure


def _choose(log: LogData) -> list[str]:
    """The joints worth a look, at most as many as fit side by side, in joint order."""
    felt = Counter(c.joint for c in log.contacts if c.phase == "begin" and c.joint is not None)
    best = [joint for joint, _ in felt.most_common(COLUMNS) if joint in log.joint_names]
    if not best:
        travel = np.ptp(log["sent_position"], axis=0)
        best = [log.joint_names[i] for i in np.argsort(-travel, kind="stable")[:COLUMNS]]
    return sorted(best, key=log.joint_names.index)


def _draw_joint(log: LogData, joint: str, panels: NDArray[np.object_]) -> None:
    index = log.joint_names.index(joint)
    scale, unit = (
        (100.0, "% of aperture") if joint in log.hand_joints else (float(np.rad2deg(1.0)), "deg")
    )
    time = log["time"]

    def of(name: str) -> NDArray[np.float64]:
        return np.asarray(log[name][:, index] * scale, dtype=np.float64)

    top: Axes
    middle: Axes
    bottom: Axes
    top, middle, bottom = panels
    sent, measured = of("sent_position"), of("position")
    top.plot(time, sent, color=BLACK, linestyle="--", linewidth=1.2, label="desired, as sent")
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
        axes.margins(x=0.0)
        axes.grid(visible=True, color="#EEEEEE", linewidth=0.8)
        axes.set_axisbelow(True)
        _mark_contacts(log, joint, axes)
        _shade_pushes(log, joint, axes)


def _chain(log: LogData, joint: str) -> tuple[str, ...]:
    return next((chain for chain in log.chains.values() if joint in chain), (joint,))


def _mark_contacts(log: LogData, joint: str, axes: Axes) -> None:
    """Lines where contacts begin; a contact put on another joint of the chain is drawn fainter."""
    chain = _chain(log, joint)
    for contact in log.contacts:
        if contact.phase != "begin" or (contact.joint is not None and contact.joint not in chain):
            continue
        here = contact.joint == joint
        if contact.kind == "rebound":
            style, color, label = ":", GREY, "rebound begins"
        elif here:
            style, color, label = "--", BLUE, "contact begins"
        else:
            style, color, label = "--", PALE_BLUE, "contact begins elsewhere on the chain or trunk"
        axes.axvline(contact.onset_time, color=color, linestyle=style, linewidth=1.3, label=label)


def _shade_pushes(log: LogData, joint: str, axes: Axes) -> None:
    if log.truth is None:
        return
    chain = [log.joint_names.index(name) for name in _chain(log, joint)]
    pushed = (np.abs(log.truth["contact_torque"][:, chain]) > PUSHED).any(axis=1)
    axes.fill_between(
        log.truth["time"],
        0.0,
        1.0,
        where=pushed,
        transform=axes.get_xaxis_transform(),
        color=SHADE,
        linewidth=0.0,
        zorder=0.0,
        label="true push (simulation only)",
    )


def _title(log: LogData) -> str:
    parts = [log.metadata.get("backend", "unknown backend")]
    if "seed" in log.metadata:
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
