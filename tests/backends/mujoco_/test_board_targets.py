"""Targets of the boards: the limiter and its fast chases, wander, drift; each against its own law."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest, kstest

from pepper_driver.backends import Command
from pepper_driver.backends.mujoco_ import MujocoBackend
from pepper_driver.backends.mujoco_.targets import REST_SPEED, REST_TIME, BoardTargets
from pepper_driver.config import PlantConfig
from pepper_driver.config.arrays import FloatArray
from support.plant import INDEX, JOINT, ROBOT, STAND, N, plain, standing, with_drive

CYCLE, ONE, STEPS = ROBOT.cycle, np.ones(N), 12
FAST = ("LShoulderPitch", "LElbowYaw")
PITCH, YAW = (ROBOT.joint_index(name) for name in FAST)
ROLL = ROBOT.joint_index("LShoulderRoll")
REST = round(REST_TIME / CYCLE)


def targeting(**changes: Any) -> PlantConfig:
    plant = plain()
    return replace(plant, targets=replace(plant.targets, **changes))


def reset(plant: PlantConfig, seed: int = 0) -> BoardTargets:
    targets = BoardTargets(ROBOT, plant, STEPS)
    targets.reset(STAND, seed)
    return targets


def followed(targets: BoardTargets, position: FloatArray, cycles: int = 1) -> FloatArray:
    """(cycles, 17) what the boards follow at the end of each cycle [rad]."""
    rows = []
    for _ in range(cycles):
        targets.plan(position, ONE)
        rows.append(targets.now + STEPS * targets.increment)
    return np.array(rows)


def test_what_the_boards_follow_is_continuous() -> None:
    plant = targeting(speed_limit=2.0, fast_chases=0.5, fast_joints=FAST)
    targets = reset(
        replace(
            plant, actuators=tuple(replace(d, wander=0.01, strays=0.5) for d in plant.actuators)
        )
    )
    rng = np.random.default_rng(1)
    before = STAND
    for tick in range(600):
        if tick % 40 == 0:
            goal = STAND + rng.uniform(-0.5, 0.5, N)
        targets.plan(goal, ONE)
        np.testing.assert_allclose(targets.now, before, atol=1e-12)
        before = targets.now + STEPS * targets.increment


def chase_speeds(probability: float, chases: int) -> FloatArray:
    """(chases, 17) speed of the targets in the middle of each of some chases [rad/s]."""
    targets = reset(targeting(speed_limit=2.0, fast_chases=probability, fast_joints=FAST))
    speeds, far = [], STAND.copy()
    for number in range(chases):
        far[[PITCH, YAW, ROLL]] = STAND[[PITCH, YAW, ROLL]] + (1.0 if number % 2 else 0.0)
        rows = followed(targets, far, 60)
        speeds.append(np.abs(rows[6] - rows[5]) / CYCLE)
        np.testing.assert_allclose(rows[-1], far, atol=1e-12)
    return np.array(speeds[1:])


def test_some_whole_chases_are_twice_as_fast() -> None:
    """Both joints at once, at the given rate; a joint that takes no part is never fast."""
    speeds = chase_speeds(0.3, 500)
    np.testing.assert_allclose(speeds[:, ROLL], 2.0)
    fast = np.isclose(speeds[:, PITCH], 4.0)
    np.testing.assert_allclose(speeds[~fast, PITCH], 2.0)
    np.testing.assert_allclose(speeds[:, PITCH], speeds[:, YAW])
    assert binomtest(int(fast.sum()), len(fast), 0.3).pvalue > 1e-3


@pytest.mark.parametrize("speed", [2.5, 3.0, 5.0])
def test_a_command_that_outruns_the_limit_is_chased_fast_in_as_many_moves(speed: float) -> None:
    """Also where it stays below twice the limit: each move is a chase of its own, begun at the usual limit."""
    targets = reset(targeting(speed_limit=2.0, fast_chases=0.3, fast_joints=FAST))
    fast, goal = [], STAND.copy()
    for number in range(400):
        direction = 1.0 if number % 2 else -1.0
        before, ways = followed(targets, goal)[-1, PITCH], []
        for _ in range(20):
            goal[PITCH] += direction * speed * CYCLE
            now = followed(targets, goal)[-1, PITCH]
            ways.append(abs(now - before) / CYCLE)
            before = now
        assert ways[0] <= 2.0 + 1e-9
        fast.append(max(ways) > 2.1)
        np.testing.assert_allclose(followed(targets, goal, 40)[-1], goal, atol=1e-12)
    assert binomtest(sum(fast), len(fast), 0.3).pvalue > 1e-3


def test_without_fast_chases_no_chase_is() -> None:
    assert np.isclose(chase_speeds(0.0, 50)[:, [PITCH, YAW, ROLL]], 2.0).all()


def test_targets_wander_with_a_spread_and_a_memory() -> None:
    """An Ornstein-Uhlenbeck process: sd sigma, correlation exp(-t / T)."""
    plant = targeting(wander_time=1.5)
    targets = reset(with_drive(plant, [JOINT], wander=0.004))
    off = (followed(targets, STAND, 200_000) - STAND)[:, INDEX]
    others = np.delete(followed(targets, STAND, 10) - STAND, INDEX, axis=1)
    assert not others.any()
    # 1600 memories long: the spread is known to 2.5 %.
    assert off[1000:].std() == pytest.approx(0.004, rel=0.06)
    for lag in (0.3, 1.5):
        ticks = round(lag / CYCLE)
        correlation = np.corrcoef(off[:-ticks], off[ticks:])[0, 1]
        assert correlation == pytest.approx(np.exp(-lag / 1.5), abs=0.06)


def rests(plant: PlantConfig, count: int) -> tuple[FloatArray, FloatArray]:
    """(count,) how far off one target is at the end of each of some rests, and at the end of each motion [rad]."""
    targets, goal = reset(plant), STAND.copy()
    off, moving = [], []
    for number in range(count):
        for step in range(8):
            goal[INDEX] = STAND[INDEX] + 0.02 * (step if number % 2 else 8 - step)
            moving.append(float(followed(targets, goal)[0, INDEX] - goal[INDEX]))
        off.append(float(followed(targets, goal, 3 * REST)[-1, INDEX] - goal[INDEX]))
    # A drift ends when its target moves on, as fast as the largest would come.
    return np.array(off), np.array(moving).reshape(count, 8)[:, -1]


def test_a_fraction_of_rests_is_off_on_either_side() -> None:
    plant = with_drive(targeting(stray=(0.01, 0.06)), [JOINT], strays=0.25)
    off, moving = rests(plant, 1600)
    drifted = off[off != 0.0]
    assert binomtest(len(drifted), len(off), 0.25).pvalue > 1e-3
    assert binomtest(int((drifted > 0).sum()), len(drifted), 0.5).pvalue > 1e-3
    size = np.abs(drifted)
    assert size.min() >= 0.01 - 1e-9
    assert size.max() <= 0.06 + 1e-9
    # Even in the reciprocal: half of them are below 2 / (1 / 0.01 + 1 / 0.06).
    even = (1 / 0.01 - 1 / size) / (1 / 0.01 - 1 / 0.06)
    assert kstest(even, "uniform").pvalue > 1e-3
    assert np.abs(moving).max() < 1e-12


def test_a_command_that_converges_comes_to_rest_too() -> None:
    """As that of a posture task, which never quite arrives: a drift begins once it is slower than REST_SPEED."""
    plant = with_drive(targeting(stray=(0.01, 0.06)), [JOINT], strays=0.999)
    targets, goal = reset(plant), STAND.copy()
    off = []
    for tick in range(600):
        goal[INDEX] = STAND[INDEX] + 0.5 * (1.0 - np.exp(-2.0 * tick * CYCLE))
        off.append(float(followed(targets, goal)[0, INDEX] - goal[INDEX]))
    begin = int(np.argmax(np.abs(off) > 1e-9))
    slow = np.log(2.0 * 0.5 / REST_SPEED) / 2.0 / CYCLE
    assert begin == pytest.approx(slow + REST, abs=2)
    assert abs(off[-1]) >= 0.01 - 1e-9


def test_a_closed_brake_stays_where_it_closed() -> None:
    hip = ROBOT.joint_index("HipPitch")
    targets = reset(with_drive(targeting(wander_time=1.0), ["HipPitch"], wander=0.01, strays=0.5))
    followed(targets, STAND, 50)
    limp = np.zeros(N)
    held = []
    for _ in range(300):
        targets.plan(STAND + 0.3, limp)
        held.append(float(targets.now[hip] + STEPS * targets.increment[hip]))
    assert np.ptp(held) < 1e-12


def test_no_current_works_against_a_drift() -> None:
    """The encoder is degrees off at rest, and the motor holds nothing."""
    plant = with_drive(targeting(stray=(0.03, 0.031)), [JOINT], strays=0.999)
    backend = MujocoBackend(ROBOT, plant, seed=3)
    goal = backend.open().position.copy()
    backend.activate()

    def send(cycles: int) -> Any:
        for _ in range(cycles):
            measured = backend.exchange(
                Command(position=goal, stiffness=ONE, wheel_speed=np.zeros(3))
            )
        return measured

    for _ in range(40):
        goal[INDEX] += 0.01
        send(1)
    measured = send(200)
    error = abs(goal[INDEX] - measured.position[INDEX])
    drive = plant.actuator(JOINT)
    held = drive.friction.contact
    stiffness = backend.plant.stiffness[INDEX]
    assert error == pytest.approx(0.03, abs=(held.motor + held.link) / stiffness + 0.002)
    asked = stiffness * error / ROBOT.motors.joint_torque_constant(JOINT)
    assert measured.current[INDEX] < 0.5 * asked
    # Once it moves on, the error is that of the motion again.
    prompt = MujocoBackend(ROBOT, plain(), seed=3)
    prompt.open()
    prompt.activate()
    for _ in range(60):
        goal[INDEX] -= 0.01
        measured = send(1)
        free = prompt.exchange(Command(position=goal, stiffness=ONE, wheel_speed=np.zeros(3)))
    assert measured.position[INDEX] == pytest.approx(free.position[INDEX], abs=np.radians(0.2))


def test_the_current_of_a_joint_that_sticks_creeps() -> None:
    """Friction holds it: the encoder stays, and the motor's torque follows K times what the target wanders."""
    plant = targeting(wander_time=3.0)
    drive = plant.actuator(JOINT)
    contact = replace(drive.friction.contact, motor=5.0, link=5.0)
    stuck = replace(
        drive.friction, contact=contact, gap=replace(drive.friction.gap, motor=5.0, link=5.0)
    )
    simulation = standing(with_drive(plant, [JOINT], wander=0.006, friction=stuck), settle=20)
    constant = ROBOT.motors.joint_torque_constant(JOINT)
    stiffness = float(simulation.boards.stiffness[INDEX])
    currents, positions = [], []
    for _ in range(2500):
        simulation.cycle(STAND, ONE, np.zeros(3), np.ones(3))
        currents.append(float(simulation.current[INDEX]))
        positions.append(float(simulation.position[INDEX]))
    assert np.ptp(positions) < ROBOT.sensors.encoder.step
    torque = constant * np.sqrt(np.mean(np.square(currents)))
    assert torque == pytest.approx(stiffness * 0.006, rel=0.4)
    change = np.abs(np.array(currents)[167:] - np.array(currents)[:-167])  # in 2 s
    assert np.mean(change > 0.02) > 0.3


def test_equal_seeds_give_equal_targets_and_others_do_not() -> None:
    plant = targeting()
    plant = with_drive(plant, [JOINT], wander=0.01, strays=0.5)
    first, again, other = (followed(reset(plant, seed), STAND, 50)[:, INDEX] for seed in (7, 7, 8))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-3


def test_a_snapshot_keeps_what_chance_has_done() -> None:
    limited = targeting(speed_limit=1.0, fast_chases=0.5, fast_joints=(JOINT,))
    plant = with_drive(limited, [JOINT], wander=0.01, strays=0.5)
    targets, twin = reset(plant, 1), reset(plant, 2)
    while not targets._fast:
        followed(targets, STAND, 60)
        followed(targets, STAND + 0.5, 5)
    twin.restore(targets.save())
    np.testing.assert_array_equal(followed(targets, STAND, 100), followed(twin, STAND, 100))
