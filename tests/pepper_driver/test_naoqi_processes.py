"""Programs that drive a robot and are killed, suspended or interrupted: in processes of their own, over real qi."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from pepper_driver import Pepper
from pepper_driver.backends.naoqi.presence import SecondDriverError
from pepper_driver.backends.naoqi_server.launch import StandIn
from support import ROOT
from support.naoqi_faults import (
    STANDS,
    assert_joints_hold,
    assert_wheels_stop,
    drives,
    max_step,
)
from support.processes import suspend
from support.stand_ins import PATIENT, patient_driver, since, url
from support.waiting import PATIENCE, wait_until

pytestmark = pytest.mark.realtime

MAX_STEP = 0.02  # [rad] of a joint's command, from a cycle to the next

PROGRAM = """
import os, sys
sys.path[:0] = sys.argv[1].split(os.pathsep)
from support.naoqi_faults import begin_to_move
from pepper_driver import Pepper
from support.stand_ins import PATIENT, patient_driver
with patient_driver(), Pepper(sys.argv[2], observer=None, safety=PATIENT) as pepper:
    begin_to_move(pepper)
    print("moving", flush=True)
    pepper.run(60.0)
"""


@pytest.fixture(scope="module")
def robot(wake_up: Callable[[StandIn], None]) -> Iterator[StandIn]:
    """Awake, and its owner allows all."""
    with StandIn("mujoco://?seed=3", network="clear", consent=True) as running:
        wake_up(running)
        yield running


@contextmanager
def program(robot: StandIn) -> Iterator[subprocess.Popen[str]]:
    """One that moves the robot."""
    robot.clear_faults()
    command = [sys.executable, "-c", PROGRAM, str(ROOT / "tests"), url(robot)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "moving\n"
            assert wait_until(lambda: drives(robot.black_box(3)))
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_program_that_stands_leaves_a_robot_that_stands(
    robot: StandIn, number: signal.Signals
) -> None:
    """Until then no other is let in; and as soon as it has ended."""
    with program(robot) as process:
        refused = rf"driven by another pepper_driver already: process {process.pid} of this computer, since"
        with (
            pytest.raises(SecondDriverError, match=refused),
            Pepper(url(robot), observer=None),
        ):
            pass
        assert drives(robot.black_box(3)), "it drives on"
        if number == signal.SIGSTOP:
            suspend(process.pid)
        else:
            process.kill()
            process.wait()
        ended = time.monotonic()
        assert wait_until(lambda: len(since(robot, ended)) >= 40)
        box = since(robot, ended - 0.5)
    assert_wheels_stop(box)
    assert_joints_hold(box, ended)
    assert max_step(box) <= MAX_STEP
    with patient_driver(), Pepper(url(robot), observer=None, safety=PATIENT) as pepper:
        pepper.run(0.1)


@pytest.mark.parametrize(
    "fault",
    ["", "hang", *(pytest.param(fault, marks=pytest.mark.whole) for fault in ("kill", "blocked"))],
)
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
