"""Planned pushes put on a joint what was asked for, and nothing into saturation."""

from typing import Any

import numpy as np
import pytest

from pepper_driver.config import load_robot
from pepper_driver.pushing import PlannedPush, PushTooStrongError, plan_push
from pepper_driver.robot import Pepper

ROBOT = load_robot()


def plan(pepper: Pepper, **changes: Any) -> PlannedPush:
    arguments: dict[str, Any] = {
        "joint": "LShoulderRoll",
        "link": "LBicep",
        "point": np.array([0.16, 0.015, 0.0]),
        "degrees": 4.0,
        "direction": 1,
        "posture": ROBOT.posture("Stand"),
        "largest_load": 0.85,
    }
    return plan_push(pepper.controller.model, ROBOT, pepper.backend.truth, **(arguments | changes))


@pytest.mark.parametrize("direction", [-1, 1])
def test_the_joint_feels_the_torque_that_was_asked_for(direction: int) -> None:
    with Pepper("mujoco", observer=None) as pepper:
        index = ROBOT.joint_index("LShoulderRoll")
        push = plan(pepper, direction=direction)
        wanted = direction * np.radians(4.0) * pepper.backend.truth.stiffness[index]
        assert push.torque == pytest.approx(wanted)
        pepper.push(push.link, push.force, push.point, 1.0, frame="link")
        pepper.run(0.5)
        assert pepper.backend.truth.contact_torque[index] == pytest.approx(wanted, rel=1e-3)


def test_no_smaller_force_would_do() -> None:
    """The force points along the joint's own motion of the point: any other direction wastes some of it."""
    with Pepper("mujoco", observer=None) as pepper:
        push = plan(pepper)
        lever = np.hypot(0.16, 0.015)
        assert np.linalg.norm(push.force) == pytest.approx(push.torque / lever, rel=1e-6)


def test_a_push_that_would_saturate_a_board_is_refused() -> None:
    with Pepper("mujoco", observer=None) as pepper:
        with pytest.raises(PushTooStrongError, match="LShoulderRoll"):
            plan(pepper, degrees=14.0)
        with pytest.raises(PushTooStrongError):
            plan(pepper, largest_load=0.2)


def test_a_force_through_the_axis_is_refused() -> None:
    with (
        Pepper("mujoco", observer=None) as pepper,
        pytest.raises(PushTooStrongError, match="does not turn"),
    ):
        plan(pepper, point=np.zeros(3))
