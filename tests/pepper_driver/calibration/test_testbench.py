"""The test bench against what a PD board with Coulomb friction must show, in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.calibration.testbench import (
    hold_errors,
    opposite,
    ramp_command,
    ramp_errors,
    real_time_factor,
)
from pepper_driver.config import RampProtocol
from pepper_driver.config.steps import Holds
from support.plant import ROBOT, N, plain

RAMP = RampProtocol(
    arrival=0.2, arrival_time=0.3, onwards=False, wait=0.3, time=0.6, travel=1.0, skip=0.4
)
ARM = ("RShoulderPitch", "RElbowRoll")
HOLDS = Holds(joints=ARM, range=0.5, move=0.6, hold=0.6, count=3)
CONSTANT = 118.1 * 0.0192  # [N m/A] of shoulder roll and elbow roll
RESISTANCE = 5.293


@pytest.mark.parametrize("joint", ["LShoulderRoll", "RElbowRoll"])
def test_ramps_show_lag_friction_load_and_transport(joint: str) -> None:
    """Eq. 11 at constant velocity: (((N Kt)^2 / R + b) v + tau + F sign v) / K, and 2 ticks late."""
    plant = plain()
    plant = replace(plant, transport=replace(plant.transport, command_delay=1, sensor_delay=1))
    drive = plant.actuator(joint)
    contact = drive.friction.contact
    stiffness = drive.kp * CONSTANT / RESISTANCE
    viscous = contact.motor_viscous + contact.link_viscous + drive.motor_damping * 118.1**2
    v, tau = np.array([-0.5, 0.3]), np.array([[0.0], [1.2]])
    pull = (CONSTANT**2 / RESISTANCE + viscous) * v + tau
    friction = (contact.motor + contact.link) * np.sign(v)
    expected = 2 * ROBOT.cycle * v + (pull + friction) / stiffness
    found = ramp_errors(ROBOT, plant, joint, list(v), [0.0, 1.2], RAMP, workers=1)
    assert found.shape == (2, 2)
    # The board's own encoder counts are 0.022 deg; teeth take their side only on average.
    np.testing.assert_allclose(np.degrees(found), np.degrees(expected), atol=0.03)


def test_both_arms_show_the_same() -> None:
    reported: list[tuple[int, int]] = []
    found = ramp_errors(
        ROBOT,
        plain(),
        "LShoulderRoll",
        [0.4, 0.4],
        [0.6],
        RAMP,
        workers=1,
        progress=lambda done, of: reported.append((done, of)),
    )
    assert found[0, 0] == pytest.approx(found[0, 1], abs=np.radians(0.01))
    assert reported == [(1, 1)]


@pytest.mark.parametrize("onwards", [True, False])
@pytest.mark.parametrize("velocity", [-0.5, 1.25])
def test_a_ramp_arrives_waits_and_runs(onwards: bool, velocity: float) -> None:
    index = ROBOT.joint_index("RElbowRoll")
    command = ramp_command(ROBOT, index, velocity, replace(RAMP, onwards=onwards))
    assert ROBOT.lower[index] <= command.min() < command.max() <= ROBOT.upper[index]
    start = 1 + round(RAMP.arrival_time / ROBOT.cycle) + round(RAMP.wait / ROBOT.cycle)
    arrived = command[start - round(RAMP.wait / ROBOT.cycle)]
    assert np.sign(arrived - command[0]) == (np.sign(velocity) if onwards else -np.sign(velocity))
    speeds = np.diff(command) / ROBOT.cycle
    np.testing.assert_allclose(speeds[start - 1 :], velocity)
    still = speeds[start - round(RAMP.wait / ROBOT.cycle) : start - 1]
    np.testing.assert_allclose(still, 0.0, atol=1e-12)


def test_holds_stick_within_friction_around_what_gravity_asks() -> None:
    plant = plain()
    held = hold_errors(ROBOT, plant, HOLDS, 3, workers=1)
    assert held.error.shape == held.current.shape == held.load.shape == (3, 2)
    assert np.abs(held.load[:, 0]).max() > 0.3, "gravity pulls at the shoulder"
    for column, (joint, constant, resistance) in enumerate(
        [(ARM[0], 101.3 * 0.0275, 3.683), (ARM[1], CONSTANT, RESISTANCE)]
    ):
        drive = plant.actuator(joint)
        k = drive.kp * constant / resistance
        friction = drive.friction.contact.motor + drive.friction.contact.link
        stuck = k * held.error[:, column] - held.load[:, column]
        counts = k * ROBOT.sensors.encoder.step
        assert np.abs(stuck).max() < friction + counts
        motor = np.abs(k * held.error[:, column])
        np.testing.assert_allclose(held.current[:, column] * constant, motor, atol=1.2 * counts)


def test_equal_seeds_give_equal_holds() -> None:
    first, again, other = (hold_errors(ROBOT, plain(), HOLDS, s, workers=1) for s in (3, 3, 4))
    np.testing.assert_array_equal(first.error, again.error)
    np.testing.assert_array_equal(first.current, again.current)
    assert not np.array_equal(first.load, other.load)


def test_the_speed_of_the_simulation_is_a_factor() -> None:
    rolling = replace(plain(), base="rolling")
    assert 0.2 < real_time_factor(ROBOT, rolling, seconds=0.12, repeats=2) < 1000


def test_the_opposite_joint() -> None:
    assert opposite("LWristYaw") == "RWristYaw"
    assert len(ROBOT.joint_names) == N
