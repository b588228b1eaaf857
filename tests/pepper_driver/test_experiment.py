"""Experiments: planned before anything moves, performed as written, on every backend."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from event_cases import contact
from experiment_cases import EXAMPLES, ROBOT, STAND, TURN, fake, listen, make_run, write

from pepper_driver import CueEvent, PepperError, StepEvent
from pepper_driver.config import ConfigError
from pepper_driver.experiment import ExperimentRun
from pepper_driver.log import read_log

CYCLE = ROBOT.cycle
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
BENT: dict[str, Any] = {
    "joints": {
        "LShoulderPitch": 0.9,
        "LShoulderRoll": 0.01,
        "LElbowYaw": -0.3,
        "LElbowRoll": -1.5,
        "LHand": 0.5,
    }
}
STRONG = PUSH | {"link": "RBicep", "joint": "RShoulderRoll", "degrees": 2.2}
PAUSE: dict[str, Any] = {"name": "wait", "wait": {"seconds": 0.6}}


def test_steps_cues_and_repetitions_come_in_order(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    run = make_run(
        monkeypatch,
        tmp_path,
        STAND,
        {"repeat": {"times": 2, "steps": [{"say": "left"}, TURN]}},
        {"leds": {"colour": [0, 0.5, 1], "duration": 0.4}},
        {"wait": {"seconds": 0.3}},
    )
    steps: list[StepEvent] = []
    cues: list[CueEvent] = []
    run.pepper.on_step()(steps.append)
    run.pepper.on_cue()(cues.append)
    report = run.perform()
    names = ["stand", "say", "turn", "say", "turn", "leds", "wait"]
    assert [event.step for event in steps] == names
    assert [step.name for step in report.motion.steps] == names
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


def test_only_cues_of_a_kind_are_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    run = make_run(monkeypatch, tmp_path, {"say": "hello"}, {"leds": {"colour": [0, 0, 0]}})
    said: list[CueEvent] = []
    run.pepper.on_cue(kind="say")(said.append)
    with pytest.raises(PepperError, match="unknown kind of cue"):
        run.pepper.on_cue(kind="sing")  # type: ignore[arg-type]
    run.perform()
    assert [cue.text for cue in said] == ["hello"]


def test_a_wait_ends_with_the_contact_it_waits_for(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    at = {
        3: (contact(1),),  # during the first step: no answer to the wait
        20: (contact(1, phase="update"),),
        21: (contact(2, link="RForeArm"),),
        22: (contact(3, kind="rebound"),),
        23: (contact(4, intensity=1.0),),
        30: (contact(4, phase="update", intensity=2.5),),
    }
    wanted = listen(link="LForeArm", min_intensity=2.0, otherwise="stop")
    run = make_run(monkeypatch, tmp_path, STAND, wanted, PAUSE, at=at)
    steps: list[StepEvent] = []
    run.pepper.on_step()(steps.append)
    report = run.perform()
    assert [wait.heard for wait in report.waits] == [True]
    assert report.completed
    assert steps[2].time == pytest.approx(30 * CYCLE)
    assert report.felt == {"LForeArm": 2, "RForeArm": 1}


@pytest.mark.parametrize("otherwise", ["continue", "stop"])
def test_a_wait_in_vain(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, otherwise: str) -> None:
    steps = [STAND, listen(otherwise=otherwise), {"say": "late"}, TURN]
    run = make_run(monkeypatch, tmp_path, *steps)
    cues: list[CueEvent] = []
    run.pepper.on_cue()(cues.append)
    report = run.perform()
    assert [wait.heard for wait in report.waits] == [False]
    assert report.completed == (otherwise == "continue")
    assert report.stopped_by == ("listen" if otherwise == "stop" else "")
    assert len(cues) == (otherwise == "continue")
    assert len(report.motion.steps) == (4 if otherwise == "continue" else 2)
    assert ("nobody came in 'listen'" in str(report)) == (otherwise == "stop")


def test_each_wait_listens_anew(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    at = {20: (contact(1),), 60: (contact(1, phase="update", intensity=9.0),)}
    loop = {"repeat": {"times": 2, "steps": [listen()]}}
    report = make_run(monkeypatch, tmp_path, STAND, loop, at=at).perform()
    assert [wait.heard for wait in report.waits] == [True, False]


def test_a_contact_under_a_reflex_ends_the_wait_after_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """While a reflex holds the robot the steps stand still; what came meanwhile is not forgotten."""
    at = {20: (contact(1),), 30: (contact(1, phase="end"),)}
    reflexes = [{"do": "hold", "pause": 0.24}]
    run = make_run(monkeypatch, tmp_path, STAND, listen(), TURN, at=at, reflexes=reflexes)
    steps: list[StepEvent] = []
    run.pepper.on_step()(steps.append)
    report = run.perform()
    assert report.waits[0].heard
    assert report.reacted == {"hold": 1}
    assert steps[2].time == pytest.approx(50 * CYCLE, abs=3 * CYCLE)


def test_reflexes_are_those_of_the_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    reflexes = [
        {"do": "hold", "name": "stand still"},
        {"on": {"link": "LForeArm"}, "do": "retract", "distance": 0.3, "priority": 70},
    ]
    run = make_run(monkeypatch, tmp_path, STAND, reflexes=reflexes)
    assert [(r.name, r.priority) for r in run.pepper.reflexes] == [
        ("retract", 70),
        ("stand still", 20),
    ]
    assert run.pepper.reflexes[0].link == "LForeArm"


def test_the_log_says_what_was_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    fake(monkeypatch)
    path = write(tmp_path, STAND, {"say": "hello"}, TURN)
    ExperimentRun(path, log=tmp_path / "run.mcap").perform()
    log = read_log(tmp_path / "run.mcap")
    assert log.metadata["experiment"] == "mine"
    assert log.metadata["experiment_file"] == path.read_text()
    assert [(e.kind, e.name, e.text) for e in log.events] == [
        ("step", "stand", ""),
        ("step", "say", ""),
        ("cue", "say", "say: hello"),
        ("step", "turn", ""),
    ]


# -- checked before anything moves ----------------------------------------------------------------------------------


LOOK = {"joints": {"HeadYaw": 1.5, "HeadPitch": 0.4}, "hold": 1.0}
LOOP = {"repeat": {"times": 2, "steps": [{**BENT, "hold": 1.0}]}}
ON_NOTHING = [{"on": {"link": "LForeAm"}, "do": "hold"}]
TWO = [{"do": "hold"}, {"do": "retract", "priority": 20}]
WRONG: list[tuple[list[Any], dict[str, Any], str, str]] = [
    ([{"posture": "Crouch", "hold": 1.0}], {}, "steps.0.posture", "limits while HeadYaw is at 0"),
    ([STAND, LOOK], {}, "steps.1.joints", "HeadPitch at 0.4 rad lies outside"),
    ([STAND, LOOP], {}, "steps.1.repeat.steps.0.joints", "l_wrist and torso would run into"),
    ([STAND], {"reflexes": ON_NOTHING}, "reflexes.0.on.link", "did you mean LForeArm"),
    ([STAND], {"reflexes": TWO}, "reflexes.1", "same priority, 20"),
    ([STAND], {"observer": {"mode": "fusoin"}}, "", "did you mean fusion"),
    ([STAND], {"observer": {"models": "gone.json"}}, "", "gone.json"),
    ([STAND, PAUSE], {"pushes": [PUSH | {"degrees": 30.0}]}, "pushes.0", "would load"),
    ([STAND, PAUSE], {"pushes": [PUSH, STRONG]}, "pushes.1", "would"),
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
    path = write(tmp_path, {"joints": {"LElbowRoll": -1.5}, "duration": 1.0})
    run = ExperimentRun(path)
    for name, angle in {"LShoulderPitch": 0.9, "LShoulderRoll": 0.01, "LElbowYaw": -0.3}.items():
        backend.position[ROBOT.joint_index(name)] = angle
    with pytest.raises(ConfigError, match=r"line \d+: key 'steps\.0\.joints'.*torso"):
        run.perform()
    for command in backend.commands:  # it was held where it stands
        np.testing.assert_allclose(command.position, backend.position, atol=1e-9)
        assert not command.wheel_speed.any()
    assert backend.calls[-1] == "close"


def test_joints_that_a_task_moves_are_not_known(tmp_path: Path) -> None:
    arm = ROBOT.chains["left_arm"]
    reach = {"link": "l_wrist", "root": "base_link", "target": [0.3, 0.2, 0.8]}
    moved = {"position": {**reach, "joints": list(arm)}, "duration": 1.0}
    bent = {**BENT, "duration": 1.0}
    with pytest.raises(ConfigError, match="torso"):
        ExperimentRun(write(tmp_path, STAND, bent))
    ExperimentRun(write(tmp_path, STAND, moved, bent))  # the wrist may be anywhere
    bent["joints"] |= {"LWristYaw": 0.0}
    with pytest.raises(ConfigError, match="torso"):
        ExperimentRun(write(tmp_path, STAND, moved, bent))


# -- pushes ---------------------------------------------------------------------------------------------------------


def test_pushes_are_left_out_where_nobody_can_push(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    run = make_run(monkeypatch, tmp_path, STAND, PAUSE, pushes=[PUSH])
    assert "only a simulated robot" in run.plan().skipped
    report = run.perform()
    assert report.completed
    assert report.pushes == 0
    assert run.plan().skipped in str(report)


def test_a_push_in_a_step_comes_each_time_and_acts(tmp_path: Path) -> None:
    start = PUSH | {"joint": "LShoulderRoll", "link": "LBicep", "xyz": [0.16, 0.0, 0.0]}
    start |= {"step": None, "degrees": 1.5, "direction": 1, "duration": 0.3}
    path = write(
        tmp_path,
        {**STAND, "duration": 0.5},
        {"repeat": {"times": 2, "steps": [PAUSE]}},
        pushes=[PUSH, start],
        observer=None,
    )
    run = ExperimentRun(path, log=tmp_path / "run.mcap")
    report = run.perform()
    assert report.pushes == 3
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


def test_a_hand_that_is_still_there_costs_one_push_and_not_the_run(tmp_path: Path) -> None:
    grab = {
        "kind": "grab", "step": "led", "joint": "LShoulderRoll", "link": "LForeArm", "xyz": [0.1, 0.0, 0.0],
        "pull": [0.0, 0.02, 0.0], "stiffness": 500.0, "start": 0.0, "rise": 0.3, "hold": 0.2, "release": 0.1,
    }  # fmt: skip
    path = write(
        tmp_path,
        STAND,
        {"name": "led", "wait": {"seconds": 0.7}},
        pushes=[grab],
        observer=None,
    )
    run = ExperimentRun(path, log=tmp_path / "run.mcap")
    (touch,) = run.plan().in_step[1]
    run.plan().in_step[1] = (touch, touch)
    assert run.perform().pushes == 1
    texts = [event.text for event in read_log(tmp_path / "run.mcap").events if event.kind == "push"]
    assert texts[0].startswith("grabbed with 10.0 N")
    assert texts[1].startswith("left out: grabbed")


# -- the shipped ones -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_examples_run(path: Path) -> None:
    run = ExperimentRun(path)
    assert not run.plan().skipped
    report = run.perform()
    assert report.completed
    assert report.felt
    assert report.reacted
    assert all(wait.heard for wait in report.waits)


def test_the_experiment_in_the_docs_is_one(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "experiments.md").read_text()
    path = tmp_path / "docs.yaml"
    path.write_text(text.split("```yaml\n")[1].split("```")[0])
    run = ExperimentRun(path)
    assert len(run.experiment.order) == 17
    assert len(run.pepper.reflexes) == 2
    assert len(run.plan().in_step) == 1


def test_the_same_run_gives_the_same_bits() -> None:
    (path,) = (path for path in EXAMPLES if path.stem == "retract")
    first, second = ExperimentRun(path).perform(), ExperimentRun(path).perform()
    assert first.contacts == second.contacts
    assert first.reflexes == second.reflexes
    assert first.seconds == second.seconds
