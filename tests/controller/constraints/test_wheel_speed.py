"""The wheels' speed limit: no wheel has to be slowed, and the base keeps its own limits at the same time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import RobotModel, WholeBodyController
from pepper_driver.controller.constraints import BrakingLimits, LinearInequality, WheelSpeedLimit
from pepper_driver.controller.odometry import desaturate
from support.controller import (
    ACCELERATION,
    BASE_ACCELERATION,
    BASE_VELOCITY,
    DT,
    ROBOT,
    SETTINGS,
    controller,
)

LIMIT = ROBOT.wheels.speed_limit
TINY = 1e-9
DIGITS = 1e-6  # of the wheels' matrix, which has fewer than the wheels' places


def wheel_speeds(twist: FloatArray) -> FloatArray:
    """(3,) from the wheels' places: the speed of the base at the wheel, along its rolling direction, by radius."""
    speeds = []
    for name, (x, y, _) in zip(ROBOT.wheels.names, ROBOT.wheels.positions, strict=True):
        row = ROBOT.wheels.matrix[ROBOT.wheels.names.index(name)]
        along = -row[:2] * ROBOT.wheels.radius
        at_wheel = np.array([twist[0] - twist[2] * y, twist[1] + twist[2] * x])
        speeds.append(-along @ at_wheel / ROBOT.wheels.radius)
    return np.array(speeds)


def driven(limited: bool) -> tuple[WholeBodyController, list[FloatArray]]:
    """Base twists of a base that is reversed from one direction into another."""
    random = np.random.default_rng(4)
    control = controller()
    control.base_velocity.stiffness = 500.0
    if limited:
        control.add(WheelSpeedLimit(ROBOT))
    twists = [np.zeros(3)]
    for tick in range(3000):
        if tick % 150 == 0:
            control.base_velocity.target = 10 * np.sign(random.normal(size=3))
        twists.append(control.step().base_twist.copy())
        assert control.status.solver == "solved"
    return control, twists


def test_flat_out_the_wheels_keep_their_limit_and_the_base_its_own() -> None:
    _, twists = driven(limited=True)
    speeds = np.abs([wheel_speeds(twist) for twist in twists])
    assert speeds.max() < LIMIT + DIGITS
    assert (speeds.max(axis=0) > LIMIT - 1e-6).all()
    assert (np.abs(twists) <= BASE_VELOCITY + TINY).all()
    assert (np.abs(np.diff(twists, axis=0)) <= BASE_ACCELERATION * DT + TINY).all()
    for twist in twists:
        commanded = ROBOT.wheels.matrix @ twist
        assert np.abs(desaturate(commanded, LIMIT) - commanded).max() < TINY


def test_without_it_wheels_would_have_to_be_slowed() -> None:
    _, twists = driven(limited=False)
    assert np.abs([wheel_speeds(twist) for twist in twists]).max() > 1.3 * LIMIT


def rows_at(twist: FloatArray, limit: WheelSpeedLimit | None = None) -> LinearInequality | None:
    model = RobotModel(ROBOT)
    v = np.zeros(20)
    v[:3] = twist
    model.set_state(model.q, v)
    braking_limits = BrakingLimits(np.concatenate([BASE_ACCELERATION, ACCELERATION]), DT)
    return (limit or WheelSpeedLimit(ROBOT)).compute_inequality(model, braking_limits)


def test_rows_forbid_what_makes_a_wheel_too_fast_and_nothing_else() -> None:
    random = np.random.default_rng(0)
    seen = {True: 0, False: 0}
    for _ in range(400):
        twist = BASE_VELOCITY * random.uniform(-1, 1, 3)
        twist *= LIMIT * random.choice([0.97, 0.99, 1.0]) / np.abs(wheel_speeds(twist)).max()
        rows = rows_at(twist)
        for fraction in random.choice([-1, -0.5, 0, 0.5, 1], (20, 3)):
            a = np.zeros(20)
            a[:3] = fraction * BASE_ACCELERATION
            allowed = rows is None or bool((rows.matrix @ a <= rows.bound + 1e-7).all())
            fast = np.abs(wheel_speeds(twist + a[:3] * DT)).max()
            if abs(fast - LIMIT) < 1e-6:
                continue
            assert allowed == (fast < LIMIT)
            seen[allowed] += 1
    assert min(seen.values()) > 500


def test_far_from_the_limit_there_are_no_rows() -> None:
    assert rows_at(np.zeros(3)) is None
    assert rows_at(np.array([0.2, 0.1, 0.3])) is None
    assert rows_at(np.array([0.35, -0.35, 0.0])) is not None


@pytest.mark.parametrize("axis", range(3))
def test_along_one_axis_weaker_wheels_are_kept_too(axis: int) -> None:
    fastest = np.abs(ROBOT.wheels.matrix[:, axis]).max()
    limit = 0.7 * fastest * BASE_VELOCITY[axis]
    robot = replace(ROBOT, wheels=replace(ROBOT.wheels, speed_limit=limit))
    control = WholeBodyController(robot, SETTINGS)
    control.add(WheelSpeedLimit(robot))
    control.base_velocity.stiffness = 500.0
    control.base_velocity.target = 10.0 * (np.arange(3) == axis)
    for _ in range(150):
        twist = control.step().base_twist
        assert np.abs(ROBOT.wheels.matrix @ twist).max() < limit + DIGITS
    assert np.abs(ROBOT.wheels.matrix @ twist).max() == pytest.approx(limit, abs=1e-4)


@pytest.mark.parametrize("turn", [0.0, 1.0, -1.0])
def test_a_base_that_is_too_fast_is_braked_as_it_may_brake(turn: float) -> None:
    control = controller()
    control.add(WheelSpeedLimit(ROBOT))
    control.base_velocity.weight = 0.0
    start = np.array([0.35, -0.35, turn])
    before = np.abs(wheel_speeds(start)).max()
    assert before > 1.05 * LIMIT
    control.step()
    control.override_state(control.position, start)
    fraction = 0.9 * (BASE_ACCELERATION * DT / np.abs(start + 1e-12)).min()
    for _ in range(150):
        twist = control.step().base_twist
        assert control.status.solver == "solved"
        speed = np.abs(wheel_speeds(twist)).max()
        assert speed < max((1 - fraction) * before, LIMIT) + DIGITS
        before = speed
    assert before < LIMIT + DIGITS
