"""Waits, loops, branches, played files and cues: which step follows which, by touch and by the clock."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver import FaultError, Pepper
from pepper_driver.config import ConfigError, load_experiment
from pepper_driver.experiments.experiment import ExperimentRun
from pepper_driver.observer import Contact
from support.events import contact
from support.experiments import (
    CYCLE,
    ROBOT,
    STAND,
    TURN,
    YAW,
    Played,
    fake,
    listen,
    make_experiment,
    write,
)

STAND_TICKS = round(0.1 / CYCLE)
LATE = {"name": "late", "hold": 0.12}


def taps(*ticks: int, length: int = 3, **changes: Any) -> dict[int, tuple[Contact, ...]]:
    """Short touches that begin in these ticks, of the left forearm unless said otherwise."""
    events: dict[int, tuple[Contact, ...]] = {}
    for number, tick in enumerate(ticks, start=min(ticks) * 100):
        events[tick] = (contact(number, **changes),)
        events[tick + length] = (contact(number, phase="end", **changes),)
    return events


# -- cues -------------------------------------------------------------------------------------------------------------


def test_cues_come_with_their_step_or_take_one_tick() -> None:
    played = Played(
        make_experiment(
            STAND,
            {"say": "left", "cue": "begin"},
            TURN | {"say": "I turn.", "leds": {"colour": [0, 0.5, 1], "group": "ChestLeds"}},
            {"cue": "end"},
        )
    )
    assert played.done.completed
    assert played.names == ["stand", "1", "turn", "3"]
    begins = dict(played.steps)
    assert played.cues == [
        ("say: left", begins["1"]),
        ("cue: begin", begins["1"]),
        ("say: I turn.", begins["turn"]),
        ("ChestLeds to 0 0.5 1", begins["turn"]),
        ("cue: end", begins["3"]),
    ]
    assert begins["turn"] - begins["1"] == 1
    assert begins["3"] - begins["turn"] == round(0.5 / CYCLE)
    assert len(played.position) == STAND_TICKS + 1 + round(0.5 / CYCLE) + 1


# -- waits ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wait", "at", "end"),
    [
        ({}, taps(5, 30), 30),  # the first one came before the wait
        ({"lasting": 0.24}, taps(30, length=20) | taps(60, length=40), 80),
        ({"touches": 2, "within": 0.3}, taps(5, 30, 60, 80), 80),
        ({"min_torque": 2.0}, taps(30, torque=1.0) | taps(40, torque=-2.5), 40),
        ({"limb": ["head", "trunk"]}, taps(30) | taps(50, limb="head"), 50),
    ],
)
def test_a_wait_ends_with_the_touch_it_waits_for(
    wait: dict[str, Any], at: dict[int, tuple[Contact, ...]], end: int
) -> None:
    played = Played(make_experiment(STAND, listen(timeout=2.4, **wait), TURN), at)
    assert [(w.step, w.detected) for w in played.done.waits] == [("listen", True)]
    assert dict(played.steps)["turn"] == end
    step = played.done.steps[1]
    assert step.duration == pytest.approx((end - STAND_TICKS) * CYCLE)
    assert step.goals == ()


def test_a_touch_that_lasts_until_after_the_timeout_does_not_count() -> None:
    at = taps(40, length=100)
    played = Played(make_experiment(STAND, listen(timeout=0.6, lasting=0.3), TURN), at)
    assert not played.done.waits[0].detected
    assert dict(played.steps)["turn"] == STAND_TICKS + 50


def test_an_experiment_without_touch_stops_if_it_says_so() -> None:
    experiment = make_experiment(STAND, listen(on_timeout="stop"), TURN)
    played = Played(experiment)
    assert played.done.stopped_by == "listen"
    assert not played.done.completed
    assert played.names == ["stand", "listen"]
    assert played.after == played.before
    assert Played(experiment, taps(30)).done.completed


def test_a_stop_in_a_loop_ends_all_of_it() -> None:
    loop = {"repeat": {"times": 3, "steps": [listen(on_timeout="stop"), TURN]}}
    played = Played(make_experiment(STAND, loop, LATE), taps(30))
    assert played.names == ["stand", "listen", "turn", "listen"]
    assert played.done.stopped_by == "listen"


# -- loops ------------------------------------------------------------------------------------------------------------


def test_loops_in_loops() -> None:
    inner = {"repeat": {"times": 2, "steps": [{"cue": "in"}]}}
    outer = {"repeat": {"times": 3, "steps": [{"cue": "out"}, inner]}}
    played = Played(make_experiment(STAND, outer, {"cue": "end"}))
    assert [text[5:] for text in played.words] == ["out", "in", "in"] * 3 + ["end"]


ROUND = 20
"""[ticks]"""
ROUNDS = {"times": 5, "steps": [{"name": "round", "hold": ROUND * CYCLE}]}


@pytest.mark.parametrize(
    ("at", "rounds"),
    [
        ({}, 5),
        (taps(STAND_TICKS), 5),  # it began with the tick before the loop
        (taps(STAND_TICKS + 1), 1),
        (taps(STAND_TICKS + ROUND), 1),
        (taps(STAND_TICKS + ROUND + 1), 2),
        (taps(STAND_TICKS + 3, link="LBicep"), 5),
    ],
)
def test_a_loop_ends_after_the_round_in_which_it_is_touched(
    at: dict[int, tuple[Contact, ...]], rounds: int
) -> None:
    loop = {"repeat": {**ROUNDS, "until": {"link": "LForeArm"}}}
    played = Played(make_experiment(STAND, loop, TURN), at)
    assert played.names == ["stand", *["round"] * rounds, "turn"]


def test_a_loop_that_is_played_again_listens_again() -> None:
    loop = {"repeat": {**ROUNDS, "until": {}}}
    outer = {"repeat": {"times": 2, "steps": [loop]}}
    played = Played(make_experiment(STAND, outer), taps(STAND_TICKS + ROUND + 5))
    assert played.names == ["stand", *["round"] * (2 + 5)]


def test_an_outer_loop_receives_what_comes_in_an_inner_one() -> None:
    inner = {"repeat": {**ROUNDS, "times": 2, "until": {"link": "LBicep"}}}
    outer = {"repeat": {"times": 4, "steps": [inner], "until": {"touches": 2, "within": 9.0}}}
    at = taps(STAND_TICKS + 5, 3 * ROUND, 4 * ROUND)
    played = Played(make_experiment(STAND, outer), at)
    assert played.names == ["stand", *["round"] * 4]


def test_random_goals_in_a_loop_are_others_in_each_round() -> None:
    goals = {
        "setpoints": {
            "joints": ["HeadYaw"],
            "range": 0.9,
            "settle": 0.12,
            "count": 2,
            "period": 0.24,
        }
    }
    loop = {
        "repeat": {
            "times": 3,
            "steps": [{**goals, "name": "goals"}, {"name": "rest", "hold": 0.12}],
        }
    }
    experiment = make_experiment(STAND, loop)
    played = Played(experiment)
    assert played.names == ["stand", *(["goals"] * 3 + ["rest"]) * 3]

    def goals_played() -> list[float]:
        targets: list[float] = []
        with Pepper("mock", observer=None) as pepper:
            pepper.play(experiment, on_step=lambda _: targets.append(float(pepper.target[YAW])))
        return targets

    targets = goals_played()
    assert targets == goals_played(), "the seed of the experiment says which"
    rounds = np.array(targets[1:]).reshape(3, 4)
    np.testing.assert_array_equal(rounds[:, 0], ROBOT.posture("Stand")[YAW])
    assert len({*rounds[:, 1], *rounds[:, 2]}) == 6
    np.testing.assert_array_equal(rounds[:, 2], rounds[:, 3])


# -- branches ---------------------------------------------------------------------------------------------------------


def branch(*cases: tuple[dict[str, Any], str], **more: Any) -> dict[str, Any]:
    """A branch with a cue for each case."""
    made = [{"on": on, "steps": [{"name": name, "cue": name, "hold": 0.12}]} for on, name in cases]
    values = {"timeout": 1.2, "otherwise": [{"name": "none", "cue": "none", "hold": 0.12}]}
    return {"name": "choice", "branch": {**values, "cases": made, **more}}


def cues(step: dict[str, Any], at: dict[int, tuple[Contact, ...]]) -> tuple[list[str], int]:
    """Words of the case that was played, and ticks since the branch began."""
    played = Played(make_experiment(STAND, step, LATE), at)
    assert played.done.completed
    begins = dict(played.steps)
    name = played.words[0][5:]
    assert begins["late"] - begins[name] == round(0.12 / CYCLE)
    assert [wait.detected for wait in played.done.waits] == [name != "none"]
    return [text[5:] for text in played.words], begins[name] - begins["choice"]


def test_a_branch_by_limb() -> None:
    step = branch(({"limb": "left_arm"}, "left"), ({"limb": "right_arm"}, "right"))
    begin = STAND_TICKS
    assert cues(step, taps(begin + 10)) == (["left"], 10)
    right = taps(begin + 10, limb="right_arm", link="RForeArm", joint="RElbowRoll")
    # Until then the other could have come, too.
    assert cues(step, right) == (["right"], 10 + round(0.3 / CYCLE))
    assert cues(step, taps(begin + 10, limb="head")) == (["none"], round(1.2 / CYCLE))
    assert cues(step, {}) == (["none"], round(1.2 / CYCLE))
    assert cues(step, taps(begin)) == (["none"], round(1.2 / CYCLE)), "it began before"


def grown(tick: int, *sizes: tuple[int, float]) -> dict[int, tuple[Contact, ...]]:
    """A touch that has these torques [N m] so many ticks after its begin."""
    events: dict[int, tuple[Contact, ...]] = {tick: (contact(7, torque=0.5),)}
    for later, torque in sizes:
        events[tick + later] = (contact(7, phase="update", torque=torque),)
    return events


def test_a_branch_by_how_hard_takes_its_time() -> None:
    """Each touch begins lightly: the harder case comes first, and is given time to."""
    step = branch(({"min_torque": 2.0}, "hard"), ({}, "light"), deciding=0.24)
    begin = STAND_TICKS
    assert cues(step, grown(begin + 10)) == (["light"], 10 + 20)
    assert cues(step, grown(begin + 10, (12, 2.5))) == (["hard"], 22), "at once"
    assert cues(step, grown(begin + 10, (20, 2.5))) == (["hard"], 30)
    assert cues(step, grown(begin + 10, (21, 2.5))) == (["light"], 30), "too late"
    at_once = branch(({"min_torque": 2.0}, "hard"), ({}, "light"), deciding=0.0)
    assert cues(at_once, grown(begin + 10, (1, 2.5))) == (["light"], 10)
    last = round(1.2 / CYCLE)
    assert cues(step, grown(begin + last - 1, (15, 2.5))) == (["hard"], last + 14)
    assert cues(step, grown(begin + last - 1)) == (["light"], last - 1 + 20)


def test_a_branch_by_how_long_and_how_often() -> None:
    step = branch(
        ({"touches": 2, "within": 0.6}, "twice"),
        ({"lasting": 0.6}, "long"),
        ({}, "once"),
        deciding=0.6,
    )
    begin, wait = STAND_TICKS, round(0.6 / CYCLE)
    assert cues(step, taps(begin + 10)) == (["once"], 10 + wait)
    assert cues(step, taps(begin + 10, length=80)) == (["long"], 10 + wait)
    assert cues(step, taps(begin + 10, begin + 40)) == (["twice"], 40)


def test_a_branch_in_a_loop_chooses_again() -> None:
    step = branch(({"limb": "left_arm"}, "left"), timeout=0.24, otherwise=[])
    loop = {"repeat": {"times": 3, "steps": [step]}}
    played = Played(make_experiment(STAND, loop, LATE), taps(STAND_TICKS + 30))
    assert played.names == ["stand", "choice", "choice", "left", "choice", "late"]
    assert [wait.detected for wait in played.done.waits] == [False, True, False]


def test_the_posture_of_a_case_is_that_of_its_steps() -> None:
    cases = [
        {"on": {"limb": "left_arm"}, "steps": [{"joints": {"HeadYaw": 0.3}, "duration": 0.6}]},
        {"on": {"limb": "right_arm"}, "steps": []},
    ]
    step = {
        "branch": {
            "timeout": 0.6,
            "cases": cases,
            "otherwise": [{"joints": {"HeadYaw": -0.3}, "duration": 0.6}],
        }
    }
    right = taps(30, limb="right_arm", link="RForeArm", joint="RElbowRoll")
    for at, angle in ((taps(30), 0.3), (right, ROBOT.posture("Stand")[YAW]), ({}, -0.3)):
        played = Played(make_experiment(STAND, step), at)
        assert played.done.completed
        assert played.position[-1, YAW] == pytest.approx(angle, abs=0.01)


# -- played files -----------------------------------------------------------------------------------------------------


def test_the_steps_of_another_file_are_played_where_it_stands(tmp_path: Path) -> None:
    write(
        tmp_path,
        {"name": "inner", "cue": "inner", "hold": 0.12},
        {"play": "leaf.yaml"},
        file="part",
    )
    write(tmp_path, {"name": "leaf", "joints": {"HeadYaw": 0.2}, "duration": 0.24}, file="leaf")
    loop = {"repeat": {"times": 2, "steps": [{"play": "part.yaml"}]}}
    path = write(tmp_path, STAND, loop, {"play": "wave"})
    played = Played(load_experiment(path, ROBOT))
    wave = ["raise", "out", "back", "out", "back", "stand"]
    assert played.names == ["stand", "inner", "leaf", "inner", "leaf", *wave]
    assert played.done.completed


def test_a_file_that_waits_for_touch_needs_an_observer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The program that plays it says nothing of touch: it gets an observer all the same, unless it switches it off."""
    _, observer = fake(monkeypatch)
    observer.at = taps(30)
    for inner in (listen(), branch(({}, "touched"))):
        write(tmp_path, inner, file="part")
        path = write(tmp_path, STAND, {"play": "part.yaml"})
        report = ExperimentRun(path).perform()
        assert [wait.detected for wait in report.waits] == [True]
        path = write(tmp_path, STAND, {"play": "part.yaml"}, observer=None)
        with pytest.raises(ConfigError, match="the experiment has no observer"):
            load_experiment(path, ROBOT)


