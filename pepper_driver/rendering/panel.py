"""Signals next to the robot: residuals of joints with their thresholds, contacts, and a cursor of time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pepper_driver.config.arrays import PixelArray
from pepper_driver.figure_style import (
    RESIDUAL,
    THRESHOLD,
    dress,
    in_words,
    joint_title,
    same_limits,
    shown_in,
    styled,
)
from pepper_driver.log import RunLog
from pepper_driver.log.plots import (
    BAR,
    mark_contacts,
    mark_faults,
    mark_pushes,
    mark_reflexes,
    reflex_names,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_JOINTS = 3
"""One below the other."""

DPI = 100
FONT_SIZE = 9.0
"""[pt] where the shorter side of the panel has 480 pixels."""

MIN_FONT_SIZE = 5.0
"""[pt] The legend has two columns where its letters are larger."""
LEGEND_HANDLE, LEGEND_LETTER = 4.8, 0.53
"""Width of a sign of the legend with its space, and of a letter on average, as multiples of the size of the letters."""

CURSOR = np.array([220, 40, 40], dtype=np.uint8)
CURSOR_WIDTH = 2
"""Pixels."""

FADE = 0.6
"""Fraction by which later parts are faded to white."""

MIN_SPAN, NAME_ROOM = 1.0, 0.15
"""Least height of a panel [deg] or [%], and room above and below for names, as a fraction of it."""

MIN_NAMED = 0.06
"""Fraction of the panel's width from which a contact's name is written into it."""


class SignalPanel:
    """The residuals over the time of a film, drawn once; a picture of a moment adds the cursor.

    Args:
        log: What was recorded.
        joints: At most ``MAX_JOINTS``.
        start: Begin of the film [s].
        stop: Its end [s].
        width: Of the panel, in pixels.
        height: The same.
    """

    def __init__(
        self,
        log: RunLog,
        joints: Sequence[str],
        start: float,
        stop: float,
        width: int,
        height: int,
    ) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        figure = residual_figure(log, joints, start, stop, width, height)
        canvas: Any = FigureCanvasAgg(figure)  # its methods have no types
        canvas.draw()
        self._all = np.asarray(canvas.buffer_rgba())[..., :3].copy()
        self._later = self._all.copy()
        self._boxes: list[tuple[int, int]] = []
        for axes in figure.axes:
            box = axes.get_window_extent()
            left, right = round(box.x0), round(box.x1)
            top, bottom = height - round(box.y1), height - round(box.y0)
            part = self._later[top:bottom, left:right].astype(np.float64)
            self._later[top:bottom, left:right] = part + FADE * (255.0 - part)
            self._boxes.append((top, bottom))
        self._left, self._right = left, right
        self._start, self._stop = start, stop

    def draw(self, time: float) -> PixelArray:
        """Return (height, width, 3) pixels at a moment: what comes later is faint."""
        ratio = (time - self._start) / (self._stop - self._start)
        x = self._left + round(float(np.clip(ratio, 0.0, 1.0)) * (self._right - self._left))
        pixels = self._all.copy()
        pixels[:, x : self._right] = self._later[:, x : self._right]
        for top, bottom in self._boxes:
            pixels[top:bottom, max(0, x - CURSOR_WIDTH // 2) :][:, :CURSOR_WIDTH] = CURSOR
        return pixels


@styled
def residual_figure(
    log: RunLog, joints: Sequence[str], start: float, stop: float, width: int, height: int
) -> Figure:
    """Return a figure with the residuals of joints, one below the other; the arguments are those of the panel."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, layout="constrained")
    panels: list[Axes] = list(figure.subplots(len(joints), 1, sharex=True, squeeze=False)[:, 0])
    size = float(np.clip(FONT_SIZE * min(height, width) / 480.0, 6.0, 16.0))
    for axes, joint in zip(panels, joints, strict=True):
        axes.set_xlim(start, stop)
        _draw_residual(log, joint, axes, size)
    _set_limits(log, joints, panels)
    for axes, joint in zip(panels, joints, strict=True):
        mark_pushes(log, joint, axes)
        mark_contacts(log, joint, axes)
        mark_reflexes(log, joint, axes)
        mark_faults(log, axes)
        _name_contacts(log, joint, axes, size)
    panels[-1].set_xlabel("time [s]", fontsize=size)
    _add_legend(figure, panels, size)
    return figure


