"""The stiffness that boards report: lowered by any program, on any way that the values come."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.backends import Backend, Command, Measurement
from pepper_driver.backends.naoqi.memory_keys import Alias, actuator_keys
from pepper_driver.backends.naoqi_server.shared_values import BlackBox
from pepper_driver.config import (
    load_controller_settings,
    load_safety_settings,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Reference
from pepper_driver.realtime import RealTimePacer
from pepper_driver.safety import FaultReason, RobotState, SafetyGate
from support.virtual_naoqi import VirtualNaoqi
from support.virtual_robot import ROBOT, Network, VirtualLoop, VirtualRobot, wifi

SAFETY = replace(load_safety_settings(), battery_fault=0.0)
"""The virtual robot has nothing but joints: no battery either."""
STAND = ROBOT.posture("Stand")
ONES, STILL = np.ones(17), np.zeros(3)
LEGS = np.array([name in ROBOT.chains["legs"] for name in ROBOT.joint_names])
ARM = ROBOT.joint_index("RElbowYaw")
HARDNESS = actuator_keys(ROBOT)[Alias.STIFFNESS]


class Run:
    """Ticks of a virtual robot under a gate, which is asked for a stiffness in each tick.

    Attributes:
        gate: That watches all measurements.
        measured: Of all ticks.
    """

    def __init__(self, robot: VirtualRobot) -> None:
        self.robot, self._loop = robot, VirtualLoop(robot)
        self._loop.link.start()
        self.measured: list[Measurement] = []
        for tick in range(1, 101):
            self._tick()
            self._loop.write(STAND, np.full(17, tick / 100), STILL)
        self.gate = SafetyGate(ROBOT, SAFETY, load_controller_settings(ROBOT))
        self.gate.activate(STAND)
        self._sent = [self.gate.sent]

    def ticks(self, number: int, stiffness: Callable[[int], FloatArray]) -> None:
        """Until their number is over, or the gate is in FAULT."""
        for tick in range(number):
            measurement = self._tick()
            ago = 3 if measurement.response_delay is None else measurement.response_delay
            self.gate.watch(measurement, self._sent[-1 - min(ago, len(self._sent) - 1)])
            if self.gate.state is RobotState.FAULT:
                return
            self.gate.gate(_reference(), stiffness(tick), STILL, measurement.age)
            self._sent.append(self.gate.sent)
            self._loop.write(STAND, self.gate.sent.stiffness, STILL)

    def _tick(self) -> Measurement:
        self._loop.wait()
        self.measured.append(self._loop.read())
        return self.measured[-1]


def _reference() -> Reference:
    zero = np.zeros(17)
    return Reference(
        position=STAND,
        velocity=zero,
        acceleration=zero,
        load_torque=zero,
        base_twist=np.zeros(3),
    )


def _stiffness(measurement: Measurement) -> FloatArray:
    assert measurement.stiffness is not None
    return measurement.stiffness


def up_and_down(tick: int) -> FloatArray:
    """The stiffness that a reflex which softens an arm asks for; the legs keep theirs."""
    return np.where(LEGS, 1.0, 0.2 if (tick // 130) % 2 == 0 else 1.0)


def jitter(mean: float, seed: int = 0) -> Network:
    random = np.random.default_rng(seed)
    return lambda _: 0.3 + float(random.exponential(mean))


def test_stiffness_is_that_of_its_sample() -> None:
    run = Run(VirtualRobot(jitter(0.2)))
    shown = [_stiffness(measurement)[ARM] for measurement in run.measured]
    assert shown[0] == 0.0
    assert (np.diff(shown) >= 0.0).all()
    run.ticks(200, up_and_down)
    shown = [_stiffness(measurement)[ARM] for measurement in run.measured[-100:]]
    assert min(shown) == 0.2
    assert _stiffness(run.measured[-1])[LEGS].min() == 1.0


@pytest.mark.parametrize("network", [jitter(0.2), jitter(1.5), wifi(1), wifi(2)])
def test_our_own_ramps_are_no_theft(network: Network) -> None:
    run = Run(VirtualRobot(network))
    run.ticks(3000, up_and_down)
    fault = run.gate.fault
    assert fault is None or fault.reason is FaultReason.STALE_SAMPLE, fault


@pytest.mark.parametrize("tick", range(0, 260, 13))
def test_a_hang_in_a_ramp_is_no_theft(tick: int) -> None:
    """Neither while it lasts nor when what was sent meanwhile has come."""
    run = Run(VirtualRobot(jitter(0.2)))
    run.ticks(tick, up_and_down)
    run.robot.hang(until=run.robot.time + 70.0)
    run.ticks(200, lambda later: up_and_down(tick + later))
    assert run.gate.fault is None


def test_commands_of_another_program_are_seen_in_a_tenth_of_a_second() -> None:
    run = Run(VirtualRobot(jitter(0.2)))
    run.ticks(20, lambda _: ONES)
    run.robot.order([HARDNESS[ARM]], [0.0], 0.0, "ClearAll")
    begin = len(run.measured)
    run.ticks(100, lambda _: ONES)
    assert run.gate.fault is not None
    assert run.gate.fault.reason is FaultReason.STIFFNESS
    assert "RElbowYaw" in run.gate.fault.text
    assert (len(run.measured) - begin) * ROBOT.cycle <= SAFETY.stiffness_time + 0.05


# -- with all of NAOqi ---------------------------------------------------------------------------------------------


@pytest.fixture
def robot(qi: object) -> Iterator[VirtualNaoqi]:
    """Awake, and its owner allows all."""
    with VirtualNaoqi() as robot:
        robot.wake_up()
        yield robot


def hold(
    backend: Backend, posture: FloatArray, until: Callable[[FloatArray], bool], seconds: float
) -> FloatArray:
    """(17,) stiffness shown by the last of ticks, in all of which full stiffness is ordered."""
    clock = backend.clock
    pacer, end = RealTimePacer(ROBOT.cycle, backend, clock=clock), clock.seconds() + seconds
    command = Command(position=posture, stiffness=ONES, wheel_speed=STILL)
    while True:
        pacer.wait()
        shown = _stiffness(backend.read())
        backend.write(command)
        if until(shown) or clock.seconds() > end:
            return shown


@pytest.mark.parametrize("fault", ["network:wifi", "dropped:0.3", "slow:0.01", "hang:0.08"])
def test_our_own_ramps_are_no_theft_over_the_whole_driver(robot: VirtualNaoqi, fault: str) -> None:
    """Half a second up and down again, on ways that are late, lose samples or stall."""
    gate = SafetyGate(ROBOT, replace(SAFETY, stiffness_ramp=0.5), load_controller_settings(ROBOT))
    with robot.backend() as backend:
        backend.open()
        posture = np.clip(backend.activate().position, ROBOT.lower, ROBOT.upper)
        gate.activate(posture)
        sent, lowest = [gate.sent] * 60, 1.0
        pacer = RealTimePacer(ROBOT.cycle, backend, clock=backend.clock)
        backend.write(gate.sent)
        for tick in range(300):
            if tick == 10:
                robot.set_fault(fault)
            pacer.wait()
            measurement = backend.read()
            lowest = min(lowest, _stiffness(measurement).min())
            ago = 3 if measurement.response_delay is None else min(measurement.response_delay, 59)
            gate.watch(measurement, sent[-1 - ago])
            assert gate.fault is None
            stiffness = np.where(LEGS, 1.0, float((tick // 50) % 2))
            gate.gate(replace(_reference(), position=posture), stiffness, STILL, 0.0)
            backend.write(gate.sent)
            sent.append(gate.sent)
    assert lowest < 0.4


def recent(robot: VirtualNaoqi, begun: float) -> BlackBox:
    robot.time.sleep(0.1)  # what was said last is done
    return robot.since(begun)


@pytest.mark.parametrize("mode", ["dcm", "angles"])
def test_who_makes_an_arm_soft_is_seen_and_it_stays_soft(robot: VirtualNaoqi, mode: str) -> None:
    arm = np.zeros(17, dtype=np.bool_)
    arm[[ROBOT.joint_index(name) for name in ROBOT.chains["right_arm"]]] = True
    others = ~LEGS & ~arm
    with robot.backend(mode) as backend:
        backend.open()
        posture = np.clip(backend.activate().position, ROBOT.lower, ROBOT.upper)
        shown = hold(backend, posture, lambda shown: bool((shown[~LEGS] == 1.0).all()), 10.0)
        assert (shown[~LEGS] == 1.0).all()
        if mode == "dcm":
            assert (shown[LEGS] == 1.0).all()
        else:
            assert np.isnan(shown[LEGS]).all(), "it cannot be changed"
        robot.call("ALMotion", "setStiffnesses", "RArm", 0.0)
        shown = hold(backend, posture, lambda shown: not shown[arm].any(), 10.0)
        assert not shown[arm].any()
        assert (shown[others] == 1.0).all()
        begun = robot.time.seconds()
        backend.deactivate()
        box = recent(robot, begun)
    stiffest = box.stiffness[:, others].max(axis=1)
    # ALMotion gives them stiffness in the next cycle, or in the very one.
    soft = int(np.argmin(stiffest))
    assert stiffest[soft] < 0.2
    gained = np.diff(box.stiffness[: soft + 1, arm], axis=0).max()
    assert gained <= 0.0, "no program gives back what another took"


def test_a_robot_that_went_to_rest_is_left_at_rest(robot: VirtualNaoqi) -> None:
    """Its legs are not led back, nor does any joint get stiffness, when the program then ends."""
    with robot.backend() as backend:
        backend.open()
        posture = np.clip(backend.activate().position, ROBOT.lower, ROBOT.upper)
        robot.time.start(lambda: robot.call("ALMotion", "rest"), "client")
        shown = hold(backend, posture, lambda shown: not shown.any(), 20.0)
        assert not shown.any()
        robot.time.sleep(1.0)
        begun = robot.time.seconds()
        backend.deactivate()
        box = recent(robot, begun)
    assert not box.stiffness.any()
    assert not box.wheel_stiffness[-1].any()
    assert np.ptp(box.position_command[:, LEGS], axis=0).max() == 0.0
