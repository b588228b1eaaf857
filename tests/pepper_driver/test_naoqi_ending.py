"""Signals in the middle of a robot's start and end, over real qi: its black box has what it really did."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.backends.naoqi_server.shared_values import BlackBox
from pepper_driver.log import read_log
from support import ROOT
from support.naoqi_faults import ROBOT, STANDS
from support.stand_ins import since, url
from support.waiting import PATIENCE, wait_until

pytestmark = pytest.mark.realtime

ARMS = [
    ROBOT.joint_index(name) for chain in ("left_arm", "right_arm") for name in ROBOT.chains[chain]
]
MAX_FALL = 0.2
"""Of a stiffness, from a cycle to the next, on a machine that leaves cycles out."""

PROGRAM = """
import os, sys, time
sys.path[:0] = sys.argv[1].split(os.pathsep)
from support.naoqi_faults import begin_to_move
from pepper_driver import Pepper
from support.stand_ins import PATIENT, patient_driver
with patient_driver(burst=0.2):
    with Pepper(sys.argv[2], observer=None, safety=PATIENT, log=sys.argv[3]) as pepper:
        begin_to_move(pepper)
        print("moving", flush=True)
        time.sleep(60.0)
"""


@pytest.fixture(scope="module")
def robot(qi: Any, wake_up: Callable[[StandIn], None]) -> Iterator[StandIn]:
    """Awake, with soft arms; its owner allows all."""
    with StandIn("mujoco://?seed=3", consent=True) as running:
        wake_up(running)
        session = qi.Session()
        session.connect(running.url)
        session.service("ALMotion").setStiffnesses(["LArm", "RArm"], 0.0)
        session.close()
        assert wait_until(lambda: not arms(running).any())
        yield running


def arms(robot: StandIn) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Their stiffness now."""
    return robot.black_box(1).stiffness[-1, ARMS]


@contextmanager
def driver(robot: StandIn, log: Path) -> Iterator[subprocess.Popen[str]]:
    folders = str(ROOT / "tests")
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, folders, url(robot), str(log)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def assert_let_go(box: BlackBox) -> None:
    """The arms became soft little by little, and the wheels stand."""
    stiffness = box.stiffness[:, ARMS]
    assert stiffness.max() > 0.1
    assert not stiffness[-1].any()
    assert np.diff(stiffness, axis=0).min() > -MAX_FALL
    assert np.abs(box.wheel_speed[-1]).max() <= STANDS
    assert not box.wheel_command[-1].any()


def test_while_the_stiffness_is_raised(robot: StandIn, tmp_path: Path) -> None:
    log, begin = tmp_path / "run.mcap", time.monotonic()
    with driver(robot, log) as process:
        assert wait_until(lambda: 0.2 < arms(robot).max() < 0.8)
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 143
    assert errors.splitlines()[-1] == f"terminated; log: {log}"
    assert read_log(log).complete
    box = since(robot, begin)
    assert box.stiffness[:, ARMS].max() < 1.0, "it was not raised any further"
    assert_let_go(box)


def test_while_the_stiffness_is_lowered(robot: StandIn, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    with driver(robot, log) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "moving\n"
        begin = time.monotonic()
        process.send_signal(signal.SIGTERM)
        assert wait_until(lambda: 0.0 < arms(robot).max() < 0.9)
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
            process.send_signal(number)
        process.communicate(timeout=PATIENCE)
    assert process.returncode in (143, 129, -signal.SIGINT)
    assert read_log(log).complete
    assert_let_go(since(robot, begin))