def joints_to_show(log: RunLog, start: float, stop: float) -> list[str]:
    """Return the joints that showed most contacts in a stretch of time, in joint order.

    Without contacts it is the joint that came nearest to its threshold, and none where nothing was observed.
    """
    detected = Counter(
        contact.shown_by
        for contact, end in log.lasting_contacts()
        if contact.shown_by in log.joint_names and contact.onset_time <= stop and end >= start
    )
    if detected:
        return sorted(
            (joint for joint, _ in detected.most_common(MAX_JOINTS)), key=log.joint_names.index
        )
    rows = (log["time"] >= start) & (log["time"] <= stop)
    with np.errstate(invalid="ignore", divide="ignore"):
        excess = np.nan_to_num(np.abs(log["residual"][rows]) / log["threshold"][rows], posinf=0.0)
    best = excess.max(axis=0, initial=0.0)
    return [log.joint_names[int(best.argmax())]] if best.any() else []


def _draw_residual(log: RunLog, joint: str, axes: Axes, size: float) -> None:
    index = log.joint_names.index(joint)
    first, last = axes.get_xlim()
    rows = (log["time"] >= first) & (log["time"] <= last)
    factor, unit = shown_in(joint, log.hand_joints)
    time = log["time"][rows]
    residual, threshold = (log[name][rows, index] * factor for name in ("residual", "threshold"))
    axes.plot(time, residual, **RESIDUAL)
    for sign in (1.0, -1.0):
        axes.plot(time, sign * threshold, **THRESHOLD)
    axes.set_title(joint_title(joint), fontsize=size)
    axes.set_ylabel(f"residual r [{unit}]", fontsize=size)
    axes.tick_params(labelsize=0.85 * size)
    dress(axes)


def _set_limits(log: RunLog, joints: Sequence[str], panels: Sequence[Axes]) -> None:
    """Give joints of the same unit the same limits, symmetric and with room for names of contacts and bars."""
    for hands in (False, True):
        alike = [a for a, j in zip(panels, joints, strict=True) if (j in log.hand_joints) == hands]
        same_limits(alike, min_span=MIN_SPAN, symmetric=True, margin=NAME_ROOM)


def _name_contacts(log: RunLog, joint: str, axes: Axes, size: float) -> None:
    """Write the link into the area of each contact of a joint; rebounds are hatched, and would lie over the next."""
    first, last = axes.get_xlim()
    for contact, end in log.lasting_contacts():
        begin, end = max(contact.onset_time, first), min(end, last)
        if contact.kind == "rebound" or contact.shown_by != joint:
            continue
        if end - begin > MIN_NAMED * (last - first):
            axes.text(
                0.5 * (begin + end),
                0.96 - BAR * len(reflex_names(log)),
                f"{contact.kind}\n{in_words(contact.link)}",
                transform=axes.get_xaxis_transform(),
                ha="center",
                va="top",
                fontsize=0.8 * size,
                clip_on=True,
            )


def _add_legend(figure: Figure, panels: Sequence[Axes], size: float) -> None:
    entries: dict[str, Artist] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    letters = LEGEND_HANDLE + LEGEND_LETTER * max(map(len, entries), default=0)
    fitting = 72.0 * figure.get_figwidth() / (2.0 * letters)  # in two columns
    wide = fitting > MIN_FONT_SIZE
    figure.legend(
        list(entries.values()),
        list(entries),
        loc="outside lower center",
        ncols=2 if wide else 1,
        frameon=False,
        fontsize=min(0.85 * size, fitting if wide else size),
    )
