"""The velocity damper of older controllers: its formula, and why it is not the default."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config import ControllerSettings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import RobotModel
from pepper_driver.controller.constraints import AccelerationBox
from support.controller import DT, JOINTS, MIDDLE, ROBOT, SETTINGS, random_posture
from support.examples import examples

Law = Literal["damper", "braking"]

URDF_VELOCITY = np.array([joint.velocity for joint in ROBOT.joints])


def with_limits(law: Law, velocity: float | None, acceleration: float) -> ControllerSettings:
    """Without margin; the velocity of the URDF if None."""
    return replace(
        SETTINGS,
        position_limit=law,
        position_margin=0.0,
        velocity="robot" if velocity is None else "safe",
        velocity_limit=dict.fromkeys(ROBOT.joint_names, velocity or 1.0),
        acceleration_limit=dict.fromkeys(ROBOT.joint_names, acceleration),
    )


class Damper:
    """One joint's bounds on the velocity after a cycle, as Tasks has them: an interval, and xi that it remembers."""

    def __init__(self, lower: float, upper: float) -> None:
        self.lower, self.upper = lower, upper
        self.near, self.stop = 0.1 * (upper - lower), 0.01 * (upper - lower)
        self.zone, self.xi = "", 0.0

    def bounds(self, q: float, v: float) -> tuple[float, float]:
        to_lower, to_upper = q - self.lower, self.upper - q
        zone = "lower" if to_lower < self.near else "upper" if to_upper < self.near else ""
        distance = to_lower if zone == "lower" else to_upper
        if zone and zone != self.zone:
            behind = distance <= self.stop
            ahead = 0.2 * (self.near - self.stop) if behind else distance - self.stop
            self.xi = abs((self.near - self.stop) / ahead * v) + 0.5
        self.zone = zone
        damped = self.xi * (distance - self.stop) / (self.near - self.stop)
        if zone == "lower":
            return -damped, np.inf
        return -np.inf, damped if zone else np.inf


def test_bounds_are_those_of_the_formula() -> None:
    """Along random paths in and out of the zones, also beyond limits."""
    random = np.random.default_rng(0)
    fast = 1e5
    model = RobotModel(ROBOT)
    box = AccelerationBox(ROBOT, with_limits("damper", fast, 1e9), model, DT)
    dampers = [Damper(joint.lower, joint.upper) for joint in ROBOT.joints]
    position = random_posture(random)
    span = ROBOT.upper - ROBOT.lower
    damped = np.zeros(JOINTS, dtype=int)
    for _ in range(2000):
        velocity = random.normal(size=JOINTS) * 3
        position = position + 0.05 * span * random.normal(size=JOINTS)
        position = np.clip(position, ROBOT.lower - 0.05 * span, ROBOT.upper + 0.05 * span)
        v = np.zeros(20)
        v[model.joint_columns] = velocity
        model.set_state(model.configuration(position), v)
        box.update(model.q, v, np.zeros(20))
        after = np.stack([box.lower, box.upper])[:, model.joint_columns] * DT + velocity
        for i, damper in enumerate(dampers):
            expected = np.clip(damper.bounds(position[i], velocity[i]), -fast, fast)
            damped[i] += damper.zone != ""
            assert after[:, i] == pytest.approx(expected, rel=1e-9, abs=1e-6)
    assert damped.min() > 300


def overshoot(law: Law, acceleration: float) -> tuple[FloatArray, FloatArray]:
    """(17,) largest distance beyond a limit [rad], over several starts, and the largest acceleration."""
    worst, hardest = np.zeros(JOINTS), np.zeros(JOINTS)
    model = RobotModel(ROBOT)
    for phase in np.linspace(0, 1, 12):
        box = AccelerationBox(ROBOT, with_limits(law, None, acceleration), model, DT)
        q, v = model.configuration(MIDDLE + phase * URDF_VELOCITY * DT), np.zeros(20)
        for tick in range(400):
            box.update(q, v, np.zeros(20))
            a = box.upper if tick < 200 else box.lower
            a = np.where(np.arange(20) < 3, 0.0, a)
            q = model.integrate(q, (v + a * DT / 2) * DT)
            v = v + a * DT
            position = model.joints_of_configuration(q)
            worst = np.maximum(worst, position - ROBOT.upper)
            worst = np.maximum(worst, ROBOT.lower - position)
            hardest = np.maximum(hardest, np.abs(model.joints_of(a)))
    return worst, hardest


def test_at_the_velocities_of_the_urdf_it_overshoots_and_the_braking_distance_does_not() -> None:
    """Fast joints with little range jump over the zone in one cycle; the others are held."""
    quick = ("Hand", "WristYaw", "ElbowRoll", "ShoulderRoll", "HeadPitch")
    over = np.array([name.endswith(quick) for name in ROBOT.joint_names])
    damped, kicked = overshoot("damper", 100.0)
    assert (damped[over] > 0.04).all()
    assert damped[~over].max() < 1e-9
    assert kicked.max() > 1000
    braked, hardest = overshoot("braking", 100.0)
    assert braked.max() < 1e-9
    assert hardest.max() < 100.0 + 1e-6


@given(
    seed=st.integers(0, 2**31),
    far=st.floats(0, 10),
    fast=st.floats(0, 1000),
    acceleration=st.sampled_from([1.0, 20.0, 100.0, 1e6]),
)
@examples(60)
def test_its_box_is_never_empty_and_never_runs_away(
    seed: int, far: float, fast: float, acceleration: float
) -> None:
    """From any state, always at an edge: what it does is finite, and no faster than the velocity limit."""
    random = np.random.default_rng(seed)
    model = RobotModel(ROBOT)
    box = AccelerationBox(ROBOT, with_limits("damper", None, acceleration), model, DT)
    q = model.configuration(random_posture(random) + far * random.normal(size=JOINTS))
    v = fast * random.normal(size=20)
    for _ in range(60):
        box.update(q, v, np.zeros(20))
        assert np.isfinite(box.upper).all()
        assert np.isfinite(box.lower).all()
        assert (box.lower <= box.upper).all()
        a = np.where(random.random(20) < 0.5, box.lower, box.upper)
        v = v + a * DT
        assert (np.abs(model.joints_of(v)) <= URDF_VELOCITY + 1e-6).all()
        q = model.integrate(q, (v - a * DT / 2) * DT)
