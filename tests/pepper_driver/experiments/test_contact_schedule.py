"""Contacts that are planned happen, are recorded as they were, and marked where a motor board was at its limit."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pepper_driver import Pepper
from pepper_driver.callbacks.events import PushEvent
from pepper_driver.config import Experiment, load_experiment
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_specs import JointPushSpec, PushSpec, RandomPushes
from pepper_driver.config.steps import Step
from pepper_driver.controller import Tick
from pepper_driver.experiments.contact_schedule import ContactSchedule
from pepper_driver.experiments.plan import plan_experiment
from pepper_driver.experiments.reports import ExperimentReport
from pepper_driver.observer import Observation
from support.experiments import CYCLE, ROBOT, make_experiment
from support.pushes import PUSHED_ARMS, limit_degrees, make_pepper

REACH = load_experiment("reach_and_push", ROBOT)
INDEX = ROBOT.joint_index("LShoulderRoll")
PUSH: dict[str, Any] = {
    "kind": "joint_push",
    "joint": "LShoulderRoll",
    "link": "LBicep",
    "xyz": [0.16, 0.015, 0.0],
    "degrees": 1.0,
    "direction": 1,
    "start": 0.6,
    "duration": 1.2,
}
GRAB: dict[str, Any] = {
    "kind": "grab",
    "joint": "LShoulderRoll",
    "link": "LForeArm",
    "xyz": [0.1, 0.0, 0.0],
    "pull": [0.0, 0.02, 0.0],
    "stiffness": 500.0,
    "start": 0.3,
    "rise": 0.3,
    "hold": 0.2,
    "release": 0.1,
}


class Witness:
    """An experiment that was played, with times, torques and saturation of every tick.

    Attributes:
        begin: When it began [s].
    """

    def __init__(self, pepper: Pepper, experiment: Experiment) -> None:
        self._pepper = pepper
        times: list[float] = []
        torques: list[FloatArray] = []
        saturated: list[Any] = []
        self.events: list[PushEvent] = []
        pepper.on_push()(self.events.append)

        def note(tick: Tick, _: Observation | None) -> None:
            truth = pepper.backend.truth
            times.append(tick.measurement.time)
            torques.append(truth.contact_torque)
            saturated.append(truth.saturated)

        with pepper:
            self.begin = pepper.time
            self.report: ExperimentReport = pepper.play(experiment, on_tick=note)
        self.time, self.torque = np.array(times), np.array(torques)
        self.saturated = np.array(saturated)


def still(*contacts: dict[str, Any], length: float = 2.4) -> Experiment:
    """A robot that stays in Stand and is touched."""
    return make_experiment({"posture": "Stand", "hold": length}, contacts=list(contacts))


def test_what_is_planned_is_what_happens() -> None:
    """Pushes in newtons and in degrees, in two steps; the end of the second is left out."""
    pepper = make_pepper()
    contacts = REACH.contacts[:2]
    stand, reach = REACH.steps[:2]
    assert isinstance(stand, Step)
    assert isinstance(reach, Step)
    steps = (stand, replace(reach, hold=5.2))
    seen = Witness(pepper, replace(REACH, steps=steps, contacts=contacts))
    assert len(seen.report.pushes) == 2
    for push, contact in zip(seen.report.pushes, contacts, strict=True):
        assert isinstance(contact, PushSpec | JointPushSpec)
        assert push.joint is not None
        assert push.onset - seen.begin == pytest.approx(1.0 + contact.start, abs=CYCLE / 2)
        assert push.release - push.onset == pytest.approx(contact.duration)
        joint_torque = seen.torque[:, ROBOT.joint_index(push.joint)]
        during = (seen.time > push.onset + 0.15) & (seen.time < push.release - 0.15)
        np.testing.assert_allclose(joint_torque[during], push.direction * push.torque, rtol=0.01)
        stiffness = pepper.backend.plant.stiffness[ROBOT.joint_index(push.joint)]
        assert push.degrees == pytest.approx(np.degrees(push.torque / stiffness))
        assert not push.saturating
    first, second = seen.report.pushes
    assert first.force == pytest.approx(20.0)
    assert second.degrees == pytest.approx(2.8)
    assert (first.direction, second.direction) == (1, -1)
    assert (first.moving, second.moving) == (True, False)
    assert [event.push for event in seen.events] == [first, second]
    assert "2.8 equivalent degrees on RElbowRoll" in seen.events[1].text


def test_contacts_at_the_beginning_and_in_each_round() -> None:
    rounds = {"repeat": {"times": 2, "steps": [{"name": "rest", "hold": 1.2}]}}
    contacts = [
        PUSH | {"start": 0.3, "duration": 0.2},
        PUSH | {"step": "rest", "start": 0.24, "duration": 0.3},
    ]
    experiment = make_experiment({"posture": "Stand", "hold": 1.2}, rounds, contacts=contacts)
    seen = Witness(make_pepper(), experiment)
    onsets = [push.onset - seen.begin for push in seen.report.pushes]
    assert onsets == pytest.approx([0.3, 1.2 + 0.24, 2.4 + 0.24], abs=CYCLE / 2)
    acting = np.abs(seen.torque[:, INDEX]) > 0.05
    begins = seen.time[1:][np.diff(acting.astype(int)) == 1] - seen.begin
    np.testing.assert_allclose(begins, onsets, atol=0.06)  # a push rises


def test_contacts_of_a_branch_that_is_not_taken_do_not_come() -> None:
    cases = [{"on": {"limb": "head"}, "steps": [{"name": "head", "hold": 0.6}]}]
    other = [{"name": "other", "hold": 0.6}]
    step = {"branch": {"timeout": 0.12, "cases": cases, "otherwise": other}}
    contacts = [PUSH | {"step": name, "start": 0.0, "duration": 0.3} for name in ("head", "other")]
    experiment = make_experiment({"posture": "Stand", "hold": 1.2}, step, contacts=contacts)
    seen = Witness(make_pepper(), experiment)
    assert [push.onset - seen.begin for push in seen.report.pushes] == pytest.approx(
        [1.32], abs=0.02
    )


@pytest.mark.parametrize("ratio", [0.3, 0.9, 1.15])
def test_a_push_is_marked_where_its_board_was_at_its_limit(ratio: float) -> None:
    """Planning looks at the rest state only; one that is to saturate must say so."""
    pepper = make_pepper()
    degrees = ratio * limit_degrees(pepper, "LShoulderRoll")
    seen = Witness(
        pepper,
        still(PUSH | {"degrees": degrees, "duration": 0.4, "saturating": ratio > 0.85}, length=1.5),
    )
    (push,) = seen.report.pushes
    assert push.saturating == (ratio > 1)
    during = (seen.time >= push.onset) & (seen.time <= push.release)
    assert push.saturated == seen.saturated[during, INDEX].any()
    assert push.saturated or ratio < 1
    assert not (push.saturated and ratio == 0.3)
    (event,) = seen.events
    assert event.push is not None
    assert replace(event.push, saturated=push.saturated) == push


def test_of_two_pushes_only_that_one_is_marked() -> None:
    pepper = make_pepper()
    limit = limit_degrees(pepper, "LShoulderRoll")
    contacts = [
        PUSH | {"degrees": 1.15 * limit, "duration": 0.4, "saturating": True},
        PUSH | {"degrees": 0.2 * limit, "duration": 0.4, "start": 2.4},
    ]
    seen = Witness(pepper, still(*contacts, length=3.6))
    assert [(push.saturating, push.saturated) for push in seen.report.pushes] == [
        (True, True),
        (False, False),
    ]


class Saturated:
    """A backend that says which boards are at their limits, and takes all pushes."""

    info = make_pepper().backend.info

    def __init__(self) -> None:
        self.joints: set[str] = set()

    @property
    def truth(self) -> Any:
        saturated = np.array([name in self.joints for name in ROBOT.joint_names])
        return type("Truth", (), {"saturated": saturated})

    def push(self, *_: object, **__: object) -> None:
        pass


def test_marks_are_those_of_the_joint_that_is_meant_and_of_its_time() -> None:
    trunk = {
        "kind": "random_forces",
        "times": [0.6],
        "newtons": [4.0, 5.0],
        "duration": [0.3, 0.3],
        "points": {"link": "torso", "xyz": [0.0, 0.0, 0.2]},
    }
    goals = {
        "setpoints": {"joints": ["HeadYaw"], "range": 0.5, "settle": 0.6, "count": 1, "period": 1.2}
    }
    experiment = make_experiment(goals, contacts=[trunk, PUSH])
    plan = plan_experiment(experiment, ROBOT, make_pepper().backend)
    backend: Any = Saturated()
    schedule = ContactSchedule(backend, ROBOT)
    (force,), (push,) = plan.segments[1].contacts, plan.at_begin
    schedule.order(
        [replace(force, delay=1.0, duration=0.5), replace(push, delay=1.0, duration=0.5)], 10.0
    )
    for time, joint, marked in (
        (10.9, "LShoulderRoll", [False, False]),
        (11.2, "LElbowRoll", [False, False]),
        (11.2, "LShoulderRoll", [False, True]),
        (11.6, "HipRoll", [False, True]),
        (11.4, "HipRoll", [True, True]),
        (11.4, "HeadYaw", [True, True]),
    ):
        backend.joints = {joint}
        schedule.watch(time)
        assert [push.saturated for push in schedule.pushes] == marked, (time, joint)


def test_a_grab_reaches_the_backend_as_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    pepper = make_pepper()
    grabs: list[tuple[tuple[Any, ...], dict[str, Any]]] = []
    monkeypatch.setattr(
        pepper.backend, "grab", lambda *args, **kw: grabs.append((args, kw)), raising=False
    )
    seen = Witness(pepper, still(GRAB))
    (((link, pull, point), options),) = grabs
    assert link == "LForeArm"
    np.testing.assert_array_equal(pull, [0.0, 0.02, 0.0])
    np.testing.assert_array_equal(point, [0.1, 0.0, 0.0])
    assert options == {
        "delay": pytest.approx(0.3),
        "stiffness": 500.0,
        "rise": 0.3,
        "hold": 0.2,
        "release": 0.1,
        "max_force": 100.0,
        "frame": "world",
    }
    (record,) = seen.report.pushes
    assert record.link == "LForeArm"
    assert record.force == pytest.approx(10.0)
    assert record.release - record.onset == pytest.approx(0.6)


def test_a_hand_that_is_still_there_costs_one_contact_and_not_the_run() -> None:
    """The step is shorter than it was planned: it reaches its target at once, and comes again."""
    early = {"name": "led", "joints": {"HeadYaw": 0.0}, "until": "reached", "timeout": 1.2}
    rounds = {"repeat": {"times": 2, "steps": [early]}}
    experiment = make_experiment(
        {"posture": "Stand", "duration": 1.2},
        rounds,
        {"hold": 1.2},
        contacts=[GRAB | {"step": "led"}],
    )
    seen = Witness(make_pepper(), experiment)
    assert len(seen.report.pushes) == 1
    assert [event.push is None for event in seen.events] == [False, True]
    assert seen.events[0].text.startswith("grabbed with 10.0 N")
    assert seen.events[1].text.startswith("left out: grabbed with 10.0 N")


def test_pushes_rise_as_fast_as_the_experiment_says(monkeypatch: pytest.MonkeyPatch) -> None:
    (pushes,) = PUSHED_ARMS.contacts
    assert isinstance(pushes, RandomPushes)
    rises = []
    for rise in (None, (0.04, 0.05)):
        pepper = make_pepper()
        asked: list[dict[str, Any]] = []
        monkeypatch.setattr(pepper.backend, "push", lambda *_, asked=asked, **kw: asked.append(kw))
        contact = replace(pushes, degrees=(0.5, 1.5), times=(0.25, 1.0), rise=rise)
        experiment = PUSHED_ARMS.with_goals(settle=0.6, count=2, period=2.4)
        Witness(pepper, replace(experiment, contacts=(contact,)))
        rises.append([kw.get("rise", 0.0) for kw in asked])
    assert rises[0] == [0.0] * 4, "that of the backend"
    assert all(0.04 <= rise <= 0.05 for rise in rises[1])
    assert len(set(rises[1])) == 4


def test_forces_on_the_trunk_act_on_the_legs() -> None:
    force = {
        "kind": "random_forces",
        "times": [0.6],
        "newtons": [8.0, 12.0],
        "duration": [0.5, 0.6],
        "points": {"link": "torso", "xyz": [0.0, 0.0, 0.2]},
    }
    goals = {
        "setpoints": {"joints": ["HeadYaw"], "range": 0.5, "settle": 0.6, "count": 2, "period": 1.8}
    }
    pepper = make_pepper("rolling")
    seen = Witness(pepper, make_experiment(goals, contacts=[force]))
    legs = [ROBOT.joint_index(name) for name in ROBOT.chains["legs"]]
    degrees = np.degrees(np.abs(seen.torque[:, legs])) / pepper.backend.plant.stiffness[legs]
    assert len(seen.report.pushes) == 2
    for push in seen.report.pushes:
        assert (push.joint, push.link) == (None, "torso")
        during = (seen.time > push.onset) & (seen.time < push.release)
        assert degrees[during].max() == pytest.approx(push.degrees, rel=0.1)


def test_one_seed_one_run() -> None:
    short = PUSHED_ARMS.with_goals(settle=0.6, count=1, period=2.4)
    (pushes,) = PUSHED_ARMS.contacts
    assert isinstance(pushes, RandomPushes)
    short = replace(short, contacts=(replace(pushes, times=(0.25,)),))
    runs = [Witness(make_pepper(), replace(short, seed=seed)).report.pushes for seed in (4, 4, 5)]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]
