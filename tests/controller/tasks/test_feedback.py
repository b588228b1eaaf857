"""Closed loop: tasks see the measured robot, the integration stays the controller's own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.backends.fields import Imu, Measurement
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import (
    BasePoseTask,
    FrameTask,
    PositionTask,
    RobotModel,
    WholeBodyController,
)
from support.controller import ACCELERATION, DT, JOINTS, MIDDLE, ROBOT, SETTINGS, VELOCITY


def closed() -> WholeBodyController:
    return WholeBodyController(ROBOT, replace(SETTINGS, feedback="joints"))


def measured(position: FloatArray, wheel_speed: FloatArray | None = None) -> Measurement:
    zero = np.zeros(JOINTS)
    return Measurement(
        time=0.0,
        tick=0,
        position=position,
        current=zero,
        wheel_speed=np.zeros(3) if wheel_speed is None else wheel_speed,
        imu=Imu(acceleration=np.zeros(3), angular_velocity=np.zeros(3), attitude=np.zeros(3)),
        touch=np.zeros(5),
        bumpers=np.zeros(3),
        buttons=np.zeros(1),
        temperature=zero,
        battery=1.0,
        age=0.0,
    )


def test_in_open_loop_a_measurement_changes_nothing() -> None:
    control, twin = (WholeBodyController(ROBOT, SETTINGS) for _ in range(2))
    for c in (control, twin):
        c.posture.target = MIDDLE + 0.2
        c.add(PositionTask("l_wrist"))
    random = np.random.default_rng(0)
    for _ in range(100):
        noise = measured(random.normal(size=JOINTS), random.normal(size=3))
        assert np.array_equal(control.step(noise).position, twin.step().position)


def test_a_constant_tracking_error_is_taken_out_in_closed_loop() -> None:
    """The robot droops by a constant angle: the reference goes as far beyond the target."""
    control = closed()
    droop = np.where(np.arange(JOINTS) % 2, 0.02, -0.03)
    control.posture.target = MIDDLE + 0.1
    at = MIDDLE - droop
    for _ in range(1500):
        reference = control.step(measured(at))
        at = reference.position - droop
    np.testing.assert_allclose(at, MIDDLE + 0.1, atol=1e-6)
    np.testing.assert_allclose(control.posture.error, 0.0, atol=1e-6)


def test_a_hand_that_lags_and_droops_arrives_in_closed_loop() -> None:
    control = closed()
    model = RobotModel(ROBOT)
    task = PositionTask("l_wrist")
    control.add(task)
    target = model.link_pose("l_wrist", MIDDLE)[:3, 3] + [0.05, 0.05, 0.1]
    task.target = target
    droop = np.full(JOINTS, 0.01)
    late = [MIDDLE - droop] * 4
    for _ in range(1500):
        late.append(control.step(measured(late[-4]), late[-4] + droop).position - droop)
        assert control.status.solver == "solved"
    assert task.reached(0.002)
    place = model.link_pose("l_wrist", late[-1])[:3, 3]
    assert np.linalg.norm(place - target) < 0.003
    reference = model.link_pose("l_wrist", control.position)[:3, 3]
    assert np.linalg.norm(reference - target) > 0.005


def test_the_base_is_where_its_wheels_have_rolled_to() -> None:
    control = closed()
    base, hand = BasePoseTask(weight=1e-6), PositionTask("l_wrist", weight=1e-6)
    control.add(base)
    control.add(hand)
    base.target = np.zeros(3)
    control.step(measured(MIDDLE))
    start = hand.target
    twist = np.array([0.1, 0.02, 0.05])
    for _ in range(100):
        control.step(measured(MIDDLE, ROBOT.wheels.matrix @ twist))
    x, y, heading = control.odometry.pose
    assert heading == pytest.approx(100 * DT * twist[2])
    np.testing.assert_allclose(base.error, [-x, -y, -heading], atol=1e-9)
    # The hand went with the base, turned and shifted.
    c, s = np.cos(heading), np.sin(heading)
    there = np.array([c * start[0] - s * start[1] + x, s * start[0] + c * start[1] + y, start[2]])
    np.testing.assert_allclose(hand.error, start - there, atol=1e-3)


def test_limits_hold_for_what_is_sent_wherever_the_robot_says_it_is() -> None:
    control = closed()
    random = np.random.default_rng(1)
    control.posture.stiffness = 200.0
    for tick in range(2000):
        if tick % 100 == 0:
            offset = random.normal(size=JOINTS)
            control.posture.target = random.uniform(ROBOT.lower, ROBOT.upper)
        reference = control.step(measured(control.position + offset))
        assert (reference.position <= ROBOT.upper).all()
        assert (reference.position >= ROBOT.lower).all()
        assert (np.abs(reference.velocity) <= VELOCITY + 1e-9).all()
        assert (np.abs(reference.acceleration) <= ACCELERATION + 1e-9).all()


def test_a_measurement_that_is_no_number_is_passed_over() -> None:
    control, twin = closed(), closed()
    for c in (control, twin):
        c.posture.target = MIDDLE + 0.3
        c.add(FrameTask("l_wrist"))
        for _ in range(40):
            c.step(measured(c.position - 0.01))
    for _ in range(20):
        nothing = measured(np.full(JOINTS, np.nan), np.full(3, np.nan))
        assert np.isfinite(control.step(nothing).load_torque).all()
        assert control.status.solver == "solved"
    for _ in range(200):
        control.step(measured(control.position - 0.01))
        twin.step(measured(twin.position - 0.01))
    assert np.isfinite(control.position).all()


def test_transport_is_not_taken_for_an_error() -> None:
    """A robot that answers late but exactly: in closed loop it moves as in open loop."""
    control, twin = closed(), WholeBodyController(ROBOT, SETTINGS)
    sent = [control.position] * 5
    for c in (control, twin):
        c.posture.target = MIDDLE + 0.3
        c.posture.stiffness = 50.0
    for _ in range(300):
        late = sent[-5]
        sent.append(control.step(measured(late), late).position)
        np.testing.assert_allclose(sent[-1], twin.step().position, atol=1e-12)


def test_reset_forgets_the_tracking_error() -> None:
    control = closed()
    for _ in range(200):
        control.step(measured(control.position - 0.05))
    control.reset(MIDDLE)
    control.step(measured(MIDDLE))
    np.testing.assert_allclose(control.posture.error, 0.0, atol=1e-12)
