"""Signals next to the robot: what is drawn, in which unit and scale, and where the cursor stands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("matplotlib")
from matplotlib.axes import Axes

from pepper_driver.figure_style import in_words, joint_title
from pepper_driver.log import RunLog, read_log
from pepper_driver.rendering.panel import (
    CURSOR,
    MAX_JOINTS,
    SignalPanel,
    joints_to_show,
    residual_figure,
)
from support.rendering import pushed_robot

JOINTS = ["LShoulderRoll", "LElbowRoll", "LHand"]
START, STOP = 3.8, 5.2


@pytest.fixture(scope="module")
def log(request: pytest.FixtureRequest) -> RunLog:
    return read_log(pushed_robot(request))


def lines(axes: Axes, label: str) -> list[np.ndarray]:
    return [np.asarray(line.get_ydata()) for line in axes.lines if line.get_label() == label]


def test_residuals_stand_between_their_thresholds_in_units_for_people(log: RunLog) -> None:
    figure = residual_figure(log, JOINTS, START, STOP, 700, 720)
    rows = (log["time"] >= START) & (log["time"] <= STOP)
    for axes, joint in zip(figure.axes, JOINTS, strict=True):
        index = log.joint_names.index(joint)
        factor = 100.0 if joint == "LHand" else np.degrees(1.0)
        (residual,) = lines(axes, "residual r: measured - predicted")
        upper, lower = lines(axes, "threshold of r")
        np.testing.assert_allclose(residual, log["residual"][rows, index] * factor)
        np.testing.assert_allclose(upper, log["threshold"][rows, index] * factor)
        np.testing.assert_allclose(lower, -upper)
        assert axes.get_title() == joint_title(joint)
        assert axes.get_xlim() == (START, STOP)
    units = [axes.get_ylabel() for axes in figure.axes]
    assert units == ["residual r [deg]", "residual r [deg]", "residual r [% of aperture]"]


def test_joints_in_degrees_have_one_scale(log: RunLog) -> None:
    roll, elbow, hand = residual_figure(log, JOINTS, START, STOP, 700, 720).axes
    assert roll.get_ylim() == elbow.get_ylim() != hand.get_ylim()
    (residual,) = lines(roll, "residual r: measured - predicted")
    assert roll.get_ylim()[1] >= np.nanmax(np.abs(residual))


def test_contacts_are_shaded_and_named_and_the_legend_has_each_line_once(log: RunLog) -> None:
    joints = joints_to_show(log, START, STOP)
    figure = residual_figure(log, joints, START, STOP, 700, 720)
    contact = next(c for c, _ in log.lasting_contacts() if c.shown_by == joints[0])
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert f"{contact.kind}\n{in_words(contact.link)}" in texts
    (legend,) = figure.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert len(labels) == len(set(labels))
    assert {
        "residual r: measured - predicted",
        "threshold of r",
        "contact reported",
        "true push that loads this limb",
    } <= set(labels)


def test_joints_with_contacts_are_shown_and_no_more_than_have_room(log: RunLog) -> None:
    touched = {c.shown_by for c, _ in log.lasting_contacts()}
    assert set(joints_to_show(log, START, STOP)) <= touched
    first = log.contacts[0]
    many = [
        replace(first, id=100 + k, shown_by=joint, phase="end")
        for k, joint in enumerate(log.joint_names[5:10])
    ]
    shown = joints_to_show(replace(log, contacts=many), START, STOP)
    assert len(shown) == MAX_JOINTS
    assert shown == sorted(shown, key=log.joint_names.index)


def test_without_contacts_it_is_the_joint_nearest_to_its_threshold(log: RunLog) -> None:
    residual = np.zeros_like(log["residual"])
    residual[:, 7] = 0.5 * log["threshold"][:, 7]
    quiet = replace(log, contacts=[], fields=log.fields | {"residual": residual})
    assert joints_to_show(quiet, START, STOP) == [log.joint_names[7]]
    unobserved = replace(log, contacts=[], fields=log.fields | {"residual": residual * np.nan})
    assert joints_to_show(unobserved, START, STOP) == []


def cursor(pixels: np.ndarray) -> int:
    """Column of the cursor: most of the panel's height has its colour there."""
    return int((pixels == CURSOR).all(axis=2).sum(axis=0).argmax())


def test_the_cursor_goes_evenly_and_what_comes_later_is_faint(log: RunLog) -> None:
    panel = SignalPanel(log, ["LShoulderRoll"], START, STOP, 600, 480)
    times = np.linspace(START, STOP, 5)
    columns = [cursor(panel.draw(float(time))) for time in times]
    np.testing.assert_allclose(np.diff(columns), np.diff(columns).mean(), atol=1.0)
    assert columns[-1] - columns[0] > 300
    begin, end = panel.draw(START), panel.draw(STOP)
    inside = slice(columns[0] + 5, columns[-1] - 5)
    assert begin[:, inside].mean() > end[:, inside].mean(), "nothing has come yet"
    middle = panel.draw(float(times[2]))
    swept = slice(columns[0] + 5, columns[2] - 5)
    to_come = slice(columns[2] + 5, columns[-1] - 5)
    np.testing.assert_array_equal(middle[:, swept], end[:, swept])
    np.testing.assert_array_equal(middle[:, to_come], begin[:, to_come])
