"""Return of joints that a reflex has led away to the user's posture."""

from dataclasses import dataclass

import numpy as np
import pytest

from pepper_driver import Pepper, Reflex
from pepper_driver.backends import Measurement
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import PostureTask, Tick
from pepper_driver.observer import Contact, Observation
from pepper_driver.reflexes import ReflexRequests
from pepper_driver.reflexes.requests import DOMINANT_WEIGHT
from support.experiments import ROBOT
from support.reflexes import touch
from support.scripted import Holder, Scripted, make_pepper

ROLL = ROBOT.joint_index("LShoulderRoll")


@dataclass(kw_only=True, eq=False)
class Lead(Reflex):
    """Turns the shoulder out by ``way`` [rad]."""

    way: float

    def begin(self, contact: Contact, requests: ReflexRequests) -> None:
        self.joints[ROLL] = True
        self._task = PostureTask(["LShoulderRoll"], stiffness=100.0, weight=DOMINANT_WEIGHT)
        self._task.target = [requests.controller.position[ROLL] + self.way]

    def act(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        if requests.claim(self.joints):
            requests.add_task(self._task)


def trace(pepper: Pepper, seconds: float) -> FloatArray:
    """(ticks,) angle of the shoulder [rad]."""
    angles: list[float] = []

    def note(tick: Tick, observation: Observation | None) -> None:
        angles.append(float(pepper.controller.position[ROLL]))

    pepper.run(seconds, on_tick=note)
    return np.array(angles)


@pytest.mark.parametrize("way", [0.1, 0.6])
def test_they_set_out_smoothly_do_not_hurry_arrive_and_never_turn_round(way: float) -> None:
    script = {1.0: touch(), 4.0: touch(phase="end")}
    with make_pepper(Lead(way=way, release_delay=0.0), script) as pepper:
        pepper.run(0.9)
        home = pepper.controller.position[ROLL]
        pepper.run(3.1)
        offset = trace(pepper, max(0.8, 1.875 * way / 0.6) + 0.1) - home
    assert offset[0] == pytest.approx(way, rel=0.02)
    speed = np.diff(offset) / ROBOT.cycle
    assert offset[-1] == pytest.approx(0.0, abs=2e-3), "a spring would creep on"
    assert -speed.min() == pytest.approx(min(0.6, 1.875 * way / 0.8), rel=0.05)
    assert speed.max() < 1e-3
    # A spring begins with its largest acceleration.
    acceleration = np.abs(np.diff(speed)) / ROBOT.cycle
    assert acceleration[0] < 0.35 * acceleration.max()


def test_a_motion_under_way_keeps_its_time() -> None:
    script = {1.0: touch(), 2.0: touch(phase="end")}
    with make_pepper(Lead(way=0.4, release_delay=0.0), script) as pepper:
        pepper.set_posture({"HeadYaw": 0.8}, duration=6.0)
        pepper.run(4.0)
        assert pepper.controller.posture.has_reference
        assert pepper.controller.position[ROBOT.joint_index("HeadYaw")] < 0.7
        pepper.run(2.2)
        assert not pepper.controller.posture.has_reference
        assert pepper.controller.position[ROBOT.joint_index("HeadYaw")] == pytest.approx(
            0.8, abs=1e-3
        )


def test_while_another_reflex_holds_the_posture_nothing_is_led_back() -> None:
    """A held posture moves no other joint, so there is no way back; a spline would hold it less firmly."""
    script = {1.0: touch(), 2.0: touch(phase="end")}
    reflexes = [Lead(way=0.3, release_delay=0.0), Holder(0.5, 6.0)]
    with Pepper("mock", observer=Scripted(script), reflexes=reflexes) as pepper:
        home = pepper.controller.position[ROLL]
        pepper.run(2.2)
        assert not pepper.controller.posture.has_reference
        assert pepper.controller.position[ROLL] == pytest.approx(home, abs=1e-3)
