"""The speed that joints reach."""

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config import load_controller_settings, load_experiment, load_plant
from pepper_driver.config.arrays import FloatArray
from pepper_driver.identification.measurements.speed import measure_speed
from pepper_driver.observer import Recording, RecordingBuilder
from pepper_driver.robot import Pepper
from support.identification import ROBOT
from support.observer import CYCLE, JOINTS, recording

JOINT = "RElbowRoll"
INDEX = ROBOT.joint_index(JOINT)


def limited(command: FloatArray, speed: float, lag: float = 0.05) -> FloatArray:
    """A joint that follows a command with a lag, and no faster than a speed."""
    position = np.empty(len(command))
    here = command[0]
    for k, target in enumerate(command):
        step = (target - here) * CYCLE / lag
        here += float(np.clip(step, -speed * CYCLE, speed * CYCLE))
        position[k] = here
    return position


def moves(commanded: float, *, way: float = 1.0, count: int = 4) -> FloatArray:
    """To and fro at a speed, with rests between."""
    up = np.linspace(0.0, way, max(2, round(way / commanded / CYCLE) + 1))
    one = np.concatenate((np.zeros(80), up, np.full(80, way), up[::-1]))
    return np.concatenate((np.tile(one, count), np.zeros(80)))


def run_of(command: FloatArray, position: FloatArray) -> Recording:
    run = recording(np.zeros((len(command), 3)), command)
    measured = np.zeros((len(command), JOINTS))
    step = ROBOT.sensors.encoder.step
    measured[:, INDEX] = step * np.round(position / step)
    return replace(run, position=measured)


@pytest.mark.parametrize("limit", [1.2, 1.9, 2.4])
@pytest.mark.parametrize("commanded", [1.0, 1.6, 3.0])
def test_a_joint_that_falls_behind_shows_its_speed(limit: float, commanded: float) -> None:
    command = moves(commanded)
    found = measure_speed(run_of(command, limited(command, limit)), JOINT, ROBOT)
    assert found is not None
    assert found.commanded == pytest.approx(commanded, rel=0.05)
    assert found.limited == (commanded > limit)
    assert found.reached == pytest.approx(min(commanded, limit), rel=0.06)
    assert found.moves == 8


@pytest.mark.parametrize("fast", [2, 6])
def test_moves_that_run_faster_now_and_then_do_not_hide_the_limit(fast: int) -> None:
    command = moves(2.5)
    one = len(moves(2.5, count=1)) - 80
    position = limited(command, 2.0)
    # The first moves to and fro are not held.
    position[: fast // 2 * one] = limited(command, 4.0)[: fast // 2 * one]
    found = measure_speed(run_of(command, position), JOINT, ROBOT)
    assert found is not None
    assert found.limited
    assert found.reached == pytest.approx(2.0, rel=0.05)
    assert found.moves == 8 - fast


def test_late_samples_make_no_limit() -> None:
    command = moves(2.0)
    run = run_of(command, limited(command, 9.0))
    rng = np.random.default_rng(3)
    age, position = np.zeros(len(run)), run.position.copy()
    for k in range(1, len(run)):
        # The one before is read again, up to three times in a row.
        if age[k - 1] < 2.5 * CYCLE and rng.random() < 0.3:
            age[k], position[k] = age[k - 1] + CYCLE, position[k - 1]
    found = measure_speed(replace(run, position=position, age=age), JOINT, ROBOT)
    assert found is not None
    assert not found.limited
    assert found.reached == pytest.approx(2.0, rel=0.05)


def test_small_moves_and_a_joint_that_stands_give_no_result() -> None:
    small = moves(1.0, way=0.1)
    assert measure_speed(run_of(small, small), JOINT, ROBOT) is None
    still = np.zeros(500)
    assert measure_speed(run_of(still, still), JOINT, ROBOT) is None


def test_a_joint_that_never_gets_there_is_no_speed() -> None:
    command = moves(1.0)
    assert measure_speed(run_of(command, np.zeros(len(command))), JOINT, ROBOT) is None


def test_a_simulated_robot_shows_the_limiter_of_its_targets() -> None:
    settings = load_controller_settings(ROBOT)
    limit = load_plant("recorded-heavy", ROBOT).targets.speed_limit
    assert limit is not None
    for commanded in (1.5, 2.5):
        arms = [name for chain in ("left_arm", "right_arm") for name in ROBOT.chains[chain]]
        faster = replace(
            settings, velocity_limit={**settings.velocity_limit, **dict.fromkeys(arms, commanded)}
        )
        builder = RecordingBuilder(ROBOT)
        pepper = Pepper(
            "mujoco://?plant=recorded-heavy", observer=None, robot=ROBOT, controller=faster
        )
        with pepper:
            pepper.play(
                load_experiment("measure_speed", ROBOT),
                on_tick=lambda tick, _, to=builder: to.append(tick),  # type: ignore[misc]
            )
        run = builder.finish()
        for joint in ("LElbowRoll", "RElbowRoll"):
            found = measure_speed(run, joint, ROBOT)
            assert found is not None
            assert found.limited == (commanded > limit)
            assert found.reached == pytest.approx(min(commanded, limit), rel=0.1)
