"""Whatever references come, what leaves the gate is within the limits, and can stop before its position limits."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.controller import WholeBodyController
from pepper_driver.safety import RobotState, SafetyGate
from pepper_driver.safety.limits import joint_limits, limit_joints
from support.examples import examples
from support.fakes import reference
from support.safety import CONTROLLER, ROBOT, SAFETY, STAND, active_gate

CYCLE = ROBOT.cycle
SPEED = SAFETY.speed_margin * CONTROLLER.joint_velocity(ROBOT)
CHANGE = SAFETY.acceleration_margin * CONTROLLER.joint_acceleration(ROBOT) * CYCLE**2
"""[rad] Of a step, from one command to the next."""
CLOSE = 1e-7
"""[rad] Sum of the roundings in one command."""


anything = st.floats(allow_nan=True, allow_infinity=True)
anywhere = st.floats(-4.0, 4.0)
nearby = st.floats(-0.1, 0.1)


def vectors(values: st.SearchStrategy[float], size: int) -> st.SearchStrategy[FloatArray]:
    return st.lists(values, min_size=size, max_size=size).map(np.array)


@st.composite
def references(draw: st.DrawFn) -> list[tuple[Any, Any, Any, float]]:
    """Positions, stiffness, wheel speeds, age: mostly wild, seldom not finite or of the wrong size."""
    ticks = []
    for _ in range(draw(st.integers(1, 25))):
        kind = draw(st.sampled_from(["jump", "jump", "limits", "huge", "wrong"]))
        position: Any = draw(vectors(anywhere, 17))
        if kind == "limits":
            position = np.where(position > 0, ROBOT.upper, ROBOT.lower) + draw(vectors(nearby, 17))
        if kind == "huge":
            position = position * draw(st.sampled_from([1e3, 1e150, 1e300]))
        stiffness: Any = draw(vectors(st.floats(-3, 3), 17))
        wheels: Any = draw(vectors(st.floats(-1e9, 1e9), 3))
        if kind == "wrong" and draw(st.integers(0, 3)) == 0:
            position = draw(vectors(anything, draw(st.integers(16, 18))))
            stiffness = draw(st.one_of(vectors(anything, 17), vectors(anything, 3), st.none()))
            wheels = draw(vectors(anything, 3))
        ticks += [(position, stiffness, wheels, draw(st.floats(0, 0.12)))] * draw(st.integers(1, 6))
    return ticks


def way_to_rest(step: FloatArray, change: FloatArray = CHANGE) -> FloatArray:
    """(n,) way that joints still go after (n,) steps, of which each following one is smaller by ``change`` (n,)."""
    size = np.abs(step)
    n = np.floor(size / change)
    way: FloatArray = n * size - change * n * (n + 1) / 2
    return way


def test_the_way_to_rest() -> None:
    step, ways = 5.3 * CHANGE, []
    while step[0] > 0:
        step = step - CHANGE
        ways.append(np.maximum(step, 0.0))
    np.testing.assert_allclose(way_to_rest(-5.3 * CHANGE), np.sum(ways, axis=0))


@examples(60)
@given(references(), st.floats(0, 1))
def test_nothing_outside_the_limits_ever_leaves(
    ticks: list[tuple[Any, Any, Any, float]], fraction: float
) -> None:
    g = active_gate(ROBOT.lower + fraction * (ROBOT.upper - ROBOT.lower))
    before, step = g.sent, np.zeros(17)
    for position, stiffness, wheels, age in ticks:
        with np.errstate(over="ignore", invalid="ignore"):
            gated = g.gate(reference(position), stiffness, wheels, age)
        sent = gated.command
        for values in (sent.position, sent.stiffness, sent.wheel_speed):
            assert np.isfinite(values).all()
        assert (sent.position >= ROBOT.lower).all()
        assert (sent.position <= ROBOT.upper).all()
        assert (sent.stiffness >= 0).all()
        assert (sent.stiffness <= 1).all()
        ramp = CYCLE / SAFETY.stiffness_ramp
        assert (np.abs(sent.stiffness - before.stiffness) <= ramp + 1e-12).all()
        assert (np.abs(sent.wheel_speed) <= ROBOT.wheels.speed_limit + 2e-6).all()
        if g.state is RobotState.FAULT:
            np.testing.assert_array_equal(sent.position, before.position)
            np.testing.assert_array_equal(sent.stiffness, before.stiffness)
            np.testing.assert_array_equal(sent.wheel_speed, 0.0)
        else:
            now = sent.position - before.position
            assert (np.abs(now) <= SPEED * CYCLE + CLOSE).all()
            assert (np.abs(now - step) <= CHANGE + CLOSE).all()
            # it can still stop
            way = way_to_rest(now)
            room = np.where(now > 0, ROBOT.upper - sent.position, sent.position - ROBOT.lower)
            assert (way <= room + CLOSE).all()
            step = now
            assert gated.limited.any() == gated.joints_limited
            same = ~gated.limited
            np.testing.assert_allclose(sent.position[same], position[same], rtol=0, atol=CLOSE)
        before = sent


class Joints:
    """Joints that follow requests within their limits, from where they stand.

    Attributes:
        position: (n,) [rad].
    """

    def __init__(
        self,
        upper: FloatArray,
        speed: FloatArray,
        acceleration: FloatArray,
        position: FloatArray | None = None,
    ) -> None:
        self.position = np.zeros(len(upper)) if position is None else position
        self._joints = joint_limits(
            np.zeros(len(upper)), upper, speed, acceleration, stiffness_ramp=1.0, cycle=0.01
        )
        self._joints["position"] = self.position
        self._limit = limit_joints.load()

    def move(self, requested: FloatArray, *, brake: bool = False) -> BoolArray:
        """Move towards (n,) positions; return (n,) True where the limits do not allow that."""
        self.position = np.empty(len(requested))
        limited = self._limit(self._joints, requested, brake, self.position)
        marks: BoolArray = self._joints["limited"].copy()
        assert limited == marks.any()
        return marks


@examples(60)
@given(
    st.lists(st.floats(-1.2, 1.2), min_size=1, max_size=60),
    st.lists(st.integers(1, 8), min_size=60, max_size=60),
    st.floats(0, 1),
)
def test_small_steps_stay_within_the_limits_of_speed_and_acceleration(
    speeds: list[float], times: list[int], start: float
) -> None:
    """Steps that no limit of speed forbids, in fractions of the largest."""
    upper = np.array([0.05, 0.2, 0.5, 1.0])
    speed, acceleration = np.array([0.5, 1.0, 2.0, 4.0]), np.array([40.0, 10.0, 20.0, 10.0])
    joints = Joints(upper, speed, acceleration, start * upper)
    step = np.zeros(4)
    for fraction, repeated in zip(speeds, times, strict=False):
        for _ in range(repeated):
            before = joints.position
            requested = before + fraction * speed * 0.01
            same = ~joints.move(requested)
            np.testing.assert_allclose(joints.position[same], requested[same], rtol=0, atol=1e-8)
            now = joints.position - before
            change = acceleration * 0.01**2
            assert (np.abs(now) <= speed * 0.01 + CLOSE).all()
            assert (np.abs(now - step) <= change + CLOSE).all()
            room = np.where(now > 0, upper - joints.position, joints.position)
            assert (room >= 0.0).all()
            assert (way_to_rest(now, change) <= room + CLOSE).all()
            step = now


def a_joint(room: float = 1.0, position: float = 0.0) -> Joints:
    return Joints(np.full(1, room), np.full(1, 2.0), np.full(1, 10.0), np.full(1, position))


def run_into(joints: Joints, goal: float, ticks: int) -> FloatArray:
    way = []
    for _ in range(ticks):
        joints.move(np.full(len(joints.position), goal))
        way.append(joints.position[0])
    return np.array(way)


@pytest.mark.parametrize("room", [0.0, 1e-5, 0.003, 0.1, 1.0])
def test_a_joint_sent_beyond_its_limit_arrives_there_at_rest(room: float) -> None:
    joints = a_joint(room)
    way = run_into(joints, 50.0, 400)
    assert way[-1] == pytest.approx(room, abs=1e-12)
    assert (np.diff(way) >= -1e-15).all()
    back = run_into(joints, -50.0, 400)
    assert back[-1] == pytest.approx(0.0, abs=1e-12)


def test_whatever_the_room_no_joint_brakes_harder_than_it_may() -> None:
    n = 1000
    upper = np.linspace(1e-4, 0.3, n)
    joints = Joints(upper, np.full(n, 2.0), np.full(n, 10.0))
    way = [np.zeros(n)]
    for _ in range(200):
        joints.move(upper + 1.0)
        way.append(joints.position)
    np.testing.assert_allclose(way[-1], upper, rtol=0, atol=1e-12)
    steps = np.diff(way, axis=0, prepend=[way[0]])
    assert np.abs(np.diff(steps, axis=0)).max() <= 10.0 * 0.01**2 + 1e-9


def test_it_brakes_as_late_as_it_can() -> None:
    """From rest over a meter at 2 rad/s and 10 rad/s2: 0.2 s each to get there and to stop, 0.3 s between."""
    way = run_into(a_joint(), 50.0, 400)
    there = int(np.argmax(way > 1.0 - 1e-9))
    assert there * 0.01 == pytest.approx(0.7, abs=0.03)


def test_a_joint_that_runs_into_its_limit_at_a_lawful_speed_is_braked_in_time() -> None:
    """Neither speed nor acceleration give it away; with 10 rad/s2 it needs 0.05 m to stop from 1 rad/s."""
    joints, step, limited = a_joint(), 0.0, []
    for _ in range(130):
        step = min(step + 0.0005, 0.01)
        limited.append(bool(joints.move(joints.position + step).any()))
        if limited[-1]:
            break
    assert joints.position[0] == pytest.approx(0.95, abs=0.015)
    assert limited.count(True) == 1
    assert run_into(joints, 50.0, 200)[-1] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("ticks", [1, 7, 20])
def test_what_is_exactly_at_the_limits_is_not_limited(ticks: int, sign: float) -> None:
    """Steps at the limit of acceleration, then of speed; those beyond are limited."""
    joints, step = a_joint(2.0, 1.0), 0.0
    for _ in range(ticks):
        step = min(step + 10.0 * 0.01**2, 0.02)
        requested = joints.position + sign * step
        assert not joints.move(requested).any()
        np.testing.assert_array_equal(joints.position, requested)
    assert joints.move(joints.position + sign * (step + 2.0 * 10.0 * 0.01**2)).all()


def test_limits_are_kept_by_the_joint_concerned_alone() -> None:
    n = 3
    joints = Joints(np.ones(n), np.full(n, 2.0), np.full(n, 10.0), np.full(n, 0.5))
    limited = joints.move(np.array([0.5, 0.5005, 0.9]))
    assert limited.tolist() == [False, False, True]
    np.testing.assert_array_equal(joints.position[:2], [0.5, 0.5005])


def test_a_joint_that_is_to_brake_comes_to_rest_whatever_is_requested() -> None:
    joints = a_joint()
    run_into(joints, 50.0, 10)
    before, steps = joints.position, []
    for _ in range(20):
        assert joints.move(np.full(1, 50.0), brake=True).all()
        steps.append((joints.position - before)[0])
        before = joints.position
    # 10 changes per tick were the last step, and each tick takes one of them away.
    np.testing.assert_allclose(steps[:10], 0.001 * np.arange(9, -1, -1), atol=1e-12)
    assert not any(steps[10:])
    assert not joints.move(joints.position, brake=True).any()


@examples(20)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["safe", "robot"]))
def test_what_the_controller_sends_flat_out_is_never_changed(seed: int, velocity: Any) -> None:
    """All joints to random goals, limits among them, at random gains; base too; it brakes as reflexes make it."""
    rng = np.random.default_rng(seed)
    chosen = replace(CONTROLLER, velocity=velocity)
    controller, g = WholeBodyController(ROBOT, chosen), SafetyGate(ROBOT, SAFETY, chosen)
    controller.reset(STAND)
    g.activate(controller.position)
    span = ROBOT.upper - ROBOT.lower
    for _ in range(6):
        fraction = rng.integers(0, 2, 17) if rng.random() < 0.4 else rng.uniform(0, 1, 17)
        controller.posture.target = np.clip(ROBOT.lower + fraction * span, ROBOT.lower, ROBOT.upper)
        controller.posture.stiffness = float(rng.choice([5.0, 50.0, 400.0, 3000.0]))
        controller.base_velocity.target = rng.uniform(-1, 1, 3) * [0.35, 0.35, 1.0]
        for tick in range(int(rng.integers(5, 80))):
            controller.hold = bool(tick > 60)
            requested = controller.step()
            wheels = ROBOT.wheels.matrix @ requested.base_twist
            gated = g.gate(requested, np.ones(17), wheels, 0.0)
            assert not gated.limited.any()
            assert not gated.wheels_limited
            np.testing.assert_array_equal(gated.command.position, requested.position)


def test_the_law_that_overshoots_is_stopped_at_the_limit() -> None:
    """The velocity damper of older controllers runs past position limits: what leaves does not."""
    chosen = replace(CONTROLLER, position_limit="damper", position_margin=0.0)
    controller, g = WholeBodyController(ROBOT, chosen), SafetyGate(ROBOT, SAFETY, chosen)
    controller.reset(STAND)
    g.activate(controller.position)
    controller.posture.stiffness = 3000.0
    clamped = 0
    for goal in (ROBOT.upper, ROBOT.lower, ROBOT.upper):
        controller.posture.target = goal
        for _ in range(150):
            gated = g.gate(controller.step(), np.ones(17), np.zeros(3), 0.0)
            assert (gated.command.position <= ROBOT.upper).all()
            assert (gated.command.position >= ROBOT.lower).all()
            if gated.joints_limited:
                clamped += 1
                controller.override_state(gated.command.position)
    assert clamped > 0
