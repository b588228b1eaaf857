"""Suites of the judge of touch: frozen, complete, and dealt to robots so that both laws meet the same."""

import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.config import ConfigError, load_robot
from pepper_driver.config.loading import package_file
from pepper_driver.config.touch_suites import EVEN, TouchSuites, load_touch_suites

ROBOT = load_robot()


@pytest.fixture(scope="module")
def suites() -> TouchSuites:
    return load_touch_suites(ROBOT)


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    return Path(shutil.copy(package_file("touch_suites.yaml"), tmp_path))


def test_the_touches_are_those_that_were_asked_for(suites: TouchSuites) -> None:
    assert suites.forces == (2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 30.0)
    even = next(row for row in suites.rows if row.name == EVEN)
    assert (even.duration, even.rise, even.states, even.places, even.forces) == (
        1.0,
        0.1,
        "all",
        "all",
        "all",
    )
    durations = {row.duration for row in suites.rows if row.act == "push"}
    assert {0.1, 0.2, 0.5, 1.0, 2.0, 6.0} <= durations
    rises = [row.rise for row in suites.rows]
    assert (min(rises), max(rises)) == (0.02, 0.3)
    hands = {stiffness for row in suites.rows for stiffness in row.stiffness}
    assert {300.0, 1000.0, 3000.0} <= hands
    assert set(suites.places) >= {
        "hand",
        "forearm",
        "upper arm",
        "shoulder",
        "head",
        "trunk",
        "hip",
        "base",
    }


def test_the_test_split_is_twenty_robots_from_the_first_that_is_held_out(
    suites: TouchSuites,
) -> None:
    split = suites.splits["test"]
    assert (split.first, split.robots, split.free) == (100, 20, 5400.0)
    assert suites.splits["development"].first + suites.splits["development"].robots <= 100


@pytest.mark.parametrize("draw", [0, 1, 2, 101])
def test_each_robot_is_touched_once_at_each_place_with_each_force_in_each_state(
    suites: TouchSuites, draw: int
) -> None:
    for state in suites.states:
        cells = Counter(
            (act.place, act.force) for act in suites.acts(state, draw) if act.row.name == EVEN
        )
        assert cells == dict.fromkeys(
            ((place, force) for place in suites.places for force in suites.forces), 1
        )


@pytest.mark.parametrize("draw", [0, 5, 100])
def test_each_robot_makes_each_other_touch_in_one_state(suites: TouchSuites, draw: int) -> None:
    made = Counter(
        (act.row.name, act.place, act.force, act.stiffness)
        for state in suites.all_states
        for act in suites.acts(state, draw)
        if act.row.name != EVEN
    )
    assert set(made.values()) == {1}
    assert {name for name, *_ in made} == {row.name for row in suites.rows} - {EVEN}


def test_two_robots_of_the_two_laws_are_touched_alike(suites: TouchSuites) -> None:
    for state in suites.all_states:
        assert suites.acts(state, 4) == suites.acts(state, 5)
    assert any(suites.acts(state, 4) != suites.acts(state, 6) for state in suites.all_states)


def test_the_right_side_mirrors_the_left(suites: TouchSuites) -> None:
    point = suites.places["hand"].points[2]
    right = point.mirrored
    assert (point.link, right.link) == ("l_wrist", "r_wrist")
    np.testing.assert_allclose(right.xyz, np.array(point.xyz) * [1, -1, 1])
    np.testing.assert_allclose(right.outward, np.array(point.outward) * [1, -1, 1])
    middle = suites.places["head"].points[0]
    assert middle.mirrored.link == middle.link


def test_a_change_is_seen(copy: Path) -> None:
    load_touch_suites(ROBOT, copy)
    copy.write_text(copy.read_text().replace("max_tipping: 0.7", "max_tipping: 0.8"))
    with pytest.raises(ConfigError, match="changed since it was frozen") as error:
        load_touch_suites(ROBOT, copy)
    assert "config.touch_suites" in str(error.value)


@pytest.mark.parametrize(
    ("before", "after", "problem"),
    [
        ("link: l_wrist", "link: l_wirst", "places.hand.points.0.link.*l_wrist"),
        ("places: [hand, head]", "places: [hand, haed]", "rows.*places.*head"),
        ("pause: [2.0, 3.5]", "pause: [3.5, 2.0]", "pause"),
        ("act: taps", "act: tabs", "rows.*act"),
        ("version: 1", "version: 2", "version"),
        ("  test: {first: 100", "  tset: {first: 100", "splits"),
    ],
)
def test_a_wrong_value_is_named(copy: Path, before: str, after: str, problem: str) -> None:
    text = copy.read_text()
    assert before in text
    copy.write_text(text.replace(before, after, 1))
    with pytest.raises(ConfigError, match=problem):
        load_touch_suites(ROBOT, copy)
