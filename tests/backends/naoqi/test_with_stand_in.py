"""The whole way to a robot against the stand-in: what it does to the robot, seen by the robot's own black box."""

import os
import signal
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.backends import BackendError, Command, NotConnectedError, make_backend
from pepper_driver.backends.naoqi.angles import AnglesBackend
from pepper_driver.backends.naoqi.connection import Connection, LoginError, connect
from pepper_driver.backends.naoqi.ownership import ConsentError, TakeOver
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.backends.naoqi_server.tls import Login
from pepper_driver.backends.readiness import NotReadyError
from pepper_driver.cli.app import run
from pepper_driver.config import PepperError, load_naoqi_settings, load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.loading import package_file
from support.naoqi_fakes import address_of
from support.processes import suspend
from support.stand_ins import SILENCE, patient_driver, since
from support.waiting import wait_until

pytestmark = pytest.mark.usefixtures("qi")

ROBOT = load_robot()
SETTINGS = load_naoqi_settings()
HEAD = ROBOT.joint_index("HeadYaw")
STILL = np.zeros(3)


@pytest.fixture(autouse=True, scope="module")
def _patient() -> Iterator[None]:
    with patient_driver():
        yield


@pytest.fixture(scope="module")
def robot() -> Iterator[StandIn]:
    """Awake, without a life of its own; its owner has allowed everything."""
    with StandIn("mujoco://?seed=5", consent=True, network="clear") as running:
        connection = connect(address_of(uri_of(running)))
        connection.call("ALMotion", "wakeUp", timeout=20.0)
        connection.close()
        yield running


@pytest.fixture
def connection(robot: StandIn) -> Iterator[Connection]:
    connection = connect(address_of(uri_of(robot)))
    yield connection
    connection.call("ALAutonomousLife", "setState", "disabled", timeout=20.0)
    connection.close()


def uri_of(robot: StandIn, options: str = "") -> str:
    return f"naoqi://127.0.0.1:{robot.port}{options}"


def orders(robot: StandIn) -> int:
    """How many orders the DCM took in a time in which nobody here gives any."""
    before = robot.black_box(last=1).orders[-1]
    time.sleep(0.3)
    return int(robot.black_box(last=1).orders[-1] - before)


def quiet(robot: StandIn) -> bool:
    """Whether nobody moves the robot; whoever did may be about to end."""
    return wait_until(lambda: orders(robot) == 0)


def position(robot: StandIn) -> FloatArray:
    newest: FloatArray = robot.black_box(last=1).position[-1]
    return newest


def stiffness(robot: StandIn) -> FloatArray:
    newest: FloatArray = robot.black_box(last=1).stiffness[-1]
    return newest


# -- taking over ----------------------------------------------------------------------------------------------------


def test_nobody_else_moves_the_robot_meanwhile(robot: StandIn, connection: Connection) -> None:
    connection.call("ALAutonomousLife", "setState", "solitary", timeout=20.0)
    assert wait_until(lambda: orders(robot) > 3), "a living robot is moved all the time"
    with TakeOver(connection, ROBOT, SETTINGS) as taken:
        assert quiet(robot)
        assert connection.call("ALAutonomousLife", "getState") == "disabled"
        assert connection.call("ALMotion", "robotIsWakeUp")
        assert np.abs(taken.posture - position(robot)).max() < 0.1
    assert taken.left == ()
    assert wait_until(lambda: orders(robot) > 3)
    assert connection.call("ALAutonomousLife", "getState") == "solitary"


@pytest.fixture
def at_rest(connection: Connection) -> Iterator[None]:
    connection.call("ALMotion", "rest", timeout=20.0)
    yield
    connection.call("ALMotion", "wakeUp", timeout=20.0)


@pytest.mark.usefixtures("at_rest")
def test_a_robot_at_rest(robot: StandIn, connection: Connection) -> None:
    """Is refused; on request woken up, and sent to rest again."""
    with make_backend(uri_of(robot)) as backend:
        backend.open()
        with pytest.raises(NotReadyError, match=r"\?wake=1"):
            backend.activate()
        assert quiet(robot)
    with TakeOver(connection, ROBOT, SETTINGS, wake=True):
        assert connection.call("ALMotion", "robotIsWakeUp")
        assert not connection.call("ALMotion", "getPushRecoveryEnabled")
        assert quiet(robot)
    assert not connection.call("ALMotion", "robotIsWakeUp")
    assert connection.call("ALMotion", "getPushRecoveryEnabled")


