"""Ticks through ALMotion: they never wait, and say how old their samples are."""

import time
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest

from pepper_driver.backends import BackendError, Measurement
from pepper_driver.backends.naoqi.angles import AnglesChannel
from pepper_driver.backends.naoqi.connection import Connection, connect
from pepper_driver.backends.naoqi.memory_keys import SensorKeys
from pepper_driver.config import load_naoqi_settings
from pepper_driver.config.arrays import FloatArray
from support.naoqi_fakes import ROBOT, FakeRobot
from support.waiting import wait_until

pytestmark = pytest.mark.usefixtures("qi")

ANGLES = load_naoqi_settings().angles
GOAL = ROBOT.posture("Stand")


@pytest.fixture
def fake() -> Iterator[FakeRobot]:
    with FakeRobot() as fake:
        yield fake


@pytest.fixture
def connection(fake: FakeRobot) -> Iterator[Connection]:
    connection = connect(fake.address)
    yield connection
    connection.close()


def made(connection: Connection) -> AnglesChannel:
    return AnglesChannel(connection, ROBOT, SensorKeys(ROBOT, complete=False), ANGLES)


def ticks(link: AnglesChannel, count: int, stiffness: float = 1.0) -> list[Measurement]:
    """Measurements of ticks in real time."""
    measured, due = [], time.monotonic()
    for _ in range(count):
        measured.append(link.exchange(GOAL, np.full(17, stiffness)))
        due += ROBOT.cycle
        time.sleep(max(0.0, due - time.monotonic()))
    return measured


def test_every_second_tick_sends_a_command(fake: FakeRobot, connection: Connection) -> None:
    begin = time.monotonic()
    link = made(connection)
    link.start(np.ones(17))
    measured = ticks(link, 100)
    passed = (time.monotonic() - begin) / ROBOT.cycle
    assert wait_until(lambda: len(fake.log) == 50 - measured[-1].dropped_commands)
    assert set(fake.log) == {("setAngles", GOAL[0], ANGLES.speed)}
    assert 95 <= measured[-1].tick <= passed + 1
    assert all(later.tick >= m.tick for m, later in pairwise(measured))
    np.testing.assert_array_equal(measured[-1].position, fake.motion.commanded)
    assert np.isnan(measured[-1].current).all(), "this robot has no such keys"


def test_a_robot_that_does_not_answer_holds_no_tick_up_and_its_samples_are_old(
    fake: FakeRobot, connection: Connection
) -> None:
    link = made(connection)
    link.start(np.ones(17))
    fake.motion.may_answer.clear()
    measured = ticks(link, 60)
    assert measured[-1].age > 0.5
    assert measured[-1].dropped_commands == 29, "one command is on its way"
    assert not fake.log
    fake.motion.commanded = (GOAL + 0.1).tolist()
    fake.motion.may_answer.set()

    def come() -> bool:
        measured.extend(ticks(link, 1))
        return bool(measured[-1].position[0] != GOAL[0])

    assert wait_until(come)
    assert measured[-1].age > 0.5, "from when it was asked for"


def test_stiffness_is_passed_on_when_it_changes(fake: FakeRobot, connection: Connection) -> None:
    link = made(connection)
    link.start(np.ones(17))

    def told(stiffness: float) -> list[float]:
        """All that the robot was told by the time it has taken what it was told last."""
        ticks(link, 4, stiffness)
        assert wait_until(lambda: ticks(link, 2, stiffness) and link.idle)
        entries = [entry for entry in fake.log if entry[0] == "setStiffnesses"]
        assert {number for _, number, _ in entries} <= {14}, "not the legs"
        return [value for *_, value in entries]

    assert told(1.0) == []
    assert told(0.5) == told(0.5) == told(0.51) == [0.5]
    assert told(0.8) == [0.5, 0.8]
    assert told(0.99) == [0.5, 0.8, 0.99]
    assert told(1.0) == [0.5, 0.8, 0.99, 1.0], "the last bit of the way too"


def test_stiffness_is_asked_for_and_unknown_while_ours_is_on_its_way(
    fake: FakeRobot, connection: Connection
) -> None:
    """Else what the robot had before looks as if somebody had taken it away."""
    link = made(connection)
    link.start(np.ones(17))
    soft = np.isin(ROBOT.joint_names, link.soft)

    def shown(stiffness: float) -> FloatArray:
        found = ticks(link, 1, stiffness)[-1].stiffness
        assert found is not None
        return found

    assert np.isnan(shown(1.0)).all()
    assert wait_until(lambda: (shown(1.0)[soft] == 1.0).all())
    assert np.isnan(shown(1.0)[~soft]).all(), "nobody can change that of the legs"
    fake.motion.may_soften.clear()
    ticks(link, 3, 0.2)
    assert all(np.isnan(shown(0.2)).all() for _ in range(20))
    fake.motion.may_soften.set()
    assert wait_until(lambda: (shown(0.2)[soft] == 0.2).all())
    for nonsense in ([], [0.2] * 3, "soft"):
        fake.motion.stiffnesses = nonsense
        assert wait_until(lambda: np.isnan(shown(0.2)).all())
        fake.motion.stiffnesses = [0.2] * 14
        assert wait_until(lambda: (shown(0.2)[soft] == 0.2).all())


def test_samples_that_are_none(fake: FakeRobot, connection: Connection) -> None:
    link = made(connection)
    for bad in ([float("nan")] * 17, [0.0] * 3, []):
        fake.motion.commanded = bad
        measured = ticks(link, 20)
        np.testing.assert_allclose(measured[-1].position, GOAL)
    assert measured[-1].age > 0.3
    with pytest.raises(BackendError, match="where its joints are"):
        made(connection)
