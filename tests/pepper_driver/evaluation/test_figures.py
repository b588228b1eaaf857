"""Figures of an evaluation: what is drawn of hand-made traces and fractions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.container import BarContainer
from matplotlib.figure import Figure

from pepper_driver.evaluation.episode_score import Trace
from pepper_driver.evaluation.figures import (
    RECALL_SUITES,
    Recall,
    contact_figure,
    fit_figure,
    recall_figure,
)
from pepper_driver.evaluation.metrics import fraction_interval
from support.evaluation import CYCLE, JOINT, ROBOT, contact, push

TIME = np.arange(round(30.0 / CYCLE)) * CYCLE
PUSH = push(2.0)


def trace(mode: str, experiment: str = "LSRoll", size: float = 1.0, **changes: Any) -> Trace:
    swing = np.radians(size) * np.sin(TIME)
    values: dict[str, Any] = {
        "mode": mode,
        "suite": "paper",
        "experiment": experiment,
        "task_stiffness": 8.0,
        "joint": JOINT,
        "time": TIME,
        "sent": 10.0 * swing,
        "position": 9.0 * swing,
        "others": {"HeadYaw": 2.0 * swing},
        "expected": 0.5 * swing,
        "residual": swing,
        "threshold": np.full(len(TIME), np.radians(2.5)),
        "pushes": (PUSH,),
        "contacts": (),
    }
    return Trace(**(values | changes))


def labels(figure: Figure) -> list[str]:
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def drawn(axes: Axes) -> set[str]:
    return {str(artist.get_label()) for artist in (*axes.lines, *axes.patches)}


def panels(figure: Figure, word: str) -> list[Axes]:
    return [axes for axes in figure.axes if word in axes.get_ylabel()]


def test_columns_have_titles_for_people_and_the_same_limits() -> None:
    modes = ("paper-affine", "fusion")
    figure = contact_figure(
        {
            "LSRoll": [trace(mode) for mode in modes],
            "RERoll": [trace(mode, "RERoll", 4.0, pushes=()) for mode in modes],
        },
        ROBOT,
    )
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert titles[0].startswith("experiment LSRoll: left shoulder roll (LShoulderRoll)\n")
    assert titles[0].endswith("1 push on this limb in these 20 s of 30 s")
    assert "no push on this limb" in titles[1]
    for word, count in (("position", 2), ("tracking error", 2), ("residual", 4)):
        assert len(panels(figure, word)) == count
        assert len({axes.get_ylim() for axes in panels(figure, word)}) == 1
    assert len(labels(figure)) == len(set(labels(figure)))
    assert set.union(*(drawn(axes) for axes in figure.axes)) == set(labels(figure))


def test_an_observer_without_a_trace_has_no_empty_panel() -> None:
    figure = contact_figure(
        {"LSRoll": [trace("fusion")], "RERoll": [trace("paper-affine", "RERoll")]}, ROBOT
    )
    assert len(figure.axes) == 2 * 2 + 2
    assert all(axes.lines for axes in figure.axes)
    assert [axes.get_xlabel() for axes in figure.axes].count("time [s]") == 2


def test_onsets_elsewhere_look_different() -> None:
    """A contact is where its last event puts it; its onset is an estimate."""
    contacts = (
        contact(1, 2.1),
        replace(contact(2, 5.0), joint="LShoulderPitch"),
        replace(contact(3, 8.0), kind="rebound"),
        contact(4, 11.0),
        replace(contact(4, 11.0), joint=None, phase="update"),
    )
    figure = contact_figure({"LSRoll": [trace("fusion", contacts=contacts)]}, ROBOT)
    (axes,) = panels(figure, "residual")
    onsets = {
        str(line.get_label()): line.get_linestyle()
        for line in axes.lines
        if "onset" in str(line.get_label())
    }
    assert onsets == {
        "contact, estimated onset": "--",
        "contact elsewhere, estimated onset": "-.",
        "rebound, estimated onset": ":",
    }
    assert sum("elsewhere" in str(line.get_label()) for line in axes.lines) == 2


def test_each_prediction_is_seen_beside_the_measurement() -> None:
    figure = fit_figure([trace("fusion"), trace("paper-affine"), trace("oracle")])
    lower = panels(figure, "tracking error")
    assert [drawn(axes) - {"measured"} for axes in lower] == [
        {"predicted for free motion by paper-affine"},
        {"predicted for free motion by fusion"},
    ]
    assert len({axes.get_ylim() for axes in lower}) == 1
    assert "left shoulder roll (LShoulderRoll)" in figure.get_suptitle()
    assert "20 s of 30 s" in figure.get_suptitle()
    (measured,) = panels(fit_figure([trace("oracle")]), "tracking error")
    assert drawn(measured) == {"measured"}


RECALLS = {
    "fusion": {"1-1.5": Recall(detected=24, count=30), "3-": Recall(detected=9, count=9)},
    "momentum": {"1-1.5": Recall(detected=14, count=28)},
}


def test_recall_has_intervals_and_counts() -> None:
    first, second = RECALL_SUITES
    figure = recall_figure({first: RECALLS, second: {"fusion": RECALLS["fusion"]}})
    left, right = figure.axes
    assert [axes.get_title() for axes in figure.axes] == list(RECALL_SUITES.values())
    assert left.get_ylim() == right.get_ylim()
    ticks = [text.get_text() for text in left.get_xticklabels()]
    assert ticks == ["1 to 1.5\nn = 28 to 30", "3 and more\nn = 9"], "no room for what is not there"
    assert next(text.get_text() for text in right.get_xticklabels()) == "1 to 1.5\nn = 30"
    bars = next(c for c in left.containers if isinstance(c, BarContainer))
    assert [bar.get_height() for bar in bars] == [0.8, 1.0]
    assert bars.errorbar is not None
    _, _, (whiskers,) = bars.errorbar.lines
    for segment, recall in zip(whiskers.get_segments(), RECALLS["fusion"].values(), strict=True):
        ends = fraction_interval(recall.detected, recall.count)
        assert np.asarray(segment)[:, 1] == pytest.approx(ends)
    assert labels(figure) == ["fusion", "momentum"]
