"""Taking a robot over from NAOqi, and giving it back whatever happened meanwhile."""

import logging
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from pepper_driver.backends.naoqi.connection import Connection, connect
from pepper_driver.backends.naoqi.ownership import ConsentError, TakeOver
from pepper_driver.backends.readiness import NotReadyError
from pepper_driver.config import NaoqiSettings, load_naoqi_settings
from pepper_driver.config.naoqi import TakeOverSettings
from support import ROOT as CHECKOUT
from support.naoqi_fakes import ROBOT, FakeRobot, address_of
from support.processes import suspend
from support.stand_ins import patient_driver

pytestmark = pytest.mark.usefixtures("qi")

SETTINGS = load_naoqi_settings()
IMPATIENT = replace(SETTINGS, take_over_time=0.5)
"""For what never comes."""
Log = list[tuple[Any, ...]]


@pytest.fixture(autouse=True, scope="module")
def _patient() -> Iterator[None]:
    with patient_driver():
        yield


@pytest.fixture
def fake() -> Iterator[FakeRobot]:
    with FakeRobot() as fake:
        yield fake


@pytest.fixture
def connection(fake: FakeRobot) -> Iterator[Connection]:
    connection = connect(fake.address, settings=SETTINGS)
    yield connection
    connection.close()


def policy(**changes: Any) -> NaoqiSettings:
    return replace(SETTINGS, take_over=replace(SETTINGS.take_over, **changes))


def take_over(
    connection: Connection, settings: NaoqiSettings = SETTINGS, *, wake: bool = False
) -> TakeOver:
    return TakeOver(connection, ROBOT, settings, wake=wake)


def enabled(fake: FakeRobot) -> set[tuple[str, str | None]]:
    return {switch for switch, on in fake.motion.on.items() if on}


def test_all_is_off_meanwhile_and_as_it_was_after(fake: FakeRobot, connection: Connection) -> None:
    fake.motion.on["Breath", "LArm"] = True
    fake.motion.on["IdlePosture", "Head"] = True
    fake.motion.on["SmartStiffness", None] = False  # by somebody else
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
    (told,) = [r.getMessage() for r in caplog.records if r.levelno == logging.WARNING]
    assert "fall manager" in told
    assert "/advanced/#/settings" in told


def test_a_switch_that_does_not_move(fake: FakeRobot, connection: Connection) -> None:
    """It says yes, and stays on: this is why all are read again."""
    fake.motion.stuck.add("SmartStiffness")
    with pytest.raises(NotReadyError, match="smart stiffness stays on; restart the robot"):
        take_over(connection, replace(SETTINGS, switch_time=0.2)).begin()
    assert ("CollisionProtection", "LArm") in enabled(fake)
    assert fake.life.state == "solitary"


def test_life_that_does_not_end(fake: FakeRobot, connection: Connection) -> None:
    fake.life.stays = True
    with pytest.raises(NotReadyError, match="autonomous life does not end"):
        take_over(connection, IMPATIENT).begin()


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
        take_over(connection, IMPATIENT, wake=True).begin()


def test_touch_is_stopped_and_started_on_request(fake: FakeRobot, connection: Connection) -> None:
    with take_over(connection, policy(touch="off")):
        assert ("touch", "exit") in fake.log
    assert ("launch", "altouch") in fake.log


def test_what_cannot_be_given_back_is_told_and_the_rest_is(
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
    (told,) = [r.getMessage() for r in caplog.records if r.levelno == logging.ERROR]
    assert told.endswith("did not get back: fall manager; restart the robot to have it as it was")


def test_a_robot_without_these_services() -> None:
    """Of another version: what is not there moves nothing."""
    with FakeRobot(without=("ALAutonomousLife", "ALTouch", "ALLauncher")) as fake:
        connection = connect(fake.address)
        with take_over(connection, policy(touch="off")):
            assert not enabled(fake)
        assert enabled(fake)
        connection.close()


def test_given_back_over_another_connection(fake: FakeRobot, connection: Connection) -> None:
    before = enabled(fake)
    first = connect(fake.address)
    taken = take_over(first)
    taken.begin()
    first.close()
    taken.restore(connection)
    assert enabled(fake) == before
    assert taken.left == ()


def test_a_lost_connection_is_told(fake: FakeRobot) -> None:
    connection = connect(fake.address)
    taken = take_over(connection)
    taken.begin()
    connection.close()
    taken.restore()
    assert "autonomous life" in taken.left
    assert "push recovery" in taken.left


def test_a_robot_that_hangs_is_not_waited_for() -> None:
    server = (
        f"import sys; sys.path.insert(0, {str(CHECKOUT / 'tests')!r})\n"
        "from support.naoqi_fakes import FakeRobot\n"
        "with FakeRobot() as fake: print(fake.uri, flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", server], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        try:
            connection = connect(address_of(process.stdout.readline().strip()))
            taken = take_over(connection)
            taken.begin()
            suspend(process.pid)
            started = time.monotonic()
            taken.restore()
            connection.close()
            assert len(taken.left) > 5
            assert time.monotonic() - started < 5 * SETTINGS.call_time, "once for all"
        finally:
            process.kill()
