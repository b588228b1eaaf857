"""The observer on ticks made by hand, and on a robot that is pushed."""

import numpy as np
import pytest
from resting_observer import TICKS, RestingObserver

from pepper_driver import Pepper
from pepper_driver.config import load_robot
from pepper_driver.testing import displaced, observe, standing_ticks

ROBOT = load_robot()
ELBOW = ROBOT.joint_index("LElbowRoll")


def test_a_joint_that_is_pushed_aside_and_let_go_is_a_contact() -> None:
    push = dict.fromkeys(range(100, 150), displaced("LElbowRoll", np.radians(3.0)))
    observations = observe(RestingObserver(ROBOT), standing_ticks(250, push))
    begin, end = (contact for observation in observations for contact in observation.contacts)
    assert (begin.phase, end.phase, begin.id) == ("begin", "end", end.id)
    assert (begin.joint, begin.link, begin.direction) == ("LElbowRoll", "LForeArm", 1)
    assert begin.intensity_deg == pytest.approx(3.0, abs=0.01)
    assert begin.time == pytest.approx((100 + TICKS - 1) * ROBOT.cycle)
    assert end.time == pytest.approx((150 + TICKS - 1) * ROBOT.cycle)


def test_less_than_the_threshold_is_none() -> None:
    push = dict.fromkeys(range(100, 150), displaced("LElbowRoll", np.radians(0.9)))
    observations = observe(RestingObserver(ROBOT), standing_ticks(250, push))
    assert not any(observation.contacts for observation in observations)
    assert observations[120].residual[ELBOW] == pytest.approx(-np.radians(0.9), rel=0.3)


def test_by_name_it_detects_a_push_in_simulation() -> None:
    with Pepper("mujoco", observer="resting") as pepper:
        pepper.run(1.0)
        assert not pepper.contact_history
        pepper.push("LBicep", [0, 30, 0], [0.16, 0, 0], 1.0)
        pepper.run(1.5)
        begin, *_, end = pepper.contact_history
    assert (begin.phase, begin.link, begin.direction) == ("begin", "LBicep", 1)
    assert end.phase == "end"
