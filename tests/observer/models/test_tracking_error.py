"""The plant's tracking error against Eq. 10 and Eq. 11 of the paper in closed form, with the plant's true parameters.

The boards are bare PD laws here: an integral part would take the error of a held load away.
"""

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.backends.mujoco_.simulation import Simulation
from pepper_driver.config import PlantConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.models.closed_form import (
    MotorParameters,
    expected_error,
    external_torque,
)
from support.plant import (
    ONE,
    ROBOT,
    STAND,
    Bench,
    friction,
    hold,
    plain,
    push,
    standing,
    with_drive,
)

CYCLE = ROBOT.cycle
ROLL = ROBOT.joint_index("LShoulderRoll")
ONE_WAY = {"KneePitch": (1, 0, 0), "HipRoll": (0, 1, 0), "LShoulderRoll": (0, 1, 0)}
"""Direction of a push that turns a joint, in world axes, in the posture Stand."""
PUSHED = {"KneePitch": ("torso", 25.0), "HipRoll": ("torso", 25.0), "LShoulderRoll": ("LBicep", 15)}
"""Link and force [N]."""


def truth_of(plant: PlantConfig, joint: str) -> MotorParameters:
    drive, motor = plant.actuator(joint), ROBOT.motors.of(joint)
    rough = drive.friction.contact
    return MotorParameters(
        resistance=motor.resistance,
        torque_constant=motor.torque_constant,
        speed_constant=motor.torque_constant,
        rotor_inertia=motor.rotor_inertia,
        motor_damping=drive.motor_damping,
        ratio=ROBOT.motors.joints[joint].ratio,
        proportional_gain=drive.kp,
        derivative_gain=drive.kd,
        coulomb_friction=rough.motor + rough.link,
        viscous_friction=rough.motor_viscous + rough.link_viscous,
    )


def load(simulation: Simulation, joint: str) -> float:
    """[N m] of the applied forces on one joint."""
    index = ROBOT.joint_index(joint)
    return float(simulation.data.qfrc_applied[simulation.model.link_dof[index]])


def pushed(simulation: Simulation, joint: str, fraction: float) -> Simulation:
    link, force = PUSHED[joint]
    body = simulation.model.bodies[link]
    point = simulation.data.xpos[body] + [0.0, 0.0, 0.2 if link == "torso" else 0.0]
    if link != "torso":
        point = simulation.data.xipos[body].copy()
    push(simulation, link, fraction * force * np.array(ONE_WAY[joint], dtype=np.float64), point)
    hold(simulation, 150)
    return simulation


@pytest.mark.parametrize("joint", list(PUSHED))
def test_a_held_load_bends_the_joint_by_torque_over_stiffness(joint: str) -> None:
    """Eq. 10 at rest: eps = -tau_ext / K, within the band that friction can hold."""
    plant = plain()
    index, parameters = ROBOT.joint_index(joint), truth_of(plain(), joint)
    band = parameters.coulomb_friction / parameters.stiffness
    drive = plant.actuator(joint)
    simulation = standing(plant, settle=100)
    simulation.model.mj.opt.gravity[:] = 0.0
    for fraction in (1.0, -1.0):
        pushed(simulation, joint, fraction)
        torque = load(simulation, joint)
        error = STAND[index] - simulation.position[index]
        wind_up = abs(torque) / drive.gear_stiffness + drive.half_gap
        assert abs(torque) > 0.5
        assert error == pytest.approx(-torque / parameters.stiffness, abs=band + wind_up)


@pytest.mark.parametrize("joint", list(PUSHED))
def test_without_friction_torque_over_stiffness_is_exact(joint: str) -> None:
    """The encoder is on the link: the gear's give is part of what the board corrects."""
    smooth = plain(friction=friction(viscous=(0.0, 0.5)), half_gap=0.0)
    index, parameters = ROBOT.joint_index(joint), truth_of(smooth, joint)
    simulation = standing(smooth, settle=50)
    simulation.model.mj.opt.gravity[:] = 0.0
    pushed(simulation, joint, 1.0)
    hold(simulation, 300)
    torque = load(simulation, joint)
    error = STAND[index] - simulation.position[index]
    count = 2 * np.pi / 2**smooth.board.encoder_bits
    assert error == pytest.approx(-torque / parameters.stiffness, rel=0.01, abs=count)
    # and Eq. 10 finds the torque from the error
    still = np.zeros((5, 3))
    found = external_torque(parameters, np.full(5, error), still, CYCLE)
    np.testing.assert_allclose(found, torque, rtol=0.01, atol=count * parameters.stiffness)


def swing(joint: str, plant: PlantConfig, seconds: float) -> tuple[FloatArray, FloatArray]:
    """(n,) true tracking error and (n, 3) desired velocity, acceleration, load of one joint without gravity."""
    others = [name for name in ROBOT.joint_names if name != joint]
    stuck = with_drive(plant, others, friction=friction(1e4, 1e4))
    simulation = standing(stuck)
    simulation.model.mj.opt.gravity[:] = 0.0
    bench, index = Bench(plant, joint), ROBOT.joint_index(joint)
    inertia = bench.inertia(bench.link)
    size, rate = np.copysign(0.4, ROBOT.lower[index] + ROBOT.upper[index] - 2 * STAND[index]), np.pi
    errors, features = [], []
    for n in range(1, round(seconds / CYCLE) + 1):
        time = n * CYCLE
        target = STAND.copy()
        target[index] += size * (1 - np.cos(rate * time))
        simulation.cycle(target, ONE, np.zeros(3), np.ones(3))
        acceleration = size * rate**2 * np.cos(rate * time)
        errors.append(target[index] - simulation.position[index])
        features.append((size * rate * np.sin(rate * time), acceleration, inertia * acceleration))
    return np.array(errors), np.array(features)


@pytest.mark.parametrize("joint", ["HeadYaw", "LElbowYaw", "LShoulderPitch"])
def test_free_motion_lags_as_the_closed_form_says(joint: str) -> None:
    """Eq. 11 with the derivative term, the lag of the motor, Coulomb and viscous friction of both sides."""
    plant = plain()
    parameters = replace(truth_of(plant, joint), friction_velocity=0.02)
    errors, features = swing(joint, plant, 4.0)
    expected = expected_error(parameters, features, CYCLE)
    late, moving = slice(round(1.0 / CYCLE), None), np.abs(features[:, 0]) > 0.3
    moving[: late.start] = False
    wrong = errors[moving] - expected[moving]
    assert np.sqrt(np.mean(wrong**2)) < 0.1 * np.sqrt(np.mean(expected[moving] ** 2))
