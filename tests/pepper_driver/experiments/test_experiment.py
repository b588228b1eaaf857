"""Experiments as a user runs them: files, checked before anything moves, performed as written, on every backend."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from pepper_driver import CueEvent, ExperimentRun, Pepper, PepperError, StepEvent
from pepper_driver.backends.mock import MockBackend
from pepper_driver.callbacks.events import PushEvent
from pepper_driver.config import ConfigError
from pepper_driver.config.contact_specs import RandomPushes
from pepper_driver.config.loading import package_file, read_yaml
from pepper_driver.controller import Tick
from pepper_driver.log import read_log
from pepper_driver.observer import Observation
from support import ROOT
from support.events import contact
from support.experiments import CYCLE, EXAMPLES, ROBOT, STAND, TURN, fake, listen, make_run, write
from support.pushes import PUSHED_ARMS
from support.pushes import make_pepper as make_pushed

PUSH: dict[str, Any] = {
    "kind": "joint_push",
    "step": "wait",
    "joint": "RElbowRoll",
    "link": "RForeArm",
    "xyz": [0.14, 0.0, 0.0],
    "degrees": 2.5,
    "direction": -1,
    "start": 0.05,
    "duration": 0.5,
}
STRONG = PUSH | {"link": "RBicep", "joint": "RShoulderRoll", "degrees": 2.2}
PAUSE: dict[str, Any] = {"name": "wait", "hold": 0.6}


def test_steps_cues_and_repetitions_come_in_order(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    run = make_run(
        monkeypatch,
        tmp_path,
        STAND,
        {"repeat": {"times": 2, "steps": [{"name": "say", "say": "left"}, TURN]}},
        {"name": "leds", "leds": {"colour": [0, 0.5, 1], "duration": 0.4}},
        {"name": "rest", "hold": 0.3},
    )
    steps: list[StepEvent] = []
    cues: list[CueEvent] = []
    run.pepper.on_step()(steps.append)
    run.pepper.on_cue()(cues.append)
    report = run.perform()
    names = ["stand", "say", "turn", "say", "turn", "leds", "rest"]
    assert [event.step for event in steps] == names
    assert [step.name for step in report.steps] == names
    assert [(cue.kind, cue.text) for cue in cues] == [
        ("say", "left"),
        ("say", "left"),
        ("leds", ""),
    ]
    assert (cues[2].group, cues[2].colour, cues[2].duration) == ("FaceLeds", (0.0, 0.5, 1.0), 0.4)
    times = np.diff([event.time for event in steps])
    ticks = [round(seconds / CYCLE) for seconds in (0.1, 0.012, 0.5, 0.012, 0.5, 0.012)]
    np.testing.assert_allclose(times, np.array(ticks) * CYCLE, atol=1e-9)
    assert report.seconds == pytest.approx((sum(ticks) + round(0.3 / CYCLE)) * CYCLE)
    assert report.completed


def test_only_cues_of_a_kind_are_published(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    steps: list[dict[str, Any]] = [
        {"say": "hello"},
        {"leds": {"colour": [0, 0, 0]}},
        {"cue": "now"},
    ]
    run = make_run(monkeypatch, tmp_path, *steps)
    said: list[CueEvent] = []
    run.pepper.on_cue(kind="say")(said.append)
    run.pepper.on_cue(kind="cue")(said.append)
    with pytest.raises(PepperError, match="unknown kind of cue"):
        run.pepper.on_cue(kind="sing")  # type: ignore[call-overload]
    run.perform()
    assert [cue.text for cue in said] == ["hello", "now"]


def test_a_wait_ends_with_the_contact_it_waits_for(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    at = {
        3: (contact(1),),  # during the first step: no answer to the wait
        20: (contact(1, phase="update"),),
        21: (contact(2, link="RForeArm"),),
        22: (contact(3, kind="rebound"),),
        23: (contact(4, intensity_deg=1.0),),
        30: (contact(4, phase="update", intensity_deg=2.5),),
    }
    requested = listen(link="LForeArm", min_intensity_deg=2.0, on_timeout="stop")
    run = make_run(monkeypatch, tmp_path, STAND, requested, PAUSE, at=at)
    steps: list[StepEvent] = []
    run.pepper.on_step()(steps.append)
    report = run.perform()
    assert [wait.detected for wait in report.waits] == [True]
    assert report.completed
    assert steps[2].time == pytest.approx(30 * CYCLE)
    assert report.contact_counts == {"LForeArm": 2, "RForeArm": 1}


@pytest.mark.parametrize("on_timeout", ["continue", "stop"])
def test_a_wait_in_vain(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, on_timeout: str) -> None:
    steps = [STAND, listen(on_timeout=on_timeout), {"say": "late"}, TURN]
    run = make_run(monkeypatch, tmp_path, *steps)
    cues: list[CueEvent] = []
    run.pepper.on_cue()(cues.append)
    report = run.perform()
    assert [wait.detected for wait in report.waits] == [False]
    assert report.completed == (on_timeout == "continue")
    assert report.stopped_by == ("listen" if on_timeout == "stop" else "")
    assert len(cues) == (on_timeout == "continue")
    assert len(report.steps) == (4 if on_timeout == "continue" else 2)
    assert ("wait 'listen' timed out" in str(report)) == (on_timeout == "stop")


def test_each_wait_listens_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    at = {20: (contact(1),), 60: (contact(1, phase="update", intensity_deg=9.0),)}
    loop = {"repeat": {"times": 2, "steps": [listen()]}}
    report = make_run(monkeypatch, tmp_path, STAND, loop, at=at).perform()
    assert [wait.detected for wait in report.waits] == [True, False]


def test_a_contact_under_a_reflex_ends_the_wait_after_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """While a reflex holds the robot the steps stand still; what came meanwhile is not forgotten."""
    at = {20: (contact(1),), 30: (contact(1, phase="end"),)}
    reactions = [{"do": "hold", "release_delay": 0.24}]
    run = make_run(monkeypatch, tmp_path, STAND, listen(), TURN, at=at, reactions=reactions)
    steps: list[StepEvent] = []
    run.pepper.on_step()(steps.append)
    report = run.perform()
    assert report.waits[0].detected
    assert report.reflex_counts == {"hold": 1}
    assert steps[2].time == pytest.approx(50 * CYCLE, abs=3 * CYCLE)


def test_reflexes_are_those_of_the_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    reactions = [
        {"do": "hold", "name": "stand still"},
        {"say": "Oh!"},
        {
            "on": {"link": "LForeArm"},
            "do": "retract",
            "distance": 0.3,
            "priority": 70,
            "say": "No!",
        },
    ]
    at = {20: (contact(1),)}
    run = make_run(monkeypatch, tmp_path, STAND, TURN, reactions=reactions, at=at)
    assert [(r.name, r.priority) for r in run.pepper.reflexes] == [
        ("retract", 70),
        ("stand still", 20),
    ]
    assert run.pepper.reflexes[0].selector.link == ("LForeArm",)
    said: list[CueEvent] = []
    run.pepper.on_cue()(said.append)
    assert "retract" in run.perform().reflex_counts
    assert [cue.text for cue in said] == ["Oh!", "No!"]


def test_a_pepper_that_plays_has_its_reflexes_already(tmp_path: Path) -> None:
    path = write(tmp_path, STAND, reactions=[{"say": "Oh!"}, {"do": "hold"}])
    with (
        Pepper("mock", observer=None) as pepper,
        pytest.raises(
            ConfigError, match=r"key 'reactions\.1\.do': .*perform it with ExperimentRun"
        ),
    ):
        pepper.play(path)


def test_reactions_play_files_in_its_folder(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    write(tmp_path, {"name": "nod", "joints": {"HeadPitch": 0.0}, "duration": 0.3}, file="nod")
    reactions = [{"on": {"limb": "left_arm"}, "play": "nod.yaml", "at_most": 1}]
    at = {20: (contact(1),), 21: (contact(1, phase="end"),), 60: (contact(2),)}
    rest = {"name": "rest", "hold": 1.2}
    run = make_run(monkeypatch, tmp_path, STAND, rest, reactions=reactions, at=at)
    assert [step.name for step in run.perform().steps] == ["stand", "nod", "rest"]


def test_the_log_says_what_was_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    fake(monkeypatch)
    path = write(tmp_path, STAND, {"say": "hello"}, TURN)
    ExperimentRun(path, log=tmp_path / "run.mcap").perform()
    log = read_log(tmp_path / "run.mcap")
    assert log.metadata["experiment"] == "mine"
    assert log.metadata["experiment_file"] == path.read_text()
    assert [(e.kind, e.name, e.text) for e in log.events] == [
        ("step", "stand", ""),
        ("step", "1", ""),
        ("cue", "say", "say: hello"),
        ("step", "turn", ""),
    ]


# -- checked before anything moves ----------------------------------------------------------------------------------


ON_NOTHING = [{"on": {"link": "LForeAm"}, "do": "hold"}]
TWO = [{"do": "hold"}, {"do": "retract", "priority": 20}]
WRONG: list[tuple[list[Any], dict[str, Any], str, str]] = [
    ([{"posture": "Crouch", "hold": 1.0}], {}, "steps.0.posture", "limits while HeadYaw is at 0"),
    ([STAND], {"reactions": ON_NOTHING}, "reactions.0.on.link", "did you mean LForeArm"),
    ([STAND], {"reactions": TWO}, "reactions.1", "same priority, 20"),
    ([STAND], {"observer": {"mode": "fusoin"}}, "observer.mode", "did you mean fusion"),
    (
        [STAND, {"joints": {"HeadYaw": 2}, "duration": 0.1}],
        {},
        "steps.1.duration",
        "give 0.28 s or",
    ),
    ([STAND], {"observer": {"models": "gone.json"}}, "", "gone.json"),
    ([STAND, PAUSE], {"contacts": [PUSH | {"degrees": 30.0}]}, "contacts.0", "would load"),
    ([STAND, PAUSE], {"contacts": [PUSH, STRONG]}, "contacts.1", "would"),
]


@pytest.mark.parametrize(("steps", "more", "where", "reason"), WRONG)
def test_what_the_robot_cannot_do_is_refused_with_line_and_reason(
    tmp_path: Path, steps: list[Any], more: dict[str, Any], where: str, reason: str
) -> None:
    with pytest.raises(PepperError) as caught:
        ExperimentRun(write(tmp_path, *steps, **more))
    message = str(caught.value)
    assert reason in message
    if where:
        assert f"mine.yaml line {message.split('line ')[1].split(':')[0]}: key '{where}'" in message


def test_where_the_robot_stands_counts_too(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The file alone is fine; from where this robot stands the step would lead the arm into the trunk."""
    backend, _ = fake(monkeypatch)
    path = write(tmp_path, {"joints": {"LElbowRoll": -1.2}, "duration": 1.0})
    run = ExperimentRun(path)
    for name, angle in {"LShoulderPitch": 0.9, "LShoulderRoll": 0.01, "LElbowYaw": -0.3}.items():
        backend.position[ROBOT.joint_index(name)] = angle
    with pytest.raises(ConfigError, match=r"line \d+: key 'steps\.0\.joints'.*torso"):
        run.perform()
    for command in backend.commands:  # it was held where it stands
        np.testing.assert_allclose(command.position, backend.position, atol=1e-9)
        assert not command.wheel_speed.any()
    assert backend.calls[-1] == "close"


