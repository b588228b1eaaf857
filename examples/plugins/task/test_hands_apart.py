"""The task by itself, and on a robot."""

import numpy as np
import pytest
from hands_apart import HANDS, HandsApart

from pepper_driver import Pepper
from pepper_driver.config import load_robot
from pepper_driver.controller import RobotModel, TargetError, TaskRows

ROBOT = load_robot()
STEP = 1e-5  # [s] of central differences


def distance_of(pepper: Pepper) -> float:
    left, right = (pepper.link_pose(link)[:3, 3] for link in HANDS)
    return float(np.linalg.norm(left - right))


def test_the_rows_are_the_derivatives_of_the_distance() -> None:
    """The Jacobian's product with v is the rate of the distance, the bias the rate of that without accelerations."""
    model, task = RobotModel(ROBOT), HandsApart(0.4)
    rows = TaskRows.empty(1, model.nv)
    task.attach(model, rows)
    random = np.random.default_rng(1)
    q, v = model.configuration(random.uniform(ROBOT.lower, ROBOT.upper)), random.uniform(-1, 1, 20)

    def at(time: float) -> tuple[float, float]:
        """Distance and its rate after a motion without accelerations."""
        model.set_state(model.integrate(q, v * time), v)
        model.update_kinematics()
        task.compute(model, rows)
        return 0.4 - float(rows.error[0]), float(rows.jacobian[0] @ v)

    (before, rate_before), (after, rate_after) = at(-STEP), at(STEP)
    _, rate = at(0.0)
    assert (after - before) / (2 * STEP) == pytest.approx(rate, abs=1e-6)
    assert (rate_after - rate_before) / (2 * STEP) == pytest.approx(float(rows.bias[0]), abs=1e-4)


def test_the_hands_come_to_their_distance_and_keep_it() -> None:
    task = HandsApart(0.30)
    with Pepper("mujoco", observer=None) as pepper:
        pepper.add(task)
        assert pepper.run(6.0, until=lambda: task.reached(0.002))
        assert distance_of(pepper) == pytest.approx(0.30, abs=0.03)
        task.distance = 0.6
        assert pepper.run(6.0, until=lambda: task.reached(0.002))
        assert distance_of(pepper) == pytest.approx(0.6, abs=0.03)


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("nan"), "far"])
def test_what_is_no_distance_is_refused(wrong: float) -> None:
    task = HandsApart(0.4)
    with pytest.raises(TargetError):
        task.distance = wrong
    assert task.distance == 0.4
