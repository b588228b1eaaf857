"""What a robot does when something goes wrong with NAOqi, the network or itself, and what its program then says.

Over real qi against the stand-in; what the robot did is in its black box. Facts about the robot are counted in its own
cycles; bounds of the clock on the wall are for busy machines, ``benchmarks/naoqi_faults.py`` measures.
"""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver import Pepper
from pepper_driver.backends import NotConnectedError
from pepper_driver.backends.naoqi import backend as naoqi_backend
from pepper_driver.backends.naoqi.presence import SecondDriverError
from pepper_driver.backends.naoqi_server.faults import parse_fault
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.callbacks.events import FaultEvent
from pepper_driver.config import PepperError, load_naoqi_settings, load_safety_settings
from pepper_driver.log import read_log
from pepper_driver.safety import FaultError, FaultReason
from support import ROOT
from support.naoqi_faults import (
    ROBOT,
    STANDS,
    TRIES,
    assert_joints_hold,
    assert_wheels_stop,
    begin_to_move,
    drive,
    drive_through,
    joints_rest,
    largest_step,
    move_arms,
    quick_settings,
    url,
    wait_for_cycles,
    what_is_still,
)
from support.stand_ins import PATIENT, SILENCE, since
from support.waiting import PATIENCE, wait_until

LARGEST_STEP = 0.02  # [rad] of a joint's command, from a cycle to the next
SAFETY = load_safety_settings()


@pytest.fixture(scope="module")
def robot(wake_up: Callable[[StandIn], None]) -> Iterator[StandIn]:
    """Awake, and its owner allows all."""
    with StandIn("mujoco://?seed=3", network="clear", consent=True) as running, quick_settings():
        wake_up(running)
        yield running


# -- nobody hears the robot, or it hears nobody ---------------------------------------------------------------------


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
    robot: StandIn, fault: str, kind: type[Exception], words: str
) -> None:
    slow = fault.startswith("slow")  # the two commands under way then still come
    outcome = drive(robot, fault, 3.0, watch=2.0 if slow else 0.3)
    assert isinstance(outcome.error, kind), outcome.error
    assert words in str(outcome.error)
    assert len(str(outcome.error).splitlines()) == 1
    assert_wheels_stop(outcome.box)
    assert_joints_hold(outcome.box, outcome.ended, late=LARGEST_STEP if slow else 0.0)
    assert largest_step(outcome.box) <= LARGEST_STEP
    assert outcome.closed < 10.0  # a service that is asked to get back what it had may not answer


def test_a_robot_that_goes_on_takes_at_most_two_commands(robot: StandIn) -> None:
    """What waited is old: no wheel turns by it, and no joint goes far."""
    outcome = drive(robot, "hang", 3.0)
    assert isinstance(outcome.error, FaultError)
    ages = [age for _, age in outcome.ages]
    # The first tick beyond it is the last.
    assert max(ages[:-1], default=0.0) <= PATIENT.stale_fault < ages[-1]
    assert outcome.closed < 10.0
    assert_wheels_stop(outcome.box)
    assert_joints_hold(outcome.box, outcome.ended)
    orders, told = outcome.box.orders[-1], outcome.box.position_command[-1]
    continues = time.monotonic()
    robot.clear_faults()
    wait_for_cycles(robot, 25)
    box = since(robot, continues)
    assert box.orders[-1] - orders <= 2
    assert np.abs(box.position_command - told).max() <= LARGEST_STEP
    assert not box.wheel_command[-1].any()
    assert np.abs(box.wheel_speed).max() <= STANDS


# -- the robot is not well ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "words"),
    [("press:ChestBoard/Button", "chest"), ("hot:LElbowRoll,80", "LElbowRoll")],
)
def test_the_safety_gate_stops_a_robot_that_is_not_well(
    robot: StandIn, fault: str, words: str
) -> None:
    outcome = drive(robot, fault, 5.0)
    assert isinstance(outcome.error, FaultError)
    assert words in str(outcome.error)
    assert_wheels_stop(outcome.box)
    assert_joints_hold(outcome.box, outcome.ended)


