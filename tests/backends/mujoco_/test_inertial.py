"""The inertial unit against gravity, rotation and the motion of the base."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from pepper_driver.backends.mujoco_.sensors import InertialUnit
from pepper_driver.backends.mujoco_.simulation import Simulation
from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.parts import Frame
from support.plant import ROBOT, STAND, hold, plain, rolling, standing, twist

ROWS = ROBOT.wheels.matrix
GRAVITY = 9.81
WHOLE_TURN = 2 * np.pi


def unit_of(
    plant: PlantConfig, robot: RobotConfig = ROBOT, *, settle: int = 40
) -> tuple[Simulation, InertialUnit]:
    simulation = standing(plant, settle=settle)
    unit = InertialUnit(robot, simulation.model.mj, simulation.data)
    unit.reset()
    return simulation, unit


def mounted(xyz: tuple[float, float, float], rpy: tuple[float, float, float]) -> RobotConfig:
    frame = Frame(parent=ROBOT.sensors.imu.parent, xyz=xyz, rpy=rpy)
    return replace(ROBOT, sensors=replace(ROBOT.sensors, imu=frame))


def matrix(rpy: FloatArray) -> FloatArray:
    """(3, 3) rotation of roll, pitch, yaw as a URDF means them."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


@pytest.mark.parametrize("plant", [plain(), rolling()], ids=["fixed", "rolling"])
def test_at_rest_it_measures_gravity(plant: PlantConfig) -> None:
    simulation, unit = unit_of(plant, settle=80)
    hold(simulation, 1)
    unit.read()
    hold(simulation, 1)
    imu = unit.read()
    np.testing.assert_allclose(imu.acceleration, [0, 0, GRAVITY], atol=0.02)
    np.testing.assert_allclose(imu.angular_velocity, 0.0, atol=1e-3)
    np.testing.assert_allclose(imu.attitude, 0.0, atol=1e-3)


def test_a_unit_mounted_askew_measures_gravity_in_its_own_axes() -> None:
    rpy = (0.2, -0.3, 0.4)
    _, unit = unit_of(plain(), mounted((0.1, 0.0, 0.0), rpy))
    imu = unit.reset()
    np.testing.assert_allclose(imu.attitude, rpy, atol=1e-9)
    down = matrix(np.array(rpy)).T @ [0, 0, GRAVITY]
    np.testing.assert_allclose(imu.acceleration, down, atol=1e-9)


def test_attitude_is_roll_pitch_yaw_of_the_base() -> None:
    simulation, unit = unit_of(rolling())
    attitude = np.array([0.1, -0.2, 2.5])
    simulation.data.qpos[3:6] = attitude[::-1]  # yaw, pitch, roll
    mujoco.mj_kinematics(simulation.model.mj, simulation.data)
    imu = unit.reset()
    np.testing.assert_allclose(imu.attitude, attitude, atol=1e-9)
    down = matrix(attitude).T @ [0, 0, GRAVITY]
    np.testing.assert_allclose(imu.acceleration, down, atol=1e-9)
    assert imu.acceleration[1] > 0.5, "rolled to the right, the left side looks up"


def test_turning_shows_in_the_gyroscope_and_pulls_inwards() -> None:
    simulation, unit = unit_of(rolling(), mounted((0.3, 0.0, 0.0), (0.0, 0.0, 0.0)))
    turn = 0.8
    hold(simulation, 150, wheels=ROWS @ [0.0, 0.0, turn])
    unit.read()
    hold(simulation, 1, wheels=ROWS @ [0.0, 0.0, turn])
    imu = unit.read()
    np.testing.assert_allclose(imu.angular_velocity, [0, 0, turn], atol=0.02)
    np.testing.assert_allclose(
        imu.acceleration, [-(turn**2) * 0.3, 0.0, GRAVITY], atol=0.05 * turn**2 * 0.3 + 0.05
    )
    yaw = simulation.data.qpos[3]
    assert (imu.attitude[2] - yaw + np.pi) % WHOLE_TURN - np.pi == pytest.approx(0.0, abs=2e-3)


def test_the_gyroscope_reads_in_the_axes_of_the_unit() -> None:
    simulation, unit = unit_of(rolling(), mounted((0.0, 0.0, 0.0), (0.0, np.pi / 2, 0.0)))
    hold(simulation, 150, wheels=ROWS @ [0.0, 0.0, 0.8])
    np.testing.assert_allclose(unit.read().angular_velocity, [-0.8, 0.0, 0.0], atol=0.02)


@pytest.mark.parametrize("axis", [0, 1])
def test_acceleration_sums_up_to_the_speed(axis: int) -> None:
    simulation, unit = unit_of(rolling())
    gained = np.zeros(3)
    driven = np.zeros(3)
    for tick in range(160):
        driven[axis] = min(0.2, 0.25 * tick * ROBOT.cycle)
        hold(simulation, 1, wheels=ROWS @ driven)
        imu = unit.read()
        gained += ROBOT.cycle * (imu.acceleration - [0, 0, GRAVITY])
    assert twist(simulation)[axis] == pytest.approx(0.2, abs=0.02)
    np.testing.assert_allclose(gained[:2], twist(simulation)[:2], atol=0.02)


def test_a_fixed_base_measures_no_motion_of_the_arms() -> None:
    simulation, unit = unit_of(plain())
    hold(simulation, 20, STAND + 0.1)
    imu = unit.read()
    np.testing.assert_allclose(imu.acceleration, [0, 0, GRAVITY], atol=1e-9)
