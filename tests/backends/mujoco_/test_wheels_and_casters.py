"""The base on its wheels: it drives as wheels.yaml says, grips as Coulomb does, and rolls when it is not driven."""

import mujoco
import numpy as np
import pytest

from pepper_driver.backends.mujoco_.simulation import Simulation
from pepper_driver.config.arrays import FloatArray
from support.plant import (
    BASE,
    ROBOT,
    STAND,
    balance,
    hold,
    push,
    rolling,
    standing,
    twist,
    wheel_loads,
)

ROWS = ROBOT.wheels.matrix
RADIUS = ROBOT.wheels.radius
LOW = 0.1
"""[m] height of pushes that do not tip."""
DIRECTIONS = np.radians([0, 45, 90, 180, 250])


def slip(simulation: Simulation) -> FloatArray:
    """(3,) speed of the wheels' rims over the floor [m/s]."""
    return np.asarray(RADIUS * (simulation.wheels.speed - ROWS @ twist(simulation)))


def towards(angle: float) -> FloatArray:
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def push_low(simulation: Simulation, force: FloatArray) -> None:
    """At the centre of mass, as seen from above."""
    _, com = balance(simulation)
    push(simulation, "Tibia", force, np.array([com[0], com[1], LOW]))


def grip_limit(simulation: Simulation, direction: FloatArray, friction: float) -> float:
    """[N] of a push at LOW at which the first blocked wheel slides: three wheels, three unknown forces, one answer."""
    weight, com = balance(simulation)
    arm = com[0] * direction[1] - com[1] * direction[0]
    wheel_torque = np.linalg.solve(ROWS.T, np.array([direction[0], direction[1], arm]))
    low, high = 0.0, weight * friction * 2
    for _ in range(50):
        force = (low + high) / 2
        loads = wheel_loads(weight, com, force * direction, LOW)
        holds = (np.abs(force * wheel_torque) <= friction * RADIUS * loads).all()
        low, high = (force, high) if holds else (low, force)
    return low


def test_wheels_carry_the_weight_where_it_stands() -> None:
    simulation = standing(rolling(), settle=80)
    weight, com = balance(simulation)
    np.testing.assert_allclose(
        simulation.wheels.load, wheel_loads(weight, com, np.zeros(3), 0.0), rtol=0.01
    )


@pytest.mark.parametrize(
    "requested", [(0.3, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, -0.8), (0.15, -0.1, 0.5)]
)
def test_drives_as_requested(requested: tuple[float, float, float]) -> None:
    simulation = standing(rolling(), settle=10)
    command = ROWS @ requested
    assert np.abs(command).max() < ROBOT.wheels.speed_limit
    hold(simulation, 120, wheels=command)
    seen, measured = [], []
    for _ in range(80):
        hold(simulation, 1, wheels=command)
        seen.append(twist(simulation))
        measured.append(simulation.wheels.speed)
    np.testing.assert_allclose(np.mean(seen, axis=0), requested, atol=0.005)
    np.testing.assert_allclose(np.mean(measured, axis=0), command, atol=0.02)
    np.testing.assert_allclose(measured, seen @ ROWS.T, atol=0.02)


def test_the_wheels_agree_with_where_the_robot_went() -> None:
    """Odometry over a curve, heading and all."""
    simulation = standing(rolling(), settle=10)
    pose, inverse = np.zeros(3), np.linalg.inv(ROWS)
    start = simulation.data.qpos[[0, 1, 3]].copy()
    for tick in range(250):
        requested, before = np.array([0.25, 0.1 * np.sin(tick / 40), 0.7]), simulation.wheels.speed
        hold(simulation, 1, wheels=ROWS @ requested)
        mean = (before + simulation.wheels.speed) / 2
        forward, left, turn = inverse @ mean * ROBOT.cycle
        heading = pose[2] + turn / 2
        pose += [
            forward * np.cos(heading) - left * np.sin(heading),
            forward * np.sin(heading) + left * np.cos(heading),
            turn,
        ]
    went = simulation.data.qpos[[0, 1, 3]] - start
    assert went[2] > 1.5
    np.testing.assert_allclose(pose, went, atol=0.01)


@pytest.mark.parametrize("friction", [0.2, 0.6])
@pytest.mark.parametrize("angle", DIRECTIONS)
def test_blocked_wheels_slide_at_the_limit_of_coulomb(angle: float, friction: float) -> None:
    simulation = standing(rolling(floor_friction=friction, friction=100.0), settle=40)
    limit = grip_limit(simulation, towards(angle), friction)
    weight, _ = balance(simulation)
    assert 0.3 * friction * weight < limit < 1.2 * friction * weight
    push_low(simulation, 0.93 * limit * towards(angle))
    hold(simulation, 120)
    before = simulation.data.qpos[BASE].copy()
    hold(simulation, 80)
    assert np.abs(simulation.data.qpos[BASE] - before).max() < 1e-4, "held means no creeping"
    assert np.abs(slip(simulation)).max() < 1e-3
    push_low(simulation, 1.07 * limit * towards(angle))
    hold(simulation, 80)
    assert np.abs(slip(simulation)).max() > 0.02


