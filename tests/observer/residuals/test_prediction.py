"""Predictions around the stick-slip model: friction band, integral of a board, models at rest, late samples."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import make_records
from pepper_driver.observer.constants import CORRECTION_TIME, REST_SPEED
from pepper_driver.observer.models.stick_slip import StickSlipState
from pepper_driver.observer.residuals.joint_tick import JointCommand
from pepper_driver.observer.residuals.prediction import (
    MAX_LATE_TICKS,
    ErrorPredictor,
    PredictedJoint,
    friction_band,
    rest,
    update_integral,
)
from support.fusion import MODEL, STICK_SLIP, VOLTAGE, fusion_model
from support.observer import CYCLE

SUMS = fusion_model(replace(STICK_SLIP, integral_rate=2.0))
"""Model of a joint whose board sums errors up."""

PACE = CYCLE / CORRECTION_TIME
TIME_CONSTANT = round(CORRECTION_TIME / CYCLE)


def stepped(
    predictor: ErrorPredictor,
    *,
    target: float = 0.0,
    load: float = 0.0,
    velocity: float | FloatArray = 0.0,
    measured: float = 0.0,
) -> None:
    """Step all joints alike."""
    n = len(predictor.joints)
    command = make_records(JointCommand, n, target=target, load_torque=load, velocity=velocity)
    predictor.step(command, np.full(n, measured))


def target(predictor: ErrorPredictor, late: int) -> float:
    """Target of the first joint in the prediction for a sample that is so many ticks late."""
    return float(predictor.before(late).command["target"][0])


# -- friction band ----------------------------------------------------------------------------------------------------


def test_friction_holds_a_joint_between_motion_one_way_and_breaking_away_the_other() -> None:
    """0.008 rad in motion and 1.3 times that at rest; 0.02 of the load, 3 N m at 100 N m/rad, add to it."""
    joints = ErrorPredictor([MODEL], CYCLE).joints
    assert friction_band(joints, 0, 0.0, False) == pytest.approx(2.3 * 0.008)
    for load in (3.0, -3.0):
        band = friction_band(joints, 0, load, False)
        assert band == pytest.approx(2.3 * (0.008 + 0.02 * 0.03))


def test_friction_holds_no_joint_that_is_to_move() -> None:
    joints = ErrorPredictor([MODEL], CYCLE).joints
    assert friction_band(joints, 0, 3.0, True) == 0.0


# -- models at rest ---------------------------------------------------------------------------------------------------


def test_a_model_at_rest_follows_its_joint_with_the_time_of_correction() -> None:
    """So does the integral of a board that sums errors up."""
    joints = make_records(PredictedJoint, 2, integrates=[True, False], board_integral=0.3)
    states = make_records(StickSlipState, 2, position=0.02, integral=0.1)
    for _ in range(TIME_CONSTANT):
        for j in range(2):
            rest(joints, states, j, float(states["position"][j]) - 0.01, PACE)
    left = math.exp(-1.0)
    np.testing.assert_allclose(states["position"], 0.01 + 0.01 * left, rtol=5e-3)
    np.testing.assert_allclose(states["integral"], [0.3 - 0.2 * left, 0.1], rtol=5e-3)


def test_a_model_that_slides_follows_nothing() -> None:
    joints = make_records(PredictedJoint, 1, integrates=True, board_integral=0.3)
    states = make_records(StickSlipState, 1, velocity=1e-9)
    rest(joints, states, 0, 0.01, PACE)
    assert (states["position"][0], states["integral"][0]) == (0.0, 0.0)


# -- integral of a board ----------------------------------------------------------------------------------------------


def test_an_integral_sums_errors_up() -> None:
    """0.01 rad at 2 / s, where the current bears it out: the motor gives error and sum."""
    joints = make_records(PredictedJoint, 1, integrates=True, integral_rate=2.0)
    for k in range(100):
        before = float(joints["board_integral"][0])
        update_integral(joints, 0, 0.01, 0.01 + before + 2.0 * CYCLE * 0.01, CYCLE)
        assert joints["board_integral"][0] == pytest.approx(2.0 * CYCLE * 0.01 * (k + 1))


def test_a_wrong_integral_goes_to_that_of_the_current_with_the_time_of_correction() -> None:
    joints = make_records(PredictedJoint, 1, integrates=True, integral_rate=2.0)
    for _ in range(TIME_CONSTANT):
        update_integral(joints, 0, 0.0, 0.05, CYCLE)
    assert joints["board_integral"][0] == pytest.approx(0.05 * (1.0 - math.exp(-1.0)), rel=5e-3)


def test_boards_without_sums_and_those_that_no_current_shows_have_no_integral() -> None:
    unseen = replace(SUMS, momentum=VOLTAGE)
    predictor = ErrorPredictor([SUMS, MODEL, unseen, None], CYCLE)
    np.testing.assert_array_equal(predictor.integrates, [True, False, False, False])
    for j in range(4):
        update_integral(predictor.joints, j, 0.01, 0.5, CYCLE)
    summed = predictor.joints["board_integral"]
    assert summed[0] > 0.0
    np.testing.assert_array_equal(summed[1:], 0.0)


def test_the_integral_of_a_board_at_rest_carries_what_its_error_does_not() -> None:
    """A load of 3 N m takes 0.03 rad, of which the error has 0.01."""
    predictor = ErrorPredictor([SUMS, MODEL], CYCLE)
    stepped(predictor, target=0.5, load=3.0, measured=0.49)
    np.testing.assert_allclose(predictor.joints["board_integral"], [0.02, 0.0], atol=1e-12)
    # So the model rests where the joint does.
    assert predictor.states["position"][0] == pytest.approx(0.49, abs=1e-12)


# -- samples ----------------------------------------------------------------------------------------------------------


def test_a_late_sample_is_compared_with_the_prediction_of_its_time() -> None:
    predictor = ErrorPredictor([MODEL], CYCLE)
    for k in range(3):
        stepped(predictor, target=0.001 * k)
    assert [target(predictor, late) for late in range(5)] == [0.002, 0.001, 0.0, 0.0, 0.0]
    for k in range(3, 10):
        stepped(predictor, target=0.001 * k)
    oldest = target(predictor, MAX_LATE_TICKS)
    assert oldest == pytest.approx(0.001 * (9 - MAX_LATE_TICKS))
    assert target(predictor, 100) == oldest


def test_a_model_that_is_put_somewhere_moves_as_it_is_to_move_or_rests() -> None:
    """A desired speed up to REST_SPEED may be one that friction holds."""
    velocity = np.array([0.5, -0.5, 0.9 * REST_SPEED, 0.0, 0.5])
    predictor = ErrorPredictor([SUMS] * 5, CYCLE)
    stepped(predictor, velocity=velocity)
    predictor.joints["board_integral"] = 0.04
    where = np.array([True, True, True, True, False])
    predictor.put(where, np.full(5, 0.3))
    states = predictor.states
    np.testing.assert_array_equal(states["velocity"], [0.5, -0.5, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(states["sticks"], [False, False, True, True, True])
    np.testing.assert_array_equal(states["position"], [0.3, 0.3, 0.3, 0.3, 0.0])
    np.testing.assert_array_equal(states["integral"], [0.04, 0.04, 0.04, 0.04, 0.0])


def test_reset_forgets_the_past() -> None:
    predictor = ErrorPredictor([SUMS], CYCLE)
    assert predictor.position is None
    stepped(predictor, target=0.5, load=3.0, measured=0.4)
    assert predictor.position is not None
    predictor.reset()
    assert predictor.position is None
    assert predictor.joints["board_integral"][0] == 0.0
    stepped(predictor, target=0.2, measured=0.2)
    assert target(predictor, 3) == 0.2
    assert predictor.states["position"][0] == pytest.approx(0.2)
