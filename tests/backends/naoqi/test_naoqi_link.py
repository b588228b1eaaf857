"""The link to a robot whose clock, network and DCM are reckoned: what arrives when, and what a tick learns of it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.fields import Measurement
from pepper_driver.backends.interface import BackendError, NotConnectedError
from pepper_driver.backends.naoqi.backend import NaoqiBackend
from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.backends.naoqi.memory_keys import SensorKeys
from pepper_driver.backends.naoqi.timing import SlowLinkError
from pepper_driver.config import load_safety_settings
from pepper_driver.config.arrays import FloatArray
from support.examples import examples
from support.naoqi_fakes import address_of
from support.virtual_robot import (
    CYCLE,
    ROBOT,
    SETTINGS,
    VirtualLoop,
    VirtualRobot,
    link_with,
    wire,
)
from support.waiting import PATIENCE

TIMING = SETTINGS.timing
SAFETY = load_safety_settings()
ONES, STILL = np.ones(17), np.zeros(3)
STAND = ROBOT.posture("Stand")
ROLL_OVER = 2**31


class Run:
    """Ticks of a moving robot, paced as the loop does it.

    Attributes:
        given: Position given in each tick.
        measured: What each tick measured.
        began: When each began [ms].
    """

    def __init__(
        self, robot: VirtualRobot, *, follow: bool = True, speed: float = 1.0, request: bool = True
    ) -> None:
        self.robot, self._speed = robot, speed
        self.loop = VirtualLoop(robot, follow=follow, request=request)
        self.link, self.began = self.loop.link, self.loop.began
        self.link.start()
        self.given: list[FloatArray] = []
        self.measured: list[Measurement] = []

    def position(self, tick: int) -> FloatArray:
        """Joints swing at ``speed`` [rad/s] at most."""
        swing: FloatArray = np.sin(3.0 * ROBOT.cycle * tick + np.arange(17))
        return STAND + self._speed / 3.0 * swing

    def ticks(
        self,
        number: int,
        wheels: FloatArray = STILL,
        late: Callable[[int], float] = lambda _: 0.0,
        until: Callable[[Measurement], bool] = lambda _: False,
    ) -> bool:
        """Return True if ``until`` ended it. ``late`` says by how many ms the tick of a number begins late."""
        for _ in range(number):
            self.loop.wait(late(len(self.given)))
            self.measured.append(self.loop.read())
            self.given.append(self.position(len(self.given)))
            self.loop.write(self.given[-1], ONES, wheels)
            if until(self.measured[-1]):
                return True
        return False

    def mismatches(self, within: float = 0.0, since: int = 20) -> list[int]:
        """Ticks whose sample shows the joints elsewhere than at the command they are said to answer, by more [rad]."""
        wrong = []
        for tick, measurement in enumerate(self.measured):
            if tick < since or measurement.response_delay is None or measurement.age > 0.05:
                continue
            late = round(measurement.age / ROBOT.cycle)
            given = self.given[max(0, tick - 1 - measurement.response_delay - late)]
            if np.abs(measurement.position - given).max() > within:
                wrong.append(tick)
        return wrong


# -- dates and pairs ----------------------------------------------------------------------------------------------


@examples(25)
@given(
    drift=st.floats(-100e-6, 100e-6),
    phase=st.floats(0.0, 12.0),
    roll_over_in=st.integers(0, 6000),
    jitter=st.floats(0.0, 0.5),
    missed=st.sets(st.integers(30, 350), max_size=6),
    seed=st.integers(0, 1000),
)
def test_each_sample_answers_the_command_it_is_said_to(
    drift: float, phase: float, roll_over_in: int, jitter: float, missed: set[int], seed: int
) -> None:
    """The DCM is exactly at each command at the date of its cycle, whatever the clocks do."""
    robot = VirtualRobot(
        wire(seed, jitter), drift=drift, phase=phase, date=ROLL_OVER - roll_over_in
    )
    run = Run(robot)
    run.ticks(400, late=lambda tick: 14.0 if tick in missed else 0.0)
    wrong = run.mismatches()
    # Where a tick was missed the DCM goes in a straight line to the next command; each is seen once, four ticks long.
    assert len(wrong) <= 2 * len(missed)
    ages = np.array([measurement.age for measurement in run.measured])
    assert ages.max() < 0.05
    assert np.count_nonzero(ages[100:]) <= 3 + 2 * len(missed)
    ticks = np.diff([measurement.tick for measurement in run.measured])
    assert set(ticks.tolist()) <= {0, 1, 2}
    assert run.measured[-1].dropped_commands == 0


def test_an_unsteady_way_costs_samples_and_no_pairs() -> None:
    run = Run(VirtualRobot(wire(1, jitter=1.5)))
    run.ticks(1500)
    assert run.link.lead == pytest.approx(0.024, abs=0.01)
    assert run.measured[-1].dropped_commands > 3
    assert not run.mismatches(within=5e-4), (
        "the DCM is nearly where a single one withheld would have had it"
    )
    late = np.mean([measurement.age > 0 for measurement in run.measured])
    assert 0.001 < late < 0.2
    assert (np.diff([measurement.tick for measurement in run.measured]) == 1).mean() > 0.98


def test_ticks_that_do_not_follow_the_robot_are_paired_as_well() -> None:
    """With a drift of 2000 ppm they slip by a cycle in six seconds."""
    run = Run(VirtualRobot(wire(2), drift=2e-3), follow=False)
    run.ticks(3000)
    assert len(run.mismatches()) <= 6 * 3


def test_ticks_settle_well_after_the_robots_cycle() -> None:
    for phase in (0.5, 4.0, 8.0, 11.5):
        run = Run(VirtualRobot(wire(3), phase=phase, drift=1e-4))
        run.ticks(400)
        after = [
            (run.robot.dcm_time(began) - run.robot.first_cycle) % CYCLE for began in run.began[200:]
        ]
        assert np.ptp(after) < 1.5
        assert np.mean(after) == pytest.approx(7.2, abs=1.0)


def test_time_and_tick_count_cycles_of_the_robot() -> None:
    run = Run(VirtualRobot())
    assert run.link.newest.tick == 0
    assert run.link.newest.time == 0.0
    run.ticks(200)
    times = np.array([measurement.time for measurement in run.measured])
    # What was read without ticks came sooner than it does with them: in the first third of a second that turns out.
    np.testing.assert_allclose(np.diff(times[30:]), ROBOT.cycle)
    assert run.measured[-1].time == run.measured[-1].tick * ROBOT.cycle


# -- what goes wrong ----------------------------------------------------------------------------------------------


def silent_for(run: Run, tick: int) -> float:
    """[s] since the last tick with a sample of its own."""
    fresh = [n for n in range(tick + 1) if run.measured[n].age < 0.006]
    return (run.began[tick] - run.began[fresh[-1]]) * 1e-3


@pytest.mark.parametrize("offset", np.arange(0.0, 12.0, 1.0).tolist())
def test_a_robot_that_hangs_is_held_and_stopped_in_time(offset: float) -> None:
    run = Run(VirtualRobot(wire(4)))
    run.ticks(150)
    run.robot.hang(until=np.inf)
    run.robot.pass_time(run.robot.time + offset)
    assert run.ticks(20, until=lambda m: m.age > SAFETY.stale_hold)
    assert run.measured[-1].age <= SAFETY.stale_fault, "it is held before it is stopped"
    assert run.ticks(20, until=lambda m: m.age > SAFETY.stale_fault)
    assert 0.07 < silent_for(run, len(run.measured) - 1) <= 0.100


@pytest.mark.parametrize("hangs", [False, True])
def test_after_a_pause_the_robot_has_the_time_to_answer_that_it_always_has(hangs: bool) -> None:
    run = Run(VirtualRobot(wire(4)))
    run.ticks(100)
    if hangs:
        run.robot.hang(until=np.inf)
    run.robot.pass_time(run.robot.time + 1000.0)
    run.ticks(1)
    assert run.measured[-1].age <= 0.0121
    assert run.ticks(8, until=lambda m: m.age > SAFETY.stale_fault) == hangs
    assert hangs or [m.age for m in run.measured[-6:]] == [0.0] * 6
    assert len(run.measured) - 101 <= 8


@pytest.mark.parametrize("speed", [0.2, 0.8, 1.6])
@pytest.mark.parametrize("after", [110.0, 150.0, 1000.0])
def test_what_a_robot_that_hung_finds_waiting_is_harmless(speed: float, after: float) -> None:
    """At most two commands wait; they let the wheels stand, and move no joint by more than a small step."""
    for begin in range(150, 162):
        robot = VirtualRobot(wire(5))
        run = Run(robot, speed=speed)
        wheels = np.full(3, 2.0) if begin % 3 else STILL
        run.ticks(begin, wheels)
        began, taken = robot.time, robot.taken
        robot.hang(until=began + after)
        assert run.ticks(20, wheels, until=lambda m: m.age > SAFETY.stale_fault)
        # The loop commands a robot that it stops to hold its joints, which do not get that far.
        run.link.write(run.given[-1], ONES, STILL)
        robot.pass_time(began + after + 500.0)
        assert robot.taken - taken <= 2
        hung, went_on = robot.dcm_time(began), robot.dcm_time(began + after)
        dates = sorted(date for date in robot.commanded if date > hung)
        joints = np.array([robot.commanded[date][0] for date in dates])
        assert np.abs(np.diff(joints, axis=0)).max() <= 0.02
        turning = [date for date in dates if robot.commanded[date][1].any()]
        soon = 1e3 * TIMING.wheels.stop
        assert all(date < hung + soon or went_on <= date < went_on + soon for date in turning)


def test_without_hanging_commands_are_far_larger_than_that_together() -> None:
    """The test before this shows the writer's doing."""
    run = Run(VirtualRobot(wire(5)), speed=1.6)
    run.ticks(200)
    assert np.abs(np.diff(run.given[150:], n=1, axis=0)).max() > 0.015
    assert np.abs(run.given[-1] - run.given[-4]).max() > 0.04