def test_what_is_borne_moves_on_without_a_jump(robot: StandIn) -> None:
    faults = ["network:wifi", "dropped:0.3", "none:Temperature", "slow:0.005", "press:FrontLeft"]
    *borne, bumped = drive_through(robot, faults, 0.6)
    for fault, outcome in zip(faults, borne, strict=False):
        assert outcome.error is None, fault
        assert np.median([age for _, age in outcome.ages]) < 0.08, fault
        assert largest_step(outcome.box) <= LARGEST_STEP, fault
        assert outcome.box.wheel_command[-25:].any(), fault
    # A bumper stops the base alone.
    assert bumped.error is None
    assert_wheels_stop(bumped.box)
    # Arms that turn round just then do not come far.
    after = bumped.box.begin > bumped.wrong
    turned = np.abs(np.diff(bumped.box.position_command[after], axis=0)).max(axis=1)
    assert np.count_nonzero(turned > 1e-5) > 10


def test_a_disconnected_joint_is_told_and_sinks(robot: StandIn) -> None:
    """The others go on until its command has left what it shows: at rest nobody could tell."""
    outcome = drive(robot, "disconnected:LShoulderPitch", 5.0)
    assert isinstance(outcome.error, FaultError)
    assert outcome.error.fault.reason is FaultReason.FROZEN_JOINT
    assert "LShoulderPitch does not answer" in str(outcome.error)
    place = ROBOT.joint_index("LShoulderPitch")
    box = outcome.box
    dead = int(np.argmax(box.stiffness[:, place] == 0.0))
    way = np.abs(box.position_command[:, place] - box.position_command[dead, place]).max()
    assert SAFETY.frozen_distance - 0.05 < way < SAFETY.following_error, (
        "sooner than by its distance alone"
    )
    assert_wheels_stop(box)
    assert_joints_hold(box, outcome.ended, but=["LShoulderPitch"])


def test_a_joint_without_values_is_named(robot: StandIn) -> None:
    outcome = drive(robot, "none:RElbowYaw", 3.0)
    assert isinstance(outcome.error, FaultError)
    assert outcome.error.fault.reason is FaultReason.STALE_SAMPLE
    assert "no answer from RElbowYaw" in str(outcome.error)
    assert_wheels_stop(outcome.box)


def test_a_robot_that_falls_asleep_stops_and_lets_its_arms_sink(robot: StandIn) -> None:
    """Nobody gives it stiffness again; nor does waking up make it go on where it was."""
    outcome = drive(robot, "asleep", 5.0, watch=1.2)  # wheels without power run out
    assert isinstance(outcome.error, FaultError)
    assert outcome.error.fault.reason is FaultReason.STIFFNESS
    assert "all joints" in str(outcome.error)
    box = outcome.box
    asleep = box.begin > outcome.wrong
    assert not box.stiffness[asleep].any()
    assert not box.wheel_command[asleep].any()
    assert np.abs(box.wheel_speed[-1]).max() <= STANDS
    # In cycles of the robot: from the first without stiffness to the last order.
    fell = int(np.argmax(~box.stiffness.any(axis=1)))
    last = int(np.flatnonzero(np.diff(box.orders))[-1])
    noticed = (last - fell) * ROBOT.cycle
    assert SAFETY.stiffness_time - ROBOT.cycle <= noticed < SAFETY.stiffness_time + SILENCE


