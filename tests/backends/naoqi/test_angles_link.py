"""Ticks through ALMotion: they never wait, and say how old their samples are."""

import time
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
from naoqi_fakes import ROBOT, FakeRobot

from pepper_driver.backends import BackendError, Measurement
from pepper_driver.backends.naoqi.angles_link import AnglesLink
from pepper_driver.backends.naoqi.connection import Connection, connect
from pepper_driver.backends.naoqi.keys import SensorKeys
from pepper_driver.config import load_naoqi_settings

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


def made(connection: Connection) -> AnglesLink:
    return AnglesLink(connection, ROBOT, SensorKeys(ROBOT, complete=False), ANGLES)


def ticks(link: AnglesLink, count: int, stiffness: float = 1.0) -> tuple[list[Measurement], float]:
    """Measurements of ticks in real time, and how long the longest took [s]."""
    measured, longest, due = [], 0.0, time.perf_counter()
    for _ in range(count):
        begin = time.perf_counter()
        measured.append(link.tick(GOAL, np.full(17, stiffness)))
        longest = max(longest, time.perf_counter() - begin)
        due += ROBOT.cycle
        time.sleep(max(0.0, due - time.perf_counter()))
    return measured, longest


def test_every_second_tick_sends_a_command(fake: FakeRobot, connection: Connection) -> None:
    link = made(connection)
    link.start(np.ones(17))
    measured, _ = ticks(link, 100)
    sent = [entry for entry in fake.log if entry[0] == "setAngles"]
    assert 50 - measured[-1].withheld >= len(sent) >= 45 - measured[-1].withheld
    assert sent[0] == ("setAngles", pytest.approx(GOAL[0]), ANGLES.speed)
    assert measured[-1].tick == pytest.approx(100, abs=10)
    assert all(later.tick >= m.tick for m, later in pairwise(measured))
    np.testing.assert_allclose(measured[-1].position, fake.motion.commanded)
    assert np.isnan(measured[-1].current).all(), "this robot has no such keys"


def test_a_slow_robot_holds_no_tick_up_and_its_samples_are_old(
    fake: FakeRobot, connection: Connection
) -> None:
    link = made(connection)
    link.start(np.ones(17))
    fake.motion.slow = 0.3
    measured, longest = ticks(link, 110)
    fake.motion.slow = 0.0
    assert longest < 0.15
    assert min(m.age for m in measured[60:]) > 0.2, "from when it was asked for"
    assert measured[-1].withheld > 30
    assert len(fake.log) < 8, "one command on its way at most"


def test_stiffness_is_passed_on_when_it_changes(fake: FakeRobot, connection: Connection) -> None:
    link = made(connection)
    link.start(np.ones(17))
    for stiffness in (1.0, 1.0, 0.5, 0.5, 0.51, 0.8):
        ticks(link, 12, stiffness)
    told = [entry for entry in fake.log if entry[0] == "setStiffnesses"]
    assert told == [("setStiffnesses", 14, 0.5), ("setStiffnesses", 14, 0.8)], "not the legs"
    ticks(link, 12, 0.99)
    ticks(link, 12, 1.0)
    assert fake.log[-1] != ("setStiffnesses", 14, 0.99)
    told = [entry for entry in fake.log if entry[0] == "setStiffnesses"]
    assert told[-1] == ("setStiffnesses", 14, 1.0), "the last bit of the way too"


def test_stiffness_is_asked_for_and_unknown_while_ours_is_on_its_way(
    fake: FakeRobot, connection: Connection
) -> None:
    """Else what the robot had before looks as if somebody had taken it away."""
    link = made(connection)
    link.start(np.ones(17))
    soft = np.isin(ROBOT.joint_names, link.soft)
    first, _ = ticks(link, 30)
    assert first[0].stiffness is not None
    assert np.isnan(first[0].stiffness).all()
    assert first[-1].stiffness is not None
    assert np.isnan(first[-1].stiffness[~soft]).all(), "nobody can change that of the legs"
    assert (first[-1].stiffness[soft] == 1.0).all()
    fake.motion.slow_stiffness = 0.3
    on_the_way, _ = ticks(link, 20, stiffness=0.2)
    fake.motion.slow_stiffness = 0.0
    shown = np.array([measurement.stiffness for measurement in on_the_way])[3:, soft]
    assert np.isnan(shown).all()
    last, _ = ticks(link, 60, stiffness=0.2)
    assert last[-1].stiffness is not None
    assert (last[-1].stiffness[soft] == 0.2).all()
    for nonsense in ([], [0.2] * 3, "soft"):
        fake.motion.stiffnesses = nonsense  # type: ignore[assignment]
        last, _ = ticks(link, 30, stiffness=0.2)
        assert last[-1].stiffness is not None
        assert np.isnan(last[-1].stiffness).all()


def test_samples_that_are_none(fake: FakeRobot, connection: Connection) -> None:
    link = made(connection)
    for bad in ([float("nan")] * 17, [0.0] * 3, []):
        fake.motion.commanded = bad
        measured, _ = ticks(link, 20)
        np.testing.assert_allclose(measured[-1].position, GOAL)
    assert measured[-1].age > 0.3
    with pytest.raises(BackendError, match="where its joints are"):
        made(connection)