@pytest.mark.parametrize("offset", np.arange(0.0, 12.0, 1.5).tolist())
def test_without_commands_the_wheels_stand_soon_and_the_joints_stay(offset: float) -> None:
    robot = VirtualRobot(wire(6))
    run = Run(robot)
    run.ticks(100, wheels=np.array([1.0, -2.0, 3.0]))
    moving = [date for date, (_, wheels) in robot.commanded.items() if wheels.any()]
    assert np.array_equal(robot.commanded[moving[-1]][1], [1.0, -2.0, 3.0])
    last = robot.dcm_time(run.began[-1])
    robot.pass_time(robot.time + 600.0 + offset)
    moving = [date for date, (_, wheels) in robot.commanded.items() if wheels.any()]
    assert 1e3 * TIMING.wheels.hold - CYCLE < moving[-1] - last < 1e3 * TIMING.wheels.stop
    assert np.array_equal(robot.commanded[max(robot.commanded)][0], run.given[-1])


def test_wheels_get_no_commands_while_they_stand_and_stop_at_once() -> None:
    robot = VirtualRobot(wire(7))
    run = Run(robot)
    run.ticks(50)
    taken = robot.taken
    run.ticks(50)
    assert robot.taken - taken in (49, 50, 51)
    run.ticks(50, wheels=np.full(3, 2.0))
    stopped = robot.dcm_time(robot.time)
    run.ticks(50)
    moving = max(date for date, (_, wheels) in robot.commanded.items() if wheels.any())
    assert moving - stopped < 2 * CYCLE


