"""The stiffness goes up at the begin and down in the end, on a robot whose clock, network and DCM are reckoned."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi import handover
from pepper_driver.backends.naoqi.dcm_channel import DcmChannel
from pepper_driver.backends.naoqi.memory_keys import Alias
from pepper_driver.config import load_safety_settings
from support.virtual_robot import ROBOT, SETTINGS, VirtualRobot, link_with

SAFETY = load_safety_settings()


@pytest.fixture
def robot() -> VirtualRobot:
    """Soft; time passes when a program sleeps."""
    return VirtualRobot()


@pytest.fixture
def link(robot: VirtualRobot) -> DcmChannel:
    return link_with(robot)


def test_joints_and_wheels_get_stiff_and_nothing_moves(
    robot: VirtualRobot, link: DcmChannel
) -> None:
    """The wheels as well, though each tick already has two commands on their way, and no more are allowed."""
    stands = ROBOT.posture("Stand")
    hold, measurement = handover.ramp_up(link, ROBOT, SETTINGS, SAFETY, lambda: None)
    robot.pass_time(robot.time + 100.0)
    np.testing.assert_array_equal(link.commanded(Alias.WHEEL_STIFFNESS), 1.0)
    np.testing.assert_array_equal(link.commanded(Alias.STIFFNESS), 1.0)
    np.testing.assert_array_equal(hold, stands)
    np.testing.assert_array_equal(measurement.position, stands)
    for joints, wheels in robot.commanded.values():
        np.testing.assert_allclose(joints, stands)
        assert not wheels.any()


def test_the_first_sample_that_counts_is_of_the_last_cycle(
    robot: VirtualRobot, link: DcmChannel
) -> None:
    """Taking the robot over lasted for seconds: the posture held is the one measured after it."""
    robot.pass_time(robot.time + 3000.0)
    robot.order(
        [key for key in robot._keys[Alias.POSITION]],
        (ROBOT.posture("Stand") + 0.01).tolist(),
        0.0,
        "ClearAll",
    )
    robot.pass_time(robot.time + 200.0)
    hold, _ = handover.ramp_up(link, ROBOT, SETTINGS, SAFETY, lambda: None)
    np.testing.assert_allclose(hold, ROBOT.posture("Stand") + 0.01)


def test_wheels_that_cannot_be_switched_on_are_an_error(
    robot: VirtualRobot, link: DcmChannel, monkeypatch: pytest.MonkeyPatch
) -> None:
    send = robot.setAlias

    def lose(request: list[Any], *, _async: bool) -> object:
        if request[0] == Alias.WHEEL_STIFFNESS:
            raise RuntimeError("Endpoint disconnected")
        return send(request, _async=_async)

    monkeypatch.setattr(robot, "setAlias", lose)
    with pytest.raises(BackendError, match="switch its wheels on"):
        handover.ramp_up(link, ROBOT, SETTINGS, SAFETY, lambda: None)


def test_a_robot_that_falls_silent_gets_no_more_stiffness(
    robot: VirtualRobot, link: DcmChannel
) -> None:
    looks: list[float] = []

    def look() -> None:
        looks.append(robot.time)
        if len(looks) == 30:
            robot.hang(robot.time + 10_000.0)

    with pytest.raises(BackendError, match="stopped answering"):
        handover.ramp_up(link, ROBOT, SETTINGS, SAFETY, look)
    assert looks[-1] - looks[29] <= 100.0, "[ms]"


LEGS = [ROBOT.joint_index(name) for name in ROBOT.chains["legs"]]


@pytest.mark.parametrize("begins", [None, "before", "meanwhile"])
def test_legs_are_led_back_unless_another_program_moves_them(
    robot: VirtualRobot, link: DcmChannel, begins: str | None
) -> None:
    """As one that sends the robot to rest: two would fight for them."""
    hold, _ = handover.ramp_up(link, ROBOT, SETTINGS, SAFETY, lambda: None)
    bowed = hold.copy()
    bowed[LEGS] += 0.3

    def others_move_legs() -> None:
        robot.almotion_target = robot.almotion_target.copy()
        robot.almotion_target[LEGS] -= 0.2

    for tick in range(200):
        robot.pass_time(robot.time + 12.0)
        if tick == 120 and begins == "before":
            others_move_legs()
        link.exchange(hold + (bowed - hold) * min(tick / 100, 1.0), np.ones(17), np.zeros(3))
    if begins == "meanwhile":
        robot._plan(robot.time + 500.0, others_move_legs)
    assert handover.release_robot(link, ROBOT, SETTINGS, SAFETY, hold)
    left = robot.commanded[max(robot.commanded)][0][LEGS]
    if begins is None:
        np.testing.assert_allclose(left, hold[LEGS], atol=1e-6)
    elif begins == "before":
        np.testing.assert_allclose(left, bowed[LEGS])
    else:
        assert (left > hold[LEGS] + 0.1).all(), "it is broken off"


def test_a_robot_that_is_silent_in_the_end_is_not_waited_for(
    robot: VirtualRobot, link: DcmChannel
) -> None:
    handover.ramp_up(link, ROBOT, SETTINGS, SAFETY, lambda: None)
    hung = robot.time
    robot.hang(hung + 10_000.0)
    assert not handover.release_robot(link, ROBOT, SETTINGS, SAFETY, np.full(17, np.nan))
    assert robot.time - hung < 200.0, "[ms]"
