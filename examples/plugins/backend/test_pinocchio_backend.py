"""The second simulator: the conformance suite, its physics, and a robot that detects contacts on it."""

import numpy as np

from pepper_driver.backends import Backend, Command, make_backend
from pepper_driver.config import load_robot
from pepper_driver.controller import RobotModel
from pepper_driver.testing.conformance import BackendConformance

ROBOT = load_robot()


class TestConformance(BackendConformance):
    """On a fixed base: its wheels take no commands."""

    drives = False

    def make_backend(self) -> Backend:
        return make_backend("pinocchio://?seed=7")


def test_a_joint_sags_under_gravity_as_its_stiffness_says() -> None:
    """At rest K (target - q) carries the load torque; friction, viscous near rest, carries nothing."""
    backend = make_backend("pinocchio")
    with backend:
        backend.open()
        start = backend.activate().position.copy()
        start[ROBOT.joint_index("LShoulderPitch")] = 0.0  # arm forwards
        command = Command(position=start, stiffness=np.ones(17), wheel_speed=np.zeros(3))
        for _ in range(400):
            backend.exchange(command)
        sag = start - backend.truth.position
        load = RobotModel(ROBOT).gravity_torque(backend.truth.position)
    np.testing.assert_allclose(backend.plant.stiffness * sag, load, atol=0.02)


def test_a_pushed_joint_yields_as_its_stiffness_says() -> None:
    backend = make_backend("pinocchio")
    roll = ROBOT.joint_index("LShoulderRoll")
    with backend:
        first = backend.open()
        backend.activate()
        command = Command(position=first.position, stiffness=np.ones(17), wheel_speed=np.zeros(3))
        for _ in range(200):
            backend.exchange(command)
        before = backend.truth.position
        backend.push("LBicep", [0, 10, 0], [0.16, 0, 0], 4.0)
        for _ in range(200):
            backend.exchange(command)
        yielded = backend.truth.position - before
        torque = backend.truth.contact_torque
    assert torque[roll] > 1.0
    np.testing.assert_allclose(
        yielded[roll], torque[roll] / backend.plant.stiffness[roll], rtol=0.05
    )
