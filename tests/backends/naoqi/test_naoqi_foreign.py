"""Other programs that command joints or wheels: noticed within a second, and never where there is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.naoqi.memory_keys import Alias, actuator_keys
from pepper_driver.backends.naoqi.timing import CommandHistory, ScheduledCommand
from pepper_driver.backends.naoqi_server.dcm import UpdateType
from pepper_driver.config.arrays import FloatArray
from support.examples import examples
from support.virtual_robot import (
    CYCLE,
    ROBOT,
    SETTINGS,
    Network,
    VirtualLoop,
    VirtualRobot,
    wifi,
    wire,
)

STAND = ROBOT.posture("Stand")
ONES, STILL = np.ones(17), np.zeros(3)
KEYS = actuator_keys(ROBOT)
HEAD = ROBOT.joint_index("HeadYaw")
WHEELS = ROBOT.wheels.names
SECOND = round(1.0 / ROBOT.cycle)
ROLL_OVER = 2**31


class Run:
    """Ticks of a robot whose joints swing and whose wheels turn, stand and turn back.

    Attributes:
        found: What each tick found.
    """

    def __init__(
        self,
        robot: VirtualRobot,
        *,
        speed: float = 2.0,
        drive: float = 3.0,
        follow: bool = True,
        ignore: bool = False,
    ) -> None:
        settings = SETTINGS
        if ignore:
            foreign = replace(settings.foreign_commands, action="ignore")
            settings = replace(settings, foreign_commands=foreign)
        self.robot, self._speed, self._drive = robot, speed, drive
        self.loop = VirtualLoop(robot, settings=settings, follow=follow)
        self.loop.link.start()
        self.found: list[tuple[str, ...]] = []

    def ticks(
        self,
        number: int,
        late: Callable[[int], float] = lambda _: 0.0,
        write: Callable[[int], bool] = lambda _: True,
    ) -> None:
        for _ in range(number):
            tick = len(self.found)
            self.loop.wait(late(tick))
            self.found.append(self.loop.read().commanded_by_others)
            if write(tick):
                self.loop.write(self.position(tick), ONES, self.wheels(tick))

    def position(self, tick: int) -> FloatArray:
        swing: FloatArray = np.sin(3.0 * ROBOT.cycle * tick + np.arange(17))
        return STAND + self._speed / 3.0 * swing

    def wheels(self, tick: int) -> FloatArray:
        """A second of each: forwards, still, back, forwards at once."""
        sign = (1.0, 0.0, -1.0, 1.0)[tick // SECOND % 4]
        return sign * self._drive * np.array([1.0, -0.5, 0.3])

    def until_found(self) -> float:
        """[s] until something is found; infinite where nothing is, in two seconds."""
        begin = len(self.found)
        for _ in range(2 * SECOND):
            self.ticks(1)
            if self.found[-1]:
                return (len(self.found) - begin) * ROBOT.cycle
        return np.inf


# -- no false alarms ----------------------------------------------------------------------------------------------


@examples(20)
@given(
    network=st.sampled_from(["wire", "jitter", "wifi"]),
    seed=st.integers(0, 1000),
    drift=st.floats(-100e-6, 100e-6),
    phase=st.floats(0.0, 12.0),
    roll_over_in=st.integers(0, 6000),
    publication=st.floats(0.0, 3.0),
    late=st.dictionaries(st.integers(30, 400), st.floats(0.0, 30.0), max_size=20),
    unwritten=st.sets(st.integers(10, 35), max_size=4),
    hang=st.floats(20.0, 300.0) | st.none(),
    follow=st.booleans(),
)
def test_our_own_commands_are_not_foreign(
    network: str,
    seed: int,
    drift: float,
    phase: float,
    roll_over_in: int,
    publication: float,
    late: dict[int, float],
    unwritten: set[int],
    hang: float | None,
    follow: bool,
) -> None:
    """Whatever is late, left out, or waits for a robot that hangs; at 2 rad/s, and wheels that turn round at once."""
    networks = {"wire": wire(seed), "jitter": wire(seed, jitter=1.5), "wifi": wifi(seed)}
    robot = VirtualRobot(
        networks[network],
        drift=drift,
        phase=phase,
        date=ROLL_OVER - roll_over_in,
        publication=publication,
    )
    run = Run(robot, follow=follow)
    run.ticks(200, late=lambda tick: late.get(tick, 0.0), write=lambda n: n // 10 not in unwritten)
    if hang is not None:
        robot.hang(until=robot.time + hang)
    run.ticks(300, late=lambda tick: late.get(tick, 0.0), write=lambda n: n // 10 not in unwritten)
    assert not any(run.found)


@examples(15)
@given(
    seed=st.integers(0, 1000),
    lost=st.floats(0.0, 0.5),
    refused=st.floats(0.0, 0.5),
    slow=st.floats(0.0, 12.0),
)
def test_nor_are_they_where_samples_and_commands_are_lost(
    seed: int, lost: float, refused: float, slow: float
) -> None:
    rng = np.random.default_rng(seed)
    robot = VirtualRobot(wire(seed))
    run = Run(robot)
    run.ticks(100)
    robot.refuses = lambda _: "DCM: the buffer is full" if rng.random() < refused else ""
    robot.spoil = lambda values: [] if rng.random() < lost else values
    network = robot._network
    robot._network = lambda time: network(time) + slow
    run.ticks(400)
    assert not any(run.found)


def test_nor_is_what_stood_there_before_the_first_command() -> None:
    """ALMotion left the joints elsewhere, and the wheels turning."""
    robot = VirtualRobot(wire(1))
    robot.order(KEYS[Alias.POSITION], (STAND + 0.4).tolist(), 0.0, "ClearAll")
    robot.order(KEYS[Alias.WHEEL_SPEED], [2.0] * 3, 0.0, "ClearAll")
    run = Run(robot, speed=0.1)
    run.ticks(3 * SECOND)
    assert not any(run.found)


def test_pauses_are_none() -> None:
    robot = VirtualRobot(wire(1))
    run = Run(robot)
    for pause in (0.0, 30.0, 200.0, 3000.0):
        run.ticks(60)
        robot.pass_time(robot.time + pause)
    run.ticks(60, write=lambda _: False)
    run.ticks(60)
    assert not any(run.found)


def test_a_joint_whose_almotion_target_is_its_measurement_has_no_other_target() -> None:
    """Its stiffness was 0 before, and ours is not ALMotion's affair."""
    robot = VirtualRobot(wire(1))
    robot.limp = {HEAD, ROBOT.joint_index("LElbowRoll")}
    run = Run(robot, speed=2.5)
    run.ticks(4 * SECOND)
    assert not any(run.found)


