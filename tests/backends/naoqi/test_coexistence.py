"""Taking a robot over from NAOqi, and giving it back whatever happened meanwhile."""

import logging
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.backends.naoqi.ownership import ConsentError, TakeOver
from pepper_driver.backends.readiness import NotReadyError
from pepper_driver.config import NaoqiSettings
from pepper_driver.config.naoqi import TakeOverSettings
from support.doctor import passing_clock
from support.naoqi_fakes import PATIENT, ROBOT, FakeRobot

pytestmark = pytest.mark.usefixtures("qi")

Log = list[tuple[Any, ...]]


@pytest.fixture
def fake() -> Iterator[FakeRobot]:
    with FakeRobot() as fake:
        yield fake


@pytest.fixture
def connection(fake: FakeRobot) -> Iterator[Connection]:
    connection = fake.connect()
    yield connection
    connection.close()


def policy(**changes: Any) -> NaoqiSettings:
    return replace(PATIENT, take_over=replace(PATIENT.take_over, **changes))


def take_over(
    connection: Connection, settings: NaoqiSettings = PATIENT, *, wake: bool = False
) -> TakeOver:
    """Return one that has patience with calls, and whose clock passes at once where it would wait."""
    return TakeOver(connection, ROBOT, settings, wake=wake, clock=passing_clock())


def enabled(fake: FakeRobot) -> set[tuple[str, str | None]]:
    return {switch for switch, on in fake.motion.on.items() if on}


def test_all_is_off_meanwhile_and_as_it_was_after(fake: FakeRobot, connection: Connection) -> None:
    fake.motion.on["Breath", "LArm"] = True
    fake.motion.on["IdlePosture", "Head"] = True
    fake.motion.on["SmartStiffness", None] = False  # by another program
    before = enabled(fake)
    fake.motion.commanded[3] = 0.25
    with take_over(connection) as taken:
        assert not enabled(fake)
        assert fake.life.state == "disabled"
        assert taken.posture.tolist() == fake.motion.commanded
        assert taken.kept == ()
    assert enabled(fake) == before
    assert fake.life.state == "solitary"
    assert fake.motion.is_awake
    assert taken.left == ()


def test_given_back_in_reverse_order_and_once(fake: FakeRobot, connection: Connection) -> None:
    taken = take_over(connection)
    taken.begin()
    off: Log = [entry for entry in fake.log if entry[-1] is False]
    assert fake.log[:2] == [("life", "disabled"), ("killAll",)], "tasks end after what starts them"
    fake.log.clear()
    taken.restore()
    assert fake.log == [(*entry[:-1], True) for entry in reversed(off)] + [("life", "solitary")]
    fake.log.clear()
    taken.restore()
    assert fake.log == []


def test_given_back_after_an_exception(fake: FakeRobot, connection: Connection) -> None:
    before = enabled(fake)
    with pytest.raises(KeyError), take_over(connection):
        raise KeyError("a user's mistake")
    assert enabled(fake) == before
    assert fake.life.state == "solitary"


def test_what_is_off_stays_off(fake: FakeRobot, connection: Connection) -> None:
    fake.life.state = "disabled"
    fake.motion.on["FallManager", None] = False
    with take_over(connection):
        pass
    assert fake.life.state == "disabled"
    assert ("FallManager", None) not in enabled(fake)
    assert ("FallManager", None, True) not in fake.log


def test_what_is_kept_is_not_touched(fake: FakeRobot, connection: Connection) -> None:
    every = dict.fromkeys(TakeOverSettings.__dataclass_fields__, "keep")
    before = enabled(fake)
    with take_over(connection, policy(**every)):
        assert enabled(fake) == before
        assert fake.life.state == "solitary"
    assert fake.log == [("killAll",)]


def test_without_consent_nothing_is_taken(fake: FakeRobot, connection: Connection) -> None:
    fake.motion.allowed = False
    before = enabled(fake)
    with pytest.raises(ConsentError) as caught:
        take_over(connection).begin()
    message = str(caught.value)
    assert "\n" not in message
    assert "push recovery stays on" in message
    assert "http://127.0.0.1/advanced/#/settings" in message
    assert "push_recovery: off if allowed" in message
    assert "the owner of this robot has not allowed it" in message
    assert enabled(fake) == before
    assert fake.life.state == "solitary"


