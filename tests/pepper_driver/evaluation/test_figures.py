"""Figures of an evaluation: drawings of hand-made traces."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pepper_driver.evaluation.episode_score import Trace
from pepper_driver.evaluation.figures import contact_figure, fit_figure
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
        replace(contact(2, 5.0), shown_by="LShoulderPitch"),
        replace(contact(3, 8.0), kind="rebound"),
        contact(4, 11.0),
        replace(contact(4, 11.0), joint=None, shown_by=None, phase="update"),
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


def test_each_prediction_is_drawn_with_the_measurement() -> None:
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
