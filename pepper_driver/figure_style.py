"""Style of all figures: colours, lines, fonts, words for joints, legends and files; needs the extra ``plot``.

The colours are those of Okabe and Ito, which people with any colour vision can distinguish, with two dark ones more.
Lines that share a panel also differ in brightness, width or dashes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from functools import wraps
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np

from pepper_driver.config import MissingExtraError, PepperError, UnknownNameError
from pepper_driver.config.errors import reason

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

P = ParamSpec("P")
R = TypeVar("R")

BLACK, GREEN, ORANGE, BLUE = "#000000", "#009E73", "#E69F00", "#0072B2"
PINK, SKY, YELLOW, VERMILION = "#CC79A7", "#56B4E9", "#F0E442", "#D55E00"
RED, VIOLET = "#CC0000", "#5B2C83"
GREY, SHADE, GRID = "#7F7F7F", "#E2E2E2", "#EEEEEE"

Style = Mapping[str, Any]
"""Properties of a line, with its label."""
MEASURED: Style = {"color": BLACK, "linewidth": 1.2, "label": "measured"}
COMMANDED: Style = {
    "color": GREEN,
    "linestyle": "--",
    "linewidth": 1.5,
    "zorder": 2.5,
    "label": "commanded",
}
REQUESTED: Style = {
    "color": PINK,
    "linestyle": "-.",
    "linewidth": 1.5,
    "label": "requested, before the safety gate",
}
PREDICTED: Style = {
    "color": ORANGE,
    "linewidth": 2.5,
    "zorder": 1.9,
    "label": "predicted for free motion",
}
RESIDUAL: Style = {
    "color": VIOLET,
    "linewidth": 1.3,
    "label": "residual r: measured - predicted",
}
THRESHOLD: Style = {"color": RED, "linestyle": "--", "linewidth": 1.2, "label": "threshold of r"}
"""The red is the paper's."""

DPI = 100
RC: Style = {
    "font.size": 11.0,
    "axes.titlesize": 12.0,
    "axes.labelsize": 11.0,
    "xtick.labelsize": 10.0,
    "ytick.labelsize": 10.0,
    "legend.fontsize": 11.0,
    "hatch.linewidth": 0.7,
    "text.parse_math": False,  # a dollar in a name is a dollar
}
TITLE_SIZE, NOTE_SIZE = 13.0, 9.0
"""[pt]"""
LEGEND_COLUMN = 3.5
"""[inch] Width of the widest label with its line."""
OUTLIER = 40.0
"""Times the usual height of panels of one kind."""
FORMATS = ("png", "svg", "pdf")


class PlotError(PepperError, OSError):
    """A figure cannot be written."""