def test_without_the_owners_consent() -> None:
    with StandIn("mujoco://?seed=5") as robot:
        connection = connect(address_of(uri_of(robot)))
        connection.call("ALMotion", "wakeUp", timeout=20.0)
        before = position(robot)
        with pytest.raises(ConsentError, match="/advanced/#/settings"):
            TakeOver(connection, ROBOT, SETTINGS).begin()
        assert connection.call("ALMotion", "getSmartStiffnessEnabled"), "given back"
        go_on = replace(
            SETTINGS, take_over=replace(SETTINGS.take_over, push_recovery="off if allowed")
        )
        with TakeOver(connection, ROBOT, go_on) as taken:
            assert set(taken.kept) == {
                "external-collision avoidance of Move",
                "fall manager",
                "push recovery",
            }
        connection.close()
        assert np.abs(position(robot) - before).max() < 0.02
        with make_backend(uri_of(robot, "?mode=angles")) as backend:
            backend.open()
            backend.activate()  # leaves on what needs the owner


# -- who is let in --------------------------------------------------------------------------------------------------


def test_over_tls(monkeypatch: pytest.MonkeyPatch) -> None:
    with StandIn("mujoco://?seed=5", login=Login(user="nao", token="sesame-8")) as robot:
        place = f"127.0.0.1:{robot.port}"
        monkeypatch.setenv("PEPPER_PASSWORD", "sesame-8")
        with make_backend(f"naoqis://nao@{place}?mode=angles") as backend:
            assert backend.open().position.shape == (17,)
            assert "sesame" not in repr(vars(backend))
        for uri, password in (
            (f"naoqis://nao@{place}", "wrong-9"),
            (f"naoqis://x@{place}", "sesame-8"),
        ):
            monkeypatch.setenv("PEPPER_PASSWORD", password)
            with pytest.raises(LoginError, match="wrong password") as caught:
                make_backend(uri).open()
            assert password not in str(caught.value)
        with pytest.raises(NotConnectedError, match=f"write naoqis://nao@{place}"):
            make_backend(f"naoqi://{place}").open()


def test_another_robot(robot: StandIn) -> None:
    robot.set_fault("wrong-type")
    try:
        with pytest.raises(NotReadyError, match="is a 'Nao', and not a Pepper"):
            make_backend(uri_of(robot)).open()
    finally:
        robot.clear_faults()


def test_what_the_robot_finds_broken(robot: StandIn) -> None:
    connection = connect(address_of(uri_of(robot)))
    before = position(robot)
    with make_backend(uri_of(robot)) as backend:
        backend.open()
        assert backend.diagnosis() == ()
        connection.call("ALMemory", "insertData", "Diagnosis/Passive/KneePitch/Error", 1)
        try:
            (error,) = backend.diagnosis() or ()
            assert (error.device, error.serious) == ("KneePitch", True)
            with pytest.raises(NotReadyError, match="KneePitch: its board does not answer"):
                backend.activate()
        finally:
            connection.call("ALMemory", "insertData", "Diagnosis/Passive/KneePitch/Error", 0)
            connection.close()
    assert np.abs(position(robot) - before).max() < 0.03, "its arms settle"


def test_the_doctor(
    robot: StandIn, connection: Connection, capsys: pytest.CaptureFixture[str]
) -> None:
    key = "Diagnosis/Temperature/LElbowRoll/Error"
    connection.call("ALMemory", "insertData", key, 1)
    assert run(["doctor", uri_of(robot), "--no-motion"]) == 1
    connection.call("ALMemory", "insertData", key, 0)
    table = capsys.readouterr().out
    for check in ("connection", "joints", "battery", "charging flap", "models"):
        assert any(row.startswith("ok") and check in row for row in table.splitlines()), table
    assert any(row.startswith("FAILED") and "diagnosis" in row for row in table.splitlines())
    assert "LElbowRoll: too hot" in table


# -- without the DCM ------------------------------------------------------------------------------------------------


def sway(
    backend: AnglesBackend, centre: FloatArray, steps: int, *, size: float = 0.3
) -> FloatArray:
    """Let the head sway, in real time; returns how old each sample was."""
    ages = np.zeros(steps)
    due = time.monotonic()
    for step in range(steps):
        goal = centre.copy()
        goal[HEAD] += size * np.sin(2 * np.pi * 0.4 * step * ROBOT.cycle)
        command = Command(position=goal, stiffness=np.ones(17), wheel_speed=np.full(3, 0.5))
        ages[step] = backend.exchange(command).age
        due = max(due + ROBOT.cycle, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))
    return ages


@pytest.fixture
def angles(robot: StandIn) -> Iterator[AnglesBackend]:
    backend = make_backend(uri_of(robot, "?mode=angles"))
    assert isinstance(backend, AnglesBackend)
    yield backend
    backend.close()
    robot.clear_faults()


def test_angles_only_on_request(robot: StandIn) -> None:
    robot.set_fault("missing:DCM")
    try:
        with pytest.raises(NotReadyError, match=r"has no DCM.*\?mode=angles"):
            make_backend(uri_of(robot)).open()
        with make_backend(uri_of(robot, "?mode=angles")) as backend:
            assert backend.open().position == pytest.approx(position(robot), abs=0.01)
            backend.activate()
    finally:
        robot.clear_faults()


