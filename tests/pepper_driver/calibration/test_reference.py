"""The plant's step is fine enough, and the metric that says so means something."""

from dataclasses import replace

import numpy as np
import pytest

import pepper_driver.calibration.testbench as reference
from pepper_driver.backends.mujoco_.motors import JointFriction
from pepper_driver.config import load_plant
from support.plant import ROBOT, plain, stepping

PLANT = load_plant("nominal", ROBOT)


def test_the_shipped_step_is_fine_enough() -> None:
    """Half a milliradian: a third of a count of the encoder."""
    assert reference.integration_error(ROBOT, PLANT) < 0.5e-3


def test_the_error_falls_with_the_step() -> None:
    errors = [
        reference.integration_error(ROBOT, stepping(plain(), step), seconds=1.0, fine_step=1e-4)
        for step in (0.002, 0.0005)
    ]
    assert errors[1] < 0.6 * errors[0]
    assert errors[1] > 1e-6


def test_a_plant_as_fine_as_the_reference_has_no_error() -> None:
    assert (
        reference.integration_error(ROBOT, PLANT, seconds=0.2, fine_step=PLANT.physics.timestep)
        == 0.0
    )


def test_all_joints_move_as_in_normal_use_and_turn_round() -> None:
    times = np.arange(0.0, 2.0, 0.001)
    path = np.array([reference._swing(ROBOT, float(time)) for time in times])
    speed = np.diff(path, axis=0) / 0.001
    fastest = np.array([joint.velocity for joint in ROBOT.joints])
    assert (np.abs(speed).max(axis=0) > 0.05 * fastest).all()
    assert (np.abs(speed).max(axis=0) < 0.3 * fastest).all()
    assert (path > ROBOT.lower).all()
    assert (path < ROBOT.upper).all()
    assert ((speed.min(axis=0) < 0) & (speed.max(axis=0) > 0)).all()
    np.testing.assert_allclose(speed[0], 0.0, atol=0.05)


def test_an_error_of_the_integration_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Friction that is set late, once in a while, as if once a cycle."""
    update, calls = JointFriction.update, [0]

    def seldom(self: JointFriction) -> None:
        calls[0] += 1
        if calls[0] % 12 == 1:
            update(self)

    good = reference.integration_error(ROBOT, PLANT, seconds=0.5, fine_step=2.5e-4)
    monkeypatch.setattr(JointFriction, "update", seldom)
    assert reference.integration_error(ROBOT, PLANT, seconds=0.5, fine_step=2.5e-4) > 1.5 * good


def test_the_base_does_not_matter() -> None:
    errors = [
        reference.integration_error(ROBOT, replace(PLANT, base=base), seconds=0.1, fine_step=5e-4)
        for base in ("fixed", "rolling")
    ]
    assert errors[0] == errors[1] > 0


def test_a_reference_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="fine_step"):
        reference.integration_error(ROBOT, PLANT, fine_step=3e-4)
    with pytest.raises(ValueError, match="fine_step"):
        reference.integration_error(ROBOT, PLANT, fine_step=0.01)
