"""Reactions to touch: words at once, steps in place of the one under way, which goes on gently afterwards."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from pepper_driver import FaultError, Hold, Pepper
from pepper_driver.config import Experiment, load_controller_settings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import TargetError
from pepper_driver.experiments import goals
from pepper_driver.experiments.player import Player
from pepper_driver.observer import Contact
from support.events import contact
from support.experiments import (
    CYCLE,
    PLACE,
    REACH,
    ROBOT,
    STAND,
    YAW,
    Played,
    listen,
    make_experiment,
    with_played,
    wrist,
)

SETTINGS = load_controller_settings(ROBOT)

BEGIN = round(0.1 / CYCLE)
"""[ticks] that the first step takes."""

BACK = round(SETTINGS.min_return_time / CYCLE)
"""[ticks] that a small way back takes."""

NOD = {"name": "nod", "joints": {"HeadPitch": 0.0}, "duration": 0.48}
NOD_TICKS = 40
TURN = {"name": "turn", "joints": {"HeadYaw": 0.6}, "duration": 2.4}
TURN_TICKS = 200
AWAY = {"name": "away", "joints": {"HeadYaw": -0.3, "LShoulderRoll": 0.5}, "duration": 1.2}
AWAY_TICKS = 100
END = {"name": "end", "hold": 0.12}


def tap(
    tick: int, number: int = 1, length: int = 3, **changes: Any
) -> dict[int, tuple[Contact, ...]]:
    """A short touch."""
    return {
        tick: (contact(number, **changes),),
        tick + length: (contact(number, phase="end", **changes),),
    }


def reacting(
    *steps: dict[str, Any], parts: dict[str, list[dict[str, Any]]] | None = None, **more: Any
) -> Experiment:
    """An experiment whose reactions play ``parts``, by name."""
    played = {name: make_experiment(*part) for name, part in (parts or {}).items()}
    return with_played(make_experiment(*steps, **more), **played)


def with_play(*steps: dict[str, Any], play: dict[str, Any] = NOD, **reaction: Any) -> Experiment:
    """An experiment with one reaction, which plays one step."""
    return reacting(STAND, *steps, END, reactions=[{"play": "p", **reaction}], parts={"p": [play]})


def ticks_of(played: Played) -> dict[str, int]:
    """Durations of the steps, as reported."""
    return {step.name: round(step.duration / CYCLE) for step in played.done.steps}


def assert_gentle(played: Played, fastest: float) -> None:
    """The reference has no jump: speeds [rad/s] are bounded, and change little by little."""
    speed = np.abs(played.velocity)
    assert speed.max() <= fastest
    assert np.abs(np.diff(played.velocity, axis=0)).max() <= 0.1


# -- words ------------------------------------------------------------------------------------------------------------


def test_words_come_in_the_tick_of_the_touch_and_nothing_stops() -> None:
    reaction = {"say": "Oh!", "cue": "touched", "leds": {"colour": [1, 0, 0]}}
    experiment = reacting(STAND, TURN, END, reactions=[reaction])
    at = tap(BEGIN + 50) | tap(BEGIN + 80, 2)
    played, quiet = Played(experiment, at), Played(experiment)
    words = ["say: Oh!", "FaceLeds to 1 0 0", "cue: touched"]
    assert played.cues == [(text, BEGIN + tick) for tick in (50, 80) for text in words]
    assert played.steps == quiet.steps
    np.testing.assert_array_equal(played.position, quiet.position)
    assert quiet.words == []


@pytest.mark.parametrize(
    ("on", "tick"),
    [
        ({}, 20),
        ({"limb": "head"}, 40),
        ({"min_intensity_deg": 5.0}, 60),
        ({"lasting": 0.24}, 100),
        ({"touches": 3, "within": 2.0}, 60),
    ],
)
def test_they_answer_the_touches_that_are_chosen(on: dict[str, Any], tick: int) -> None:
    at = tap(20) | tap(40, 2, limb="head") | tap(60, 3, intensity_deg=6.0) | tap(80, 4, length=30)
    experiment = reacting(STAND, TURN, END, reactions=[{"on": on, "cue": "touched"}])
    assert Played(experiment, at).cues[0] == ("cue: touched", tick)


def test_as_often_as_they_may() -> None:
    at = tap(20) | tap(40, 2) | tap(60, 3)
    for at_most, ticks in ((1, [20]), (2, [20, 40]), (None, [20, 40, 60])):
        limit = {} if at_most is None else {"at_most": at_most}
        experiment = reacting(STAND, TURN, reactions=[{"cue": "touched", **limit}])
        assert [tick for _, tick in Played(experiment, at).cues] == ticks


def test_words_come_at_once_while_a_reflex_holds_the_robot() -> None:
    experiment = reacting(STAND, TURN, END, reactions=[{"cue": "touched"}])
    at = tap(30) | tap(40, 2)
    played = Played(experiment, at, reflexes=(Hold(release_delay=0.6),))
    assert [tick for _, tick in played.cues] == [30, 40]
    assert played.done.reflex_counts == {"hold": 1}


# -- steps ------------------------------------------------------------------------------------------------------------


def test_a_step_is_interrupted_on_its_way_and_goes_on() -> None:
    played = Played(with_play(TURN), tap(BEGIN + 100))
    assert played.steps == [
        ("stand", 0),
        ("turn", BEGIN),
        ("nod", BEGIN + 100),
        ("end", BEGIN + NOD_TICKS + TURN_TICKS),
    ]
    assert ticks_of(played) == {
        "stand": BEGIN,
        "nod": NOD_TICKS,
        "turn": TURN_TICKS + NOD_TICKS,
        "end": 10,
    }
    assert [step.name for step in played.done.steps] == ["stand", "nod", "turn", "end"]
    over = BEGIN + TURN_TICKS + NOD_TICKS
    assert played.position[over - 1, YAW] == pytest.approx(0.6, abs=0.01)
    pitch = ROBOT.joint_index("HeadPitch")
    assert played.position[over - 1, pitch] == pytest.approx(
        ROBOT.posture("Stand")[pitch], abs=0.01
    )
    assert played.position[BEGIN + 100 + NOD_TICKS, pitch] == pytest.approx(0.0, abs=0.01)
    assert_gentle(played, 0.9)
    assert played.after == played.before


@pytest.mark.parametrize("tick", [1, 40, 100, 180, 199])
def test_the_way_back_is_gentle_wherever_it_was(tick: int) -> None:
    """Near its end there is less time left than the way back takes: it takes longer then."""
    played = Played(with_play(TURN, play=AWAY), tap(BEGIN + tick))
    here = played.position[BEGIN + tick + AWAY_TICKS]
    needed = 1.875 * (0.6 - here[YAW]) / SETTINGS.return_speed
    back = max(needed / CYCLE, TURN_TICKS - tick)
    assert ticks_of(played)["turn"] == pytest.approx(tick + AWAY_TICKS + back, abs=3)
    returning = np.abs(played.velocity[BEGIN + tick + AWAY_TICKS :])
    assert returning.max() <= 1.02 * SETTINGS.return_speed
    assert np.abs(np.diff(played.velocity, axis=0)).max() <= 0.1
    assert played.position[-11, YAW] == pytest.approx(0.6, abs=0.01)


@pytest.mark.parametrize(
    "motion",
    [
        TURN | {"hold": 1.2},
        {"name": "turn", "hold": 3.6, "joints": {"HeadYaw": 0.2}},
        {"name": "turn", "hold": 3.6},
    ],
)
@pytest.mark.parametrize("tick", [210, 299])
def test_in_a_hold_the_rest_of_it_is_held_once_the_robot_is_back(
    motion: dict[str, Any], tick: int
) -> None:
    played = Played(with_play(motion), tap(BEGIN + tick))
    assert ticks_of(played)["turn"] == 300 + NOD_TICKS + BACK
    quiet = Played(with_play(motion))
    assert ticks_of(quiet)["turn"] == 300
    np.testing.assert_allclose(played.position[-12], quiet.position[-12], atol=0.01)
    assert_gentle(played, 1.2)


def test_a_wait_goes_on_and_receives_what_comes_meanwhile() -> None:
    reaction: dict[str, Any] = {"on": {"limb": "head"}}
    experiment = with_play(listen(timeout=2.4, limb="left_arm"), **reaction)
    head = tap(BEGIN + 50, limb="head", link="Head", joint="HeadYaw")
    later = Played(experiment, head | tap(BEGIN + 50 + NOD_TICKS + 30, 2))
    assert later.names == ["stand", "listen", "nod", "end"]
    assert ticks_of(later)["listen"] == 50 + NOD_TICKS + 30
    meanwhile = Played(experiment, head | tap(BEGIN + 50 + 10, 2))
    assert ticks_of(meanwhile)["listen"] == pytest.approx(50 + NOD_TICKS, abs=2)
    in_vain = Played(experiment, head)
    assert ticks_of(in_vain)["listen"] == 200 + NOD_TICKS + BACK
    detected = [played.done.waits[0].detected for played in (later, meanwhile, in_vain)]
    assert detected == [True, True, False]


def test_a_touch_that_ended_meanwhile_has_not_lasted() -> None:
    experiment = with_play(listen(timeout=3.6, lasting=0.6), on={"min_intensity_deg": 2.0})
    played = Played(experiment, tap(BEGIN + 20, length=10))
    assert [wait.detected for wait in played.done.waits] == [False]


def test_the_touch_that_is_waited_for_may_set_off_a_reaction_too() -> None:
    played = Played(with_play(listen(timeout=2.4)), tap(BEGIN + 50))
    assert played.names == ["stand", "listen", "nod", "end"]
    assert ticks_of(played)["listen"] == pytest.approx(50 + NOD_TICKS, abs=2)


def test_a_branch_still_decides_as_it_was_about_to() -> None:
    cases = [
        {"on": {"min_torque": 2.0}, "steps": [{"cue": "hard"}]},
        {"on": {}, "steps": [{"cue": "light"}]},
    ]
    branch = {"name": "choice", "branch": {"timeout": 2.4, "deciding": 0.6, "cases": cases}}
    inner = {"branch": {"timeout": 0.24, "deciding": 0.0, "cases": cases[1:]}}
    experiment = reacting(
        STAND, branch, END, reactions=[{"on": {"limb": "head"}, "play": "p"}], parts={"p": [inner]}
    )
    at = tap(BEGIN + 50, limb="head", link="Head", joint="HeadYaw")
    hard = {
        BEGIN + 80: (contact(2, torque=0.5),),
        BEGIN + 110: (contact(2, phase="update", torque=3.0),),
    }
    assert Played(experiment, at | hard).words == ["cue: hard"]
    # The first touch is received by the branch, which decides after the reaction.
    assert Played(experiment, at).words == ["cue: light"]


# -- steps with tasks -------------------------------------------------------------------------------------------------


def test_tasks_let_go_meanwhile_and_come_back() -> None:
    step = {
        "name": "reach",
        "duration": 2.4,
        "position": REACH,
        "look_at": {"point": [1.0, 0.2, 1.0]},
    }
    ends: list[FloatArray] = []
    played = Played(
        with_play(step, {"name": "there", "hold": 0.12}, play=AWAY),
        tap(BEGIN + 100),
        on_tick=lambda pepper, tick: ends.append(wrist(pepper)),
    )
    own = {"posture", "base velocity"}
    tasks, back = own | {"position l_wrist", "look at"}, BEGIN + 100 + AWAY_TICKS
    over = BEGIN + ticks_of(played)["reach"]
    assert all(names == tasks for names in played.tasks[BEGIN : BEGIN + 99])
    assert all(names == own for names in played.tasks[BEGIN + 100 : back - 1])
    assert all(names == tasks for names in played.tasks[back : over - 1])
    assert all(names == own for names in played.tasks[over:])
    np.testing.assert_allclose(ends[over - 1], PLACE, atol=0.005)
    report = next(step for step in played.done.steps if step.name == "reach")
    assert [goal.name for goal in report.goals] == ["position l_wrist", "look at"]
    assert_gentle(played, 2.0)
    assert played.after == played.before


def test_a_reaction_keeps_no_task_and_a_kept_one_comes_back() -> None:
    kept = {"name": "reach", "duration": 1.2, "position": REACH | {"keep": True}}
    look = {"name": "look", "duration": 1.2, "look_at": {"point": [1.0, 0.3, 1.0], "keep": True}}
    played = Played(with_play(kept, {"name": "rest", "hold": 1.2}, play=look), tap(BEGIN + 150))
    own = {"posture", "base velocity"}
    assert "look at" in played.tasks[BEGIN + 160]
    assert played.tasks[-1] == own | {"position l_wrist"}
    assert played.after == played.before


def test_a_step_that_waits_for_its_targets_reaches_them_again() -> None:
    step = {
        "name": "reach",
        "until": "reached",
        "duration": 1.2,
        "timeout": 2.4,  # over before the last of the touches comes
        "tolerance": 0.005,
        "hold": 2.4,
        "position": REACH,
        "stiffness": 20.0,
    }
    ends: list[FloatArray] = []
    quiet = Played(with_play(step))
    first = ticks_of(quiet)["reach"]
    for tick in (50, 130, first - 100, first - 2):
        ends.clear()
        played = Played(
            with_play(step, play=AWAY),
            tap(BEGIN + tick),
            on_tick=lambda pepper, tick: ends.append(wrist(pepper)),
        )
        report = next(step for step in played.done.steps if step.name == "reach")
        assert report.reached, tick
        assert np.linalg.norm(ends[BEGIN + tick + AWAY_TICKS] - PLACE) > 0.05
        np.testing.assert_allclose(
            np.array(ends[-12 - 190 : -12]), np.tile(PLACE, (190, 1)), atol=0.01
        )


def test_a_base_goes_back_to_what_it_was_sent_to() -> None:
    """A base of which the step says nothing stays where it was when the step began, not where it was pushed to."""
    poses: list[FloatArray] = []
    step = {"name": "forward", "duration": 3.6, "base": {"x": 0.2}, "hold": 2.4}
    aside = {"name": "aside", "duration": 1.2, "base_velocity": {"vy": 0.1, "wz": 0.2}}
    played = Played(
        with_play(step, play=aside),
        tap(BEGIN + 100),
        on_tick=lambda pepper, tick: poses.append(pepper.controller.base_pose),
    )
    assert poses[BEGIN + 100 + AWAY_TICKS][1] > 0.05
    np.testing.assert_allclose(
        poses[BEGIN + ticks_of(played)["forward"] - 1], [0.2, 0.0, 0.0], atol=0.01
    )


def test_a_base_that_was_driven_is_driven_on() -> None:
    step = {"name": "roll", "duration": 2.4, "base_velocity": {"vx": 0.1}}
    played = Played(with_play(step), tap(BEGIN + 100))
    speeds = played.twist[:, 0]
    assert (speeds[BEGIN : BEGIN + 99] == 0.1).all()
    assert (speeds[BEGIN + 100 : BEGIN + 100 + NOD_TICKS - 1] == 0.0).all()
    assert (speeds[BEGIN + 100 + NOD_TICKS : -12] == 0.1).all()
    assert speeds[-1] == 0.0


def test_the_stiffness_of_a_reaction_ends_with_it() -> None:
    stiffness: list[float] = []
    Played(
        with_play(TURN | {"stiffness": 9.0}, play=NOD | {"stiffness": 30.0}),
        tap(BEGIN + 100),
        on_tick=lambda pepper, tick: stiffness.append(pepper.controller.posture.stiffness),
    )
    changes = [stiffness[0], *(b for a, b in pairwise(stiffness) if a != b)]
    assert changes == [5.0, 9.0, 30.0, 9.0]


def test_what_a_reaction_says_of_attention_ends_with_it() -> None:
    """The arms oscillate from here on: in the steps before and after it, and not in a reaction that stops it."""
    attentive: list[bool] = []
    played = Played(
        with_play(TURN | {"attentive": True}, play=AWAY | {"attentive": False}),
        tap(BEGIN + 100),
        on_tick=lambda pepper, tick: attentive.append(pepper._loop.arbiter.attentive),
    )
    changes = [attentive[0], *(b for a, b in pairwise(attentive) if a != b)]
    assert changes == [False, True, False, True]
    assert played.after == played.before


# -- several ----------------------------------------------------------------------------------------------------------


def two(**more: Any) -> Experiment:
    """Reactions to the head and to everything, which play a step each, and words."""
    reactions = [
        {"on": {"limb": "head"}, "play": "first", "cue": "first"},
        {"play": "second", "cue": "second", **more},
        {"cue": "words"},
    ]
    parts = {"first": [NOD | {"name": "first"}], "second": [NOD | {"name": "second"}]}
    return reacting(STAND, TURN, END, reactions=reactions, parts=parts)


HEAD: dict[str, Any] = {"limb": "head", "link": "Head", "joint": "HeadYaw"}


def test_of_two_at_once_the_first_is_played() -> None:
    played = Played(two(), tap(BEGIN + 50, **HEAD))
    assert played.names == ["stand", "turn", "first", "end"]
    assert played.words == ["cue: first", "cue: words"]


def test_while_one_is_played_no_other_is_and_words_are_said() -> None:
    at = tap(BEGIN + 50) | tap(BEGIN + 70, 2, **HEAD) | tap(BEGIN + 140, 3, **HEAD)
    played = Played(two(), at)
    assert played.names == ["stand", "turn", "second", "first", "end"]
    assert played.words == ["cue: second", "cue: words", "cue: words", "cue: first", "cue: words"]


def test_only_those_that_are_played_are_counted() -> None:
    at = tap(BEGIN + 50, **HEAD) | tap(BEGIN + 120, 2) | tap(BEGIN + 180, 3)
    played = Played(two(at_most=1), at)
    assert played.names == ["stand", "turn", "first", "second", "end"]


def test_one_after_the_other_each_interrupts_the_same_step() -> None:
    at = tap(BEGIN + 50) | tap(BEGIN + 50 + NOD_TICKS + 20, 2)
    played = Played(with_play(TURN), at)
    assert played.names == ["stand", "turn", "nod", "nod", "end"]
    assert ticks_of(played)["turn"] == TURN_TICKS + 2 * NOD_TICKS
    assert played.position[-12, YAW] == pytest.approx(0.6, abs=0.01)
    assert_gentle(played, 0.9)


def test_a_reaction_waits_while_a_reflex_holds_the_robot() -> None:
    held = 30
    played = Played(with_play(TURN), tap(BEGIN + 100), reflexes=(Hold(release_delay=held * CYCLE),))
    begins = dict(played.steps)
    assert begins["nod"] == pytest.approx(BEGIN + 100 + 3 + held, abs=4)
    still = played.velocity[BEGIN + 120 : BEGIN + 100 + held]
    assert np.abs(still).max() < 0.05
    assert played.position[-12, YAW] == pytest.approx(0.6, abs=0.01)
    assert_gentle(played, 1.2)


def test_a_reflex_holds_the_steps_of_a_reaction_too() -> None:
    """Only a touch of the head makes it nod; one of the arm meanwhile stops it for a while."""
    at = tap(BEGIN + 50, **HEAD) | tap(BEGIN + 60, 2)
    experiment = with_play(TURN, on={"limb": "head"})
    played = Played(experiment, at, reflexes=(Hold(limb="left_arm", release_delay=0.36),))
    assert played.names == ["stand", "turn", "nod", "end"]
    assert ticks_of(played)["nod"] > NOD_TICKS + 30
    assert played.position[-12, YAW] == pytest.approx(0.6, abs=0.01)
    assert_gentle(played, 1.2)


def test_a_loop_ends_by_the_touch_that_was_answered() -> None:
    loop = {"repeat": {"times": 5, "steps": [{"name": "round", "hold": 0.24}], "until": {}}}
    played = Played(with_play(loop), tap(BEGIN + 25))
    assert played.names == ["stand", "round", "round", "nod", "end"]


def test_a_reaction_between_random_goals() -> None:
    goals = {
        "setpoints": {"joints": ["HeadYaw"], "range": 0.5, "settle": 0.6, "count": 3, "period": 1.2}
    }
    experiment = with_play({"name": "goals", **goals})
    played, quiet = Played(experiment, tap(BEGIN + 80)), Played(experiment)
    assert played.names == ["stand", "goals", "goals", "nod", "goals", "goals", "end"]
    assert len(played.position) - len(quiet.position) == NOD_TICKS + BACK
    np.testing.assert_allclose(played.position[-12], quiet.position[-12], atol=0.01)


# -- the end ----------------------------------------------------------------------------------------------------------


def test_a_reaction_that_waits_may_stop_it_all() -> None:
    experiment = with_play(TURN, play=listen(timeout=0.24, limb="head", on_timeout="stop"))
    played = Played(experiment, tap(BEGIN + 50))
    assert played.names == ["stand", "turn", "listen"]
    assert played.done.stopped_by == "listen"
    assert played.after == played.before


def stop(pepper: Pepper) -> None:
    pepper.emergency_stop()


def interrupt(pepper: Pepper) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize(("end", "error"), [(stop, FaultError), (interrupt, KeyboardInterrupt)])
@pytest.mark.parametrize("tick", [100, 101, 100 + NOD_TICKS, 150])
def test_what_breaks_it_off_leaves_nothing_behind(
    end: Callable[[Pepper], None], error: type[BaseException], tick: int
) -> None:
    """In the tick of the touch, in the reaction, on the way back."""
    step = {"name": "reach", "duration": 2.4, "position": REACH, "base": {"x": 0.1}}
    look = NOD | {
        "look_at": {"point": [1.0, 0.3, 1.0]},
        "base_velocity": {"vx": 0.1},
        "stiffness": 30.0,
    }
    played = Played(
        with_play(step, play=look),
        tap(BEGIN + 100),
        on_tick=lambda pepper, now: end(pepper) if now == BEGIN + tick else None,
    )
    assert isinstance(played.error, error)
    assert played.after == played.before


def test_a_target_that_is_refused_in_a_reaction_leaves_nothing_behind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    honest = goals._target

    def target(spec: Any, controller: Any) -> FloatArray:
        return honest(spec, controller) * (np.nan if spec.label == "look at" else 1.0)

    monkeypatch.setattr(goals, "_target", target)
    step = {"name": "reach", "duration": 2.4, "position": REACH}
    look = NOD | {
        "position": REACH | {"link": "r_wrist", "joints": ["right_arm"]},
        "look_at": {"point": [1.0, 0.3, 1.0]},
    }
    played = Played(with_play(step, play=look), tap(BEGIN + 100))
    assert isinstance(played.error, TargetError)
    assert played.after == played.before


def test_after_the_last_step_there_is_no_reaction() -> None:
    """A touch in the last tick comes too late, one before it is answered, and the step goes on."""
    experiment = reacting(STAND, TURN, reactions=[{"play": "p"}], parts={"p": [NOD]})
    last = BEGIN + TURN_TICKS
    assert Played(experiment, tap(last + 1)).names == ["stand", "turn"]
    played = Played(experiment, tap(last))
    assert played.names == ["stand", "turn", "nod"]
    assert played.position[-1, YAW] == pytest.approx(0.6, abs=0.01)


def test_a_player_says_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    fractions: list[float] = []
    honest = Player.advance

    def advance(self: Player) -> bool:
        fractions.append(self.progress)
        return honest(self)

    monkeypatch.setattr(Player, "advance", advance)
    Played(with_play(TURN), tap(BEGIN + 100))
    assert fractions == sorted(fractions)
    assert fractions[0] < 0.01
    assert fractions[-1] == 1.0, "a reaction takes time that was not planned"
