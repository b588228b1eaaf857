"""Arrival at position limits: no overshoot, no relaxed limit, and no oscillation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import RobotModel, Task
from pepper_driver.controller.constraints import AccelerationBox
from pepper_driver.controller.tasks.task import TaskRows
from support.controller import (
    ACCELERATION,
    DT,
    JOINTS,
    MIDDLE,
    ROBOT,
    SETTINGS,
    VELOCITY,
    controller,
)
from support.examples import examples

MARGIN = SETTINGS.position_margin
TINY = 1e-9


class Pull(Task):
    """Task that requests an acceleration in any posture, as a hand task with a target out of reach."""

    needs_kinematics = False

    def __init__(self, acceleration: FloatArray) -> None:
        super().__init__(JOINTS, stiffness=0.0, weight=1000.0)
        self.acceleration = acceleration

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        rows.jacobian[np.arange(JOINTS), model.joint_columns] = 1.0
        rows.error[:] = 0.0
        rows.bias[:] = -self.acceleration


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("fraction", [0.01, 1.0])
def test_a_joint_pulled_at_its_limit_comes_to_rest_there(side: float, fraction: float) -> None:
    """The acceleration must not change its sign in every cycle: the load torque would."""
    control = controller()
    control.posture.weight = 0.0
    control.add(Pull(side * fraction * ACCELERATION))
    limit = np.where(side > 0, ROBOT.upper - MARGIN, ROBOT.lower + MARGIN)
    for _ in range(4500):
        reference = control.step()
    assert np.abs(reference.position - limit).max() < TINY
    for _ in range(10):
        reference = control.step()
        assert np.abs(reference.velocity).max() < TINY
        assert np.abs(reference.acceleration).max() < 1e-7


@pytest.mark.parametrize("joint", range(JOINTS))
def test_the_velocity_never_reverses_before_a_limit(joint: int) -> None:
    control = controller()
    pull = np.zeros(JOINTS)
    pull[joint] = ACCELERATION[joint]
    control.add(Pull(pull))
    velocities = np.array([control.step().velocity[joint] for _ in range(600)])
    top = int(velocities.argmax())
    assert velocities[top] > 0.5 * VELOCITY[joint]
    assert velocities.min() > -TINY
    assert np.diff(velocities[top:]).max() < TINY
    # Braking is hard, not a creep: the last hundredth of a radian takes a few cycles.
    assert velocities[top:].sum() * DT > 0.9 * (ROBOT.upper[joint] - control.position[joint])
    assert velocities[-1] < 1e-3


@given(
    seed=st.integers(0, 2**31),
    mode=st.sampled_from(["edge", "switch", "both", "inside"]),
    dt=st.sampled_from([DT, DT / 8, 4 * DT]),
)
@examples(40)
def test_no_sequence_of_bounds_violates_a_limit(seed: int, mode: str, dt: float) -> None:
    """Whatever is chosen inside the box, the next box still holds all limits: none is ever relaxed."""
    random = np.random.default_rng(seed)
    model = RobotModel(ROBOT)
    box = AccelerationBox(ROBOT, SETTINGS, model, dt)
    q = model.configuration(random.uniform(ROBOT.lower + 0.01, ROBOT.upper - 0.01))
    v = np.zeros(model.nv)
    side = random.choice([-1, 1], model.nv)
    for _ in range(150):
        model.set_state(q, v)
        box.update(model.q, model.v, np.zeros(20))
        assert (box.lower <= box.upper).all()
        assert box.relaxed() == ()
        if mode == "both" or (mode == "switch" and random.random() < 0.05):
            side = random.choice([-1, 1], model.nv)
        a = (
            random.uniform(box.lower, box.upper)
            if mode == "inside"
            else np.where(side > 0, box.upper, box.lower)
        )
        q = model.integrate(q, (v + a * dt / 2) * dt)
        v = v + a * dt
        model.set_state(q, v)
        position = model.joint_position
        assert (position <= ROBOT.upper - MARGIN + TINY).all()
        assert (position >= ROBOT.lower + MARGIN - TINY).all()
        assert (np.abs(model.joint_velocity) <= VELOCITY + TINY).all()
        assert (np.abs(a[model.joint_columns]) <= ACCELERATION + TINY).all()


def max_velocity(distance: float, velocity: float, brake: float) -> float:
    """The largest v+ after which the joint can still stop in time, by bisection on what is asked for."""

    def in_time(after: float) -> bool:
        left = distance - (velocity + after) * DT / 2
        if after <= brake * DT:
            return after * DT <= left
        return after**2 / (2 * brake) <= left - brake * DT**2 / 2

    low, high = -100.0, 100.0
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if in_time(middle) else (low, middle)
    return max(low, -brake * DT / 2)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_bound_is_the_largest_velocity_that_can_be_stopped(side: float) -> None:
    random = np.random.default_rng(1)
    bound_by_position = np.zeros(JOINTS, dtype=int)
    columns = RobotModel(ROBOT).joint_columns
    limit = np.where(side > 0, ROBOT.upper - MARGIN, ROBOT.lower + MARGIN)
    brake = 0.9 * ACCELERATION
    for _ in range(200):
        scale = 10.0 ** random.uniform(-6, 0, JOINTS)
        distance = scale * VELOCITY**2 / brake
        velocity = VELOCITY * random.uniform(-0.3, 1.0, JOINTS)
        box = box_at(limit - side * distance, side * velocity)
        edge = box.upper[columns] if side > 0 else -box.lower[columns]
        for joint in range(JOINTS):
            after = max_velocity(distance[joint], velocity[joint], brake[joint])
            requested = (after - velocity[joint]) / DT
            free = min(ACCELERATION[joint], (VELOCITY[joint] - velocity[joint]) / DT)
            bound_by_position[joint] += requested < free
            assert edge[joint] == pytest.approx(min(requested, free), abs=1e-7)
    assert bound_by_position.min() > 20


def test_braking_uses_the_acceleration_that_is_allowed() -> None:
    """From full speed: the stopping distance is that of 0.9 of the limit, give or take the distance of one cycle."""
    control = controller()
    control.add(Pull(ACCELERATION))
    joint = ROBOT.joint_index("LShoulderPitch")
    trail = [control.step() for _ in range(300)]
    fast = [r for r in trail if r.velocity[joint] > VELOCITY[joint] - TINY]
    assert fast
    left = ROBOT.upper[joint] - MARGIN - fast[-1].position[joint]
    stop = VELOCITY[joint] ** 2 / (2 * 0.9 * ACCELERATION[joint])
    assert stop <= left < stop + 1.5 * VELOCITY[joint] * DT


def box_at(position: FloatArray, joint_velocity: FloatArray) -> AccelerationBox:
    model = RobotModel(ROBOT)
    box = AccelerationBox(ROBOT, SETTINGS, model, DT)
    v = np.zeros(model.nv)
    v[model.joint_columns] = joint_velocity
    model.set_state(model.configuration(position), v)
    box.update(model.q, v, np.zeros(20))
    return box


def test_what_was_relaxed_is_named() -> None:
    assert box_at(MIDDLE, np.zeros(JOINTS)).relaxed() == ()
    hand, knee = ROBOT.joint_index("LHand"), ROBOT.joint_index("KneePitch")
    fast = np.zeros(JOINTS)
    fast[hand] = 2 * VELOCITY[hand]
    assert box_at(MIDDLE, fast).relaxed() == ("LHand acceleration",)
    beyond = MIDDLE.copy()
    beyond[knee] = ROBOT.lower[knee] - 0.1
    assert box_at(beyond, np.zeros(JOINTS)).relaxed() == ("KneePitch position",)
    close = ROBOT.upper - MARGIN
    towards = np.zeros(JOINTS)
    towards[hand] = VELOCITY[hand]
    assert box_at(close, towards).relaxed() == ("LHand acceleration",)


@pytest.mark.parametrize("order", ["reversed", "shuffled"])
def test_limits_follow_the_names_of_the_joints(order: str) -> None:
    """Another order of the public vectors gives the same motion."""
    turn = np.arange(JOINTS)[::-1]
    if order == "shuffled":
        turn = np.random.default_rng(0).permutation(JOINTS)
    robot = replace(ROBOT, joints=tuple(ROBOT.joints[i] for i in turn))
    control, other = controller(), type(controller())(robot, SETTINGS)
    control.posture.target, other.posture.target = ROBOT.upper, robot.upper
    control.posture.stiffness = other.posture.stiffness = 100.0
    for _ in range(200):
        reference, turned = control.step(), other.step()
        for field in ("position", "velocity", "acceleration", "load_torque"):
            assert np.abs(getattr(reference, field)[turn] - getattr(turned, field)).max() < TINY