def test_without_consent_one_may_go_on_with_what_is_allowed(
    fake: FakeRobot, connection: Connection, caplog: pytest.LogCaptureFixture
) -> None:
    fake.motion.allowed = False
    critical = {
        ("ExternalCollisionProtection", "Move"),
        ("FallManager", None),
        ("PushRecovery", None),
    }
    with take_over(connection, policy(push_recovery="off if allowed")) as taken:
        assert enabled(fake) == critical
        assert set(taken.kept) == {
            "external-collision avoidance of Move",
            "fall manager",
            "push recovery",
        }
    (reported,) = [r.getMessage() for r in caplog.records if r.levelno == logging.WARNING]
    assert "fall manager" in reported
    assert "/advanced/#/settings" in reported


def test_a_switch_that_does_not_move(fake: FakeRobot, connection: Connection) -> None:
    """It says yes, and stays on: this is why all are read again."""
    fake.motion.stuck.add("SmartStiffness")
    with pytest.raises(NotReadyError, match="smart stiffness stays on; restart the robot"):
        take_over(connection).begin()
    assert ("CollisionProtection", "LArm") in enabled(fake)
    assert fake.life.state == "solitary"


def test_life_that_does_not_end(fake: FakeRobot, connection: Connection) -> None:
    fake.life.stays = True
    with pytest.raises(NotReadyError, match="autonomous life does not end"):
        take_over(connection).begin()


def test_a_robot_that_lies_down_when_life_ends_is_woken_up_again(
    fake: FakeRobot, connection: Connection
) -> None:
    fake.life.lies_down = True
    with take_over(connection):
        assert fake.motion.is_awake
        assert not enabled(fake), "waking up switches protections on"
        assert fake.log.index(("wakeUp",)) < fake.log.index(("PushRecovery", None, False))
    assert ("rest",) not in fake.log, "it was awake before"


def test_a_robot_at_rest_is_woken_up_on_request_and_rests_again(
    fake: FakeRobot, connection: Connection
) -> None:
    fake.motion.is_awake = False
    fake.life.state = "disabled"
    with pytest.raises(NotReadyError, match="wake=1"):
        take_over(connection).begin()
    assert ("wakeUp",) not in fake.log
    with take_over(connection, wake=True):
        assert fake.motion.is_awake
    assert fake.log[-1] == ("rest",), "protections are on before it moves to rest"
    assert not fake.motion.is_awake


def test_a_robot_that_does_not_wake_up(fake: FakeRobot, connection: Connection) -> None:
    fake.motion.is_awake = False
    fake.motion.stuck.add("wakeUp")
    with pytest.raises(NotReadyError, match="does not wake up"):
        take_over(connection, wake=True).begin()


def test_touch_is_stopped_and_started_on_request(fake: FakeRobot, connection: Connection) -> None:
    with take_over(connection, policy(touch="off")):
        assert ("touch", "exit") in fake.log
    assert ("launch", "altouch") in fake.log


def test_what_cannot_be_given_back_is_reported_and_the_rest_is(
    fake: FakeRobot, connection: Connection, caplog: pytest.LogCaptureFixture
) -> None:
    before = enabled(fake)
    taken = take_over(connection)
    taken.begin()
    fake.motion.refuses.add("FallManager")
    taken.restore()
    assert taken.left == ("fall manager",)
    assert enabled(fake) == before - {("FallManager", None)}
    assert fake.life.state == "solitary"
    (reported,) = [r.getMessage() for r in caplog.records if r.levelno == logging.ERROR]
    assert reported.endswith(
        "did not get back: fall manager; restart the robot to have it as it was"
    )


def test_a_robot_without_these_services() -> None:
    """As of another version: what is not there moves nothing."""
    with FakeRobot(without=("ALAutonomousLife", "ALTouch", "ALLauncher")) as fake:
        connection = fake.connect()
        with take_over(connection, policy(touch="off")):
            assert not enabled(fake)
        assert enabled(fake)
        connection.close()


def test_given_back_over_another_connection(fake: FakeRobot, connection: Connection) -> None:
    before = enabled(fake)
    first = fake.connect()
    taken = take_over(first)
    taken.begin()
    first.close()
    taken.restore(connection)
    assert enabled(fake) == before
    assert taken.left == ()


def test_a_lost_connection_is_reported(fake: FakeRobot) -> None:
    connection = fake.connect()
    taken = take_over(connection)
    taken.begin()
    connection.close()
    taken.restore()
    assert "autonomous life" in taken.left
    assert "push recovery" in taken.left
