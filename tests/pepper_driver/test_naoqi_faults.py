"""A robot when something goes wrong with NAOqi, the network or itself, and what its program then says.

In virtual time, at the bounds that are shipped; what the robot did is in its black box.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.backends import Command, NotConnectedError
from pepper_driver.backends.naoqi.presence import SecondDriverError
from pepper_driver.callbacks.events import FaultEvent
from pepper_driver.config import PepperError, load_naoqi_settings, load_safety_settings
from pepper_driver.log import read_log
from pepper_driver.safety import FaultError, FaultReason
from support.naoqi_faults import (
    ROBOT,
    STANDS,
    assert_drives,
    assert_joints_hold,
    assert_wheels_stop,
    begin_to_move,
    drive,
    drive_through,
    max_step,
    move_arms,
)
from support.virtual_naoqi import VirtualNaoqi

MAX_STEP = 0.02  # [rad] of a joint's command, from a cycle to the next
SAFETY = load_safety_settings()
SETTINGS = load_naoqi_settings()
pytestmark = pytest.mark.usefixtures("qi")


@pytest.fixture
def robot() -> Iterator[VirtualNaoqi]:
    """Awake, and its owner allows all."""
    with VirtualNaoqi() as robot:
        robot.wake_up()
        yield robot


# -- a robot that sends nothing, or receives nothing -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "kind", "words"),
    [
        ("cut", NotConnectedError, "connection was lost"),
        ("kill", NotConnectedError, "connection was lost"),
        ("blocked", FaultError, "newest sample is"),
        ("stall:DCM", FaultError, "newest sample is"),
        ("error:DCM", FaultError, "newest sample is"),
        ("none:Position", FaultError, "newest sample is"),
        ("dropped", FaultError, "newest sample is"),
        ("slow:1.5", FaultError, "newest sample is"),
    ],
)
def test_wheels_stop_and_joints_hold(
    robot: VirtualNaoqi, fault: str, kind: type[Exception], words: str
) -> None:
    slow = fault.startswith("slow")  # the two commands under way then still come
    outcome = drive(robot, fault, 3.0, watch=2.0 if slow else 0.3)
    assert isinstance(outcome.error, kind), outcome.error
    assert words in str(outcome.error)
    assert len(str(outcome.error).splitlines()) == 1
    assert_wheels_stop(outcome.box)
    assert_joints_hold(outcome.box, outcome.ended, late=MAX_STEP if slow else 0.0)
    assert max_step(outcome.box) <= MAX_STEP
    # A service that is asked to get back what it had may not answer.
    assert outcome.closed < 2 * SETTINGS.end_silence + 2 * SETTINGS.call_time
    if kind is FaultError:
        ages = [age for _, age in outcome.ages]
        # The first tick beyond the bound is the last.
        assert max(ages[:-1], default=0.0) <= SAFETY.stale_fault < ages[-1]
    else:
        assert outcome.ended - outcome.begun <= 2 * ROBOT.cycle, "a loss is known at once"


def test_a_robot_that_goes_on_takes_at_most_two_commands(robot: VirtualNaoqi) -> None:
    """Commands that waited are old: no wheel turns by them, and no joint goes far."""
    outcome = drive(robot, "hang", 3.0)
    assert isinstance(outcome.error, FaultError)
    ages = [age for _, age in outcome.ages]
    # The first tick beyond it is the last.
    assert max(ages[:-1], default=0.0) <= SAFETY.stale_fault < ages[-1]
    assert outcome.closed < 2 * SETTINGS.end_silence + 2 * SETTINGS.call_time
    assert_wheels_stop(outcome.box)
    assert_joints_hold(outcome.box, outcome.ended)
    orders, commanded = outcome.box.orders[-1], outcome.box.position_command[-1]
    continues = robot.time.seconds()
    robot.clear_faults()
    robot.time.sleep(0.012 * 25)
    box = robot.since(continues)
    soon = box.begin < continues + 0.02  # before ALMotion's first own cycle has an effect
    assert box.orders[soon][-1] - orders <= 2
    assert np.abs(box.position_command[soon] - commanded).max() <= MAX_STEP
    assert not box.wheel_command[-1].any()
    assert np.abs(box.wheel_speed).max() <= STANDS


# -- the robot is not well ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "words"),
    [("press:ChestBoard/Button", "chest"), ("hot:LElbowRoll,80", "LElbowRoll")],
)
def test_the_safety_gate_stops_a_robot_that_is_not_well(
    robot: VirtualNaoqi, fault: str, words: str
) -> None:
    outcome = drive(robot, fault, 5.0)
    assert isinstance(outcome.error, FaultError)
    assert words in str(outcome.error)
    assert_wheels_stop(outcome.box)
    assert_joints_hold(outcome.box, outcome.ended)


def test_what_is_borne_moves_on_without_a_jump(robot: VirtualNaoqi) -> None:
    faults = ["network:wifi", "dropped:0.3", "none:Temperature", "slow:0.005", "press:FrontLeft"]
    *borne, bumped = drive_through(robot, faults, 0.6)
    for fault, outcome in zip(faults, borne, strict=False):
        assert outcome.error is None, fault
        assert np.median([age for _, age in outcome.ages]) < 0.03, fault
        assert max_step(outcome.box) <= MAX_STEP, fault
        assert outcome.box.wheel_command[-25:].any(), fault
    # A bumper stops the base alone.
    assert bumped.error is None
    assert_wheels_stop(bumped.box)
    # Arms that turn round just then do not come far.
    after = bumped.box.begin > bumped.begun
    turned = np.abs(np.diff(bumped.box.position_command[after], axis=0)).max(axis=1)
    assert np.count_nonzero(turned > 1e-5) > 10


def test_a_disconnected_joint_is_reported_and_sinks(robot: VirtualNaoqi) -> None:
    """The others go on until its command has left what it shows: at rest it would not show."""
    outcome = drive(robot, "disconnected:LShoulderPitch", 5.0)
    assert isinstance(outcome.error, FaultError)
    assert outcome.error.fault.reason is FaultReason.FROZEN_JOINT
    assert "LShoulderPitch does not answer" in str(outcome.error)
    place = ROBOT.joint_index("LShoulderPitch")
    box = outcome.box
    dead = int(np.argmax(box.stiffness[:, place] == 0.0))
    distance = np.abs(box.position_command[:, place] - box.position_command[dead, place]).max()
    assert SAFETY.frozen_distance - 0.05 < distance < SAFETY.following_error, (
        "sooner than by its distance alone"
    )
    assert_wheels_stop(box)
    assert_joints_hold(box, outcome.ended, but=["LShoulderPitch"])


def test_a_joint_without_values_is_named(robot: VirtualNaoqi) -> None:
    outcome = drive(robot, "none:RElbowYaw", 3.0)
    assert isinstance(outcome.error, FaultError)
    assert outcome.error.fault.reason is FaultReason.STALE_SAMPLE
    assert "no answer from RElbowYaw" in str(outcome.error)
    assert_wheels_stop(outcome.box)


def test_a_robot_that_falls_asleep_stops_and_lets_its_arms_sink(robot: VirtualNaoqi) -> None:
    """No program gives it stiffness again; nor does waking up make it go on where it was."""
    outcome = drive(robot, "asleep", 5.0, watch=1.2)  # wheels without power run out
    assert isinstance(outcome.error, FaultError)
    assert outcome.error.fault.reason is FaultReason.STIFFNESS
    assert "all joints" in str(outcome.error)
    box = outcome.box
    asleep = box.begin > outcome.begun
    assert not box.stiffness[asleep].any()
    assert not box.wheel_command[asleep].any()
    assert np.abs(box.wheel_speed[-1]).max() <= STANDS
    # In cycles of the robot: from the first without stiffness to the last order.
    fell = int(np.argmax(~box.stiffness.any(axis=1)))
    last = int(np.flatnonzero(np.diff(box.orders))[-1])
    noticed = (last - fell) * ROBOT.cycle
    assert SAFETY.stiffness_time - ROBOT.cycle <= noticed < SAFETY.stiffness_time + 0.1


@pytest.mark.parametrize("mode", ["dcm", "angles"])
def test_a_program_that_makes_an_arm_soft_stops_the_robot(
    robot: VirtualNaoqi, tmp_path: Path, mode: str
) -> None:
    """By the way of all faults: FAULT, the log and callbacks have it; the arm stays soft."""
    log, reported = tmp_path / "run.mcap", list[FaultEvent]()
    pepper = robot.pepper(mode, log=log)
    pepper.on_fault()(reported.append)
    with pepper:
        pepper.run(0.5)
        robot.call("ALMotion", "setStiffnesses", "RArm", 0.0)
        with pytest.raises(FaultError, match="RShoulderPitch, RShoulderRoll, RElbowYaw and 3"):
            pepper.run(10.0)
    assert [event.fault.reason for event in reported] == [FaultReason.STIFFNESS]
    (event,) = (event for event in read_log(log).events if event.kind == "fault")
    assert (event.name, event.text) == ("stiffness", reported[0].fault.text)
    logged = read_log(log)["stiffness"]
    arm = [ROBOT.joint_index(name) for name in ROBOT.chains["right_arm"]]
    assert not logged[-1, arm].any()


def command_head(robot: VirtualNaoqi) -> None:
    """Command the head by the DCM from another program, again and again."""
    dcm = robot.connect()

    def command() -> None:
        date = dcm.call("DCM", "getTime", 20)
        dcm.call("DCM", "set", ["HeadYaw/Position/Actuator/Value", "ClearAll", [[0.5, date]]])

    def work() -> None:
        while True:
            command()
            robot.time.sleep(0.02)

    robot.time.start(work, "other program")


@pytest.mark.parametrize(
    ("begin", "names"),
    [
        (command_head, "HeadYaw"),
        (lambda robot: robot.call("ALMotion", "setAngles", "HeadYaw", 0.5, 0.2), "HeadYaw"),
        (lambda robot: robot.call("ALMotion", "move", 0.1, 0.0, 0.0), "WheelFL, WheelFR"),
    ],
    ids=["DCM", "setAngles", "move"],
)
def test_another_program_that_commands_the_robot_stops_the_run(
    robot: VirtualNaoqi, tmp_path: Path, begin: Callable[[VirtualNaoqi], None], names: str
) -> None:
    """It is named by what it commands, in the error, the log and callbacks; our wheels and joints stand."""
    log, reported = tmp_path / "run.mcap", list[FaultEvent]()
    pepper = robot.pepper(log=log)
    pepper.on_fault()(reported.append)
    with pepper:
        pepper.run(1.0)
        begin(robot)
        with pytest.raises(FaultError, match=f"another program commands {names}.*start again"):
            pepper.run(10.0)
        robot.time.kill("other program")
        robot.call("ALMotion", "killAll")
    assert [event.fault.reason for event in reported] == [FaultReason.FOREIGN_COMMAND]
    (event,) = (event for event in read_log(log).events if event.kind == "fault")
    assert (event.name, event.text) == ("foreign command", reported[0].fault.text)
    robot.time.sleep(1.0)
    assert np.abs(robot.black_box(20).wheel_speed).max() <= 2 * STANDS


def test_the_clock_rolls_over_under_a_robot_that_moves() -> None:
    """From 2^31 - 1 ms to -2^31: no sample is old, no command late, no joint jumps."""
    with VirtualNaoqi(clock=2**31 - 6_000) as robot:
        robot.wake_up()
        robot.set_fault("value:Battery/Charge/Sensor/Value,0.3")
        with robot.pepper() as pepper:
            begin_to_move(pepper)
            begun = robot.time.seconds()
            assert robot.robot.time() > 0
            while robot.robot.time() > 0:
                pepper.run(0.1)
            move_arms(pepper)
            pepper.run(0.6)
            box = robot.since(begun)
    dates = box.date.astype(np.int64)
    assert (np.diff(dates) % 2**32 == 12 * np.diff(box.cycle)).all()
    assert dates[0] > 0 > dates[-1]
    assert max_step(box) <= MAX_STEP
    assert np.ptp(box.position_command[dates < 0], axis=0).max() > 0.02  # it moves on


@pytest.mark.parametrize(
    ("fault", "word"),
    [
        ("wrong-type:Nao", "Nao"),
        ("missing:DCM", "DCM"),
        ("none:LElbowRoll/Position", "LElbowRoll"),
        ("error:ALMemory,text=no memory", "no memory"),
        ("slow:0.03", "too slow"),
    ],
)
def test_what_is_wrong_at_the_start_is_one_line_and_nothing_moves(
    robot: VirtualNaoqi, fault: str, word: str
) -> None:
    robot.time.sleep(1.0)
    robot.set_fault(fault)
    begun = robot.time.seconds()
    with pytest.raises(PepperError, match=word) as caught, robot.pepper():
        pass
    assert len(str(caught.value).splitlines()) == 1
    robot.time.sleep(0.1)
    box = robot.since(begun)
    assert np.ptp(box.position, axis=0).max() < 0.01
    assert not box.wheel_command.any()


# -- two programs ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["dcm", "angles"])
def test_a_second_driver_is_refused_while_the_first_one_drives(
    robot: VirtualNaoqi, mode: str
) -> None:
    second, errors = robot.backend(mode), list[Exception]()

    def try_to_drive() -> None:
        second.open()
        try:
            second.activate()
        except PepperError as error:
            errors.append(error)
        second.close()

    with robot.pepper() as pepper:
        begin_to_move(pepper)
        robot.time.start(try_to_drive, "client")
        pepper.run(3.0)
        assert_drives(robot.black_box(3))
    (error,) = errors
    assert isinstance(error, SecondDriverError)
    assert "driven by another pepper_driver already" in str(error)
    # As soon as the first has ended.
    with second:
        second.open()
        second.activate()


def test_of_two_drivers_the_one_whose_commands_do_not_count_stops(robot: VirtualNaoqi) -> None:
    """Forced to it, both command all joints."""
    other = robot.backend(force=True)

    def drive_too() -> None:
        other.open()
        held = other.activate().position
        with suppress(PepperError):
            while True:
                other.read()
                other.write(Command(position=held, stiffness=np.ones(17), wheel_speed=np.zeros(3)))
                robot.time.sleep(ROBOT.cycle)

    with robot.pepper() as pepper, pytest.raises(FaultError) as caught:  # noqa: PT012
        move_arms(pepper)
        robot.time.start(drive_too, "client")
        pepper.run(10.0)
    assert caught.value.fault.reason is FaultReason.FOREIGN_COMMAND