def without(key: str) -> Callable[[list[Any]], Any]:
    place = SensorKeys(ROBOT).names.index(key)
    return lambda values: [None if n == place else value for n, value in enumerate(values)]


def fail(_: list[Any]) -> Any:
    raise RuntimeError("ALMemory: out of order")


HEAD = ROBOT.naoqi.prefix + ROBOT.naoqi.position.format(joint="HeadYaw")


@pytest.mark.parametrize(
    "spoil", [without(HEAD), without("DCM/Time"), fail, lambda _: [], lambda _: None]
)
def test_bad_answers_are_no_samples(
    spoil: Callable[[list[Any]], Any], caplog: pytest.LogCaptureFixture
) -> None:
    run = Run(VirtualRobot(wire(8)))
    run.ticks(100)
    run.robot.spoil = spoil
    run.ticks(4)
    ages = [round(measurement.age / ROBOT.cycle) for measurement in run.measured[-4:]]
    assert ages in ([0, 1, 2, 3], [1, 2, 3, 4])
    assert np.isfinite(run.measured[-1].position).all()
    run.robot.spoil = lambda values: values
    run.ticks(4)
    assert run.measured[-1].age == 0.0
    assert not run.mismatches()
    run.robot.spoil = spoil
    assert run.ticks(12, until=lambda m: m.age > SAFETY.stale_fault)
    assert len([record for record in caplog.records if "no good sample" in record.message]) == 1


