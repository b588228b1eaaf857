"""Driven flat out at every limit of every joint, alone and together, at 12 ms: no limit broken, no cycle unsolved."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import WholeBodyController
from pepper_driver.controller.constraints import CoupledLimits, TorqueLimit, WheelSpeedLimit
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
)

Velocity = Literal["safe", "robot"]

TINY = 1e-9
SPEEDS = pytest.mark.parametrize("velocity", ["safe", "robot"])


def controller(velocity: Velocity, jerk: float | None = None) -> WholeBodyController:
    """Flat out; ``jerk`` is what acceleration limits may be crossed in a second, None for no limit."""
    table = None
    if jerk is not None:
        table = {name: jerk * a for name, a in SETTINGS.acceleration_limit.items()}
    control = WholeBodyController(ROBOT, replace(SETTINGS, velocity=velocity, jerk_limit=table))
    for constraint in (CoupledLimits(ROBOT), WheelSpeedLimit(ROBOT), TorqueLimit(ROBOT)):
        control.add(constraint)
    control.posture.stiffness = 2000.0
    control.base_velocity.stiffness = 500.0
    return control


def coupled_room(positions: FloatArray) -> float:
    """Distance of (ticks, 17) positions from the nearest coupled limit [rad], negative beyond it."""
    least = np.inf
    for limit in ROBOT.limits.coupled:
        angles, lower, upper = np.array(limit.table).T
        driver = positions[:, ROBOT.joint_index(limit.driver)]
        driven = positions[:, ROBOT.joint_index(limit.driven)]
        least = min(least, (driven - np.interp(driver, angles, lower)).min())
        least = min(least, (np.interp(driver, angles, upper) - driven).min())
    return float(least)


def drive(
    control: WholeBodyController,
    velocity: Velocity,
    targets: Iterator[tuple[FloatArray, FloatArray]],
    ticks: int,
) -> tuple[FloatArray, float]:
    """Run towards (posture, twist) targets, one per cycle, and check all that must hold after each.

    Returns:
        (17,) top speed as a fraction of the limit; least distance from a coupled limit.
    """
    references = []
    posture: FloatArray | None = None
    for _ in range(ticks):
        target, base = next(targets)
        if target is not posture:
            control.posture.target = posture = target
            control.base_velocity.target = base
        references.append(control.step())
        status = control.status
        relaxed = [name for name in status.relaxed if not name.endswith(" jerk")]
        assert (status.solver, relaxed) == ("solved", [])
    position = np.array([r.position for r in references])
    speed = np.abs([r.velocity for r in references])
    twist = np.array([np.zeros(3), *(r.base_twist for r in references)])
    limit = VELOCITY if velocity == "safe" else np.array([j.velocity for j in ROBOT.joints])
    assert (position - ROBOT.upper).max() <= TINY
    assert (ROBOT.lower - position).max() <= TINY
    nearest = coupled_room(position)
    assert nearest > 0
    assert (speed - limit).max() <= TINY
    assert (np.abs([r.acceleration for r in references]) - ACCELERATION).max() <= TINY
    assert (np.abs(twist) - BASE_VELOCITY).max() <= TINY
    assert (np.abs(np.diff(twist, axis=0)) - BASE_ACCELERATION * DT).max() <= TINY
    wheels = np.abs(twist @ ROBOT.wheels.matrix.T)
    assert wheels.max() <= ROBOT.wheels.speed_limit + 1e-6
    return (speed / limit).max(axis=0), nearest


def held(
    choices: Iterator[tuple[FloatArray, FloatArray]], ticks: Iterator[int]
) -> Iterator[tuple[FloatArray, FloatArray]]:
    for choice, count in zip(choices, ticks, strict=False):
        for _ in range(count):
            yield choice


@SPEEDS
@pytest.mark.parametrize("name", ROBOT.joint_names)
def test_every_joint_alone(name: str, velocity: Velocity) -> None:
    """From one limit to the other and back, and reversed at half of the distance."""
    joint = ROBOT.joint_index(name)
    distance = (ROBOT.upper - ROBOT.lower)[joint]
    speed = ROBOT.joints[joint].velocity if velocity == "robot" else VELOCITY[joint]
    brake = 0.9 * ACCELERATION[joint]
    there = int((distance / speed + min(speed / brake, 2 * (distance / brake) ** 0.5)) / DT) + 25

    def choices() -> Iterator[tuple[FloatArray, FloatArray]]:
        for side in (1, 0, 1, 0, 1):
            target = MIDDLE.copy()
            target[joint] = (ROBOT.lower, ROBOT.upper)[side][joint]
            yield target, np.zeros(3)

    ticks = iter((there, there, there // 3, there // 2, there))
    count = 3 * there + there // 3 + there // 2
    control = controller(velocity)
    drive(control, velocity, held(choices(), ticks), count)
    end = ROBOT.upper[joint] if name != "HeadPitch" else 0.445059  # the table with yaw at 0
    assert control.position[joint] == pytest.approx(end - SETTINGS.position_margin, abs=3e-3)


@pytest.mark.parametrize("jerk", [5.0, 12.0, 30.0])
def test_a_jerk_limit_is_relaxed_for_limits_that_joints_share(jerk: float) -> None:
    random = np.random.default_rng(int(jerk))

    def choices() -> Iterator[tuple[FloatArray, FloatArray]]:
        while True:
            yield (
                np.where(random.random(JOINTS) < 0.5, ROBOT.lower, ROBOT.upper),
                10 * random.choice([-1.0, 1.0], 3),
            )

    ticks = iter(lambda: int(random.integers(1, 120)), -1)
    top, nearest = drive(controller("safe", jerk), "safe", held(choices(), ticks), 1500)
    assert (top > 0.9).sum() >= 12
    assert nearest > 0.003


@SPEEDS
@pytest.mark.parametrize("seed", range(3))
def test_all_together_at_random_corners(seed: int, velocity: Velocity) -> None:
    random = np.random.default_rng(seed)

    def choices() -> Iterator[tuple[FloatArray, FloatArray]]:
        while True:
            yield (
                np.where(random.random(JOINTS) < 0.5, ROBOT.lower, ROBOT.upper),
                10 * random.choice([-1.0, 1.0], 3),
            )

    def ticks() -> Iterator[int]:
        while True:
            yield int(random.integers(1, (20, 80, 250)[seed]))

    top, nearest = drive(controller(velocity), velocity, held(choices(), ticks()), 1000)
    assert (top > (0.99 if velocity == "safe" else 0.4)).sum() >= 10
    assert nearest < 0.01


@SPEEDS
@pytest.mark.parametrize("seed", range(2))
def test_drivers_and_driven_to_all_corners_of_their_tables(seed: int, velocity: Velocity) -> None:
    """Rows of the tables and both ends of each, all pairs at once, from each to a random other one."""
    random = np.random.default_rng(seed)

    def choices() -> Iterator[tuple[FloatArray, FloatArray]]:
        while True:
            target = MIDDLE.copy()
            for limit in ROBOT.limits.coupled:
                row = limit.table[random.integers(len(limit.table))]
                driver, driven = (
                    ROBOT.joint_index(limit.driver),
                    ROBOT.joint_index(limit.driven),
                )
                beyond = random.choice([0.0, 0.3])
                side = random.integers(2)
                target[driver] = row[0]
                target[driven] = row[1 + side] + (2 * side - 1) * beyond
            yield np.clip(target, ROBOT.lower, ROBOT.upper), np.zeros(3)

    def ticks() -> Iterator[int]:
        while True:
            yield int(random.integers(5, 120) if seed else random.integers(1, 40))

    _, nearest = drive(controller(velocity), velocity, held(choices(), ticks()), 1200)
    assert nearest < 0.01


@SPEEDS
def test_the_head_thrown_across_the_corners_of_its_table(velocity: Velocity) -> None:
    """From the middle at its highest and lowest to one side, over to the other, and across."""
    control = controller(velocity)
    yaw, pitch = ROBOT.joint_index("HeadYaw"), ROBOT.joint_index("HeadPitch")

    def choices() -> Iterator[tuple[FloatArray, FloatArray]]:
        for turn in (-1.0, 1.0):
            for lift in (-1.0, 1.0):
                for corner in ((0.0, lift), (turn, lift), (-turn, lift), (turn, -lift)):
                    target = MIDDLE.copy()
                    target[yaw] = corner[0] * 2.0
                    target[pitch] = (ROBOT.upper if corner[1] > 0 else ROBOT.lower)[pitch]
                    yield target, np.zeros(3)

    def ticks() -> Iterator[int]:
        while True:
            yield 60

    drive(control, velocity, held(choices(), ticks()), 960)