@pytest.mark.parametrize("mode", ["dcm", "angles"])
def test_somebody_who_makes_an_arm_soft_stops_the_robot(
    qi: Any, robot: StandIn, tmp_path: Path, mode: str
) -> None:
    """By the way of all faults: FAULT, the log and callbacks have it; the arm stays soft."""
    robot.clear_faults()
    session = qi.Session()
    session.connect(robot.url)
    motion = session.service("ALMotion")
    log, told = tmp_path / "run.mcap", list[FaultEvent]()
    try:
        pepper = Pepper(f"{url(robot)}?mode={mode}", observer=None, log=log, safety=PATIENT)
        pepper.on_fault()(told.append)
        with pepper:
            pepper.run(0.5)
            motion.setStiffnesses("RArm", 0.0)
            with pytest.raises(FaultError, match="RShoulderPitch, RShoulderRoll, RElbowYaw and 3"):
                pepper.run(10.0)
        assert [event.fault.reason for event in told] == [FaultReason.STIFFNESS]
        (event,) = (event for event in read_log(log).events if event.kind == "fault")
        assert (event.name, event.text) == ("stiffness", told[0].fault.text)
        logged = read_log(log)["stiffness"]
        arm = [ROBOT.joint_index(name) for name in ROBOT.chains["right_arm"]]
        assert not logged[-1, arm].any()
    finally:
        motion.setStiffnesses("Body", 1.0)
        session.close()


@contextmanager
def commanding(session: Any, who: str) -> Iterator[None]:
    """Another program that commands the head by the DCM, or head or base by ALMotion."""
    motion, dcm, over = session.service("ALMotion"), session.service("DCM"), threading.Event()

    def command() -> None:
        while not over.wait(0.02):
            dcm.set(["HeadYaw/Position/Actuator/Value", "ClearAll", [[0.5, dcm.getTime(20)]]])

    thread = threading.Thread(target=command)
    if who == "DCM":
        thread.start()
    elif who == "setAngles":
        motion.setAngles("HeadYaw", 0.5, 0.2)
    else:
        motion.move(0.1, 0.0, 0.0)
    try:
        yield
    finally:
        over.set()
        if who == "DCM":
            thread.join()
        motion.killAll()


@pytest.mark.parametrize(
    ("who", "names"),
    [("DCM", "HeadYaw"), ("setAngles", "HeadYaw"), ("move", "WheelFL, WheelFR")],
)
def test_another_program_that_commands_the_robot_stops_the_run(
    qi: Any, robot: StandIn, tmp_path: Path, who: str, names: str
) -> None:
    """It is named by what it commands, in the error, the log and callbacks; our wheels and joints stand."""
    robot.clear_faults()
    session = qi.Session()
    session.connect(robot.url)
    log, told = tmp_path / "run.mcap", list[FaultEvent]()
    pepper = Pepper(url(robot), observer=None, log=log, safety=PATIENT)
    pepper.on_fault()(told.append)
    with pepper:
        pepper.run(1.0)
        with (
            commanding(session, who),
            pytest.raises(FaultError, match=f"another program commands {names}.*start again"),
        ):
            pepper.run(10.0)
    session.close()
    assert [event.fault.reason for event in told] == [FaultReason.FOREIGN_COMMAND]
    (event,) = (event for event in read_log(log).events if event.kind == "fault")
    assert (event.name, event.text) == ("foreign command", told[0].fault.text)
    assert wait_until(lambda: np.abs(robot.black_box(20).wheel_speed).max() <= 2 * STANDS)


def test_the_clock_rolls_over_under_a_robot_that_moves(wake_up: Callable[[StandIn], None]) -> None:
    """From 2^31 - 1 ms to -2^31: no sample is old, no command late, no joint jumps."""
    for ahead in (7, 20, 60):  # [s] in which this machine must be ready
        faults = [
            parse_fault(f"rollover:{ahead}"),
            parse_fault("value:Battery/Charge/Sensor/Value,0.3"),
        ]
        with StandIn("mujoco://?seed=3", consent=True, faults=faults) as robot, quick_settings():
            wake_up(robot)
            with Pepper(url(robot), observer=None, safety=PATIENT) as pepper:
                begin_to_move(pepper)
                begun, ready = time.monotonic(), robot.robot.time() > 0
                while robot.robot.time() > 0:
                    pepper.run(0.1)
                move_arms(pepper)
                pepper.run(0.6)
                box = since(robot, begun)
        if ready:
            break
    dates = box.date.astype(np.int64)
    assert (np.diff(dates) % 2**32 == 12 * np.diff(box.cycle)).all()
    assert dates[0] > 0 > dates[-1]
    assert largest_step(box) <= LARGEST_STEP
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
    robot: StandIn, fault: str, word: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(naoqi_backend, "load_naoqi_settings", load_naoqi_settings)
    robot.clear_faults()
    assert wait_until(lambda: joints_rest(robot))
    robot.set_fault(fault)
    begun = time.monotonic()
    with pytest.raises(PepperError, match=word) as caught, Pepper(url(robot), observer=None):
        pass
    assert len(str(caught.value).splitlines()) == 1
    time.sleep(0.1)
    box = since(robot, begun)
    assert np.ptp(box.position, axis=0).max() < 0.01
    assert not box.wheel_command.any()