def test_a_temperature_may_be_missing() -> None:
    run = Run(VirtualRobot(wire(8)))
    key = ROBOT.naoqi.prefix + ROBOT.naoqi.temperature.format(joint="HeadYaw")
    run.robot.spoil = without(key)
    run.ticks(50)
    assert run.measured[-1].age == 0.0
    assert np.flatnonzero(np.isnan(run.measured[-1].temperature)) == [ROBOT.joint_index("HeadYaw")]


def test_commands_that_the_robot_refuses_make_it_silent(caplog: pytest.LogCaptureFixture) -> None:
    run = Run(VirtualRobot(wire(9)))
    run.ticks(100)
    run.robot.refuses = lambda alias: "DCM: the buffer is full" if "Position" in alias else ""
    assert run.ticks(12, np.ones(3), until=lambda m: m.age > SAFETY.stale_fault)
    assert "buffer is full" in caplog.text
    assert len([record for record in caplog.records if "refused" in record.message]) == 1
    run.robot.refuses = lambda _: ""
    run.ticks(5)
    assert run.measured[-1].age == 0.0


def test_a_slow_dcm_takes_fewer_commands_which_are_counted() -> None:
    """Each command takes 30 ms on its way: two are on it, all others are withheld."""
    robot = VirtualRobot(wire(10))
    run = Run(robot)
    run.ticks(50)
    robot._network = lambda _: 15.0
    run.ticks(100)
    dropped_commands = run.measured[-1].dropped_commands - run.measured[50].dropped_commands
    assert 40 <= dropped_commands <= 80
    assert run.measured[-1].age < SAFETY.stale_hold


# -- at the start -------------------------------------------------------------------------------------------------


def test_an_actuator_unknown_to_the_dcm_is_named() -> None:
    robot = VirtualRobot()
    call = robot.call

    def unknown(service: str, method: str, *arguments: Any, timeout: float | None = None) -> Any:
        answer = call(service, method, *arguments, timeout=timeout)
        if method == "createAlias" and "Wheel" in answer[0]:
            return [answer[0], ["", *answer[1][1:]]]
        return answer

    robot.call = unknown  # type: ignore[method-assign]
    with pytest.raises(BackendError, match=r"does not know the actuator .*WheelFL/Speed"):
        Run(robot)


def test_a_bad_way_is_refused() -> None:
    with pytest.raises(SlowLinkError, match="cable"):
        Run(VirtualRobot(lambda _: 12.0))


def test_before_the_start_nothing_is_sent() -> None:
    robot = VirtualRobot()
    link = link_with(robot)
    for _ in range(10):
        robot.pass_time(robot.time + CYCLE)
        assert link.exchange(STAND + 0.5, ONES, np.ones(3)).response_delay is None
    assert robot.taken == 0


class Busy(NaoqiBackend):
    """Takes its time to connect."""

    def __init__(self) -> None:
        super().__init__(address_of("naoqi://pepper.invalid"), ROBOT, SETTINGS)
        self.begun, self.go = threading.Event(), threading.Event()

    def _met(self) -> Connection:
        self.begun.set()
        self.go.wait(PATIENCE)
        raise NotConnectedError("not reached")


def test_a_request_does_not_wait_for_another_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    requests: list[str] = []
    backend, link = Busy(), link_with(VirtualRobot())
    monkeypatch.setattr(link, "request", lambda: requests.append("asked"))
    backend._link = link
    backend.request()
    assert requests == ["asked"]

    def begin() -> None:
        with pytest.raises(NotConnectedError):
            backend.open()

    beginning = threading.Thread(target=begin)
    beginning.start()
    assert backend.begun.wait(PATIENCE)
    try:
        backend.request()
        assert beginning.is_alive()
        assert requests == ["asked"]
    finally:
        backend.go.set()
        beginning.join(PATIENCE)
    backend.request()
    assert requests == ["asked", "asked"]
