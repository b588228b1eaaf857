"""The hand of the facade: bounded by the moment that lifts a wheel, detected by the observer, scored as a contact."""

import numpy as np
import pytest

from pepper_driver import Pepper
from pepper_driver.backends import BackendError, CapabilityError
from pepper_driver.controller.support_polygon import SupportPolygon
from pepper_driver.steady_hand import MAX_TIPPING


def test_its_force_stays_within_what_the_robot_stands() -> None:
    """By the closed form: the moment of the force about an edge between two wheels, over that of the weight."""
    with Pepper("mujoco", observer=None) as pepper:
        hand = pepper.take_hand("Head", max_force=500.0)
        pepper.step()
        polygon = SupportPolygon.from_robot(pepper.config)
        for way in ([1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [-0.5, 0.5, 0.2]):
            for _ in range(60):
                hand.move(hand.point + way)
                pepper.step()
            assert hand.limited
            ratio = polygon.tipping_ratio(pepper.backend.truth.position, hand.point, hand.force)
            assert ratio <= MAX_TIPPING * 1.05
            assert ratio > 0.3


@pytest.mark.parametrize("link", ["Head", "LForeArm"])
def test_a_strong_hand_that_turns_downwards_tips_no_robot(link: str) -> None:
    """The spring still pulls sideways while the goal is below, where the robot stands any force."""
    with Pepper("mujoco", observer=None) as pepper:
        hand = pepper.take_hand(link, stiffness=3000.0, max_force=1000.0)
        pepper.step()
        for way in ([3.0, 0.0, 0.0], [0.0, 0.0, -3.0], [0.0, 3.0, 0.0], [0.0, 0.0, -3.0]):
            for _ in range(30):
                hand.move(hand.point + way)
                pepper.step()
                assert np.degrees(np.abs(pepper.backend.truth.tilt)).max() < 2.0


def test_downwards_it_is_as_strong_as_it_can() -> None:
    with Pepper("mujoco", observer=None) as pepper:
        hand = pepper.take_hand("torso", max_force=60.0)
        pepper.step()
        for _ in range(60):
            hand.move(hand.point + np.array([0.0, 0.0, -1.0]))
            pepper.step()
        assert not hand.limited
        assert np.linalg.norm(hand.force) == pytest.approx(60.0, rel=0.01)


def test_a_drag_of_the_arm_is_detected_there() -> None:
    with Pepper("mujoco") as pepper:
        pepper.set_posture({"LShoulderPitch": 0.6, "LElbowRoll": -0.9}, duration=2.0)
        pepper.run(2.5)
        hand = pepper.take_hand("LForeArm")
        pepper.step()
        goal = hand.point + np.array([0.0, 0.2, 0.05])
        pulled = pepper.time
        for _ in range(100):
            hand.move(goal)
            pepper.step()
        contact = pepper.contact_history[0]
        assert contact.limb == "left_arm"
        assert pulled < contact.detection_time < pulled + 0.5


def test_only_an_active_simulated_robot_is_taken() -> None:
    pepper = Pepper("mujoco", observer=None)
    with pytest.raises(BackendError, match="not active"):
        pepper.take_hand("Head")
    with Pepper("mock", observer=None) as other, pytest.raises(CapabilityError):
        other.take_hand("Head")