def test_almotion_may_still_come_to_rest_when_we_begin() -> None:
    robot = VirtualRobot(wire(1))
    robot.almotion_target = STAND + 0.2
    run = Run(robot, speed=0.1)
    run.ticks(20)
    robot.almotion_target = STAND + 0.28
    run.ticks(3 * SECOND)
    assert not any(run.found)


def test_one_odd_value_stops_no_robot() -> None:
    """Nor does a command that ours overrule at once."""
    robot = VirtualRobot(wire(1))
    run = Run(robot)
    shown: list[bool] = []
    robot.spoil = lambda values: shown.append(1.5 in values[92:]) or values  # type: ignore[func-returns-value]
    for number in range(12):
        run.ticks(40 + number)
        robot.order([KEYS[Alias.POSITION][HEAD]], [1.5], 500.0 * (number % 2), "ClearAll")
    run.ticks(SECOND)
    assert any(shown), "it was there to see"
    assert not any(run.found)


# -- what is noticed ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("update", ["ClearAll", "ClearAfter"])
@pytest.mark.parametrize("period", [10.0, 12.0, 20.0, 33.3, 50.0])
@pytest.mark.parametrize("network", [wire, wifi])
def test_another_program_that_commands_a_joint_is_noticed_within_a_second(
    network: Callable[[int], Network], period: float, update: UpdateType
) -> None:
    """Whatever comes of it between the two: each wins for some cycles, in the least of cases 12 of 100."""
    robot = VirtualRobot(network(2))
    run = Run(robot, speed=0.3)
    run.ticks(2 * SECOND)
    key = KEYS[Alias.POSITION][HEAD]
    robot.every(period, lambda: robot.order([key], [STAND[HEAD] + 0.5], min(period, 20.0), update))
    assert run.until_found() <= 1.0
    assert run.found[-1] == ("HeadYaw",)


@pytest.mark.parametrize("seed", range(5))
def test_wheels_that_stand_and_are_commanded_to_turn_are_noticed(seed: int) -> None:
    """One order is enough: we say nothing while they stand."""
    robot = VirtualRobot(wire(seed))
    run = Run(robot, drive=0.0)
    run.ticks(SECOND + seed)
    robot.order(KEYS[Alias.WHEEL_SPEED], [1.0, 0.0, -1.0], 40.0, "ClearAll")
    assert run.until_found() <= 0.5
    assert run.found[-1] == (WHEELS[0], WHEELS[2])


