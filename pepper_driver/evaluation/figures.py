"""Figures 2, 3 and 4 of the paper again; needs the extra ``plot``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.robot import TRUNK
from pepper_driver.evaluation.episode_score import Trace
from pepper_driver.evaluation.evaluate import EXPERIMENT_JOINTS, FIT_JOINT
from pepper_driver.evaluation.results import EvaluationResult
from pepper_driver.figure_style import (
    BLUE,
    COMMANDED,
    GREY,
    MEASURED,
    ORANGE,
    PREDICTED,
    RESIDUAL,
    SHADE,
    SKY,
    THRESHOLD,
    TITLE_SIZE,
    Style,
    add_legend,
    counted,
    dress,
    joint_title,
    new_figure,
    same_limits,
    save_figure,
    styled,
)
from pepper_driver.observer import Contact, KnownPush

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WINDOW = 20.0
"""[s] of an episode in a figure, as in the paper."""
SHOWN: dict[str, Style] = {
    "paper-affine": {"color": ORANGE, "linewidth": 2.5, "zorder": 1.9},
    "fusion": {"color": SKY, "linewidth": 1.5, "zorder": 2.2},
}
"""Observers in the figures of single episodes: their predictions, below and above the black line of the measurement."""
_COLOURS = 96
_NAMES = ("figure2.png", "figure3.png", "figure4.png")


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
            f"Figure 2 of the paper: a test run of {FIT_JOINT}, its tracking error and the predictions of two "
            "observers.",
        )
    touched = {
        name: [t for t in evaluation.traces if t.suite == "paper" and t.experiment == name]
        for name in EXPERIMENT_JOINTS
    }
    first = {name: traces for name in ("LSRoll", "RERoll") if (traces := touched[name])}
    if first:
        drawn["figure3.png"] = (
            contact_figure(first, robot),
            "Figure 3: trajectories, tracking error with its prediction, residual r with its threshold; grey while the "
            "joint's limb is pushed. Dashed lines are onsets as the observer estimates them, which can be before the "
            "push; dash-dotted ones are of contacts that it reports on another joint of the limb, or on the trunk.",
        )
    if touched["RSRoll"]:
        drawn["figure4.png"] = (
            contact_figure({"RSRoll": touched["RSRoll"]}, robot),
            "Figure 4: the same of RShoulderRoll, whose model was identified on the left.",
        )
    for name in _NAMES:  # of an earlier run: they would not fit the new tables
        (folder / name).unlink(missing_ok=True)
    for name, (figure, _) in drawn.items():
        save_figure(figure, folder / name, colours=_COLOURS)
    return {name: caption for name, (_, caption) in drawn.items()}


@styled
def fit_figure(traces: Sequence[Trace]) -> Figure:
    """Trajectories above; below a panel for each observer, with the tracking error and what it predicted of it."""
    by_mode = {trace.mode: trace for trace in traces if trace.mode in SHOWN}
    first = traces[0]
    rows = _window(first)
    figure = new_figure(12.0, 4.2 + 2.8 * max(len(by_mode), 1))
    top, *lower = figure.subplots(1 + max(len(by_mode), 1), 1, sharex=True)
    _draw_positions(first, rows, top)
    for axes, mode in zip(lower, [m for m in SHOWN if m in by_mode] or [first.mode], strict=True):
        _draw_errors({mode: by_mode.get(mode, first)}, rows, axes)
    same_limits(lower, min_span=1.0)
    figure.suptitle(
        f"Free motion of the {joint_title(first.joint)}, in simulation\n"
        f"test run, task stiffness {first.task_stiffness:g}, {WINDOW:g} s of {_seconds(first)}",
        fontsize=TITLE_SIZE,
    )
    lower[-1].set_xlabel("time [s]")
    for axes in (top, *lower):
        axes.margins(x=0.0)
        dress(axes)
    add_legend(figure)
    return figure


@styled
def contact_figure(experiments: Mapping[str, Sequence[Trace]], robot: RobotConfig) -> Figure:
    """Return a column for each experiment: trajectories, tracking error, and r of each observer with its threshold.

    Panels of a row have the same limits, those of all residuals too. A panel without data is left out.
    """
    modes = [
        mode
        for mode in SHOWN
        if any(t.mode == mode for group in experiments.values() for t in group)
    ]
    figure = new_figure(max(8.5 * len(experiments), 11.0), 6.5 + 2.3 * len(modes))
    grid = figure.add_gridspec(2 + len(modes), len(experiments))
    positions, errors, residuals = [], [], []
    for column, (name, traces) in enumerate(experiments.items()):
        by_mode = {trace.mode: trace for trace in traces}
        first = traces[0]
        rows = _window(first)
        panels = [figure.add_subplot(grid[row, column]) for row in (0, 1)]
        _draw_positions(first, rows, panels[0])
        positions.append(panels[0])
        panels[0].set_title("\n".join(_experiment_remarks(name, first, rows, robot)))
        _draw_errors(by_mode, rows, panels[1])
        errors.append(panels[1])
        for row, mode in enumerate(modes):
            if mode in by_mode:
                axes = figure.add_subplot(grid[2 + row, column])
                _draw_residual(by_mode[mode], rows, robot, axes)
                panels.append(axes)
                residuals.append(axes)
        for axes in panels:
            axes.tick_params(labelbottom=axes is panels[-1])
            _shade(first, rows, robot, axes)
            axes.set_xlim(0.0, first.time[rows][-1] - first.time[rows][0])
            dress(axes)
        panels[-1].set_xlabel("time [s]")
    for alike, symmetric in ((positions, False), (errors, False), (residuals, True)):
        same_limits(alike, min_span=1.0, symmetric=symmetric)
    figure.suptitle("Pushes on a moving Pepper, in simulation", fontsize=TITLE_SIZE)
    add_legend(figure)
    return figure


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


def _seconds(trace: Trace) -> str:
    return f"{trace.time[-1] - trace.time[0]:.0f} s"


def _experiment_remarks(name: str, trace: Trace, rows: slice, robot: RobotConfig) -> list[str]:
    """Return the title of an experiment: the joint, how it moves and how often its limb is pushed."""
    pushes = sum(_in_window(trace, rows, push.onset, push.release) for push in _own(trace, robot))
    return [
        f"experiment {name}: {joint_title(trace.joint)}",
        f"task stiffness {trace.task_stiffness:g}; {counted(pushes, 'push')} on this limb "
        f"in these {trace.time[rows][-1] - trace.time[rows][0]:.0f} s of {_seconds(trace)}",
    ]


def _own(trace: Trace, robot: RobotConfig) -> list[KnownPush]:
    """Pushes on the limb of a trace."""
    limb = robot.limb_of(trace.joint)
    return [push for push in trace.pushes if robot.limb_of(push.joint) == limb]


def _in_window(trace: Trace, rows: slice, begin: float, end: float) -> bool:
    return bool(end > trace.time[rows][0] and begin < trace.time[rows][-1])


def _draw_positions(trace: Trace, rows: slice, axes: Axes) -> None:
    time = trace.time[rows] - trace.time[rows][0]
    for position in trace.others.values():
        axes.plot(
            time,
            np.degrees(position[rows]),
            color=GREY,
            linewidth=0.8,
            label="other joints, commanded",
        )
    axes.plot(time, np.degrees(trace.position[rows]), **MEASURED)
    axes.plot(time, np.degrees(trace.sent[rows]), **COMMANDED)
    axes.set_ylabel("position [deg]")


def _draw_errors(by_mode: Mapping[str, Trace], rows: slice, axes: Axes) -> None:
    """Draw the tracking error, and what each observer predicted of it."""
    first = next(iter(by_mode.values()))
    time = first.time[rows] - first.time[rows][0]
    axes.plot(time, np.degrees((first.sent - first.position)[rows]), **MEASURED)
    for mode, style in SHOWN.items():
        if mode in by_mode:
            expected = np.degrees(by_mode[mode].expected[rows])
            axes.plot(time, expected, **style, label=f"{PREDICTED['label']} by {mode}")
    axes.set_ylabel("tracking error [deg]")


def _draw_residual(trace: Trace, rows: slice, robot: RobotConfig, axes: Axes) -> None:
    start, end = trace.time[rows][0], trace.time[rows][-1]
    time = trace.time[rows] - start
    threshold = np.degrees(trace.threshold[rows])
    axes.plot(time, np.degrees(trace.residual[rows]), **RESIDUAL)
    for sign in (1.0, -1.0):
        axes.plot(time, sign * threshold, **THRESHOLD)
    axes.set_ylabel(f"residual r [deg]\n{trace.mode}")
    limb = robot.limb_of(trace.joint)
    last = {contact.id: contact for contact in trace.contacts}
    for contact in last.values():
        if robot.limb_of(contact.joint) in (limb, TRUNK) and start <= contact.onset_time <= end:
            axes.axvline(contact.onset_time - start, **_onset_style(contact, trace.joint))


def _onset_style(contact: Contact, joint: str) -> Style:
    if contact.kind == "rebound":
        style = {"color": GREY, "linestyle": ":", "label": "rebound, estimated onset"}
    elif contact.shown_by == joint:
        style = {"color": BLUE, "linestyle": "--", "label": "contact, estimated onset"}
    else:
        style = {"color": SKY, "linestyle": "-.", "label": "contact elsewhere, estimated onset"}
    return {**style, "linewidth": 1.5}


def _shade(trace: Trace, rows: slice, robot: RobotConfig, axes: Axes) -> None:
    start, end = trace.time[rows][0], trace.time[rows][-1]
    for push in _own(trace, robot):
        if _in_window(trace, rows, push.onset, push.release):
            axes.axvspan(
                max(push.onset, start) - start,
                min(push.release, end) - start,
                color=SHADE,
                linewidth=0.0,
                zorder=0.0,
                label="true push on this limb",
            )
