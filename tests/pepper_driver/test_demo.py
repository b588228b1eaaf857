"""The main job."""

import json
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.config import PepperError, load_demo_scenario, load_robot
from pepper_driver.demo import CONTACTS_NAME, FIGURE_NAME, LOG_NAME, run_demo
from pepper_driver.log import read_log
from pepper_driver.observer import Contact, Push
from pepper_driver.robot import Pepper

ROBOT = load_robot()
SCENARIO = load_demo_scenario(ROBOT)


def test_every_push_of_five_equivalent_degrees_is_felt(tmp_path: Path) -> None:
    heard: list[tuple[Contact, tuple[Push, ...]]] = []
    result = run_demo(
        tmp_path, seed=2, seconds=32.0, on_contact=lambda c, pushes: heard.append((c, pushes))
    )
    assert len(result.pushes) == 8
    assert all(push.degrees < 5.0 for push in result.score.missed)
    assert not result.score.false
    for felt in result.score.felt:
        assert felt.contact.direction == felt.push.direction
        assert felt.contact.joint == felt.push.joint
        assert 0.0 < felt.delay < felt.push.release - felt.push.onset + 0.15
    assert len(heard) >= len(result.score.felt)

    # what was planned is what the joints really felt
    log = read_log(tmp_path / LOG_NAME)
    assert log.truth is not None
    time, torque = np.asarray(log["time"]), log.truth["contact_torque"]
    for push in result.pushes:
        during = (time > push.onset) & (time < push.release)
        felt_torque = torque[during, ROBOT.joint_index(push.joint)]
        peak = felt_torque[np.abs(felt_torque).argmax()]
        assert peak == pytest.approx(push.direction * push.torque, rel=0.01)
        assert SCENARIO.degrees[0] <= push.degrees <= SCENARIO.degrees[1]
        board = log.truth["saturated"][during, ROBOT.joint_index(push.joint)]
        assert push.saturated == board.any()

    saved = json.loads((tmp_path / CONTACTS_NAME).read_text())
    assert saved["summary"] == result.summary
    assert result.summary["felt"] + result.summary["missed"] == 8
    assert result.summary["direction_right"] == result.summary["felt"]
    assert result.summary["simulated_seconds"] == pytest.approx(32.0, abs=0.2)
    assert len(saved["events"]) == len(result.contacts)


def test_the_same_seed_gives_the_same_contacts(tmp_path: Path) -> None:
    first = run_demo(tmp_path / "a", seed=4, seconds=8.0)
    second = run_demo(tmp_path / "b", seed=4, seconds=8.0)
    assert first.contacts == second.contacts
    assert first.pushes == second.pushes
    other = run_demo(tmp_path / "c", seed=5, seconds=8.0)
    assert other.pushes != first.pushes


def test_without_pushes_nothing_is_felt() -> None:
    """The same motion as in the demo, untouched."""
    rng = np.random.default_rng(9)
    with Pepper("mujoco?seed=9") as pepper:
        middle, half = (ROBOT.lower + ROBOT.upper) / 2, (ROBOT.upper - ROBOT.lower) / 2
        pepper.set_posture("Stand", stiffness=SCENARIO.stiffness)
        for _ in range(8):
            pepper.set_posture(
                {
                    name: middle[i] + SCENARIO.range * half[i] * rng.uniform(-1, 1)
                    for name in SCENARIO.joints
                    for i in [ROBOT.joint_index(name)]
                }
            )
            pepper.run(4.0)
        assert pepper.contacts == ()


def test_a_push_that_saturates_its_board_is_marked(tmp_path: Path) -> None:
    """Planning looks at the rest state; a joint that is also braking may need more."""
    result = run_demo(tmp_path, seed=9, seconds=32.0)
    assert any(push.saturated for push in result.pushes), "this seed has one"
    log = read_log(tmp_path / LOG_NAME)
    assert log.truth is not None
    for push in result.pushes:
        time = np.asarray(log["time"])
        during = (time >= push.onset) & (time <= push.release)
        board = log.truth["saturated"][during, ROBOT.joint_index(push.joint)]
        assert push.saturated == board.any()


def test_results_of_an_earlier_run_do_not_stay_beside_a_new_log(tmp_path: Path) -> None:
    (tmp_path / FIGURE_NAME).write_text("old")
    (tmp_path / CONTACTS_NAME).write_text("old")

    def stop(share: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_demo(tmp_path, seconds=8.0, on_progress=stop)
    assert [p.name for p in tmp_path.iterdir()] == [LOG_NAME]


@pytest.mark.parametrize("name", [FIGURE_NAME, CONTACTS_NAME])
def test_a_result_that_cannot_be_written_is_told_before_the_run(tmp_path: Path, name: str) -> None:
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
