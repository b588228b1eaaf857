"""Figures 2, 3 and 4 of the paper again, with recall by size of push; needs the extra ``plot``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pepper_driver.config import MissingExtraError, RobotConfig
from pepper_driver.config.errors import reason
from pepper_driver.config.robot import TRUNK
from pepper_driver.evaluation.episode_score import Trace
from pepper_driver.evaluation.evaluate import EXPERIMENT_JOINTS, FIT_JOINT
from pepper_driver.evaluation.metrics import RECALL_BINS
from pepper_driver.evaluation.results import EvaluationResult
from pepper_driver.log.plots import BLACK, BLUE, GREEN, GREY, ORANGE, RED, SHADE, PlotError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WINDOW = 20.0
"""[s] of an episode in a figure, as in the paper."""
SHOWN = {"paper-affine": ORANGE, "fusion": BLUE}
"""Observers in the pictures of single episodes."""
_BARS = (BLUE, ORANGE, "#F5CE8B", GREEN, BLACK, GREY, RED)
_DPI = 80
_COLOURS = 96
"""Of the palette of a file: a third of the bytes of full colour, and no difference to the eye."""
_NAMES = ("figure2.png", "figure3.png", "figure4.png", "recall.png")


def check_plotting() -> None:
    """Refuse pictures before the work for them is done.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    if find_spec("matplotlib") is None:
        raise MissingExtraError("the pictures of a report", "plot")


def write_figures(evaluation: EvaluationResult, folder: Path, robot: RobotConfig) -> dict[str, str]:
    """Draw what the evaluation has data for.

    Args:
        evaluation: The results.
        folder: For the PNG files; made when there is something to draw.
        robot: Its description.

    Returns:
        By name of a file, what it shows.

    Raises:
        PlotError: A file cannot be written.
    """
    drawn: dict[str, tuple[Figure, str]] = {}
    swept = [t for t in evaluation.traces if t.suite == "fit" and t.joint == FIT_JOINT]
    if swept:
        drawn["figure2.png"] = (
            fit_figure(swept),
            f"Figure 2 of the paper: a test run of {FIT_JOINT}, its tracking error and the prediction.",
        )
    touched = {
        name: [t for t in evaluation.traces if t.suite == "paper" and t.experiment == name]
        for name in EXPERIMENT_JOINTS
    }
    first = {name: traces for name in ("LSRoll", "RERoll") if (traces := touched[name])}
    if first:
        drawn["figure3.png"] = (
            contact_figure(first, robot),
            "Figure 3: trajectories, expected error, contact observer signal r with its threshold; grey while the "
            "joint's limb is pushed, dashed blue where a contact begins.",
        )
    if touched["RSRoll"]:
        drawn["figure4.png"] = (
            contact_figure({"RSRoll": touched["RSRoll"]}, robot),
            "Figure 4: the same of RShoulderRoll, whose model was identified on the left.",
        )
    if any(_recalls(evaluation, mode) for mode in evaluation.modes):
        drawn["recall.png"] = (
            recall_figure(evaluation),
            "Fraction of pushes detected, by their size.",
        )
    for name in _NAMES:  # of an earlier run: they would not fit the new tables
        (folder / name).unlink(missing_ok=True)
    for name, (figure, _) in drawn.items():
        _save(figure, folder / name)
    return {name: caption for name, (_, caption) in drawn.items()}


