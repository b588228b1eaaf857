"""The hold reflex: freezes while touched, goes on afterwards, and never keeps itself alive."""

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config import load_robot
from pepper_driver.controller import WholeBodyController
from pepper_driver.observer import Contact, Observation
from pepper_driver.reflexes import Hold, ReflexError, ReflexRequests
from pepper_driver.testing import standing_measurement
from support.scripted import NAN, contact

ROBOT = load_robot()
BLANK = standing_measurement()


class Scene:
    def __init__(self, pause: float = 0.5) -> None:
        self.requests = ReflexRequests(WholeBodyController(ROBOT), ROBOT)
        self.requests.controller.reset(ROBOT.posture("Stand"))
        self.reflex = Hold(release_delay=pause)
        self.reflex.setup(ROBOT)

    def at(self, time: float, *contacts: Contact) -> None:
        observation = Observation(
            contacts=contacts,
            expected=NAN,
            residual=NAN,
            threshold=NAN,
            torque=NAN,
            torque_std=NAN,
            state=np.zeros(17, dtype=np.int8),
        )
        self.requests.clear()
        self.reflex.step(observation, replace(BLANK, time=time), self.requests)


def test_it_freezes_the_reference_and_resumes_after_the_pause() -> None:
    scene = Scene()
    scene.at(1.0)
    assert scene.requests.posture is None
    scene.at(1.1, contact(1, "begin"))
    # at rest, it freezes where it is
    np.testing.assert_array_equal(scene.requests.posture, scene.requests.controller.position)
    scene.at(2.0, contact(1, "update"))
    scene.at(2.5, contact(1, "end"))
    scene.at(2.99)
    assert scene.requests.posture is not None
    scene.at(3.0)
    assert scene.requests.posture is None


def test_a_moving_reference_brakes_hard_and_does_not_turn_round() -> None:
    scene = Scene()
    controller, index = scene.requests.controller, ROBOT.joint_index("LShoulderPitch")
    target = ROBOT.posture("Stand")
    target[index] -= 1.5
    controller.posture.target = target
    for _ in range(40):
        moving = controller.step()
    speed = moving.velocity[index]
    assert abs(speed) > 0.7
    scene.at(1.0, contact(1, "begin"))
    assert scene.requests.posture is not None
    assert scene.requests.posture_stiffness is not None
    controller.posture.target = scene.requests.posture
    controller.posture.stiffness = scene.requests.posture_stiffness
    trail = [controller.step() for _ in range(60)]
    travel = np.array([r.position[index] for r in trail]) - moving.position[index]
    assert abs(travel[-1]) == pytest.approx(abs(speed) / 20, rel=0.2)
    assert (np.diff(travel) * np.sign(speed) >= -1e-9).all(), "it never comes back"
    assert abs(trail[20].velocity[index]) < 0.05 * abs(speed)
    scene.at(2.0, contact(1, "end"))
    scene.at(9.0)
    assert scene.requests.posture_stiffness is None


def test_it_holds_until_the_last_of_several_contacts_ended() -> None:
    scene = Scene(pause=0.0)
    scene.at(1.0, contact(1, "begin"))
    frozen = scene.requests.posture
    scene.at(1.1, contact(2, "begin"))
    scene.at(1.2, contact(1, "end"))
    scene.at(1.3)
    assert scene.requests.posture is frozen
    scene.at(1.4, contact(2, "end"))
    assert scene.requests.posture is None


def test_a_contact_during_the_pause_prolongs_the_same_hold() -> None:
    scene = Scene(pause=0.5)
    scene.at(1.0, contact(1, "begin"))
    frozen = scene.requests.posture
    scene.at(1.2, contact(1, "end"))
    scene.at(1.4, contact(2, "begin"))
    scene.at(2.0)
    assert scene.requests.posture is frozen


def test_a_rebound_neither_starts_nor_prolongs_it() -> None:
    scene = Scene(pause=0.5)
    scene.at(1.0, contact(1, "begin", "rebound"))
    assert scene.requests.posture is None
    scene.at(2.0, contact(2, "begin"))
    scene.at(2.1, contact(2, "end"))
    scene.at(2.2, contact(3, "begin", "rebound"))
    scene.at(2.6)
    assert scene.requests.posture is None


def test_the_end_of_a_contact_it_did_not_see_is_ignored() -> None:
    scene = Scene()
    scene.at(1.0, contact(1, "end"))
    scene.at(9.0)
    assert scene.requests.posture is None


@pytest.mark.parametrize("pause", [-1.0, np.nan, np.inf])
def test_a_wrong_pause_is_refused(pause: float) -> None:
    with pytest.raises(ReflexError, match="release_delay"):
        Hold(release_delay=pause)
