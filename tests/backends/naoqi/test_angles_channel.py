"""Ticks through ALMotion, in virtual time: they never wait, and say how old their samples are."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends import BackendError, Measurement
from pepper_driver.backends.naoqi.angles import AnglesChannel
from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.backends.naoqi.memory_keys import SensorKeys
from pepper_driver.config import load_naoqi_settings
from pepper_driver.config.arrays import FloatArray
from support.naoqi_fakes import ROBOT, Memory, Motion, well
from support.virtual_naoqi import Served, VirtualNaoqi
from support.virtual_time import Flag

pytestmark = pytest.mark.usefixtures("qi")

ANGLES = load_naoqi_settings().angles
GOAL = ROBOT.posture("Stand")


class Fake:
    """A robot whose ALMotion and ALMemory do what a test requests, and the link to it.

    Attributes:
        log: All requests to its ALMotion.
    """

    def __init__(self, naoqi: VirtualNaoqi) -> None:
        self.time = naoqi.time
        self.log: list[tuple[Any, ...]] = []
        self.motion = Motion(self.log)
        self.motion.may_answer, self.motion.may_soften = Flag(self.time), Flag(self.time)
        self.motion.may_answer.set()
        self.motion.may_soften.set()
        for name, service in (("ALMotion", self.motion), ("ALMemory", Memory(well()))):
            naoqi.offer(name, Served(naoqi.time, naoqi.group, service, 0))
        self.connection: Connection = naoqi.connect()
        self.link = self.channel()

    def channel(self) -> AnglesChannel:
        """Open another link."""
        keys = SensorKeys(ROBOT, complete=False)
        return AnglesChannel(self.connection, ROBOT, keys, ANGLES, clock=self.time.clock())

    def ticks(self, count: int, stiffness: float = 1.0) -> list[Measurement]:
        """Tick, 12 ms apart; return what was measured."""
        measured = []
        for _ in range(count):
            measured.append(self.link.exchange(GOAL, np.full(17, stiffness)))
            self.time.sleep(ROBOT.cycle)
        return measured


@pytest.fixture
def fake() -> Iterator[Fake]:
    with VirtualNaoqi() as naoqi:
        fake = Fake(naoqi)
        fake.link.start(np.ones(17))
        fake.time.sleep(ROBOT.cycle / 2)
        yield fake


def test_every_second_tick_sends_a_command(fake: Fake) -> None:
    measured = fake.ticks(100)
    assert fake.log == 50 * [("setAngles", GOAL[0], ANGLES.speed)]
    assert [sample.tick for sample in measured] == list(range(1, 101))
    assert not any(sample.age or sample.dropped_commands for sample in measured)
    np.testing.assert_array_equal(measured[-1].position, fake.motion.commanded)
    assert np.isnan(measured[-1].current).all(), "this robot has no such keys"


def test_ticks_that_did_not_take_place_count(fake: Fake) -> None:
    assert fake.ticks(10)[-1].tick == 10
    fake.time.sleep(20 * ROBOT.cycle)
    assert [sample.tick for sample in fake.ticks(5)] == [30, 31, 32, 33, 34]


def test_a_robot_that_does_not_answer_holds_no_tick_up_and_its_samples_are_old(fake: Fake) -> None:
    begin = fake.time.seconds()
    fake.motion.may_answer.clear()
    measured = fake.ticks(60)
    assert fake.time.seconds() - begin == pytest.approx(60 * ROBOT.cycle)
    # Tick n is n - 1/2 cycles after the first sample; three cycles are usual, as one asks every second.
    assert measured[-1].age == pytest.approx((59.5 - 3) * ROBOT.cycle)
    assert measured[-1].dropped_commands == 29, "one command is on its way"
    assert not fake.log
    fake.motion.commanded = (GOAL + 0.1).tolist()
    fake.motion.may_answer.set()
    (first,) = fake.ticks(1)
    assert first.position[0] == GOAL[0]
    (come,) = fake.ticks(1)
    assert come.position[0] == GOAL[0] + 0.1
    assert come.age == pytest.approx((62 - 2 - 3) * ROBOT.cycle), "from when it was asked for"


def test_stiffness_is_passed_on_when_it_changes(fake: Fake) -> None:
    def received(stiffness: float) -> list[float]:
        """All stiffnesses that the robot has received by the time it has taken the last one."""
        fake.ticks(6, stiffness)
        assert fake.link.idle
        entries = [entry for entry in fake.log if entry[0] == "setStiffnesses"]
        assert {number for _, number, _ in entries} <= {14}, "not the legs"
        return [value for *_, value in entries]

    assert received(1.0) == []
    assert received(0.5) == received(0.5) == received(0.51) == [0.5]
    assert received(0.8) == [0.5, 0.8]
    assert received(0.99) == [0.5, 0.8, 0.99]
    assert received(1.0) == [0.5, 0.8, 0.99, 1.0], "the last bit of the way too"


def test_stiffness_is_asked_for_and_unknown_while_ours_is_on_its_way(fake: Fake) -> None:
    """Else what the robot had before looks as if another program had taken it away."""
    soft = np.isin(ROBOT.joint_names, fake.link.soft)

    def shown(stiffness: float, ticks: int = 1) -> FloatArray:
        found = fake.ticks(ticks, stiffness)[-1].stiffness
        assert found is not None
        return found

    assert np.isnan(shown(1.0)).all()
    assert (shown(1.0, 30)[soft] == 1.0).all()
    assert np.isnan(shown(1.0)[~soft]).all(), "that of the legs cannot be changed"
    fake.motion.may_soften.clear()
    fake.ticks(3, 0.2)
    assert all(np.isnan(shown(0.2)).all() for _ in range(20))
    fake.motion.may_soften.set()
    assert (shown(0.2, 30)[soft] == 0.2).all()
    for nonsense in ([], [0.2] * 3, "soft"):
        fake.motion.stiffnesses = nonsense
        assert np.isnan(shown(0.2, 30)).all()
        fake.motion.stiffnesses = [0.2] * 14
        assert (shown(0.2, 30)[soft] == 0.2).all()


def test_samples_that_are_none(fake: Fake) -> None:
    for bad in ([float("nan")] * 17, [0.0] * 3, []):
        fake.motion.commanded = bad
        measured = fake.ticks(20)
        np.testing.assert_allclose(measured[-1].position, GOAL)
    assert measured[-1].age > 0.6
    with pytest.raises(BackendError, match="where its joints are"):
        fake.channel()