def fit_figure(traces: Sequence[Trace]) -> Figure:
    """Trajectories above, tracking error and what observers expected of it below, in one episode."""
    from matplotlib.figure import Figure

    first = traces[0]
    rows = _window(first)
    time = first.time[rows] - first.time[rows][0]
    figure = Figure(figsize=(12.0, 6.5), dpi=_DPI, layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    _draw_ways(first, rows, top)
    bottom.plot(
        time, np.degrees((first.sent - first.position)[rows]), color=GREEN, label="measured"
    )
    for trace in traces:
        if trace.mode in SHOWN:
            bottom.plot(
                time,
                np.degrees(trace.expected[rows]),
                color=SHOWN[trace.mode],
                label=f"expected, {trace.mode}",
            )
    top.set_title(
        f"{first.joint}, test run, task stiffness {first.task_stiffness:g}: in simulation"
    )
    bottom.set_ylabel("tracking error [deg]")
    bottom.set_xlabel("time [s]")
    for axes in (top, bottom):
        _dress(axes)
    _legend(figure)
    return figure


def contact_figure(experiments: Mapping[str, Sequence[Trace]], robot: RobotConfig) -> Figure:
    """Return a column for each experiment: trajectories, expected error, and r of each observer with its threshold."""
    from matplotlib.figure import Figure

    modes = [
        mode
        for mode in SHOWN
        if any(t.mode == mode for group in experiments.values() for t in group)
    ]
    figure = Figure(
        figsize=(6.0 + 6.0 * len(experiments), 4.5 + 2.2 * len(modes)),
        dpi=_DPI,
        layout="constrained",
    )
    panels = figure.subplots(2 + len(modes), len(experiments), sharex="col", squeeze=False)
    for column, (name, traces) in zip(panels.T, experiments.items(), strict=True):
        by_mode = {trace.mode: trace for trace in traces}
        first = traces[0]
        rows = _window(first)
        time = first.time[rows] - first.time[rows][0]
        _draw_ways(first, rows, column[0])
        column[0].set_title(
            f"{name}: {first.joint}, task stiffness {first.task_stiffness:g}, in simulation"
        )
        error = np.degrees((first.sent - first.position)[rows])
        column[1].plot(time, error, color=GREEN, label="measured")
        for mode in modes:
            if mode in by_mode:
                expected = np.degrees(by_mode[mode].expected[rows])
                column[1].plot(time, expected, color=SHOWN[mode], label=f"expected, {mode}")
        column[1].set_ylabel("tracking error [deg]")
        for axes, mode in zip(column[2:], modes, strict=True):
            if mode in by_mode:
                _draw_residual(by_mode[mode], rows, robot, axes)
            axes.set_ylabel(f"r, {mode} [deg]")
        column[-1].set_xlabel("time [s]")
        for axes in column:
            _shade(first, rows, robot, axes)
            _dress(axes)
    _legend(figure)
    return figure


def recall_figure(evaluation: EvaluationResult) -> Figure:
    """Bars of recall by size of push, a colour for each observer."""
    from matplotlib.figure import Figure

    modes = [mode for mode in evaluation.modes if _recalls(evaluation, mode)]
    figure = Figure(figsize=(9.0, 4.0), dpi=_DPI, layout="constrained")
    axes = figure.subplots()
    width = 0.8 / len(modes)
    places = np.arange(len(RECALL_BINS))
    for number, mode in enumerate(modes):
        recalls = [_recalls(evaluation, mode).get(name, np.nan) for name in RECALL_BINS]
        axes.bar(
            places - 0.4 + (number + 0.5) * width,
            recalls,
            width,
            color=_BARS[number % len(_BARS)],
            label=mode,
        )
    axes.set_xticks(places, [_size(name) for name in RECALL_BINS])
    axes.set_xlabel("size of the push [equivalent degrees]")
    axes.set_ylabel("fraction detected, in simulation")
    axes.set_xlim(-0.5, len(RECALL_BINS) - 0.5)
    axes.set_ylim(0.0, 1.0)
    axes.grid(visible=True, axis="y", color="#EEEEEE")
    axes.set_axisbelow(True)
    figure.legend(loc="outside upper center", ncols=len(modes), frameon=False)
    return figure


def _size(name: str) -> str:
    return f"{name.removesuffix('-')} and more" if name.endswith("-") else name.replace("-", " to ")


def _recalls(evaluation: EvaluationResult, mode: str) -> dict[str, float]:
    metrics = evaluation.modes[mode].get("collision")
    recalls = metrics.recall if metrics is not None else {}
    return {name: value for name, value in recalls.items() if value is not None}


def _window(trace: Trace) -> slice:
    """Rows of the WINDOW with most pushes; the first WINDOW without any."""
    time = trace.time
    starts = [time[0], *(push.onset - 1.0 for push in trace.pushes)]
    last = max(time[-1] - WINDOW, time[0])
    starts = [float(min(max(start, time[0]), last)) for start in starts]

    def inside(start: float) -> int:
        return sum(start <= p.onset and p.release <= start + WINDOW for p in trace.pushes)

    begin = max(starts, key=inside)
    return slice(*np.searchsorted(time, (begin, begin + WINDOW)).tolist())


def _draw_ways(trace: Trace, rows: slice, axes: Axes) -> None:
    time = trace.time[rows] - trace.time[rows][0]
    for position in trace.others.values():
        axes.plot(
            time,
            np.degrees(position[rows]),
            color=GREY,
            linewidth=0.7,
            label="other joints, as sent",
        )
    axes.plot(
        time, np.degrees(trace.sent[rows]), color=BLACK, linestyle="--", label="desired, as sent"
    )
    axes.plot(time, np.degrees(trace.position[rows]), color=GREEN, label="measured")
    axes.set_ylabel("position [deg]")


def _draw_residual(trace: Trace, rows: slice, robot: RobotConfig, axes: Axes) -> None:
    start, end = trace.time[rows][0], trace.time[rows][-1]
    time = trace.time[rows] - start
    threshold = np.degrees(trace.threshold[rows])
    residual = np.degrees(trace.residual[rows])
    axes.plot(time, residual, color=BLACK, linewidth=1.0, label="contact observer signal r")
    for sign in (1.0, -1.0):
        axes.plot(
            time, sign * threshold, color=RED, linestyle="--", linewidth=1.0, label="threshold"
        )
    limb = robot.limb_of(trace.joint)
    for contact in trace.contacts:
        if (
            contact.phase == "begin"
            and robot.limb_of(contact.joint) in (limb, TRUNK)
            and start <= contact.onset_time <= end
        ):
            rebound = contact.kind == "rebound"
            axes.axvline(
                contact.onset_time - start,
                color=GREY if rebound else BLUE,
                linestyle=":" if rebound else "--",
                linewidth=1.2,
                label="rebound begins" if rebound else "contact begins",
            )


def _shade(trace: Trace, rows: slice, robot: RobotConfig, axes: Axes) -> None:
    start, end = trace.time[rows][0], trace.time[rows][-1]
    limb = robot.limb_of(trace.joint)
    for push in trace.pushes:
        if robot.limb_of(push.joint) == limb and push.release > start and push.onset < end:
            axes.axvspan(
                max(push.onset, start) - start,
                min(push.release, end) - start,
                color=SHADE,
                linewidth=0.0,
                zorder=0.0,
                label="true push on this limb",
            )


def _dress(axes: Axes) -> None:
    axes.margins(x=0.0)
    axes.grid(visible=True, color="#EEEEEE", linewidth=0.8)
    axes.set_axisbelow(True)


def _legend(figure: Figure) -> None:
    """One legend for all panels, every label once."""
    entries: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    figure.legend(
        list(entries.values()), list(entries), loc="outside lower center", ncols=5, frameon=False
    )


def _save(figure: Figure, path: Path) -> None:
    from PIL import Image  # matplotlib brings it

    picture = BytesIO()
    figure.savefig(picture, format="png")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.open(picture).convert("RGB").quantize(_COLOURS).save(path, optimize=True)
    except OSError as error:
        raise PlotError(f"{path}: cannot be written ({reason(error)})") from error
