"""Words, limits, legends and files that all figures share."""

from __future__ import annotations

from pathlib import Path

import pytest
from matplotlib.figure import Figure

from pepper_driver.config import MissingExtraError, load_robot
from pepper_driver.figure_style import (
    PlotError,
    add_legend,
    check_plotting,
    counted,
    in_words,
    joint_title,
    new_figure,
    same_limits,
    save_figure,
)

ROBOT = load_robot()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("LElbowRoll", "left elbow roll"),
        ("RHand", "right hand"),
        ("HeadYaw", "head yaw"),
        ("KneePitch", "knee pitch"),
        ("LForeArm", "left fore arm"),
        ("l_wrist", "left wrist"),
        ("r_gripper", "right gripper"),
        ("base_link", "base"),
        ("left_arm", "left arm"),
        ("legs", "legs"),
        ("torso", "torso"),
        ("", ""),
        ("L", "l"),
    ],
)
def test_names_in_words(name: str, words: str) -> None:
    assert in_words(name) == words


def test_every_joint_and_link_has_words_of_its_own() -> None:
    assert joint_title("LElbowRoll") == "left elbow roll (LElbowRoll)"
    for names in (ROBOT.joint_names, ROBOT.links):
        words = [in_words(name) for name in names]
        assert len(set(words)) == len(names)
        assert all(text == text.lower() and "_" not in text for text in words)


def test_counts_with_their_nouns() -> None:
    texts = [counted(count, noun) for noun in ("push", "contact") for count in (0, 1, 2)]
    assert texts == ["no push", "1 push", "2 pushes", "no contact", "1 contact", "2 contacts"]


def test_same_limits() -> None:
    first, second, empty = new_figure(6.0, 4.0).subplots(3, 1)
    first.plot([0.0, 1.0], [-1.0, 3.0])
    second.plot([0.0, 1.0], [float("nan"), 7.0])
    same_limits([first, second, empty], min_span=1.0, margin=0.0)
    assert first.get_ylim() == second.get_ylim() == empty.get_ylim() == (-1.0, 7.0)
    same_limits([first, second], min_span=1.0, symmetric=True, margin=0.1)
    assert first.get_ylim() == second.get_ylim() == pytest.approx((-8.4, 8.4))
    same_limits([empty], min_span=2.0, margin=0.0)
    assert empty.get_ylim() == (-1.0, 1.0)
    same_limits([], min_span=2.0)


def test_a_panel_of_another_size_has_its_own_scale() -> None:
    small, smaller, large = new_figure(6.0, 4.0).subplots(3, 1)
    small.plot([0.0, 1.0], [-2.0, 2.0])
    smaller.plot([0.0, 1.0], [-1.0, 1.0])
    large.plot([0.0, 1.0], [0.0, 400.0])
    same_limits([small, smaller, large], min_span=1.0, margin=0.0)
    assert small.get_ylim() == smaller.get_ylim() == (-2.0, 2.0)
    assert large.get_ylim() == (0.0, 400.0)
    assert [axes.get_title(loc="right") for axes in (small, smaller, large)] == [
        "",
        "",
        "other scale",
    ]


def test_the_legend_fits_the_figure() -> None:
    """A legend of many long labels is as wide as its figure at most."""
    for width in (6.0, 14.0):
        figure = new_figure(width, 6.0)
        axes = figure.subplots()
        for number in range(12):
            axes.plot([0.0], [0.0], label=f"a label of the usual length {number:2d}")
        add_legend(figure)
        figure.draw_without_rendering()
        (legend,) = figure.legends
        box = legend.get_window_extent()
        assert box.x0 >= 0.0
        assert box.x1 <= figure.bbox.width


def test_files(tmp_path: Path) -> None:
    figure = Figure()
    figure.subplots().plot([0.0, 1.0])
    save_figure(figure, tmp_path / "new" / "a.png")
    save_figure(figure, tmp_path / "few.png", colours=16)
    whole, few = (tmp_path / name for name in ("new/a.png", "few.png"))
    assert few.read_bytes().startswith(b"\x89PNG")
    assert few.stat().st_size < whole.stat().st_size
    with pytest.raises(PlotError, match="cannot be written"):
        save_figure(figure, tmp_path / "few.png" / "a.png")


def test_figures_are_refused_without_matplotlib(monkeypatch: pytest.MonkeyPatch) -> None:
    check_plotting()
    monkeypatch.setattr("pepper_driver.figure_style.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"the pictures of a report.*pepper-driver\[plot\]"):
        check_plotting("the pictures of a report")