def test_wheels_that_turn_against_their_command_are_noticed() -> None:
    """By orders that come after ours, and before the DCM's cycle; others change nothing."""
    robot = VirtualRobot(wire(3))
    run = Run(robot)
    run.ticks(10)
    robot.pass_time(robot.time + 10.5 - (robot.dcm_time(robot.time) - robot.first_cycle) % CYCLE)
    backwards = [-3.0, 1.5, -0.9]
    robot.every(12.0, lambda: robot.order(KEYS[Alias.WHEEL_SPEED], backwards, 0.0, "ClearAll"))
    assert run.until_found() <= 1.0
    assert set(run.found[-1]) <= set(WHEELS)


def test_joints_that_we_leave_alone_are_watched_too() -> None:
    """We read, and do not write."""
    robot = VirtualRobot(wire(3))
    run = Run(robot)
    run.ticks(SECOND)
    run.ticks(SECOND, write=lambda _: False)
    assert not any(run.found)
    robot.order([KEYS[Alias.POSITION][HEAD]], [1.0], 400.0, "ClearAll")
    run.ticks(SECOND, write=lambda _: False)
    assert run.found[-1] == ("HeadYaw",)


def test_targets_of_almotion_are_noticed_though_ours_overrule_them() -> None:
    robot = VirtualRobot(wire(4))
    run = Run(robot, speed=0.3)
    run.ticks(2 * SECOND)
    robot.almotion_target = STAND.copy()
    robot.almotion_target[[HEAD, 5]] += [0.3, -0.2]
    assert run.until_found() <= 0.7
    assert run.found[-1] == ("HeadYaw", ROBOT.joint_names[5])


def test_a_base_that_almotion_drives_is_noticed() -> None:
    robot = VirtualRobot(wire(4))
    run = Run(robot)
    run.ticks(2 * SECOND)
    robot.drives = True
    assert run.until_found() <= 0.7
    assert run.found[-1] == tuple(WHEELS)


def test_once_the_other_ends_nothing_is_found() -> None:
    robot = VirtualRobot(wire(4))
    run = Run(robot)
    run.ticks(SECOND)
    robot.drives = True
    run.ticks(SECOND)
    assert run.found[-1]
    robot.drives = False
    run.ticks(SECOND)
    assert not run.found[-1]


def test_it_can_be_switched_off() -> None:
    robot = VirtualRobot(wire(4))
    run = Run(robot, ignore=True)
    run.ticks(SECOND)
    robot.drives = True
    robot.almotion_target = STAND + 0.3
    robot.every(12.0, lambda: robot.order(KEYS[Alias.WHEEL_SPEED], [-5.0] * 3, 0.0, "ClearAll"))
    run.ticks(2 * SECOND)
    assert not any(run.found)
    assert {method for _, method in robot.asked} == {"getListData", "getTime", "setAlias"}


def test_the_dcm_is_asked_for_a_fifth_more_values_half_of_the_time() -> None:
    robot = VirtualRobot(wire(4))
    lengths: list[int] = []
    robot.spoil = lambda values: lengths.append(len(values)) or values  # type: ignore[func-returns-value]
    run = Run(robot)
    lengths.clear()
    run.ticks(400)
    assert set(lengths) == {92, 112}
    assert np.mean(np.array(lengths) == 112) == pytest.approx(0.5, abs=0.01)


# -- between which commands the DCM is -----------------------------------------------------------------------------


def command(
    value: float, date: int, *, sent: float, acknowledged: float = np.inf
) -> ScheduledCommand:
    return ScheduledCommand(
        values=np.array([value]), date=date, sent=sent, acknowledged=acknowledged
    )


def test_bounds_are_those_of_commands_from_the_last_that_was_surely_reached() -> None:
    history = CommandHistory(float(CYCLE))
    assert history.bounds(0) is None
    for number in range(10):
        sent = 12.0 * number - 30.0
        history.add(command(0.1 * number, 12 * number, sent=sent, acknowledged=sent + 5.0))

    def bounds(date: int) -> list[float] | None:
        found = history.bounds(date)
        return (
            None if found is None else [round(float(found[0][0]), 6), round(float(found[1][0]), 6)]
        )

    assert bounds(11) is None, "the first may not be reached"
    assert bounds(24) == [0.1, 0.5], "of date 12, up to what was sent by then"
    assert bounds(96) == [0.7, 0.9]
    assert bounds(5000) == [0.9, 0.9], "the last one is held"
    history.add(command(2.0, 5100, sent=5080.0))
    assert bounds(5200) == [0.9, 2.0], "it may have come, or not"
    history.add(command(3.0, 5112, sent=5092.0, acknowledged=5195.0))
    assert bounds(5200) == [0.9, 3.0], "its acknowledgement was seen too late to say when it came"
    assert bounds(5300) == [3.0, 3.0]
