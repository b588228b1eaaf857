"""What happened in a run, marked in a panel over time: contacts, true pushes, reflexes, faults.

The limits of the panel are set before; what lies outside them in time is left out, in the legend too.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from pepper_driver.log import LogData
from pepper_driver.palette import BLUE, GREY, PALE_BLUE, PINK, RED, SKY, VERMILION, YELLOW

if TYPE_CHECKING:
    from matplotlib.axes import Axes

REFLEX_COLORS = (PINK, SKY, YELLOW, VERMILION)

PUSHED = 1e-6
"""[N m] Contact torque that counts as none: rounding of J^T f."""
BAR = 0.035
"""Height of a bar at the top or bottom, as a share of the panel's."""


def make_room(log: LogData, axes: Axes) -> None:
    """Widen the limits of a panel, so that bars at its top and bottom cover no line."""
    low, high = axes.get_ylim()
    bar = 1.3 * BAR * (high - low)
    below = 0 if log.truth is None else 1
    axes.set_ylim(low - below * bar, high + len(_reflex_names(log)) * bar)


def mark_contacts(log: LogData, joint: str, axes: Axes) -> None:
    """Areas from onset to end; a contact put on another joint of the chain is drawn fainter, a rebound hatched."""
    chain = _chain(log, joint)
    for contact, end in log.lasting_contacts():
        onset = contact.onset_time
        if contact.joint is not None and contact.joint not in chain:
            continue
        if not _shown(onset, end, axes):
            continue
        style, color, label = "--", BLUE, "contact"
        look: dict[str, Any] = {"facecolor": color, "alpha": 0.2}
        if contact.kind == "rebound":
            style, color, label = ":", GREY, "rebound"
            look = {"facecolor": "none", "edgecolor": color, "hatch": "///"}
        elif contact.joint != joint:
            color, label = PALE_BLUE, "contact elsewhere on the chain or trunk"
            look = {"facecolor": color, "alpha": 0.2}
        axes.axvline(onset, color=color, linestyle=style, linewidth=1.3)
        axes.axvspan(onset, end, linewidth=0.0, zorder=0.5, label=label, **look)


def mark_pushes(log: LogData, joint: str, axes: Axes) -> None:
    """A bar at the bottom while something really touched the chain of a joint."""
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


def mark_reflexes(log: LogData, joint: str, axes: Axes) -> None:
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


def mark_faults(log: LogData, axes: Axes) -> None:
    """Lines where the robot was stopped."""
    for event in log.events:
        if event.kind == "fault" and _shown(event.time, event.time, axes):
            axes.axvline(event.time, color=RED, linewidth=2.0, label="stopped")


def _shown(begin: float, end: float, axes: Axes) -> bool:
    left, right = axes.get_xlim()
    return begin <= right and end >= left


def _reflex_names(log: LogData) -> list[str]:
    return list(dict.fromkeys(event.name for event in log.events if event.kind == "reflex"))


def _reflexes(log: LogData, joint: str) -> Iterator[tuple[str, float, float]]:
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


def _chain(log: LogData, joint: str) -> tuple[str, ...]:
    return next((chain for chain in log.chains.values() if joint in chain), (joint,))
