"""Limits that depend on another joint: kept whatever is pulled, whole region usable, slow return from outside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config import ConfigError, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.parts import CoupledLimit
from pepper_driver.controller import RobotModel, WholeBodyController
from pepper_driver.controller.constraints import AccelerationBox, BrakingLimits, CoupledLimits
from pepper_driver.controller.solvers.daqp_ import DaqpSolver
from support.controller import ACCELERATION, DT, JOINTS, MIDDLE, ROBOT, SETTINGS
from support.coupled import DIGITS, MARGIN, PITCH, YAW, Velocity, coupled, room
from support.examples import examples

BRAKE = 0.9 * ACCELERATION
TINY = 1e-9


def with_table(*tables: tuple[tuple[float, float, float], ...]) -> RobotConfig:
    pairs = [("HeadYaw", "HeadPitch"), ("RElbowYaw", "RElbowRoll")]
    limits = tuple(
        CoupledLimit(driver=driver, driven=driven, table=table)
        for (driver, driven), table in zip(pairs, tables, strict=False)
    )
    return replace(ROBOT, limits=replace(ROBOT.limits, coupled=limits))


def test_the_tables_are_tighter_than_the_joints_limits() -> None:
    """Otherwise nothing below tests anything: the box alone breaks them."""
    assert room(np.where(np.arange(JOINTS) == PITCH, ROBOT.upper, 0.0))[1] < -0.1
    corner = ROBOT.upper.copy()
    corner[ROBOT.joint_index("LElbowRoll")] = ROBOT.lower[ROBOT.joint_index("LElbowRoll")]
    assert room(corner)[2] < -0.1


def rest(position: float, velocity: float, brake: float) -> FloatArray:
    """Positions of a joint after each cycle of braking."""
    path = []
    while velocity != 0.0:
        after = np.sign(velocity) * max(abs(velocity) - brake * DT, 0.0)
        position += (velocity + after) / 2 * DT
        velocity = after
        path.append(position)
    return np.array(path or [position])


def assert_can_be_stopped(position: FloatArray, velocity: FloatArray) -> None:
    """Wherever between the limits of braking a joint brakes, all pairs stay in their regions."""
    for fraction in (1.0, 0.9):
        paths = [rest(*s) for s in zip(position, velocity, fraction * ACCELERATION, strict=True)]
        for k in range(max(map(len, paths))):
            there = np.array([path[min(k, len(path) - 1)] for path in paths])
            assert room(there).min() > 0


@pytest.mark.parametrize("velocity", ["safe", "robot"])
def test_whatever_box_and_rows_allow_can_be_stopped(velocity: Velocity) -> None:
    """Walks along the edges of the polytope that box and rows leave: never empty, and braking is always safe."""
    random = np.random.default_rng(0)
    active = sum(walk(random, velocity) for _ in range(15))
    assert active > 500


def walk(random: np.random.Generator, velocity: Velocity) -> int:
    """150 cycles; how many of them had rows."""
    model = RobotModel(ROBOT)
    box = AccelerationBox(ROBOT, replace(SETTINGS, velocity=velocity), model, DT)
    braking_limits = BrakingLimits(box.acceleration_limit, DT)
    limits = CoupledLimits(ROBOT, MARGIN)
    solver = DaqpSolver()
    q, v = model.configuration(MIDDLE), np.zeros(20)
    side = random.choice([-1.0, 1.0], 20)
    active = 0
    for tick in range(150):
        model.set_state(q, v)
        box.update(q, v, np.zeros(20))
        rows = limits.compute_inequality(model, braking_limits)
        if random.random() < 0.05:
            side = random.choice([-1.0, 1.0], 20) * random.choice([0.3, 1.0], 20)
        matrix, bound = np.zeros((0, 20)), np.zeros(0)
        if rows is not None:
            matrix, bound = rows.matrix, rows.bound
            active += 1
        price = 10.0 ** random.uniform(-1, 1, 20)
        requested = 30 * side
        answer = solver.solve(
            np.diag(price), -price * requested, box.lower, box.upper, matrix, bound
        )
        assert answer.status == "solved"
        q = model.integrate(q, (v + answer.x * DT / 2) * DT)
        v = v + answer.x * DT
        model.set_state(q, v)
        assert room(model.joint_position).min() > MARGIN - DIGITS
        if tick % 10 == 0:
            assert_can_be_stopped(model.joint_position, model.joint_velocity)
    return active


@pytest.mark.parametrize("dt", [0.002, 0.02, 0.05])
def test_at_other_cycles(dt: float) -> None:
    control = WholeBodyController(ROBOT, SETTINGS, dt=dt)
    control.add(CoupledLimits(ROBOT, MARGIN))
    control.posture.stiffness = 300.0
    random = np.random.default_rng(5)
    nearest = np.inf
    for tick in range(1000):
        if tick % 100 == 0:
            side = random.random(JOINTS) < 0.5
            control.posture.target = np.where(side, ROBOT.lower, ROBOT.upper)
        reference = control.step()
        assert control.status.solver == "solved"
        nearest = min(nearest, room(reference.position).min())
    assert MARGIN - DIGITS < nearest < MARGIN + 0.01


def test_left_and_right_elbow_mirror_one_another() -> None:
    control = coupled()
    left = [ROBOT.joint_index(name) for name in ("LElbowYaw", "LElbowRoll")]
    right = [ROBOT.joint_index(name) for name in ("RElbowYaw", "RElbowRoll")]
    random = np.random.default_rng(3)
    control.posture.stiffness = 100.0
    for tick in range(1500):
        if tick % 60 == 0:
            target = MIDDLE.copy()
            target[left] = random.choice([-1, 1], 2) * [2.0, 0.77] + [0.0, -0.785]
            target[right] = -target[left]
            control.posture.target = target
        reference = control.step()
        assert reference.position[left] == pytest.approx(-reference.position[right], abs=1e-7)


@pytest.mark.parametrize("posture", ["Crouch", "up", "down"])
def test_started_outside_it_comes_back_slowly(posture: str) -> None:
    """Recorded postures hold the head beyond the table."""
    start = ROBOT.postures["Crouch"].copy()
    if posture != "Crouch":
        start[YAW] = 1.9
        start[PITCH] = {"up": ROBOT.upper, "down": ROBOT.lower}[posture][PITCH] - 0.006
    control = coupled()
    control.reset(start)
    assert room(start).min() < -0.05
    speed = BRAKE[PITCH] * DT / 2
    inward = -1.0 if start[PITCH] > 0 else 1.0
    for _ in range(500):
        outside = room(control.position).min() < 0
        reference = control.step()
        assert control.status.solver == "solved"
        assert (np.abs(reference.acceleration) <= ACCELERATION + TINY).all()
        assert inward * reference.velocity[PITCH] <= 1.05 * speed
        assert np.abs(reference.velocity[YAW]) < speed
        if outside:
            assert inward * reference.velocity[PITCH] > 0.95 * speed
    assert room(reference.position).min() > MARGIN - DIGITS
    assert np.abs(reference.velocity).max() < 1e-3


def test_far_from_the_limits_there_are_no_rows_and_near_one_only_its_own() -> None:
    model = RobotModel(ROBOT)
    braking_limits = BrakingLimits(np.full(20, 20.0), DT)
    limits = CoupledLimits(ROBOT, MARGIN)
    model.set_state(model.configuration(MIDDLE), np.zeros(20))
    assert limits.compute_inequality(model, braking_limits) is None
    near = MIDDLE.copy()
    near[PITCH] = 0.44
    model.set_state(model.configuration(near), np.zeros(20))
    rows = limits.compute_inequality(model, braking_limits)
    assert rows is not None
    assert set(rows.names) == {"HeadPitch by HeadYaw"}
    columns = np.flatnonzero(np.abs(rows.matrix).max(axis=0))
    assert set(columns) <= set(model.joint_columns[[YAW, PITCH]])


@st.composite
def hills(draw: st.DrawFn) -> tuple[tuple[float, float, float], ...]:
    """Tables with one peak, steep and flat, neither convex nor concave."""
    angles = sorted(draw(st.sets(st.integers(-19, 19), min_size=2, max_size=5)))
    random = np.random.default_rng(draw(st.integers(0, 2**31)))
    count = len(angles) + 2
    sides = []
    for _ in range(2):
        peak = random.integers(0, count)
        heights = np.sort(random.uniform(0.05, 0.4, count))
        left = random.permutation(count - 1)[:peak]
        right = np.setdiff1d(np.arange(count - 1), left)
        order = [*np.sort(left), count - 1, *np.sort(right)[::-1]]
        sides.append(heights[order])
    theta = np.array([-2.1, *(x / 10 for x in angles), 2.1])
    return tuple(
        (float(x), -float(low), float(high)) for x, low, high in zip(theta, *sides, strict=True)
    )


@given(table=hills(), seed=st.integers(0, 2**31), velocity=st.sampled_from(["safe", "robot"]))
@examples(40)
def test_other_tables_are_kept_too(
    table: tuple[tuple[float, float, float], ...], seed: int, velocity: Velocity
) -> None:
    random = np.random.default_rng(seed)
    robot = with_table(table)
    control = coupled(robot, velocity)
    start = MIDDLE.copy()
    start[PITCH] = 0.0
    control.reset(start)
    control.posture.stiffness = 1000.0
    target = start.copy()
    for tick in range(300):
        if tick % 25 == 0:
            target[[YAW, PITCH]] = (
                random.choice([-2.0, -1.0, 0.0, 1.0, 2.0]),
                random.choice([-0.6, 0.6]),
            )
            control.posture.target = target
        reference = control.step()
        assert control.status.solver == "solved"
        assert room(reference.position, robot).min() > MARGIN - DIGITS


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (((0.0, -0.1, 0.1), (0.0, -0.1, 0.2)), "increase"),
        (((-1.0, -0.3, 0.2), (0.0, -0.3, 0.1), (1.0, -0.3, 0.2)), "peak"),
        (((-1.0, -0.2, 0.3), (0.0, -0.1, 0.3), (1.0, -0.2, 0.3)), "peak"),
    ],
)
def test_tables_that_it_cannot_keep_are_refused(
    table: tuple[tuple[float, float, float], ...], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        CoupledLimits(with_table(table))


def test_limits_follow_the_names_of_the_joints() -> None:
    turn = np.random.default_rng(0).permutation(JOINTS)
    robot = replace(ROBOT, joints=tuple(ROBOT.joints[i] for i in turn))
    control, other = coupled(), coupled(robot)
    for c, r in ((control, ROBOT), (other, robot)):
        c.posture.target = r.upper
        c.posture.stiffness = 100.0
    for _ in range(200):
        reference, turned = control.step(), other.step()
        assert np.abs(reference.position[turn] - turned.position).max() < TINY