def test_each_file_plays_those_in_its_folder(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    write(tmp_path, STAND, file="leaf")
    write(tmp_path / "sub", TURN, file="leaf")
    write(tmp_path / "sub", {"play": "leaf.yaml"}, file="part")
    path = write(tmp_path, {"play": "leaf.yaml"}, {"play": "sub/part.yaml"})
    assert Played(load_experiment(path, ROBOT)).names == ["stand", "turn"]


def test_only_files_play_files() -> None:
    missing = [
        (make_experiment(STAND, {"play": "wave"}), r"steps\.1\.play"),
        (make_experiment(STAND, reactions=[{"play": "wave"}]), r"reactions\.0\.play"),
    ]
    for experiment, key in missing:
        with (
            Pepper("mock", observer=None) as pepper,
            pytest.raises(ConfigError, match=f"key '{key}': the steps of 'wave' were not loaded"),
        ):
            pepper.play(experiment)


@pytest.mark.parametrize(
    ("step", "key"),
    [
        ({"joints": {"HeadYaw": 3.0}, "duration": 1.0}, "steps.1.joints.HeadYaw"),
        ({"joints": {"HeadYow": 0.3}, "duration": 1.0}, "steps.1.joints"),
        (listen(link="LForeAm"), "steps.1.wait.link"),
        ({"play": "wave"}, "steps.1.play"),
    ],
)
def test_an_experiment_that_no_file_made_is_checked_too(step: dict[str, Any], key: str) -> None:
    with Pepper("mock", observer=None) as pepper:
        with pytest.raises(ConfigError, match=f"^mine: key '{key}"):
            pepper.play(make_experiment(STAND, step))
        assert pepper.time == 0.0


# -- the end ----------------------------------------------------------------------------------------------------------


def test_a_fault_in_a_branch_leaves_nothing_behind() -> None:
    played = Played(
        make_experiment(STAND, branch(({}, "touched"))),
        taps(30),
        on_tick=lambda pepper, tick: pepper.emergency_stop() if tick == 32 else None,
    )
    assert isinstance(played.error, FaultError)
    assert played.names == ["stand", "choice", "touched"]
    assert played.after == played.before