# -- the program dies -----------------------------------------------------------------------------------------------


@contextmanager
def program(stand_in: StandIn) -> Iterator[subprocess.Popen[str]]:
    """One that moves the robot in a process of its own."""
    folders = str(ROOT / "tests")
    command = [sys.executable, "-c", PROGRAM, folders, url(stand_in)]
    for _ in range(TRIES):
        stand_in.clear_faults()
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            try:
                assert process.stdout is not None
                moving = process.stdout.readline() == "moving\n"
                if moving and wait_until(lambda: not what_is_still(stand_in)):
                    yield process
                    return
            finally:
                process.kill()
    raise AssertionError("no program that moves the robot, perhaps because this machine is busy")


PROGRAM = """
import os, sys
sys.path[:0] = sys.argv[1].split(os.pathsep)
from support.naoqi_faults import begin_to_move, quick_settings
from pepper_driver import Pepper
from support.stand_ins import PATIENT
with quick_settings(), Pepper(sys.argv[2], observer=None, safety=PATIENT) as pepper:
    begin_to_move(pepper)
    print("moving", flush=True)
    pepper.run(60.0)
"""


def test_a_program_that_is_killed_leaves_a_robot_that_stands(robot: StandIn) -> None:
    """Until then no other is let in; and as soon as it is gone."""
    with program(robot) as process:
        for mode in ("dcm", "angles"):
            refused = rf"driven by another pepper_driver already: process {process.pid} of this computer, since"
            with (
                pytest.raises(SecondDriverError, match=refused),
                Pepper(f"{url(robot)}?mode={mode}", observer=None),
            ):
                pass
        assert not what_is_still(robot), "it drives on"
        process.kill()
        process.wait()
        killed = time.monotonic()
        wait_for_cycles(robot, 40)
    box = since(robot, killed - 0.5)
    assert_wheels_stop(box)
    assert_joints_hold(box, killed)
    assert largest_step(box) <= LARGEST_STEP
    with Pepper(url(robot), observer=None, safety=PATIENT) as pepper:
        pepper.run(0.1)


def test_two_programs_that_are_told_so_do_not_drive_for_long(robot: StandIn) -> None:
    """Both command all joints: at least the one whose commands do not count notices it, and stops."""
    reason = None
    with program(robot) as process:
        try:
            with Pepper(f"{url(robot)}?force=1", observer=None, safety=PATIENT) as pepper:
                while process.poll() is None:
                    pepper.run(0.2)
        except FaultError as error:
            reason = error.fault.reason
        assert process.poll() is not None or reason is FaultReason.FOREIGN_COMMAND


@pytest.mark.parametrize("fault", ["", "hang", "kill", "blocked"])
def test_ctrl_c_ends_the_program(robot: StandIn, fault: str) -> None:
    """Within a second on a machine that has nothing else to do; here others may have it."""
    with program(robot) as process:
        if fault:
            robot.set_fault(fault)
        begin = time.monotonic()
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE)
        assert time.monotonic() - begin < 10.0
    assert wait_until(lambda: np.abs(robot.black_box(20).wheel_speed).max() <= 2 * STANDS)