def test_nothing_is_planned_twice_but_for_where_the_robot_stands(tmp_path: Path) -> None:
    """Random goals and contacts are those that were shown before the robot moved."""
    arms = PUSHED_ARMS.with_goals(count=2, settle=0.1, period=2.4)
    (pushes,) = arms.contacts
    assert isinstance(pushes, RandomPushes)
    arms = replace(arms, contacts=(replace(pushes, times=(0.25,)),), observer=None)
    run = ExperimentRun(arms, seed=5)
    assert run.plan() is run.plan()
    planned = [contact for segment in run.plan().segments for contact in segment.contacts]
    done = run.perform().pushes
    assert [push.force for push in done] == [contact.planned.newtons for contact in planned]
    assert len(done) == 2


# -- contacts -------------------------------------------------------------------------------------------------------


def test_contacts_on_a_robot_that_cannot_be_pushed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    fake(monkeypatch)
    path = write(tmp_path, STAND, PAUSE, contacts=[PUSH])
    with pytest.raises(ConfigError, match=r"key 'contacts': only simulated robots.*--no-contacts"):
        ExperimentRun(path)
    report = ExperimentRun(path, contacts=False).perform()
    assert report.completed
    assert report.pushes == ()


def test_a_real_robot_is_asked_before_it_is_planned(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Nothing connects before it is performed; what is wrong with contacts is said then, and nothing moves."""
    backend, _ = fake(monkeypatch, MockBackend(real_time=True))
    run = ExperimentRun(write(tmp_path, STAND, PAUSE, contacts=[PUSH]))
    assert backend.calls == []
    with pytest.raises(ConfigError, match="only simulated robots"):
        run.perform()
    assert "activate" not in backend.calls


def test_a_push_in_a_step_comes_each_time_and_is_logged(tmp_path: Path) -> None:
    start = PUSH | {"joint": "LShoulderRoll", "link": "LBicep", "xyz": [0.16, 0.0, 0.0]}
    start |= {"step": None, "degrees": 1.5, "direction": 1, "duration": 0.3}
    path = write(
        tmp_path,
        {**STAND, "duration": 0.5},
        {"repeat": {"times": 2, "steps": [PAUSE]}},
        contacts=[PUSH, start],
        observer=None,
    )
    run = ExperimentRun(path, log=tmp_path / "run.mcap")
    report = run.perform()
    assert [push.link for push in report.pushes] == ["LBicep", "RForeArm", "RForeArm"]
    log = read_log(tmp_path / "run.mcap")
    events = [event for event in log.events if event.kind == "push"]
    assert [event.name for event in events] == ["LBicep", "RForeArm", "RForeArm"]
    assert "2.5 equivalent degrees on RElbowRoll" in events[1].text
    assert log.truth is not None
    torque = log.truth["contact_torque"][:, ROBOT.joint_index("RElbowRoll")]
    begins = np.flatnonzero(np.diff((torque < -0.5).astype(int)) == 1)
    # A push rises within a tenth of a second.
    assert len(begins) == 2
    for begin, event in zip(log["time"][begins], events[1:], strict=True):
        assert 0.04 < begin - event.time < 0.16
    assert report.as_json()["pushes"][1]["joint"] == "RElbowRoll"


# -- random goals -----------------------------------------------------------------------------------------------------


def test_the_base_moves_as_the_experiment_says_and_stops_at_its_end(tmp_path: Path) -> None:
    base = {"linear": 0.2, "angular": 0.5, "share": 1.0}
    goals = {"joints": ["HeadYaw"], "range": 0.5, "settle": 0.6, "count": 2, "period": 1.2}
    path = write(tmp_path, {"setpoints": goals | {"base": base}}, seed=3)
    pepper = make_pushed("rolling")
    targets, wheels = [], []

    def on_tick(tick: Tick, _: Observation | None) -> None:
        targets.append(pepper.controller.base_velocity.target.copy())
        wheels.append(np.abs(tick.measurement.wheel_speed).max())

    with pepper:
        pepper.play(path, on_tick=on_tick, skip_settling=True)
        np.testing.assert_array_equal(pepper.controller.base_velocity.target, np.zeros(3))
    assert len(targets) == 200, "the way to the first posture is left out"
    first, second = np.array(targets[:99]), np.array(targets[100:199])
    for part in (first, second):
        assert part.any()
        np.testing.assert_array_equal(part, np.broadcast_to(part[0], part.shape))
    assert (first[0] != second[0]).any()
    assert max(wheels) > 0.3


def test_holds_go_along_a_spline_of_least_jerk_and_stay(tmp_path: Path) -> None:
    goals = {"joints": ["HeadYaw"], "range": 0.4, "settle": 0.012, "move": 2.4, "hold": 0.6}
    path = write(tmp_path, {"holds": goals | {"count": 3}}, seed=3)
    yaw = ROBOT.joint_index("HeadYaw")
    positions: list[float] = []
    requested: list[float] = []
    with Pepper("mock", observer=None) as pepper:
        pepper.play(
            path,
            on_tick=lambda *_: positions.append(pepper.controller.position[yaw]),
            on_step=lambda _: requested.append(pepper.target[yaw]),
        )
    start, *goals_reached = requested
    assert np.ptp(goals_reached) > 0.1
    for number, goal in enumerate(goals_reached):
        way = np.array(positions[1 + 250 * number : 1 + 250 * (number + 1)])
        s = np.minimum(np.arange(1, 251) / 200, 1.0)
        spline = start + (goal - start) * (10 * s**3 - 15 * s**4 + 6 * s**5)
        np.testing.assert_allclose(way, spline, atol=0.01)
        start = goal


def test_progress_rises_to_one() -> None:
    reported: list[float] = []
    with Pepper("mock", observer=None) as pepper:
        pepper.play("wave", on_progress=reported.append)
    assert reported == sorted(reported)
    assert reported[-1] == 1.0
    assert len(reported) >= 4


# -- the shipped ones -----------------------------------------------------------------------------------------------


PUSHED = [path for path in EXAMPLES if "contacts:" in path.read_text()]


@pytest.mark.parametrize("path", PUSHED, ids=lambda path: path.stem)
def test_the_examples_run(path: Path) -> None:
    run = ExperimentRun(path)
    reported: list[PushEvent] = []
    run.pepper.on_push()(reported.append)
    report = run.perform()
    assert report.completed
    assert report.contact_counts
    assert report.reflex_counts
    assert all(wait.detected for wait in report.waits)
    assert len(reported) == len(report.pushes) >= 1


def test_the_experiment_in_the_docs_is_the_shipped_one(tmp_path: Path) -> None:
    root = ROOT
    text = (root / "docs" / "experiments.md").read_text()
    (tmp_path / "docs.yaml").write_text(text.split("```yaml\n")[1].split("```")[0])
    shown = read_yaml(tmp_path / "docs.yaml")
    assert shown == read_yaml(root / "examples" / "experiments" / "touch_the_arm.yaml")


def test_a_file_of_ones_own_that_begins_as_a_shipped_one(tmp_path: Path) -> None:
    data = read_yaml(package_file("experiments", "reach_and_push.yaml"))
    data["steps"], data["contacts"] = data["steps"][:2], data["contacts"][:1]
    data["steps"][1]["hold"] = 2.4
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(data))
    with make_pushed() as pepper:
        assert len(pepper.play(path).pushes) == 1


def test_the_same_run_gives_the_same_bits() -> None:
    (path,) = (path for path in EXAMPLES if path.stem == "retract")
    first, second = ExperimentRun(path).perform(), ExperimentRun(path).perform()
    assert first.contacts == second.contacts
    assert first.reflexes == second.reflexes
    assert first.seconds == second.seconds
    assert first.pushes == second.pushes
