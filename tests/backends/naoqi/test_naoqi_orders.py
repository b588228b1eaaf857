"""Commands to the DCM: what goes first where few may be in flight, and what is sent again."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends.naoqi.dcm_channel import Orders
from pepper_driver.backends.naoqi.dcm_io import MAX_OUTSTANDING, Writer
from pepper_driver.backends.naoqi.memory_keys import Alias
from pepper_driver.backends.naoqi.timing import CommandScheduler, Cycles
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.naoqi import WheelTimes

WHEELS = WheelTimes(reach=0.012, hold=0.030, stop=0.042)
CYCLE, FIRST = 12.0, 1000  # [ms]
STAND, ONES, STILL = np.zeros(17), np.ones(17), np.zeros(3)
TURNING = np.array([1.0, -2.0, 3.0])
ACKNOWLEDGED = 4321.0  # [ms]
POSITION, STIFFNESS, SPEED = (str(a) for a in (Alias.POSITION, Alias.STIFFNESS, Alias.WHEEL_SPEED))


class Reply:
    """Future of a call."""

    running, error = True, False

    def isRunning(self) -> bool:
        return self.running

    def hasError(self) -> bool:
        return self.error

    def value(self) -> None:
        if self.error:
            raise RuntimeError("no such actuator")


@dataclass
class Dcm:
    """Takes commands and says nothing until the test does."""

    calls: list[tuple[list[Any], Reply]] = field(default_factory=list)

    def setAlias(self, command: list[Any], _async: bool) -> Reply:
        self.calls.append((command, Reply()))
        return self.calls[-1][1]

    @property
    def names(self) -> list[str]:
        return [command[0] for command, _ in self.calls]

    def answer(self, *, error: bool = False) -> None:
        """To all commands so far."""
        for _, reply in self.calls:
            reply.running, reply.error = False, error


class Bench:
    """Orders to a DCM of which the test has the answers, one call of ``tick`` a cycle."""

    def __init__(self) -> None:
        self.dcm, self.now, self.step = Dcm(), float(FIRST), 0
        self.writer = Writer(self.dcm, max_step=1.0)
        cycles = Cycles(CYCLE, FIRST)
        scheduler = CommandScheduler(cycles, lead=24.0, delay=1)
        self.orders = Orders(
            self.writer, cycles, scheduler, WHEELS, ONES.copy(), lambda: ACKNOWLEDGED
        )

    def tick(
        self,
        position: FloatArray | None = STAND,
        stiffness: FloatArray = ONES,
        wheels: FloatArray = STILL,
    ) -> list[str]:
        """Aliases of the commands that were sent."""
        before = len(self.dcm.calls)
        self.writer.collect()
        self.orders.give(self.step, self.now, position, stiffness, wheels)
        self.now, self.step = self.now + CYCLE, self.step + 1
        return self.dcm.names[before:]

    def fill(self, free: int) -> None:
        """Leave so many places for commands in flight."""
        self.dcm.answer()
        self.writer.collect()
        for _ in range(MAX_OUTSTANDING - free):
            assert self.writer.send(Alias.WHEEL_STIFFNESS, "ClearAll", [0], [[0.0]])


def test_a_wheel_command_ends_in_standing_still() -> None:
    bench = Bench()
    bench.now += 5.0
    assert SPEED in bench.tick(wheels=TURNING)
    command = next(command for command, _ in bench.dcm.calls if command[0] == SPEED)
    assert command[1:4] == ["ClearAll", "time-separate", 0]
    assert command[4] == [FIRST + 12, FIRST + 30, FIRST + 42], "from the cycle before"
    assert command[5] == [[speed, speed, 0.0] for speed in TURNING.tolist()]


def test_wheels_that_stand_get_one_command_and_then_none() -> None:
    bench = Bench()
    assert SPEED in bench.tick(wheels=STILL), "how they are is not known at first"
    bench.dcm.answer()
    for _ in range(3):
        assert bench.tick(wheels=TURNING) == [POSITION, SPEED]
        bench.dcm.answer()
    sent = [bench.tick(wheels=STILL)]
    command = next(command for command, _ in reversed(bench.dcm.calls) if command[0] == SPEED)
    assert command[4] == [FIRST + 5 * CYCLE], "at the next cycle"
    assert command[5] == [[0.0]] * 3
    for _ in range(3):
        bench.dcm.answer()
        sent.append(bench.tick(wheels=STILL))
    assert [SPEED in names for names in sent] == [True, False, False, False]


def test_stiffness_is_sent_when_it_changes() -> None:
    bench = Bench()
    soft = np.linspace(0.2, 1.0, 17)
    sent = []
    for stiffness in (ONES, soft, soft, ONES):
        sent.append(STIFFNESS in bench.tick(stiffness=stiffness))
        np.testing.assert_array_equal(bench.orders.stiffness, stiffness)
        bench.dcm.answer()
    assert sent == [False, True, False, True]
    command = next(command for command, _ in bench.dcm.calls if command[0] == STIFFNESS)
    assert command[1] == "ClearAll"
    assert command[4] == [FIRST + CYCLE + 12]
    assert command[5] == [[value] for value in soft.tolist()]


@pytest.mark.parametrize(("alias", "more"), [(SPEED, {}), (STIFFNESS, {"stiffness": 0.5 * ONES})])
def test_what_the_robot_refused_is_sent_again(alias: str, more: dict[str, FloatArray]) -> None:
    bench = Bench()
    for _ in range(3):
        assert alias in bench.tick(None, **more)
        bench.dcm.answer(error=True)
    assert alias in bench.tick(None, **more)
    bench.dcm.answer()
    assert bench.tick(None, **more) == []


def test_a_sample_answers_no_command_that_the_robot_refused() -> None:
    """The command of tick k is for cycle k + 2, and the sample after that shows it."""
    bench = Bench()
    bench.tick()
    bench.dcm.answer()
    bench.tick()
    assert [bench.orders.answers(2, cycle) for cycle in (2, 3, 4)] == [None, 2, 1]
    for _ in range(2):
        bench.writer.collect()
        for command, reply in bench.dcm.calls[-1:]:
            assert command[0] == POSITION
            reply.running, reply.error = False, True
        bench.tick()
    bench.writer.collect()
    assert [bench.orders.answers(4, cycle) for cycle in (3, 4, 5)] == [4, 4, 4]


def test_a_command_that_was_not_sent_is_not_in_the_history() -> None:
    bench = Bench()
    bench.fill(0)
    assert bench.tick(wheels=TURNING) == []
    assert not bench.orders.positions._commands
    assert not bench.orders.speeds._commands
    bench.fill(2)
    assert SPEED in bench.tick(wheels=TURNING), "and is given again"
    (command,) = bench.orders.speeds._commands
    assert command.date == FIRST + CYCLE + 12
    np.testing.assert_array_equal(command.values, TURNING)


def test_a_command_is_remembered_with_the_time_of_its_acknowledgement() -> None:
    bench = Bench()
    bench.tick(wheels=TURNING)
    histories = (bench.orders.positions, bench.orders.speeds)
    for history in histories:
        (command,) = history._commands
        assert command.acknowledged == np.inf
    bench.dcm.answer()
    bench.writer.collect()
    for history in histories:
        (command,) = history._commands
        assert command.acknowledged == ACKNOWLEDGED


@pytest.mark.parametrize("waited", [0, 1, 5])
def test_the_stop_of_the_base_takes_the_only_place(waited: int) -> None:
    bench = Bench()
    bench.tick(wheels=TURNING)
    for number in range(waited):
        bench.fill(0)
        assert bench.tick(stiffness=(0.5 + 0.01 * number) * ONES, wheels=TURNING) == []
    bench.fill(1)
    assert bench.tick(stiffness=0.1 * ONES, wheels=STILL) == [SPEED]
    assert bench.dcm.calls[-1][0][5] == [[0.0]] * 3


@pytest.mark.parametrize(
    ("changing", "pattern"),
    [(False, "PPSPPSPPSPPS"), (True, "PPSPHSPPSPHS")],
)
def test_where_one_command_fits_into_a_tick_none_waits_for_long(
    changing: bool, pattern: str
) -> None:
    """Positions go first. Wheels come every third tick at the latest, before their last command is over."""
    bench, sent = Bench(), []
    bench.tick(wheels=TURNING)
    for number in range(60):
        bench.fill(1)
        stiffness = (0.2 + 0.01 * number) * ONES if changing else ONES
        sent += bench.tick(stiffness=stiffness, wheels=TURNING)
    assert len(sent) == 60, "one in each tick"
    letters = {POSITION: "P", SPEED: "S", STIFFNESS: "H"}
    assert "".join(letters[name] for name in sent).startswith(pattern)
    wheels = [number for number, name in enumerate(sent) if name == SPEED]
    assert max(np.diff(wheels)) <= 3
    assert bench.orders.dropped_commands == 60 - sent.count(POSITION)


def test_without_positions_the_others_are_sent() -> None:
    bench = Bench()
    assert bench.tick(None, stiffness=0.5 * ONES, wheels=TURNING) == [SPEED, STIFFNESS]
    assert bench.orders.dropped_commands == 0


def test_time_without_acknowledgement_is_that_of_the_oldest_command_that_waits() -> None:
    now = [0]
    dcm = Dcm()
    writer = Writer(dcm, max_step=1.0, now=lambda: now[0])
    assert writer.idle is True
    assert writer.unacknowledged_time == 0.0
    for _ in range(MAX_OUTSTANDING):
        assert writer.send(Alias.WHEEL_SPEED, "ClearAll", [0], [[0.0]])
        now[0] += 10_000_000
    now[0] = 50_000_000
    assert writer.idle is False
    assert writer.unacknowledged_time == pytest.approx(0.050)
    dcm.calls[0][1].running = False
    writer.collect()
    assert writer.unacknowledged_time == pytest.approx(0.040)
    dcm.answer()
    writer.collect()
    assert writer.unacknowledged_time == 0.0
    assert writer.idle is True


def test_before_the_first_acknowledgement_there_is_one_position_in_flight() -> None:
    """Two that come late together might move a joint too far from where the robot is."""
    bench = Bench()
    assert sorted(bench.tick()) == sorted([POSITION, SPEED])
    next(reply for command, reply in bench.dcm.calls if command[0] == SPEED).running = False
    assert bench.tick() == []
    bench.dcm.answer()
    assert bench.tick(STAND + 0.8) == [POSITION]
    bench.dcm.answer()
    assert bench.tick(STAND + 0.8) == [POSITION]
    assert bench.tick(STAND + 1.0) == [POSITION], "near the last one that the robot took"
    bench.dcm.calls[-2][1].running = False
    assert bench.tick(STAND + 1.9) == [], "and this is not"


def test_a_command_over_a_lost_connection_is_not_in_flight() -> None:
    class Lost(Dcm):
        def setAlias(self, command: list[Any], _async: bool) -> Reply:
            raise RuntimeError("not connected")

    writer = Writer(Lost(), max_step=1.0)
    assert not writer.send(Alias.WHEEL_SPEED, "ClearAll", [0], [[0.0]])
    assert writer.idle
    assert writer.unacknowledged_time == 0.0
