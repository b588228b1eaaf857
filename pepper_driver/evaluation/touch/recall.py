"""Pictures of the fraction of touches that are detected, over force; and all pictures of a summary. Needs ``plot``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.evaluation.touch.map import TICKS, law_in_words, n90_figure
from pepper_driver.evaluation.touch.n90 import CONFIDENCE, N90_FRACTION
from pepper_driver.evaluation.touch.observers import ABLATIONS, FUSION, MATCHED
from pepper_driver.evaluation.touch.summary_data import (
    GROUPS,
    Cell,
    ForceFraction,
    ObserverSummary,
    TouchSummary,
)
from pepper_driver.figure_style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PINK,
    SKY,
    TITLE_SIZE,
    VERMILION,
    VIOLET,
    add_legend,
    dress,
    new_figure,
    save_figure,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Lines = Mapping[str, Sequence[ForceFraction]]
"""By label, fractions from the smallest force up."""

COLUMNS = 4
"""Panels of a row."""

APART = 1.03
"""Factor in force from the bars of one line to those of the next: they must not hide each other."""

OBSERVERS_AT = ("hand", "forearm", "upper arm", "head")
OBSERVERS_IN = ("standing", "in motion")
"""Places and groups of states in the picture that compares observers."""

_STYLES = (
    (BLUE, "o", "-"),
    (ORANGE, "s", "--"),
    (GREEN, "^", "-."),
    (VERMILION, "v", ":"),
    (SKY, "D", "-"),
    (PINK, "P", "--"),
    (VIOLET, "X", "-."),
    (GREY, "<", ":"),
    (BLACK, ">", "-"),
    (ORANGE, "*", "-"),
)
"""Colour, marker and dashes of each line."""


@styled
def recall_figure(panels: Mapping[str, Lines], title: str) -> Figure:
    """Draw one panel for each entry, with the fraction detected over the force that acted, and whiskers (Wilson).

    Args:
        panels: By title. A label has the same colour in each of them.
        title: Of the picture.
    """
    labels = list(dict.fromkeys(label for lines in panels.values() for label in lines))
    columns = max(min(COLUMNS, len(panels)), 1)
    rows = max(-(-len(panels) // columns), 1)
    figure = new_figure(max(3.3 * columns, 8.0), 3.0 * rows + 1.5)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for number, axes in enumerate(grid.ravel()):
        if number >= len(panels):
            axes.set_axis_off()
            continue
        name, lines = list(panels.items())[number]
        _draw(axes, lines, labels)
        axes.set_title(name)
        if number % columns == 0:
            axes.set_ylabel("fraction detected")
        if number + columns >= len(panels):
            axes.set_xlabel("force that acted [N]")
            axes.tick_params(labelbottom=True)
    figure.suptitle(
        f"{title}\nwhiskers: {CONFIDENCE:.0%} interval; dashed: the fraction of N90",
        fontsize=TITLE_SIZE,
    )
    if labels:
        add_legend(figure)
    return figure


def _draw(axes: Axes, lines: Lines, labels: Sequence[str]) -> None:
    axes.set_xscale("log")
    axes.set_xlim(TICKS[0] / 1.25, TICKS[-1] * 1.25)
    axes.set_ylim(-0.03, 1.05)
    axes.axhline(N90_FRACTION, color=GREY, linestyle=(0, (4, 3)), linewidth=1.0)
    for label, fractions in lines.items():
        number = labels.index(label)
        colour, marker, dashes = _STYLES[number % len(_STYLES)]
        known = sorted(
            (one for one in fractions if one.detected.fraction is not None),
            key=lambda one: one.acted,
        )
        shift = APART ** (number - (len(labels) - 1) / 2.0)
        fraction = np.array([one.detected.fraction for one in known], dtype=np.float64)
        ends = np.array([(one.detected.low, one.detected.high) for one in known]).reshape(-1, 2)
        axes.errorbar(
            [one.acted * shift for one in known],
            fraction,
            yerr=np.abs(ends.T - fraction),
            color=colour,
            marker=marker,
            markersize=5.0,
            linestyle=dashes,
            linewidth=1.6,
            elinewidth=0.9,
            capsize=2.0,
            label=label,
        )
    axes.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
    axes.minorticks_off()
    dress(axes)


def recall_by_group(observer: ObserverSummary, law: str, places: Sequence[str]) -> dict[str, Lines]:
    """Return a panel for each place that was touched, with a line for each group of states."""
    panels = {place: _lines({g: observer.group(law, place, g) for g in GROUPS}) for place in places}
    return {place: lines for place, lines in panels.items() if lines}


def recall_by_observer(observers: Sequence[ObserverSummary], law: str) -> dict[str, Lines]:
    """Return a panel for each of OBSERVERS_AT and OBSERVERS_IN, with a line for each observer."""
    panels = {
        f"{place}, {group}": _lines({o.name: o.group(law, place, group) for o in observers})
        for group in OBSERVERS_IN
        for place in OBSERVERS_AT
    }
    return {name: lines for name, lines in panels.items() if lines}


def _lines(cells: Mapping[str, Cell | None]) -> Lines:
    return {name: cell.forces for name, cell in cells.items() if cell is not None and cell.forces}


def write_touch_pictures(
    summary: TouchSummary,
    folder: Path,
    robot: RobotConfig,
    *,
    ours: str = FUSION,
    simulated: bool = True,
) -> dict[str, str]:
    """Draw what the summary has data for.

    Args:
        summary: All results.
        folder: For the files; made when there is something to draw. Pictures of an earlier run are removed.
        robot: Its description.
        ours: Name of the project's own observer.
        simulated: False for real robots.

    Returns:
        By name of a file, what it shows.

    Raises:
        PlotError: A file cannot be written.
    """
    drawn: dict[str, tuple[Figure, str]] = {}
    where = ", in simulation" if simulated else ""
    observer = summary.observer(ours)
    if observer is not None and observer.groups:
        drawn["touch_map.png"] = (
            n90_figure(observer, summary.laws, robot, simulated=simulated),
            "N90 by place: the force at which nine touches of 1 s in ten are detected. Hatched: not reached.",
        )
        for law in summary.laws:
            if panels := recall_by_group(observer, law, summary.places):
                title = f"Touches of 1 s that are detected{where}: {_law(law)}"
                drawn[f"touch_recall_{law}.png"] = (
                    recall_figure(panels, title),
                    f"Fraction of touches that are detected, by force and place: {_law(law)}. Intervals: Wilson.",
                )
            others = _compared(summary)
            if len(others) > 1 and (panels := recall_by_observer(others, law)):
                title = f"Touches of 1 s that each observer detects{where}: {_law(law)}"
                drawn[f"touch_recall_observers_{law}.png"] = (
                    recall_figure(panels, title),
                    f"The same for each observer, baselines with matched thresholds: {_law(law)}.",
                )
    for old in folder.glob("touch_*.png"):
        old.unlink()
    for name, (figure, _) in drawn.items():
        save_figure(figure, folder / name, colours=256 if name == "touch_map.png" else 96)
    return {name: caption for name, (_, caption) in drawn.items()}


def _compared(summary: TouchSummary) -> list[ObserverSummary]:
    """Return the observers that are compared: of a baseline with a matched threshold, the matched one."""
    names = [o.name for o in summary.observers if o.robots and o.name not in ABLATIONS]
    return [o for o in summary.observers if o.name in names and o.name + MATCHED not in names]


def _law(law: str) -> str:
    return law_in_words(law).replace("\n", " ")
