"""Faults of NAOqi, network and robot in any order and at any moment of a run: what always holds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends import Command
from pepper_driver.backends.interface import DEAD_MAN_CYCLES
from pepper_driver.backends.naoqi_server.shared_values import BlackBox
from pepper_driver.config import PepperError
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.realtime import RealTimePacer
from support.examples import examples
from support.naoqi_faults import DEAD_MAN, ROBOT, begin_to_move
from support.virtual_naoqi import VirtualNaoqi

pytestmark = pytest.mark.usefixtures("qi")

MAX_STEP = 0.02  # [rad] of a joint's command, from a cycle to the next
SPEED = 1.8 * 1.875 / 4.0  # [rad/s] of the arms in the middle of their motion, minimum jerk
LEAD = 3  # [cycles] by which commands are sent ahead, at most
FAULTS = (
    "cut",
    "kill",
    "blocked",
    "hang",
    "stall",
    "stall:DCM",
    "stall:ALMemory",
    "error:DCM",
    "error:ALMemory",
    "none",
    "none:Temperature",
    "dropped:0.5",
    "slow:0.03",
    "slow:0.2,DCM",
    "network:wifi",
    "missing:DCM",
    "press:FrontLeft",
    "press:ChestBoard/Button",
)

moments = st.integers(0, 1500).map(lambda ms: ms / 1000)
"""[s] after the robot has begun to move."""

events = st.lists(st.tuples(moments, moments, st.sampled_from(FAULTS)), min_size=1, max_size=4)
"""Begin, duration and kind of each fault."""


def excess(box: BlackBox, chosen: BoolArray) -> FloatArray:
    """(n,) by how much the largest step of a joint exceeds what it may be, in each of the chosen cycles [rad].

    Where calls are so slow that commands are left out, a step makes up for the motion meanwhile.
    """
    steps = np.abs(np.diff(box.position_command[chosen], axis=0)).max(axis=1)
    taken = np.flatnonzero(np.diff(box.orders[chosen], prepend=box.orders[chosen][:1] - 1))
    cycles = np.arange(1, len(steps) + 1)
    before = taken[np.maximum(np.searchsorted(taken, cycles) - 2, 0)]
    allowed = np.maximum(MAX_STEP, SPEED * (cycles - before + LEAD) * ROBOT.cycle)
    return np.asarray(steps - allowed, dtype=np.float64)


def wheels_after(box: BlackBox, now: float) -> float:
    """Largest speed command of wheels later than the dead-man's time after an order for wheels that was taken."""
    silent = box.begin - box.wheel_order > DEAD_MAN
    return float(np.abs(box.wheel_command[silent & (box.begin < now)]).max(initial=0.0))


@examples(8)
@given(events=events, network=st.sampled_from(["clear", "wired", "wifi"]), seed=st.integers(0, 9))
def test_whatever_happens_the_robot_moves_evenly_and_its_wheels_stop(
    events: list[tuple[float, float, str]], network: str, seed: int
) -> None:
    with VirtualNaoqi(network=network, seed=seed) as robot:
        robot.wake_up()
        pepper = robot.pepper()
        error: PepperError | None = None
        begun = ran = robot.time.seconds()
        try:
            with pepper:
                begin_to_move(pepper)
                begun = robot.time.seconds()
                for begin, duration, fault in events:
                    name, _, values = fault.partition(":")
                    timing = f"after={begin + 0.001},seconds={duration + 0.001}"
                    robot.set_fault(f"{name}:{values + ',' if values else ''}{timing}")
                try:
                    pepper.run(3.5)
                finally:
                    ran = robot.time.seconds()
        except PepperError as caught:
            error = caught
        ended = robot.time.seconds()
        driven = robot.since(begun - 0.3)
        # What follows is ALMotion's, which gets the robot back.
        ours = driven.begin < ran
        assert (excess(driven, ours) <= 0.0).all()
        assert wheels_after(driven, ended) == 0.0
        if error is not None:
            assert "\n" not in str(error)
        # All ends within a bounded time, and the robot can be driven again.
        assert ended - begun < 3.5 + 15.0
        robot.clear_faults()
        robot.time.sleep(4.0)
        assert not robot.black_box(20).wheel_command.any()
        robot.wake_up()
        with robot.pepper() as again:
            again.run(0.2)
        assert math.isfinite(float(robot.black_box(1).position.sum()))


@examples(6)
@given(
    silence=st.integers(1, 60).map(lambda cycles: cycles * ROBOT.cycle),
    phase=st.integers(0, 11),
    network=st.sampled_from(["clear", "wired"]),
)
def test_wheels_stop_by_themselves_when_no_command_comes(
    silence: float, phase: int, network: str
) -> None:
    """At the moment that the dead-man's time says, and not before."""
    with VirtualNaoqi(network=network, seed=1) as robot:
        robot.time.sleep(0.001 * phase)
        robot.wake_up()
        with robot.backend() as backend:
            backend.open()
            held = np.clip(backend.activate().position, ROBOT.lower, ROBOT.upper)
            command = Command(
                position=held, stiffness=np.ones(17), wheel_speed=np.array([1.0, -1.0, 0.0])
            )
            pacer = RealTimePacer(ROBOT.cycle, backend, clock=backend.clock)
            for _ in range(40):
                pacer.wait()
                backend.read()
                backend.write(command)
            assert robot.black_box(1).wheel_command.any()
            begun = robot.time.seconds()
            robot.time.sleep(silence)
            box = robot.since(begun)
        turning = np.abs(box.wheel_command).max(axis=1) > 0.0
        last = float(box.wheel_order[-1])
        silent = box.begin - last
        assert not turning[silent > DEAD_MAN].any()
        assert turning[silent < DEAD_MAN_CYCLES * ROBOT.cycle].all()
