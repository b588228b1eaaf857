"""The driver against the stand-in in virtual time: what it does to the robot, seen by the robot's own black box."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.backends import BackendError, Command, NotConnectedError, make_backend
from pepper_driver.backends.naoqi.angles import AnglesBackend
from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.backends.naoqi.ownership import ConsentError, TakeOver
from pepper_driver.backends.readiness import NotReadyError
from pepper_driver.config import NaoqiSettings, PepperError, load_naoqi_settings, load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.loading import package_file
from support.virtual_naoqi import VirtualNaoqi

pytestmark = pytest.mark.usefixtures("qi")

ROBOT = load_robot()
SETTINGS = load_naoqi_settings()
HEAD = ROBOT.joint_index("HeadYaw")
STILL = np.zeros(3)


@pytest.fixture
def robot() -> Iterator[VirtualNaoqi]:
    """Awake, without a life of its own; its owner has allowed everything."""
    with VirtualNaoqi("mujoco://?seed=5") as robot:
        robot.wake_up()
        yield robot


@pytest.fixture
def connection(robot: VirtualNaoqi) -> Connection:
    return robot.connect()


def take_over(
    robot: VirtualNaoqi,
    connection: Connection,
    settings: NaoqiSettings = SETTINGS,
    *,
    wake: bool = False,
) -> TakeOver:
    return TakeOver(connection, ROBOT, settings, wake=wake, clock=robot.time.clock())


def orders(robot: VirtualNaoqi) -> int:
    """Number of orders that the DCM took in a time in which this test gives none."""
    before = robot.black_box(last=1).orders[-1]
    robot.time.sleep(0.3)
    return int(robot.black_box(last=1).orders[-1] - before)


def quiet(robot: VirtualNaoqi) -> bool:
    """Return True if no program moves the robot; the one that did may be about to end."""
    return robot.time.clock().wait_for(lambda: orders(robot) == 0, 5.0)


def position(robot: VirtualNaoqi) -> FloatArray:
    newest: FloatArray = robot.black_box(last=1).position[-1]
    return newest


def stiffness(robot: VirtualNaoqi) -> FloatArray:
    newest: FloatArray = robot.black_box(last=1).stiffness[-1]
    return newest


# -- taking over ----------------------------------------------------------------------------------------------------


def test_no_other_program_moves_the_robot_meanwhile(
    robot: VirtualNaoqi, connection: Connection
) -> None:
    connection.call("ALAutonomousLife", "setState", "solitary", timeout=20.0)
    assert robot.time.clock().wait_for(lambda: orders(robot) > 3), (
        "a living robot is moved all the time"
    )
    with take_over(robot, connection) as taken:
        assert quiet(robot)
        assert connection.call("ALAutonomousLife", "getState") == "disabled"
        assert connection.call("ALMotion", "robotIsWakeUp")
        assert np.abs(taken.posture - position(robot)).max() < 0.1
    assert taken.left == ()
    assert robot.time.clock().wait_for(lambda: orders(robot) > 3)
    assert connection.call("ALAutonomousLife", "getState") == "solitary"


@pytest.fixture
def at_rest(connection: Connection) -> Iterator[None]:
    connection.call("ALMotion", "rest", timeout=20.0)
    yield
    connection.call("ALMotion", "wakeUp", timeout=20.0)


@pytest.mark.usefixtures("at_rest")
def test_a_robot_at_rest(robot: VirtualNaoqi, connection: Connection) -> None:
    """Is refused; on request woken up, and sent to rest again."""
    with robot.backend() as backend:
        backend.open()
        with pytest.raises(NotReadyError, match=r"\?wake=1"):
            backend.activate()
        assert quiet(robot)
    with take_over(robot, connection, wake=True):
        assert connection.call("ALMotion", "robotIsWakeUp")
        assert not connection.call("ALMotion", "getPushRecoveryEnabled")
        assert quiet(robot)
    assert not connection.call("ALMotion", "robotIsWakeUp")
    assert connection.call("ALMotion", "getPushRecoveryEnabled")


def test_without_the_owners_consent() -> None:
    with VirtualNaoqi("mujoco://?seed=5", consent=False) as robot:
        connection = robot.connect()
        connection.call("ALMotion", "wakeUp", timeout=20.0)
        before = position(robot)
        with pytest.raises(ConsentError, match="/advanced/#/settings"):
            take_over(robot, connection).begin()
        assert connection.call("ALMotion", "getSmartStiffnessEnabled"), "given back"
        go_on = replace(
            SETTINGS, take_over=replace(SETTINGS.take_over, push_recovery="off if allowed")
        )
        with take_over(robot, connection, go_on) as taken:
            assert set(taken.kept) == {
                "external-collision avoidance of Move",
                "fall manager",
                "push recovery",
            }
        connection.close()
        assert np.abs(position(robot) - before).max() < 0.02
        with robot.backend("angles") as backend:
            backend.open()
            backend.activate()  # leaves on what needs the owner


def test_a_robot_that_hangs_is_not_waited_for(robot: VirtualNaoqi, connection: Connection) -> None:
    taken = take_over(robot, connection)
    taken.begin()
    robot.suspend_naoqi()
    begun = robot.time.seconds()
    taken.restore()
    assert robot.time.seconds() - begun == pytest.approx(SETTINGS.alive_time), "once for all"
    assert len(taken.left) > 5


# -- who is let in --------------------------------------------------------------------------------------------------


def test_another_robot(robot: VirtualNaoqi) -> None:
    robot.set_fault("wrong-type")
    try:
        with pytest.raises(NotReadyError, match="is a 'Nao', and not a Pepper"):
            robot.backend().open()
    finally:
        robot.clear_faults()


def test_what_the_robot_finds_broken(robot: VirtualNaoqi) -> None:
    connection = robot.connect()
    before = position(robot)
    with robot.backend() as backend:
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


# -- without the DCM ------------------------------------------------------------------------------------------------


def sway(
    backend: AnglesBackend, centre: FloatArray, steps: int, *, size: float = 0.3
) -> FloatArray:
    """Let the head sway; returns how old each sample was."""
    ages = np.zeros(steps)
    clock = backend.clock
    due = clock.seconds()
    for step in range(steps):
        goal = centre.copy()
        goal[HEAD] += size * np.sin(2 * np.pi * 0.4 * step * ROBOT.cycle)
        command = Command(position=goal, stiffness=np.ones(17), wheel_speed=np.full(3, 0.5))
        ages[step] = backend.exchange(command).age
        due = max(due + ROBOT.cycle, clock.seconds())
        clock.sleep(max(0.0, due - clock.seconds()))
    return ages


@pytest.fixture
def angles(robot: VirtualNaoqi) -> Iterator[AnglesBackend]:
    backend = robot.backend("angles")
    assert isinstance(backend, AnglesBackend)
    yield backend
    backend.close()
    robot.clear_faults()


def test_angles_only_on_request(robot: VirtualNaoqi) -> None:
    robot.set_fault("missing:DCM")
    try:
        with pytest.raises(NotReadyError, match=r"has no DCM.*\?mode=angles"):
            robot.backend().open()
        with robot.backend("angles") as backend:
            assert backend.open().position == pytest.approx(position(robot), abs=0.01)
            backend.activate()
    finally:
        robot.clear_faults()


def test_joints_follow_through_almotion(robot: VirtualNaoqi, angles: AnglesBackend) -> None:
    before = angles.open()
    start = position(robot)
    angles.exchange(
        Command(position=before.position + 0.2, stiffness=np.ones(17), wheel_speed=np.ones(3))
    )
    robot.time.sleep(0.3)
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


def test_what_it_is_in_angles_mode(angles: AnglesBackend, robot: VirtualNaoqi) -> None:
    info = angles.info
    assert info.identity.endswith("/angles"), "models of the other way are none of this one"
    assert info.response_delay == SETTINGS.angles.response_delay
    with pytest.raises(NotConnectedError, match="is not open"):
        angles.activate()
    angles.open()
    angles.activate()
    with pytest.raises(BackendError, match="by its own program"):
        angles.services.rest()
    assert robot.time.clock().wait_for(lambda: stiffness(robot).min() > 0.9)
    angles.deactivate()
    legs = [ROBOT.joint_index(name) for name in ROBOT.chains["legs"]]
    assert robot.time.clock().wait_for(lambda: np.delete(stiffness(robot), legs).max() < 0.01)
    assert stiffness(robot)[legs].min() > 0.5, "without it the robot would bow"


def test_stiffness_is_passed_on_but_for_the_legs(
    robot: VirtualNaoqi, angles: AnglesBackend
) -> None:
    angles.open()
    hold = angles.activate()
    requested = np.ones(17)
    requested[HEAD] = 0.4
    command = Command(position=hold.position, stiffness=requested, wheel_speed=STILL)

    def arrived() -> bool:
        angles.exchange(command)
        return bool(abs(stiffness(robot)[HEAD] - 0.4) < 0.02)

    assert robot.time.clock().wait_for(arrived)
    requested[ROBOT.joint_index("KneePitch")] = 0.0
    for _ in range(20):
        angles.exchange(command)
        robot.time.sleep(ROBOT.cycle)
    assert stiffness(robot)[ROBOT.joint_index("KneePitch")] > 0.9


def test_a_robot_that_hangs_in_angles_mode(robot: VirtualNaoqi, angles: AnglesBackend) -> None:
    angles.open()
    hold = angles.activate()
    sway(angles, hold.position, 60)
    robot.suspend_naoqi()
    try:
        ages = sway(angles, hold.position, 40)
        assert ages[-1] > 0.3
        started = robot.time.seconds()
        angles.close()
        assert robot.time.seconds() - started < SETTINGS.end_silence + SETTINGS.call_time, (
            "it waits for no answer any more"
        )
    finally:
        robot.resume_naoqi()


def test_angles_mode_after_the_connection_is_lost(
    robot: VirtualNaoqi, angles: AnglesBackend
) -> None:
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

    assert robot.time.clock().wait_for(lost)
    lost_at = robot.time.seconds()
    assert robot.time.clock().wait_for(lambda: len(robot.since(lost_at)) > 80)
    stays = robot.since(lost_at).position[40:]
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


def test_settings_of_ones_own(robot: VirtualNaoqi, tmp_path: Path) -> None:
    """With the charging flap open head and arms can be moved, where its user says so."""
    mine = tmp_path / "mine.yaml"
    shipped = package_file("naoqi_settings.yaml").read_text()
    mine.write_text(shipped.replace("charging_flap: refuse", "charging_flap: stand"))
    robot.set_fault("value:Platform/ILS/Sensor/Value,1")
    try:
        with robot.backend("angles") as backend:
            assert backend.open().charging_flap == 1.0
            with pytest.raises(NotReadyError, match="charging flap: open"):
                backend.activate()
        with robot.backend("angles", load_naoqi_settings(mine)) as backend:
            backend.open()
            backend.activate()
    finally:
        robot.clear_faults()
