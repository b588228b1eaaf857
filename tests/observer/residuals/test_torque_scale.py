"""Scale of torques: by a known weight, by documented constants, and how far each is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config import load_robot
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.measured_robot import MeasuredJoint, MeasuredRobot
from pepper_driver.observer.residuals.torque_scale import (
    ASSUMED_STD,
    GEAR_EFFICIENCY,
    LOAD_STD,
    WEIGHED_STD,
    TorqueScale,
)
from support.fusion import MODEL, STICK_SLIP, fusion_model
from support.observer import measured

ROBOT = load_robot()
N = len(ROBOT.joint_names)
ELBOW = ROBOT.joint_index("LElbowRoll")
CONSTANT = ROBOT.motors.joint_torque_constant("LElbowRoll")


def with_stiffness(true: float, efficiency: float, mass: float) -> FusionModel:
    """Model that identification finds of a joint: K from ``mass`` times the documented loads, ampere from the gear."""
    momentum = replace(MODEL.momentum, torque_per_ampere=efficiency * CONSTANT / true)
    model: FusionModel = fusion_model(replace(STICK_SLIP, load_gain=mass / true), momentum=momentum)
    return model


def of_elbow(model: FusionModel | None, facts: MeasuredRobot | None = None) -> TorqueScale:
    models: list[FusionModel | None] = [None] * N
    models[ELBOW] = model
    return TorqueScale.from_models(models, ROBOT, facts)


def test_a_weight_shows_the_stiffness_whatever_gear_and_masses_are() -> None:
    model = with_stiffness(83.0, efficiency=0.66, mass=1.5)
    found = of_elbow(model, measured(LElbowRoll=MeasuredJoint(torque_scale=1.0 / 0.66)))
    assert found.stiffness[ELBOW] == pytest.approx(83.0)
    assert (found.known[ELBOW], found.std[ELBOW]) == (True, WEIGHED_STD)


def test_without_a_weight_both_assumptions_count_and_the_scale_is_unknown() -> None:
    model = with_stiffness(80.0, efficiency=GEAR_EFFICIENCY, mass=1.0)
    for facts in (None, measured(), measured(LElbowRoll=MeasuredJoint(load_scale=1.3))):
        found = of_elbow(model, facts)
        assert found.stiffness[ELBOW] == pytest.approx(80.0)
        assert (found.known[ELBOW], found.std[ELBOW]) == (False, ASSUMED_STD)


@pytest.mark.parametrize(("efficiency", "mass"), [(0.34, 1.0), (1.0, 1.0), (0.8, 1.6), (0.8, 2.2)])
def test_the_truth_is_within_two_deviations_where_one_assumption_is_wrong(
    efficiency: float, mass: float
) -> None:
    """As on recorded robots: gears lose more, or arms are heavier; no run without a weight shows which."""
    found = of_elbow(with_stiffness(80.0, efficiency, mass))
    assert abs(np.log(found.stiffness[ELBOW] / 80.0)) < 2.0 * found.std[ELBOW]
    differ = abs(np.log(mass * GEAR_EFFICIENCY / efficiency))
    assert found.std[ELBOW] == pytest.approx(max(ASSUMED_STD, 0.5 * differ))


def test_a_joint_whose_current_shows_nothing_has_the_scale_of_its_load() -> None:
    momentum = replace(MODEL.momentum, source="voltage", torque_per_ampere=0.0)
    facts = measured(LElbowRoll=MeasuredJoint(torque_scale=1.2))
    found = of_elbow(fusion_model(momentum=momentum), facts)
    assert found.stiffness[ELBOW] == pytest.approx(1.0 / STICK_SLIP.load_gain)
    assert (found.known[ELBOW], found.by_current[ELBOW]) == (False, False)
    assert found.std[ELBOW] == LOAD_STD


def test_a_joint_without_a_model_has_no_scale() -> None:
    found = of_elbow(None)
    assert np.isnan(found.stiffness).all()
    assert np.isnan(found.std).all()
    assert not found.known.any()
    assert not found.by_current.any()
