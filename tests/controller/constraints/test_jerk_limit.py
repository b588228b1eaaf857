"""Jerk limit: it holds unless a more important limit prevails, and is relaxed for velocity and position."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.controller import RobotModel, WholeBodyController
from pepper_driver.controller.constraints import AccelerationBox
from support.controller import (
    ACCELERATION,
    BASE,
    BASE_ACCELERATION,
    BASE_VELOCITY,
    DT,
    JOINTS,
    MIDDLE,
    ROBOT,
    SETTINGS,
    VELOCITY,
    random_posture,
)
from support.examples import examples

JERK = 12.0 * ACCELERATION
WITH_JERK = replace(SETTINGS, jerk_limit=dict(zip(ROBOT.joint_names, JERK.tolist(), strict=True)))
BASE_JERK = np.array([BASE.linear_jerk, BASE.linear_jerk, BASE.angular_jerk])
MARGIN = SETTINGS.position_margin
TINY = 1e-9


@given(
    seed=st.integers(0, 2**31),
    far=st.floats(0, 100),
    fast=st.floats(0, 1000),
    hard=st.floats(0, 1000),
    law=st.sampled_from(["braking", "damper"]),
)
@examples(200)
def test_the_box_is_never_empty(
    seed: int, far: float, fast: float, hard: float, law: Literal["braking", "damper"]
) -> None:
    random = np.random.default_rng(seed)
    model = RobotModel(ROBOT)
    box = AccelerationBox(ROBOT, replace(WITH_JERK, position_limit=law), model, DT)
    q = model.configuration(random_posture(random) + far * random.normal(size=JOINTS))
    box.update(q, fast * random.normal(size=20), hard * random.normal(size=20))
    assert np.isfinite(box.lower).all()
    assert np.isfinite(box.upper).all()
    assert (box.lower <= box.upper).all()


def test_slow_and_far_from_limits_the_box_is_jerk_cut_by_acceleration() -> None:
    model = RobotModel(ROBOT)
    box = AccelerationBox(ROBOT, WITH_JERK, model, DT)
    random = np.random.default_rng(0)
    limit, jerk = np.zeros(20), np.zeros(20)
    limit[:3], jerk[:3] = BASE_ACCELERATION, BASE_JERK
    limit[model.joint_columns], jerk[model.joint_columns] = ACCELERATION, JERK
    for _ in range(50):
        before = limit * random.uniform(-1, 1, 20)
        box.update(model.configuration(MIDDLE), np.zeros(20), before)
        assert box.upper == pytest.approx(np.minimum(limit, before + jerk * DT))
        assert box.lower == pytest.approx(np.maximum(-limit, before - jerk * DT))


def test_without_it_the_box_is_that_of_a_controller_that_has_none() -> None:
    model = RobotModel(ROBOT)
    box, plain = (AccelerationBox(ROBOT, s, model, DT) for s in (WITH_JERK, SETTINGS))
    random = np.random.default_rng(0)
    for _ in range(20):
        state = model.configuration(random_posture(random)), random.normal(size=20)
        before = random.normal(size=20)
        box.update(*state, before, jerk=False)
        plain.update(*state, before)
        assert np.array_equal(box.upper, plain.upper)
        assert np.array_equal(box.lower, plain.lower)


def thrown(jerk: bool) -> float:
    """Largest change of an acceleration, in units of the jerk limit, on paths that end far from any limit."""
    control = WholeBodyController(ROBOT, WITH_JERK if jerk else SETTINGS)
    random = np.random.default_rng(1)
    control.posture.stiffness = 60.0
    before, largest = np.zeros(JOINTS), 0.0
    distance = np.minimum(0.1 * (ROBOT.upper - ROBOT.lower), 0.05 * VELOCITY)
    for tick in range(1000):
        if tick % 40 == 0:
            control.posture.target = MIDDLE + distance * random.uniform(-1, 1, JOINTS)
            control.base_velocity.target = 0.2 * random.uniform(-1, 1, 3)
        reference = control.step()
        assert control.status.solver == "solved"
        assert all(kind in ("jerk", "acceleration") for _, kind in control.status.at_limit)
        largest = max(largest, float(np.abs((reference.acceleration - before) / (JERK * DT)).max()))
        before = reference.acceleration
    return largest


def test_in_free_motion_it_is_kept() -> None:
    assert thrown(jerk=True) < 1 + TINY
    assert thrown(jerk=False) > 1.5


def test_the_base_keeps_its_own() -> None:
    control = WholeBodyController(ROBOT, WITH_JERK)
    control.base_velocity.stiffness = 30.0
    before, twist = np.zeros(3), np.zeros(3)
    for tick in range(600):
        if tick % 150 == 0:
            control.base_velocity.target = BASE_VELOCITY * 0.5 * (-1) ** (tick // 150)
        last, twist = twist, control.step().base_twist.copy()
        a = (twist - last) / DT
        assert (np.abs(a - before) <= BASE_JERK * DT + TINY).all()
        before = a


@pytest.mark.parametrize("velocity", ["safe", "robot"])
def test_position_and_velocity_count_more(velocity: Literal["safe", "robot"]) -> None:
    control = WholeBodyController(ROBOT, replace(WITH_JERK, velocity=velocity))
    control.posture.stiffness = 1000.0
    fastest = VELOCITY if velocity == "safe" else np.array([j.velocity for j in ROBOT.joints])
    random = np.random.default_rng(2)
    before, hardest = np.zeros(JOINTS), np.zeros(JOINTS)
    for tick in range(2000):
        if tick % 100 == 0:
            control.posture.target = np.where(random.random(JOINTS) < 0.5, ROBOT.lower, ROBOT.upper)
        reference = control.step()
        assert control.status.solver == "solved"
        assert (reference.position <= ROBOT.upper - MARGIN + TINY).all()
        assert (reference.position >= ROBOT.lower + MARGIN - TINY).all()
        assert (np.abs(reference.velocity) <= fastest + TINY).all()
        assert (np.abs(reference.acceleration) <= ACCELERATION + TINY).all()
        hardest = np.maximum(hardest, np.abs(reference.acceleration - before) / (JERK * DT))
        before = reference.acceleration
    assert (hardest > 1.5).all()  # relaxed by every joint


def test_a_jerk_limit_that_was_relaxed_is_named() -> None:
    model, hand = RobotModel(ROBOT), ROBOT.joint_index("LHand")
    box, column = AccelerationBox(ROBOT, WITH_JERK, model, DT), model.joint_columns[hand]
    q, v, before = model.configuration(MIDDLE), np.zeros(20), np.zeros(20)
    box.update(q, v, before)
    assert box.relaxed() == ()
    # As fast as it may be, and speeding up until now: nothing but to stop that at once.
    v[column], before[column] = VELOCITY[hand], ACCELERATION[hand]
    box.update(q, v, before)
    assert box.relaxed() == box.relaxed(box.upper) == ("LHand jerk",)
    v[column], before[column] = -VELOCITY[hand], -ACCELERATION[hand]
    box.update(q, v, before)
    assert box.relaxed() == ("LHand jerk",)


def test_without_jerk_limit_those_are_named_that_would_have_broken_it() -> None:
    model, hand = RobotModel(ROBOT), ROBOT.joint_index("LHand")
    box, column = AccelerationBox(ROBOT, WITH_JERK, model, DT), model.joint_columns[hand]
    box.update(model.configuration(MIDDLE), np.zeros(20), np.zeros(20), jerk=False)
    assert box.relaxed() == ()  # every joint could keep it
    a = np.zeros(20)
    a[column] = 0.999 * JERK[hand] * DT
    assert box.relaxed(a) == ()
    for sign in (-1, 1):
        a[column] = sign * 1.001 * JERK[hand] * DT
        assert box.relaxed(a) == ("LHand jerk",)
    plain = AccelerationBox(ROBOT, SETTINGS, model, DT)
    plain.update(model.configuration(MIDDLE), np.zeros(20), np.zeros(20))
    assert plain.relaxed(a) == ()


def test_the_controller_names_joints_that_brake_at_their_position_limit() -> None:
    control = WholeBodyController(ROBOT, WITH_JERK)
    control.posture.stiffness = 1000.0
    control.posture.target = ROBOT.upper
    named: set[str] = set()
    for _ in range(400):
        control.step()
        named.update(control.status.relaxed)
    assert named == {f"{name} jerk" for name in ROBOT.joint_names}
