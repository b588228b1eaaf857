"""Limits of position, velocity and acceleration, for any request."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Reference, RobotModel, WholeBodyController
from pepper_driver.controller.constraints import AccelerationBox
from support.controller import (
    ACCELERATION,
    BASE_ACCELERATION,
    BASE_VELOCITY,
    DT,
    JOINTS,
    MIDDLE,
    ROBOT,
    SETTINGS,
    VELOCITY,
    controller,
    random_posture,
)
from support.examples import examples

TINY = 1e-9
MARGIN = SETTINGS.position_margin
BRAKE = 0.9 * ACCELERATION


def assert_within(reference: Reference, margin: float = 0.0) -> None:
    assert (reference.position <= ROBOT.upper - margin + TINY).all()
    assert (reference.position >= ROBOT.lower + margin - TINY).all()
    assert (np.abs(reference.velocity) <= VELOCITY + TINY).all()
    assert (np.abs(reference.acceleration) <= ACCELERATION + TINY).all()


def jump(random: np.random.Generator) -> FloatArray:
    """A posture with every joint at one of its limits."""
    return np.where(random.random(JOINTS) < 0.5, ROBOT.lower, ROBOT.upper)


@pytest.mark.parametrize("stiffness", [5.0, 100.0, 1000.0])
@pytest.mark.parametrize("damping", [None, 0.0])
def test_flat_out_between_limits_all_joints_together(
    stiffness: float, damping: float | None
) -> None:
    random = np.random.default_rng(int(stiffness))
    control = controller()
    control.posture.stiffness = stiffness
    if damping is not None:
        control.posture.damping = damping
    fastest = np.zeros(JOINTS)
    until = 0
    for tick in range(3000):
        if tick == until:
            control.posture.target = jump(random)
            until += int(random.integers(1, 250))
        reference = control.step()
        assert control.status.solver == "solved"
        assert_within(reference, MARGIN)
        fastest = np.maximum(fastest, np.abs(reference.velocity))
    if stiffness > 5:  # the test would be idle otherwise
        assert (fastest > 0.99 * VELOCITY).sum() >= 12


@pytest.mark.parametrize("name", ROBOT.joint_names)
def test_flat_out_one_joint_alone(name: str) -> None:
    control = controller()
    control.posture.stiffness = 1000.0
    joint = ROBOT.joint_index(name)
    target = MIDDLE.copy()
    for limit in (ROBOT.upper[joint], ROBOT.lower[joint], ROBOT.upper[joint]):
        target[joint] = limit
        control.posture.target = target
        for _ in range(300):
            reference = control.step()
            assert_within(reference, MARGIN)
        end = np.clip(limit, ROBOT.lower[joint] + MARGIN, ROBOT.upper[joint] - MARGIN)
        travel = ROBOT.upper[joint] - ROBOT.lower[joint]
        if travel / VELOCITY[joint] + VELOCITY[joint] / BRAKE[joint] < 300 * DT:
            assert reference.position[joint] == pytest.approx(end, abs=1e-3)
        assert np.abs(np.delete(reference.position - MIDDLE, joint)).max() < TINY


@pytest.mark.parametrize("dt", [0.002, 0.02, 0.05])
def test_flat_out_at_other_cycles(dt: float) -> None:
    random = np.random.default_rng(1)
    control = WholeBodyController(ROBOT, SETTINGS, dt=dt)
    control.posture.stiffness = 300.0
    for tick in range(1500):
        if tick % 150 == 0:
            control.posture.target = jump(random)
        assert_within(control.step(), MARGIN)


def test_a_joint_flat_out_moves_as_fast_as_it_may_and_brakes_as_late() -> None:
    """Trapezium: up at the acceleration limit, down at 0.9 of it, flat at the velocity limit."""
    control = controller()
    control.posture.stiffness = 1000.0
    joint = ROBOT.joint_index("LShoulderPitch")
    start = MIDDLE.copy()
    start[joint] = ROBOT.lower[joint] + MARGIN
    control.reset(start)
    target = start.copy()
    target[joint] = ROBOT.upper[joint]
    control.posture.target = target
    distance = ROBOT.upper[joint] - ROBOT.lower[joint] - 2 * MARGIN
    v, a, b = VELOCITY[joint], ACCELERATION[joint], BRAKE[joint]
    shortest = distance / v + v / (2 * a) + v / (2 * b)
    ticks = 0
    while control.position[joint] < ROBOT.upper[joint] - MARGIN - 0.01:
        control.step()
        ticks += 1
    assert shortest - 0.1 < ticks * DT < shortest + 0.1


def test_joints_at_their_limit_are_named() -> None:
    control = controller()
    assert not control.status.at_limit
    joint = ROBOT.joint_index("RElbowYaw")
    target = MIDDLE.copy()
    target[joint] = ROBOT.upper[joint]
    control.posture.stiffness = 1000.0
    control.posture.target = target
    control.step()
    assert control.status.at_limit == (("RElbowYaw", "acceleration"),)
    control.reset(MIDDLE)
    assert not control.status.at_limit
    control.step()
    assert not control.status.at_limit


@pytest.mark.parametrize("solver", ["daqp", "osqp"])
def test_the_base_keeps_its_limits(solver: str) -> None:
    random = np.random.default_rng(2)
    control = controller(solver)
    control.base_velocity.stiffness = 500.0
    before = np.zeros(3)
    fastest = np.zeros(3)
    for tick in range(1500):
        if tick % 200 == 0:
            control.base_velocity.target = 10 * np.sign(random.normal(size=3))
        twist = control.step().base_twist
        assert (np.abs(twist) <= BASE_VELOCITY + TINY).all()
        assert (np.abs(twist - before) <= BASE_ACCELERATION * DT + TINY).all()
        fastest = np.maximum(fastest, np.abs(twist))
        before = twist
    assert fastest == pytest.approx(BASE_VELOCITY)


@pytest.mark.parametrize("beyond", [-MARGIN, -MARGIN / 2, 0.001, 0.05, 0.5])
def test_started_beyond_a_limit_it_comes_back_slowly(beyond: float) -> None:
    """Every joint beyond one of its limits or in the margin before it, and no task that leads it back."""
    control = controller()
    side = np.where(np.arange(JOINTS) % 2, 1.0, -1.0)
    limit = np.where(side > 0, ROBOT.upper, ROBOT.lower) - side * MARGIN
    control.reset(limit + side * (MARGIN + beyond))
    control.posture.weight = 0.0
    speed = BRAKE * DT / 2
    before = control.position
    for _ in range(int((beyond + MARGIN) / speed.min() / DT) + 20):
        reference = control.step()
        outside = side * (before - limit) > 2 * speed * DT  # then it slows down
        inwards = -side * reference.velocity
        assert inwards[outside] == pytest.approx(speed[outside])
        assert (inwards >= 0).all()
        assert (inwards <= speed + TINY).all()
        assert (np.abs(reference.acceleration) <= ACCELERATION + TINY).all()
        before = reference.position
    assert (reference.position <= ROBOT.upper - MARGIN + TINY).all()
    assert (reference.position >= ROBOT.lower + MARGIN - TINY).all()


def test_started_beyond_a_limit_it_follows_a_task_that_leads_back() -> None:
    control = controller()
    control.reset(ROBOT.upper + 0.3)
    control.posture.target = MIDDLE
    control.posture.stiffness = 100.0
    for _ in range(1000):
        reference = control.step()
        assert (np.abs(reference.velocity) <= VELOCITY + TINY).all()
        assert (np.abs(reference.acceleration) <= ACCELERATION + TINY).all()
        assert (reference.position >= ROBOT.lower + MARGIN - TINY).all()
    assert np.abs(reference.position - MIDDLE).max() < 1e-6


def box_at(position: FloatArray, velocity: FloatArray) -> AccelerationBox:
    model = RobotModel(ROBOT)
    box = AccelerationBox(ROBOT, SETTINGS, model, DT)
    v = np.empty(20)
    v[:3] = velocity[:3]
    v[model.joint_columns] = velocity[3:]
    model.set_state(model.configuration(position), v)
    box.update(model.q, model.v, np.zeros(20))
    return box


@given(seed=st.integers(0, 2**31), far=st.floats(0, 100), fast=st.floats(0, 1000))
@examples(200)
def test_the_box_is_never_empty(seed: int, far: float, fast: float) -> None:
    random = np.random.default_rng(seed)
    position = random_posture(random) + far * random.normal(size=JOINTS)
    box = box_at(position, fast * random.normal(size=20))
    assert np.isfinite(box.lower).all()
    assert np.isfinite(box.upper).all()
    assert (box.lower <= box.upper).all()


def test_at_rest_in_the_middle_the_box_is_the_acceleration_limit() -> None:
    box = box_at(MIDDLE, np.zeros(20))
    columns = RobotModel(ROBOT).joint_columns
    assert np.abs(box.upper[columns] - ACCELERATION).max() < 1e-12
    assert np.abs(box.lower[columns] + ACCELERATION).max() < 1e-12
    assert box.upper[:3] == pytest.approx(BASE_ACCELERATION)
    assert box.lower[:3] == pytest.approx(-BASE_ACCELERATION)
    assert np.array_equal(box.joint_velocity_limit, VELOCITY)


@given(seed=st.integers(0, 2**31), push=st.sampled_from([-1.0, 1.0]))
@examples(50)
def test_whatever_the_box_allows_can_be_stopped(seed: int, push: float) -> None:
    """One edge of the box for a while, then as much braking as the box allows: inside all the time."""
    random = np.random.default_rng(seed)
    model = RobotModel(ROBOT)
    box = AccelerationBox(ROBOT, SETTINGS, model, DT)
    position, velocity = random.uniform(ROBOT.lower + 0.01, ROBOT.upper - 0.01), np.zeros(JOINTS)
    for tick in range(80):
        v = np.zeros(20)
        v[model.joint_columns] = velocity
        model.set_state(model.configuration(position), v)
        box.update(model.q, model.v, np.zeros(20))
        lower, upper = box.lower[model.joint_columns], box.upper[model.joint_columns]
        a = (upper if push > 0 else lower) if tick < 60 else np.clip(-velocity / DT, lower, upper)
        assert (np.abs(a) <= ACCELERATION + TINY).all()
        position = position + velocity * DT + a * DT**2 / 2
        velocity = velocity + a * DT
        assert (position <= ROBOT.upper - MARGIN + TINY).all()
        assert (position >= ROBOT.lower + MARGIN - TINY).all()
        assert (np.abs(velocity) <= VELOCITY + TINY).all()


def test_too_fast_at_the_start_it_is_braked_to_the_velocity_limit_at_once() -> None:
    """Velocity counts more than acceleration."""
    velocity = np.concatenate([2 * BASE_VELOCITY, -2 * VELOCITY])
    box = box_at(MIDDLE, velocity)
    columns = RobotModel(ROBOT).joint_columns
    after = velocity[:3] + DT * box.upper[:3]
    assert after == pytest.approx(BASE_VELOCITY)
    assert velocity[3:] + DT * box.lower[columns] == pytest.approx(-VELOCITY)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_beyond_a_limit_and_moving_out_it_is_turned_at_once(side: float) -> None:
    """Position counts more than acceleration."""
    columns = RobotModel(ROBOT).joint_columns
    limit = ROBOT.upper if side > 0 else ROBOT.lower
    box = box_at(limit + side * 0.1, np.concatenate([np.zeros(3), side * VELOCITY]))
    towards = box.upper if side > 0 else box.lower
    assert side * VELOCITY + DT * towards[columns] == pytest.approx(-side * BRAKE * DT / 2)


def test_a_margin_wider_than_the_range_leaves_room() -> None:
    control = WholeBodyController(ROBOT, replace(SETTINGS, position_margin=10.0))
    control.posture.target = ROBOT.upper
    for _ in range(2000):
        assert_within(control.step())
    assert control.position == pytest.approx(
        ROBOT.upper - (ROBOT.upper - ROBOT.lower) / 4, abs=1e-3
    )
