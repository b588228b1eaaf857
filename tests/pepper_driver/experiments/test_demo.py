"""The main job."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import yaml

from pepper_driver.cli.demo import describe_contact
from pepper_driver.config import PepperError, load_experiment, load_robot
from pepper_driver.config.contact_specs import RandomPushes
from pepper_driver.config.loading import package_file, read_yaml
from pepper_driver.config.steps import RandomStep, Setpoints
from pepper_driver.experiments import demo
from pepper_driver.experiments.demo import CONTACTS_NAME, FIGURE_NAME, LOG_NAME, run_demo
from pepper_driver.log import read_log
from pepper_driver.observer import Contact, KnownPush, Observer
from pepper_driver.observer.interface import Phase
from pepper_driver.robot import Pepper
from support.events import Scripted, contact

ROBOT = load_robot()
DEMO = load_experiment("demo", ROBOT)
GOALS = cast(Setpoints, cast(RandomStep, DEMO.random_step).goals)
PUSHES = cast(RandomPushes, DEMO.contacts[0])


class Numb(Pepper):
    """A Pepper that detects nothing by itself, and holds nothing: it moves and is pushed as in the demonstration."""

    def __init__(
        self, uri: str, *, models: object, detects: Observer | None = None, **options: Any
    ) -> None:
        super().__init__(uri, observer=detects, **options | {"reflexes": ()})


@pytest.fixture
def numb(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "Pepper", Numb)


def test_every_push_of_five_equivalent_degrees_is_detected(tmp_path: Path) -> None:
    received: list[tuple[Contact, tuple[KnownPush, ...]]] = []
    result = run_demo(
        tmp_path, seed=2, seconds=32.0, on_contact=lambda c, pushes: received.append((c, pushes))
    )
    # Eight of them are strong enough to be detected in the right place; the last three are light.
    strong = result.pushes[:8]
    assert [push.force for push in result.pushes[8:]] == pytest.approx([8.0] * 3)
    assert all(push.degrees < 5.0 for push in result.score.missed)
    assert not result.score.false
    right = [detected for detected in result.score.detected if detected.push in strong]
    assert len(right) > 4
    for detected in right:
        assert detected.direction_right
        assert detected.joint_right
        assert 0.0 < detected.delay < detected.push.release - detected.push.onset + 0.15

    # each contact is reported once, where it ended up
    last = {event.id: event for event in result.contacts}
    reported = {event.id: event for event, _ in received}
    assert len(reported) == len(received)
    for reported_event in reported.values():
        assert reported_event in result.contacts
        settled = reported_event.time - reported_event.detection_time >= 0.15
        assert settled or reported_event == last[reported_event.id]
    for detected in right:
        settled_event = reported[detected.contact.id]
        assert settled_event.link == detected.final_contact.link

    # what was planned is what the joints really detected
    log = read_log(tmp_path / LOG_NAME)
    assert log.truth is not None
    assert log.truth["wheel_load"].min() > 0.0, "the robot is not tipped"
    time, torque = np.asarray(log["time"]), log.truth["contact_torque"]
    for push in result.pushes:
        assert push.joint is not None
        joint = ROBOT.joint_index(push.joint)
        during = np.flatnonzero((time > push.onset) & (time < push.release))
        contact_torque = torque[during, joint]
        peak = contact_torque[np.abs(contact_torque).argmax()]
        # The last are stated in the axes of the world, in which the arm gives way and breathes.
        rel = 0.01 if push in strong else 0.1
        assert peak == pytest.approx(push.direction * push.torque, rel=rel)
        if push in strong:
            assert PUSHES.degrees[0] <= push.degrees <= PUSHES.degrees[1]
        board = log.truth["saturated"][during, joint]
        assert push.saturated == board.any()

    saved = json.loads((tmp_path / CONTACTS_NAME).read_text())
    assert saved["summary"] == result.summary
    assert result.summary["detected"] + result.summary["missed"] == 11
    assert result.summary["direction_right"] == result.summary["detected"]
    # Its steps wait while the reflex holds the robot.
    waited = result.summary["simulated_seconds"] - DEMO.with_goals(count=4).max_length
    assert 0.0 < waited < sum(push.release - push.onset + 1.5 for push in result.pushes)
    assert len(saved["events"]) == len(result.contacts)


def event(number: int, phase: Phase, time: float, joint: str | None, link: str) -> Contact:
    """An event of the contact that was detected at ``number`` seconds."""
    made = contact(number, phase=phase, joint=joint, link=link)
    return replace(made, time=number + time, detection_time=float(number))


STANDS = {"name": "stand", "posture": "Stand", "hold": 2.0}
LIGHT = {
    "kind": "push",
    "joint": "LShoulderRoll",
    "link": "LBicep",
    "xyz": [0.16, 0.015, 0.0],
    "force": [0.0, 5.0, 0.0],
    "frame": "link",
    "start": 1.0,
    "duration": 0.5,
}


def test_a_contact_is_reported_once_where_it_ends_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    events = [
        # begun on the base, moved to the arm at once, and along it at the last moment
        event(1, "begin", 0.0, None, "base_link"),
        event(1, "update", 0.024, "LShoulderRoll", "LBicep"),
        event(1, "update", 0.152, "LElbowRoll", "LForeArm"),
        event(1, "end", 0.8, "LElbowRoll", "LForeArm"),
        # over before it is settled
        event(2, "begin", 0.0, None, "base_link"),
        event(2, "update", 0.05, "LShoulderRoll", "LBicep"),
        event(2, "end", 0.1, "LShoulderRoll", "LBicep"),
        # still there when the run is over
        event(3, "begin", 0.0, None, "base_link"),
        event(3, "update", 0.05, "HeadYaw", "Head"),
    ]
    observer = Scripted()
    observer.at = {100 + number: (event,) for number, event in enumerate(events)}
    monkeypatch.setattr(demo, "Pepper", partial(Numb, detects=observer))
    reported: list[tuple[int, str | None, float]] = []
    run_demo(
        tmp_path,
        experiment=own_script(tmp_path, steps=[STANDS], contacts=[LIGHT]),
        on_contact=lambda c, _: reported.append((c.id, c.joint, c.time)),
    )
    assert reported == [(1, "LElbowRoll", 1.152), (2, "LShoulderRoll", 2.1), (3, "HeadYaw", 3.05)]


def test_a_line_names_the_place_and_the_delay() -> None:
    push = KnownPush(
        joint="LElbowRoll",
        link="LForeArm",
        direction=1,
        force=20.0,
        torque=4.0,
        degrees=4.0,
        onset=0.9,
        release=1.5,
        moving=False,
    )
    settled = event(1, "update", 0.152, "LElbowRoll", "LForeArm")
    line = describe_contact(settled, (push,))
    assert line.startswith("   1.00 s  contact   LElbowRoll     LForeArm   direction +")
    assert line.endswith("3.0 deg   100 ms after the true onset")
    line = describe_contact(event(1, "end", 0.2, None, "base_link"), (push,))
    assert line.split()[3:5] == ["trunk", "base_link"]
    assert line.endswith("intensity        -")
    assert "onset" not in line


PERIOD = 3.0  # [s]


def quick_goals(folder: Path) -> Path:
    """A file: the random goals of the demonstration and their pushes, in quick succession."""
    data = read_yaml(package_file("experiments", "demo.yaml"))
    data["steps"], data["contacts"] = data["steps"][:1], data["contacts"][:1]
    data["steps"][0]["setpoints"] |= {"period": PERIOD, "settle": 0.6}
    data["contacts"][0] |= {"times": [0.25, 1.6], "duration": [0.5, 0.8]}
    path = folder / "quick.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def test_the_same_seed_gives_the_same_contacts(tmp_path: Path) -> None:
    mine = quick_goals(tmp_path)
    first = run_demo(tmp_path / "a", experiment=mine, seconds=PERIOD, seed=4)
    second = run_demo(tmp_path / "b", experiment=mine, seconds=PERIOD, seed=4)
    assert first.contacts
    assert first.contacts == second.contacts
    assert first.pushes == second.pushes
    other = run_demo(tmp_path / "c", experiment=mine, seconds=PERIOD, seed=5)
    assert other.pushes != first.pushes


def test_without_pushes_nothing_is_detected() -> None:
    """The same motion as in the demo, untouched."""
    rng = np.random.default_rng(9)
    with Pepper("mujoco?seed=9") as pepper:
        middle, half = (ROBOT.lower + ROBOT.upper) / 2, (ROBOT.upper - ROBOT.lower) / 2
        pepper.set_posture("Stand", stiffness=DEMO.stiffness)
        for _ in range(4):
            pepper.set_posture(
                {
                    name: middle[i] + GOALS.range * half[i] * rng.uniform(-1, 1)
                    for name in GOALS.joints
                    for i in [ROBOT.joint_index(name)]
                }
            )
            pepper.run(4.0)
        assert pepper.contact_history == ()


def own_script(folder: Path, **changes: Any) -> Path:
    """A file: a reach, with the pushes of the shipped one in the first seven seconds."""
    data = read_yaml(package_file("experiments", "reach_and_push.yaml"))
    data["name"] = "mine"
    data["steps"] = data["steps"][:2]
    data["contacts"] = data["contacts"][:2]
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump(data | changes))
    return path


@pytest.mark.usefixtures("numb")
def test_a_push_that_saturates_its_board_is_marked(tmp_path: Path) -> None:
    plant = Pepper("mujoco", observer=None).backend.plant
    index = ROBOT.joint_index("RElbowRoll")
    shipped = read_yaml(package_file("experiments", "reach_and_push.yaml"))
    push: dict[str, Any] = shipped["contacts"][1]
    limit = float(np.degrees(plant.torque_limit[index] / plant.stiffness[index]))
    pushes = [
        push | {"start": 1.0, "degrees": 1.15 * limit, "duration": 0.4, "saturating": True},
        push | {"start": 4.0, "degrees": 0.2 * limit},
    ]
    result = run_demo(tmp_path / "out", experiment=own_script(tmp_path, contacts=pushes))
    assert [push.saturating for push in result.pushes] == [True, False]
    assert [push.saturated for push in result.pushes] == [True, False]
    assert result.summary["saturated"] == 1
    log = read_log(tmp_path / "out" / LOG_NAME)
    assert log.truth is not None
    time = np.asarray(log["time"])
    for reported in result.pushes:
        during = (time >= reported.onset) & (time <= reported.release)
        assert reported.saturated == log.truth["saturated"][during, index].any()


@pytest.mark.usefixtures("numb")
def test_a_script_of_ones_own_is_shown(tmp_path: Path) -> None:
    result = run_demo(tmp_path / "out", experiment=own_script(tmp_path, seed=3, plant="nominal"))
    assert result.uri == "mujoco://?seed=3&plant=nominal"
    assert result.experiment == "mine"
    assert result.simulated_seconds == pytest.approx(7.0, abs=0.02)
    assert [push.joint for push in result.pushes] == ["LShoulderRoll", "RElbowRoll"]
    summary = json.loads((tmp_path / "out" / CONTACTS_NAME).read_text())["summary"]
    forces = [push.force for push in result.pushes]
    assert forces[0] == pytest.approx(20.0)
    assert summary["force_n"] == {"least": min(forces), "most": max(forces)}
    degrees = [push.degrees for push in result.pushes]
    assert degrees[1] == pytest.approx(2.8)
    assert summary["degrees"] == {"least": min(degrees), "most": max(degrees)}
    missed = json.loads((tmp_path / "out" / CONTACTS_NAME).read_text())["missed"]
    assert [push["force"] for push in missed] == forces, "nothing is detected without an observer"
    again = run_demo(tmp_path / "out", experiment=own_script(tmp_path, seed=3), seed=8)
    assert again.uri == "mujoco://?seed=8&plant=integral"


@pytest.mark.usefixtures("numb")
def test_the_length_is_the_experiments_or_whole_periods_of_the_time_given(tmp_path: Path) -> None:
    fractions: list[float] = []
    mine = quick_goals(tmp_path)
    result = run_demo(tmp_path, experiment=mine, seconds=2.2 * PERIOD, on_progress=fractions.append)
    length = load_experiment(mine, ROBOT).with_goals(count=2).max_length
    assert result.simulated_seconds == pytest.approx(length, abs=0.02)
    assert len(result.pushes) == 4
    assert len(fractions) == pytest.approx(length, abs=1)
    assert fractions[-1] == 1.0


@pytest.mark.parametrize(
    ("changes", "options", "word"),
    [
        ({}, {"seconds": 8.0}, "leave out seconds"),
        ({"contacts": []}, {}, "key 'contacts': a demonstration needs some"),
        ({"plant": "worm"}, {}, "unknown plant 'worm'"),
        ({"contacts": [{"kind": "push"}]}, {}, "key 'contacts.0"),
        ({"max_load": 0.01}, {}, "key 'contacts.0': 20.0 N"),
    ],
)
@pytest.mark.usefixtures("numb")
def test_an_experiment_that_cannot_be_shown_is_refused_and_leaves_nothing(
    tmp_path: Path, changes: dict[str, Any], options: dict[str, Any], word: str
) -> None:
    with pytest.raises(PepperError) as caught:
        run_demo(tmp_path / "out", experiment=own_script(tmp_path, **changes), **options)
    assert word in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_free_motion_is_no_demonstration(tmp_path: Path) -> None:
    with pytest.raises(PepperError, match="key 'contacts': a demonstration needs some"):
        run_demo(tmp_path / "out", experiment="identify")


@pytest.mark.usefixtures("numb")
def test_results_of_an_earlier_run_do_not_stay_next_to_a_new_log(tmp_path: Path) -> None:
    (tmp_path / FIGURE_NAME).write_text("old")
    (tmp_path / CONTACTS_NAME).write_text("old")

    def stop(fraction: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_demo(tmp_path, seconds=8.0, on_progress=stop)
    assert {p.name for p in tmp_path.iterdir()} == {LOG_NAME, CONTACTS_NAME}
    assert json.loads((tmp_path / CONTACTS_NAME).read_text())["events"] == []


@pytest.mark.usefixtures("numb")
@pytest.mark.parametrize("name", [FIGURE_NAME, CONTACTS_NAME])
def test_a_result_that_cannot_be_written_is_reported_before_the_run(
    tmp_path: Path, name: str
) -> None:
    (tmp_path / name).mkdir()
    with pytest.raises(PepperError, match=name):
        run_demo(tmp_path, seconds=8.0)
    assert [p.name for p in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("seconds", [0.0, 7.9, float("nan"), float("inf")])
def test_a_wrong_time_is_refused_and_leaves_nothing(tmp_path: Path, seconds: float) -> None:
    out = tmp_path / "out"
    with pytest.raises(PepperError, match="seconds"):
        run_demo(out, seconds=seconds)
    assert not out.exists()