def check_plotting(what: str = "plotting") -> None:
    """Refuse figures before the work for them is done.

    Args:
        what: Is refused; for the message.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    if find_spec("matplotlib") is None:
        raise MissingExtraError(what, "plot")


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
    check_plotting()


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Draw with the fonts of all figures; where matplotlib is missing it raises MissingExtraError."""

    @wraps(draw)
    def with_style(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            import matplotlib as mpl
            import matplotlib.figure
        except ImportError as error:
            raise MissingExtraError("plotting", "plot") from error
        settings: Any = RC  # the stubs of matplotlib list every key
        with mpl.rc_context(settings):
            return draw(*args, **kwargs)

    return with_style


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure without a display, of a width and height [inch] at DPI dots."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=DPI, layout="constrained")


def save_figure(figure: Figure, path: Path, *, colours: int | None = None) -> None:
    """Write a figure; missing folders are made, an existing file is replaced.

    Args:
        figure: To write.
        path: PNG, SVG or PDF by suffix.
        colours: Of the palette of a PNG: a hundred are a third of the bytes, and no difference to the eye.

    Raises:
        PlotError: The file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if colours is None:
            figure.savefig(path)
        else:
            from PIL import Image  # matplotlib brings it

            picture = BytesIO()
            figure.savefig(picture, format="png")
            Image.open(picture).convert("RGB").quantize(colours).save(path, optimize=True)
    except OSError as error:
        raise PlotError(f"{path}: cannot be written ({reason(error)})") from error


def in_words(name: str) -> str:
    """Return the name of a joint, link or limb in words: ``left elbow roll`` for ``LElbowRoll``."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name.removesuffix("_link").replace("_", " "))
    side, rest = words[:1].lower(), words[1:].lstrip()
    if side in {"l", "r"} and (words[1:2] == " " or rest[:1].isupper()):
        words = f"{'left' if side == 'l' else 'right'} {rest}"
    return words.lower()


def joint_title(joint: str) -> str:
    """Return the name of a joint in words and as programs know it."""
    return f"{in_words(joint)} ({joint})"


def shown_in(joint: str, hands: Iterable[str]) -> tuple[float, str]:
    """Return the factor and the unit in which people read positions of a joint: degrees, of a hand per cent."""
    return (100.0, "% of aperture") if joint in hands else (float(np.rad2deg(1.0)), "deg")


def counted(count: int, noun: str) -> str:
    """Return a count with its noun: ``no push``, ``1 push``, ``2 pushes``."""
    ending = "es" if noun.endswith(("sh", "x")) else "s"
    return f"{count or 'no'} {noun}{'' if count < 2 else ending}"


def dress(axes: Axes) -> None:
    """Give a panel a pale grid below its data, and no frame where no axis is."""
    axes.grid(visible=True, color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def same_limits(
    panels: Iterable[Axes], *, min_span: float, symmetric: bool = False, margin: float = 0.06
) -> None:
    """Give panels of one kind the same limits, so that heights can be compared.

    A panel that is OUTLIER times as high as the others has limits of its own, and says so: next to it no line of theirs
    could be read.

    Args:
        panels: Of one quantity and unit; lines drawn in them count, what else is drawn does not.
        min_span: What is flatter is not enlarged beyond this height, in the unit of the panels.
        symmetric: With zero in the middle.
        margin: Room above and below, as a fraction of the height.
    """
    panels = list(panels)
    if not panels:
        return
    bounds = [_bounds(axes, symmetric=symmetric) for axes in panels]
    spans = [max(high - low, min_span) for low, high in bounds]
    usual = OUTLIER * sorted(spans)[(len(spans) - 1) // 2]
    alike = [bound for bound, span in zip(bounds, spans, strict=True) if span <= usual]
    common = min(low for low, _ in alike), max(high for _, high in alike)
    for axes, own, span in zip(panels, bounds, spans, strict=True):
        low, high = common if span <= usual else own
        middle, half = (low + high) / 2, max(high - low, min_span) / 2 * (1 + 2 * margin)
        axes.set_ylim(middle - half, middle + half)
        if span > usual:
            axes.set_title("other scale", loc="right", fontsize=NOTE_SIZE, color=RED)


def _bounds(axes: Axes, *, symmetric: bool) -> tuple[float, float]:
    """Return the least and the greatest value of the lines of a panel, 0 for none."""
    values = [np.asarray(line.get_ydata(), dtype=np.float64) for line in axes.lines]
    seen = np.concatenate([np.zeros(0), *(v[np.isfinite(v)] for v in values)])
    low, high = (float(seen.min()), float(seen.max())) if seen.size else (0.0, 0.0)
    return (-max(-low, high), max(-low, high)) if symmetric else (low, high)


def add_legend(figure: Figure | SubFigure) -> None:
    """Add one legend below all panels: every label once, in as many columns as are sure to fit."""
    entries: dict[str, Artist] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    figure.legend(
        list(entries.values()),
        list(entries),
        loc="outside lower center",
        ncols=min(max(int(figure.bbox.width / DPI / LEGEND_COLUMN), 1), len(entries)),
        frameon=False,
    )
