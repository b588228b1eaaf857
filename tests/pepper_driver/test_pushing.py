"""Planned pushes put on a joint what was asked for, and nothing into saturation unless that is wanted."""

from typing import Any

import numpy as np
import pytest

from pepper_driver.controller import RobotModel
from pepper_driver.pushing import (
    Bounds,
    PlannedPush,
    PushTooStrongError,
    plan_push,
    weigh_push,
)
from pepper_driver.robot import Pepper

from scenario_cases import ROBOT, limit_degrees, make_pepper  # isort: skip

BOUNDS = Bounds(load=0.85, tipping=0.8)
INDEX = ROBOT.joint_index("LShoulderRoll")
POINT = np.array([0.16, 0.015, 0.0])


def plan(pepper: Pepper, **changes: Any) -> PlannedPush:
    arguments: dict[str, Any] = {
        "joint": "LShoulderRoll",
        "link": "LBicep",
        "point": POINT,
        "degrees": 0.4 * limit_degrees(pepper, "LShoulderRoll"),
        "direction": 1,
        "posture": ROBOT.posture("Stand"),
        "bounds": BOUNDS,
    }
    return plan_push(RobotModel(ROBOT), ROBOT, pepper.backend.truth, **(arguments | changes))


def weigh(pepper: Pepper, **changes: Any) -> PlannedPush:
    arguments: dict[str, Any] = {
        "joint": "LShoulderRoll",
        "link": "LBicep",
        "point": POINT,
        "force": np.array([0.0, 10.0, 0.0]),
        "frame": "link",
        "posture": ROBOT.posture("Stand"),
        "bounds": BOUNDS,
    }
    return weigh_push(RobotModel(ROBOT), ROBOT, pepper.backend.truth, **(arguments | changes))


@pytest.mark.parametrize("direction", [-1, 1])
def test_the_joint_feels_the_torque_that_was_asked_for(direction: int) -> None:
    with make_pepper() as pepper:
        push = plan(pepper, direction=direction)
        wanted = direction * 0.4 * pepper.backend.truth.torque_limit[INDEX]
        assert push.torque == pytest.approx(wanted)
        assert push.degrees == pytest.approx(0.4 * limit_degrees(pepper, "LShoulderRoll"))
        pepper.push(push.link, push.force, push.point, 1.0, frame=push.frame)
        pepper.run(0.5)
        assert pepper.backend.truth.contact_torque[INDEX] == pytest.approx(wanted, rel=1e-3)


def test_no_smaller_force_would_do() -> None:
    """The force points along the joint's own motion of the point: any other direction wastes some of it."""
    push = plan(make_pepper())
    assert push.newtons == pytest.approx(push.torque / np.hypot(0.16, 0.015), rel=1e-6)
    assert push.newtons == pytest.approx(np.linalg.norm(push.force))


@pytest.mark.parametrize("frame", ["world", "link"])
def test_a_force_is_told_in_degrees_as_the_joint_will_feel_it(frame: str) -> None:
    with make_pepper() as pepper:
        posture = ROBOT.posture("Stand")
        push = weigh(pepper, force=np.array([3.0, 8.0, -2.0]), frame=frame, posture=posture)
        assert push.newtons == pytest.approx(np.sqrt(77.0))
        pepper.set_posture(posture)
        pepper.push(push.link, push.force, push.point, 1.0, frame=push.frame)
        pepper.run(0.3)
        truth = pepper.backend.truth
        assert truth.contact_torque[INDEX] == pytest.approx(push.torque, rel=0.05)
        degrees = np.degrees(abs(push.torque) / truth.stiffness[INDEX])
        assert push.degrees == pytest.approx(degrees)


def test_a_push_that_would_saturate_a_board_is_refused() -> None:
    pepper = make_pepper()
    limit = limit_degrees(pepper, "LShoulderRoll")
    with pytest.raises(PushTooStrongError, match=r"would load LShoulderRoll to \d+% of its limit"):
        plan(pepper, degrees=0.9 * limit)
    with pytest.raises(PushTooStrongError):
        plan(pepper, bounds=Bounds(load=0.1, tipping=0.8))


def test_a_push_that_is_meant_to_saturate_is_not() -> None:
    pepper = make_pepper()
    limit = limit_degrees(pepper, "LShoulderRoll")
    push = plan(pepper, degrees=1.2 * limit, bounds=Bounds(load=0.85, tipping=0.8, saturating=True))
    assert push.load > 1.2
    assert push.degrees == pytest.approx(1.2 * limit)


def test_gravity_counts() -> None:
    """An arm stretched forward is heavier to hold than one that hangs."""
    pepper = make_pepper()
    hanging, forward = ROBOT.posture("Stand"), ROBOT.posture("StandZero")
    arguments = {"joint": "LShoulderPitch", "force": np.array([0.0, 0.0, -1.0]), "frame": "world"}
    index = ROBOT.joint_index("LShoulderPitch")
    gravity = RobotModel(ROBOT).gravity_torque(forward)[index]
    push = weigh(pepper, posture=forward, **arguments)
    limit = pepper.backend.truth.torque_limit[index]
    assert push.load * limit >= abs(push.torque) + abs(gravity) - 1e-9
    assert push.load > weigh(pepper, posture=hanging, **arguments).load


def test_a_force_the_joint_cannot_feel_is_refused() -> None:
    pepper = make_pepper()
    with pytest.raises(PushTooStrongError, match="does not turn"):
        plan(pepper, point=np.zeros(3))
    with pytest.raises(PushTooStrongError, match="does not turn RShoulderRoll"):
        weigh(pepper, joint="RShoulderRoll")


def test_no_hand_is_stronger_than_a_hand() -> None:
    with pytest.raises(PushTooStrongError, match="than any hand"):
        plan(
            make_pepper(),
            point=np.array([0.002, 0.0, 0.0]),
            degrees=80.0,
            bounds=Bounds(load=1.0, tipping=1.0, saturating=True),
        )


def test_on_wheels_a_push_must_not_tip_the_robot() -> None:
    fixed = make_pepper()
    rolling = make_pepper("rolling")
    wide = Bounds(load=np.inf, tipping=np.inf)
    # Forwards, at the shoulder: the hip and the wheels have to hold it.
    push = {"joint": "HipPitch", "link": "torso", "frame": "world", "point": np.zeros(3)}
    light, heavy = np.array([1.0, 0.0, 0.0]), np.array([40.0, 0.0, 0.0])
    per_newton = weigh(rolling, **push, force=light, bounds=wide).tipping
    assert weigh(rolling, **push, force=heavy, bounds=wide).tipping == pytest.approx(
        40 * per_newton
    )
    assert weigh(fixed, **push, force=heavy, bounds=wide).tipping == 0.0
    enough = np.array([0.81 / per_newton, 0.0, 0.0])
    for saturating in (False, True):
        bounds = Bounds(load=np.inf, tipping=0.8, saturating=saturating)
        weigh(rolling, **push, force=enough * 0.98, bounds=bounds)
        with pytest.raises(PushTooStrongError, match="81% of what tips the robot over"):
            weigh(rolling, **push, force=enough, bounds=bounds)