def test_joints_follow_through_almotion(robot: StandIn, angles: AnglesBackend) -> None:
    before = angles.open()
    start = position(robot)
    angles.exchange(
        Command(position=before.position + 0.2, stiffness=np.ones(17), wheel_speed=np.ones(3))
    )
    time.sleep(0.3)
    assert np.abs(position(robot) - start).max() < 0.01, "not active yet"
    hold = angles.activate()
    base = robot.black_box(last=1).base[-1]
    sway(angles, hold.position, 420)
    seen = robot.black_box(last=400)
    assert np.ptp(seen.position[:, HEAD]) == pytest.approx(0.6, abs=0.12)
    others = np.delete(np.arange(17), [HEAD])
    assert np.ptp(seen.position[:, others], axis=0).max() < 0.1
    assert seen.stiffness.min() > 0.9
    assert np.abs(seen.base[-1] - base).max() < 0.02, "the base stands still"
    assert np.abs(seen.wheel_speed).max() < 0.3


def test_what_it_is_in_angles_mode(angles: AnglesBackend, robot: StandIn) -> None:
    info = angles.info
    assert info.identity.endswith("/angles"), "models of the other way are none of this one"
    assert info.response_delay == SETTINGS.angles.response_delay
    with pytest.raises(NotConnectedError, match="is not open"):
        angles.activate()
    angles.open()
    angles.activate()
    with pytest.raises(BackendError, match="by its own program"):
        angles.services.rest()
    assert wait_until(lambda: stiffness(robot).min() > 0.9)
    angles.deactivate()
    legs = [ROBOT.joint_index(name) for name in ROBOT.chains["legs"]]
    assert wait_until(lambda: np.delete(stiffness(robot), legs).max() < 0.01)
    assert stiffness(robot)[legs].min() > 0.5, "without it the robot would bow"


def test_stiffness_is_passed_on_but_for_the_legs(robot: StandIn, angles: AnglesBackend) -> None:
    angles.open()
    hold = angles.activate()
    wanted = np.ones(17)
    wanted[HEAD] = 0.4
    command = Command(position=hold.position, stiffness=wanted, wheel_speed=STILL)

    def told() -> bool:
        angles.exchange(command)
        return bool(abs(stiffness(robot)[HEAD] - 0.4) < 0.02)

    assert wait_until(told)
    wanted[ROBOT.joint_index("KneePitch")] = 0.0
    for _ in range(20):
        angles.exchange(command)
        time.sleep(ROBOT.cycle)
    assert stiffness(robot)[ROBOT.joint_index("KneePitch")] > 0.9


def test_a_robot_that_hangs_in_angles_mode(robot: StandIn, angles: AnglesBackend) -> None:
    angles.open()
    hold = angles.activate()
    sway(angles, hold.position, 60)
    suspend(robot.naoqi_process.pid)
    try:
        ages = sway(angles, hold.position, 40)
        assert ages[-1] > 0.3
        started = time.monotonic()
        angles.close()
        assert time.monotonic() - started < 5 * SILENCE, "it waits for no answer any more"
    finally:
        os.kill(robot.naoqi_process.pid, signal.SIGCONT)


def test_angles_mode_after_the_connection_is_lost(robot: StandIn, angles: AnglesBackend) -> None:
    angles.open()
    hold = angles.activate()
    sway(angles, hold.position, 100)
    robot.set_fault("cut")

    def lost() -> bool:
        try:
            sway(angles, hold.position, 1)
        except NotConnectedError:
            return True
        return False

    assert wait_until(lost)
    lost_at = time.monotonic()
    assert wait_until(lambda: len(since(robot, lost_at)) > 80)
    stays = since(robot, lost_at).position[40:]
    assert np.ptp(stays, axis=0).max() < 0.01, "the joints stay where they are"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("?mode=angels", "did you mean angles"),
        ("?mode=angles&delay=3", "unknown key 'delay'"),
        ("?wake=2", "wake takes 0 or 1"),
        ("?settings=nowhere.yaml", "nowhere.yaml"),
    ],
)
def test_wrong_options(options: str, message: str) -> None:
    with pytest.raises(PepperError, match=message) as caught:
        make_backend(f"naoqi://127.0.0.1{options}")
    assert "\n" not in str(caught.value)


def test_settings_of_ones_own(robot: StandIn, tmp_path: Path) -> None:
    """With the charging flap open head and arms can be moved, where its user says so."""
    mine = tmp_path / "mine.yaml"
    shipped = package_file("naoqi_settings.yaml").read_text()
    mine.write_text(shipped.replace("charging_flap: refuse", "charging_flap: stand"))
    robot.set_fault("value:Platform/ILS/Sensor/Value,1")
    try:
        with make_backend(uri_of(robot, "?mode=angles")) as backend:
            assert backend.open().charging_flap == 1.0
            with pytest.raises(NotReadyError, match="charging flap: open"):
                backend.activate()
        with make_backend(uri_of(robot, f"?mode=angles&settings={mine}")) as backend:
            backend.open()
            backend.activate()
    finally:
        robot.clear_faults()