def test_powered_wheels_hold_a_push_and_stay() -> None:
    simulation = standing(rolling(), settle=40)
    start = simulation.data.qpos[BASE].copy()
    push_low(simulation, 40.0 * towards(0.0))
    hold(simulation, 250)
    before = simulation.data.qpos[BASE].copy()
    hold(simulation, 80)
    assert np.abs(simulation.data.qpos[BASE] - before).max() < 2e-4
    assert np.hypot(*(before - start)[:2]) < 0.05


def test_on_ice_the_wheels_spin() -> None:
    requested = np.array([0.35, 0.0, 0.0])
    speeds = []
    for friction in (0.8, 0.005):
        simulation = standing(rolling(floor_friction=friction), settle=40)
        hold(simulation, 120, wheels=ROWS @ requested)
        speeds.append(twist(simulation)[0])
        turning = simulation.wheels.speed
    assert speeds[0] == pytest.approx(0.35, rel=0.05)
    assert speeds[1] < 0.2
    assert np.abs(turning[:2]).min() > 0.9 * np.abs(ROWS @ requested)[:2].min()


@pytest.mark.parametrize("angle", [0.0, 2.0])
def test_unpowered_wheels_roll(angle: float) -> None:
    """A = F / (m + wheels), closed form: the wheels turn with the base."""
    simulation = standing(rolling(friction=0.0), settle=40)
    model = simulation.model.mj
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, simulation.data, mass)
    wheel = model.joint("WheelFL").dofadr[0]
    planar = [0, 1, 3]
    whole = mass[np.ix_(planar, planar)] + mass[wheel, wheel] * ROWS.T @ ROWS
    _, com = balance(simulation)
    force = 10.0 * towards(angle)
    expected = np.linalg.solve(
        whole, np.array([force[0], force[1], com[0] * force[1] - com[1] * force[0]])
    )
    push_low(simulation, force)
    seconds = 40 * ROBOT.cycle
    hold(simulation, 40, powered=False)
    speed = simulation.data.qvel[planar]
    np.testing.assert_allclose(speed[:2] / seconds, expected[:2], rtol=0.06, atol=0.01)
    assert np.abs(slip(simulation)).max() < 1e-3


def test_the_friction_of_unpowered_wheels_holds_a_weak_push() -> None:
    simulation = standing(rolling(friction=0.5), settle=40)
    hold(simulation, 20, powered=False)
    before = simulation.data.qpos[BASE].copy()
    push_low(simulation, 0.8 * 2 * np.abs(ROWS[0, 0]) * 0.5 * towards(0.0))
    hold(simulation, 150, powered=False)
    assert np.abs(simulation.data.qpos[BASE] - before).max() < 1e-3


def test_wheels_keep_their_speed_limit() -> None:
    simulation = standing(rolling(), settle=5)
    hold(simulation, 300, wheels=np.full(3, 100.0))
    np.testing.assert_allclose(simulation.wheels.speed, ROBOT.wheels.speed_limit, rtol=1e-2)


@pytest.mark.parametrize("fraction", [0.0, 0.25, 1.0])
def test_stiffness_is_the_fraction_of_its_torque_that_a_wheel_may_use(fraction: float) -> None:
    simulation = standing(rolling(), settle=5)
    simulation.cycle(STAND, np.ones(17), np.full(3, 100.0), np.full(3, fraction))
    torque = simulation.data.actuator_force[
        [simulation.model.mj.actuator(name).id for name in ROBOT.wheels.names]
    ]
    limit = rolling().wheels.torque_limit
    np.testing.assert_allclose(torque, fraction * limit, atol=1e-9)


def test_a_wheel_that_gets_stiffness_again_starts_without_a_past() -> None:
    """Else what its speed control added up while blocked would throw it."""
    simulation = standing(rolling(), settle=5)
    still, stiff = np.zeros(3), np.ones(3)
    one_off = np.array([0.0, 1.0, 1.0])
    for _ in range(50):
        simulation.cycle(STAND, np.ones(17), np.full(3, 0.5), stiff)
    simulation.cycle(STAND, np.ones(17), still, one_off)
    integral = simulation.wheels.wheels["integral"]
    assert integral[0] == 0.0
    assert (integral[1:] != 0.0).all()
    simulation.cycle(STAND, np.ones(17), still, 0.5 * one_off)
    assert (integral[1:] != 0.0).all(), "less stiffness, same past"
