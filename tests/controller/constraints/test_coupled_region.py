"""All of the coupled limits' region can be used: joints reach its edge, follow it, and do not slow down for nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.controller import WholeBodyController
from pepper_driver.controller.constraints import CoupledLimits
from support.controller import ACCELERATION, DT, JOINTS, MIDDLE, ROBOT, SETTINGS, VELOCITY
from support.coupled import DIGITS, MARGIN, PITCH, YAW, Velocity, coupled, room

TINY = 1e-9
HEAD = np.array(ROBOT.limits.coupled[0].table)


@pytest.mark.parametrize("velocity", ["safe", "robot"])
@pytest.mark.parametrize("yaw", [-2.0, -1.6, -1.59, -1.2, -1.075, -0.6, -0.57, 0.0, 0.9, 1.7])
@pytest.mark.parametrize("side", [0, 1])
def test_all_of_the_region_can_be_reached_and_joints_come_to_rest_at_its_edge(
    velocity: Velocity, yaw: float, side: int
) -> None:
    control = coupled(velocity=velocity)
    start = MIDDLE.copy()
    start[YAW] = yaw
    control.reset(start)
    target = start.copy()
    target[PITCH] = (ROBOT.lower, ROBOT.upper)[side][PITCH]
    weights = np.ones(JOINTS)
    weights[YAW] = 1e4  # else yaw moves instead
    control.posture.dim_weight = weights
    control.posture.target = target
    control.posture.stiffness = 400.0
    speeds = []
    for _ in range(150):
        reference = control.step()
        assert room(reference.position).min() > MARGIN - DIGITS
        speeds.append(reference.velocity[PITCH] * (1, -1)[1 - side])
    assert abs(reference.position[YAW] - yaw) < 0.01
    # A chord is at most half of the largest step too strict, of both joints.
    step = (ACCELERATION[PITCH] + 0.25 * ACCELERATION[YAW]) * DT**2 / 2
    at_edge = min(
        room(reference.position)[side], (target - reference.position)[PITCH] * (2 * side - 1)
    )
    assert at_edge < MARGIN + step + 1e-4
    assert np.abs(speeds[-20:]).max() < 1e-6
    assert min(speeds) > -0.05  # it does not swing back


@pytest.mark.parametrize("velocity", ["safe", "robot"])
def test_joints_pass_from_piece_to_piece_of_the_region(velocity: Velocity) -> None:
    """Pitch pressed at its limit while yaw goes from end to end: it follows the limit down and up again."""
    control = coupled(velocity=velocity)
    control.posture.stiffness = 50.0
    target = MIDDLE.copy()
    for pitch, ends in ((ROBOT.upper[PITCH], 2), (ROBOT.lower[PITCH], 1)):
        for yaw in (-2.0, 2.0, -2.0):
            target[[YAW, PITCH]] = yaw, pitch
            control.posture.target = target
            for _ in range(350):
                reference = control.step()
                assert control.status.solver == "solved"
                assert room(reference.position).min() > MARGIN - DIGITS
            assert reference.position[YAW] == pytest.approx(yaw, abs=0.02)
            edge = np.interp(yaw, HEAD[:, 0], HEAD[:, ends])
            assert reference.position[PITCH] == pytest.approx(edge, abs=MARGIN + 0.003)


@pytest.mark.parametrize("velocity", ["safe", "robot"])
@pytest.mark.parametrize("outward", [False, True])
@pytest.mark.parametrize("pitch", [0.21, 0.5])
def test_where_the_limit_turns_up_joints_need_not_give_way(
    velocity: Velocity, outward: bool, pitch: float
) -> None:
    """Past yaw of 1.6, where the limit is flat and pitch below it or, before that, pressed at it."""
    if outward and pitch > 0.3:
        return  # then pitch has to come down first
    ticks = []
    for free in (True, False):
        control = WholeBodyController(ROBOT, replace(SETTINGS, velocity=velocity))
        if not free:
            control.add(CoupledLimits(ROBOT, MARGIN))
        start, target = MIDDLE.copy(), MIDDLE.copy()
        start[YAW], target[YAW] = (0.5, 2.05) if outward else (2.05, 0.5)
        start[PITCH], target[PITCH] = 0.21, pitch
        control.reset(start)
        control.posture.target = target
        control.posture.stiffness = 400.0
        count = 0
        while abs(control.position[YAW] - target[YAW]) > 0.05:
            control.step()
            count += 1
            if abs(control.position[YAW] - 1.6) < 0.2:
                assert control.velocity[PITCH] > -1e-3
        ticks.append(count)
    assert ticks[0] == ticks[1]


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_driver_in_motion_does_not_stop_before_it_has_to(side: float) -> None:
    """Pitch at rest at 0.3: yaw stops where the limit comes down to that, from full speed and from either side."""
    control = coupled()
    start = MIDDLE.copy()
    start[YAW], start[PITCH] = -side * 1.0, 0.3
    control.reset(start)
    target = start.copy()
    target[YAW] = side * 2.0
    weights = np.ones(JOINTS)
    weights[PITCH] = 1e4
    control.posture.dim_weight = weights
    control.posture.target = target
    control.posture.stiffness = 400.0
    fastest = 0.0
    for _ in range(300):
        reference = control.step()
        fastest = max(fastest, side * reference.velocity[YAW])
    assert fastest > VELOCITY[YAW] - TINY
    half = len(HEAD) // 2
    meets = np.interp(-(0.3 + MARGIN), -HEAD[half:, 2], HEAD[half:, 0])
    assert reference.position[PITCH] == pytest.approx(0.3, abs=2e-3)
    assert side * reference.position[YAW] == pytest.approx(meets, abs=0.02)
    assert np.abs(reference.velocity).max() < 1e-6
