"""Signals of the page: residual with its threshold, torque with its deviation, times of stages, what happened."""

from __future__ import annotations

import html
from collections import deque
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import viser
from viser import uplot

from pepper_driver.config import RobotConfig
from pepper_driver.figure_style import (
    BLUE,
    GREY,
    ORANGE,
    RED,
    SHADE,
    VERMILION,
    VIOLET,
    in_words,
)
from pepper_driver.log import LogEvent
from pepper_driver.observer import Contact
from pepper_driver.viewer.picture import Picture

WINDOW = 10.0
"""[s] that the curves go back."""

MAX_POINTS = 400
"""Points of a curve."""

SHOWN_LINES = 12
"""Lines of the list of what happened."""

AUTOMATIC = "most touched"
"""In place of a joint: the one of a contact; without one that whose residual is nearest to its threshold."""

LINE_WIDTH, LINE_ROW, MIN_BAR = 1000, 12, 2.0
"""Units of the time line: its width, the height of a row, the least width of a bar."""

HOLD_CHOICE = 2.0
"""[s] for which the automatic choice stays on a joint."""


class Curves:
    """Curves of one joint: residual with threshold above, torque with deviation below.

    Args:
        server: Of the page.
        robot: Names the joints.
        start: Name of the joint at first, or ``AUTOMATIC``.
    """

    def __init__(self, server: viser.ViserServer, robot: RobotConfig, start: str) -> None:
        self._names = robot.joint_names
        self.choice = server.gui.add_dropdown(
            "Joint", (AUTOMATIC, *self._names), initial_value=start
        )
        self._name, self._named = server.gui.add_markdown(""), ""
        self._joint, self._since = 0, -np.inf
        empty = np.zeros(1)
        axes = (uplot.Axis(label="time [s]"),)
        self._residual = server.gui.add_uplot(
            (empty, empty, empty, empty),
            (
                uplot.Series(label="time [s]"),
                uplot.Series(label="residual [deg]", stroke=VIOLET, width=2),
                uplot.Series(label="threshold [deg]", stroke=RED, dash=(6.0, 4.0)),
                uplot.Series(label="- threshold [deg]", stroke=RED, dash=(6.0, 4.0)),
            ),
            scales={"x": uplot.Scale(time=False)},
            axes=(*axes, uplot.Axis(label="residual [deg]")),
            title="Residual: error beyond that of free motion",
            height=180,
        )
        self._torque = server.gui.add_uplot(
            (empty, empty, empty, empty),
            (
                uplot.Series(label="time [s]"),
                uplot.Series(label="torque [N m]", stroke=VERMILION, width=2),
                uplot.Series(label="+ one deviation", stroke=ORANGE),
                uplot.Series(label="- one deviation", stroke=ORANGE),
            ),
            scales={"x": uplot.Scale(time=False)},
            axes=(*axes, uplot.Axis(label="torque [N m]")),
            title="External torque, as estimated",
            height=180,
        )

    def show(self, visible: bool) -> None:
        """Show or hide the curves, with their choice of the joint."""
        for part in (self.choice, self._name, self._residual, self._torque):
            part.visible = visible

    def update(
        self, pictures: Sequence[Picture], moment: Picture, contacts: Iterable[Contact]
    ) -> None:
        """Show some pictures, of a joint that is chosen at a moment with its contacts."""
        joint = self._chosen(moment, contacts)
        step = -(-len(pictures) // MAX_POINTS)
        shown = pictures[::step]
        time = np.array([p.time for p in shown])
        residual = np.degrees([p.residual[joint] for p in shown])
        threshold = np.degrees([p.threshold[joint] for p in shown])
        torque = np.array([p.torque[joint] for p in shown])
        std = np.array([p.torque_std[joint] for p in shown])
        name = self._names[joint]
        if name != self._named:  # not as titles: a chart with a new title is empty again
            self._named = name
            self._name.content = f"**{name}**"
        self._residual.data = (time, residual, threshold, -threshold)
        self._torque.data = (time, torque, torque + std, torque - std)

    def _chosen(self, picture: Picture, contacts: Iterable[Contact]) -> int:
        if self.choice.value != AUTOMATIC:
            return self._names.index(self.choice.value)
        touched = [self._names.index(c.shown_by) for c in contacts if c.shown_by is not None]
        if touched:
            self._since = picture.time
            if self._joint not in touched:
                self._joint = touched[-1]
            return self._joint
        if not self._since <= picture.time < self._since + HOLD_CHOICE:
            ratio = picture.excess
            best = int(ratio.argmax())
            if ratio[best] >= 1.0 or ratio[self._joint] < 0.5:
                self._joint, self._since = best, picture.time
        return self._joint


class Happenings:
    """List of contacts and events, the newest first.

    Args:
        server: Of the page.
        title: Above it.
    """

    def __init__(self, server: viser.ViserServer, title: str) -> None:
        self._title = title
        self._lines: deque[str] = deque(maxlen=SHOWN_LINES)
        self._html = server.gui.add_html("")
        self._draw()

    def show_list(self, visible: bool) -> None:
        """Show or hide the list."""
        self._html.visible = visible

    def clear(self) -> None:
        """Forget all."""
        self._lines.clear()
        self._draw()

    def add(self, item: Contact | LogEvent) -> None:
        """Add a line."""
        if isinstance(item, Contact) and item.phase == "update":
            return
        self._lines.appendleft(describe(item))
        self._draw()

    def show(self, items: Sequence[Contact | LogEvent]) -> None:
        """Show these, of which the last comes first."""
        self._lines.clear()
        for item in items:
            if not (isinstance(item, Contact) and item.phase == "update"):
                self._lines.appendleft(describe(item))
        self._draw()

    def _draw(self) -> None:
        lines = (
            "".join(f"<div>{html.escape(line)}</div>" for line in self._lines) or "<div>none</div>"
        )
        self._html.content = (
            f'<div style="font-size:0.8em;line-height:1.45;padding:0 1em 0.5em">'
            f"<b>{html.escape(self._title)}</b>{lines}</div>"
        )


def pair_table(pairs: Sequence[tuple[Contact | None, Contact | None]], *, recomputed: bool) -> str:
    """Return recorded and recomputed contacts next to each other as HTML, the newest first.

    Args:
        pairs: Those that match; None for a contact that only the other has.
        recomputed: False before a replay: there is one column.
    """
    heads = ("Recorded contacts", "Recomputed") if recomputed else ("Recorded contacts",)
    rows = [
        "".join(f"<td>{_touch(contact)}</td>" for contact in pair[: len(heads)])
        for pair in reversed(pairs)
    ] or ["<td>none until now</td>"]
    return (
        '<table style="font-size:0.8em;line-height:1.3;margin:0 1em 0.5em;width:90%;text-align:left">'
        f"<tr>{''.join(f'<th>{head}</th>' for head in heads)}</tr>"
        f"{''.join(f'<tr>{row}</tr>' for row in rows)}</table>"
    )


def _touch(contact: Contact | None) -> str:
    """Return onset, place and force or intensity of a contact as HTML."""
    if contact is None:
        return "&ndash;"
    text = f"{contact.onset_time:.2f} s {in_words(contact.link)}, {contact.kind}"
    size = contact.force_text or f"{contact.intensity_deg:.1f} deg"
    return html.escape(f"{text}, {size}")


def time_line(
    pairs: Sequence[tuple[Contact | None, Contact | None]],
    begin: float,
    end: float,
    *,
    recomputed: bool,
) -> str:
    """Return contacts over the time of a log as HTML: a bar for each, rebounds grey.

    Args:
        pairs: See :func:`pair_table`.
        begin: Of the log [s].
        end: The same.
        recomputed: False before a replay: there is one row.
    """
    names = ("recorded", "recomputed") if recomputed else ("recorded",)
    scale = LINE_WIDTH / max(end - begin, 1e-9)
    bars = []
    for row, color in enumerate((BLUE, ORANGE)[: len(names)]):
        for contact in (pair[row] for pair in pairs):
            if contact is None:
                continue
            left = scale * (contact.onset_time - begin)
            right = scale * ((contact.time if contact.phase == "end" else end) - begin)
            fill = GREY if contact.kind == "rebound" else color
            bars.append(
                f'<rect x="{left:.1f}" width="{max(right - left, MIN_BAR):.1f}" '
                f'y="{LINE_ROW * row + 1}" height="{LINE_ROW - 2}" fill="{fill}"/>'
            )
    height = LINE_ROW * len(names)
    return (
        '<div style="font-size:0.75em;padding:0 1em">Contacts: '
        + ", ".join(
            f'<span style="color:{c}">{n}</span>'
            for n, c in zip(names, (BLUE, ORANGE), strict=False)
        )
        + f'<svg viewBox="0 0 {LINE_WIDTH} {height}" preserveAspectRatio="none" '
        f'style="width:100%;height:{height}px;background:{SHADE};display:block">{"".join(bars)}</svg></div>'
    )


def describe(item: Contact | LogEvent) -> str:
    """Return one line about a contact or event."""
    if isinstance(item, LogEvent):
        words = [item.kind, item.name, item.phase or "", item.text]
        return f"{item.time:7.2f} s  {' '.join(word for word in words if word)}"
    if item.phase == "end":
        return f"{item.time:7.2f} s  {item.kind} on {item.limb} over"
    torque = "" if item.torque is None else f", {abs(item.torque):.1f} N m"
    if item.torque is not None and item.torque_std is not None:
        torque += f" ± {item.torque_std:.1f}"
    force = f", {item.force_text}" if item.force_text else ""
    place = f"{item.link} ({item.joint or 'base'})"
    return f"{item.time:7.2f} s  {item.kind} on {item.limb}: {place}{torque}{force}"


def stage_text(stages: Mapping[str, float]) -> str:
    """Return the times of the stages as one line."""
    if not stages:
        return ""
    own = sum(us for stage, us in stages.items() if stage not in ("read", "write"))
    parts = ", ".join(f"{stage} {us:.0f}" for stage, us in stages.items())
    return f"tick without the robot {own:.0f} us: {parts}"
