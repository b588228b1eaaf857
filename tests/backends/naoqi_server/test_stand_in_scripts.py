"""Programs as people write them for the robot run against the stand-in unchanged: those in ``naoqi_scripts``."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.config import load_robot
from support.stand_in_session import connected
from support.waiting import wait_until

pytestmark = pytest.mark.usefixtures("qi")

SCRIPTS = Path(__file__).parent / "naoqi_scripts"
LIBQI_LEAVES = "terminate called without an active exception"


@pytest.fixture(scope="module")
def stand_in() -> Iterator[StandIn]:
    with StandIn("mujoco") as made:
        yield made


@pytest.fixture
def outside(stand_in: StandIn) -> Iterator[Any]:
    with connected(stand_in.url) as session:
        service = session.service("StandIn")
        yield service
        service.clearFaults()


def started(stand_in: StandIn, name: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [
            sys.executable,
            str(SCRIPTS / f"{name}.py"),
            "--ip",
            "127.0.0.1",
            "--port",
            str(stand_in.port),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def ended(process: "subprocess.Popen[str]") -> list[str]:
    """The rest of its lines; it must end well."""
    try:
        out, error = process.communicate(timeout=120)
    finally:
        process.kill()
    # Now and then libqi aborts a program that is over, while threads of its own still end. What the program
    # had to say it has said by then.
    left = process.returncode == -signal.SIGABRT and error.strip() == LIBQI_LEAVES
    assert process.returncode == 0 or left, error
    return [line for line in out.splitlines() if not line.startswith("[")]  # libqi logs there too


def until_ready(process: "subprocess.Popen[str]") -> None:
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("waiting"):
            return
    pytest.fail(f"it ended: {process.stderr.read() if process.stderr else ''}")


def said(outside: Any, service: str) -> list[list[Any]]:
    """Method and arguments of the calls of a service."""
    return [list(entry[2:]) for entry in outside.record() if entry[1] == service]


def test_gestures(stand_in: StandIn) -> None:
    lines = ended(started(stand_in, "gestures"))
    assert lines == [
        "awake True",
        "posture True Stand",
        "arm [-0.2, 1.0]",
        "yaw 0.6",
        "hand 1.0",
        "stiffness [0.6]",
        "awake False",
    ]
    box = stand_in.black_box()
    names = load_robot().joint_names
    swing = box.position[:, names.index("RShoulderRoll")]
    assert swing.min() < -0.6  # the wave, as it really went
    assert box.stiffness.max() == 1.0
    assert wait_until(lambda: stand_in.black_box(1).stiffness.max() == 0.0)


def test_driving(stand_in: StandIn) -> None:
    lines = ended(started(stand_in, "drive"))
    assert lines == [
        "there True",
        "moved [0.3, 0.0]",
        "forward [0.2, 0.0, 0.0] True",
        "turning True",
        "stopped True False",
        "on its way True",
        "interrupted False",
    ]
    assert wait_until(lambda: abs(stand_in.black_box(1).wheel_speed).max() < 0.01)


def test_an_application_that_reacts_to_touch(stand_in: StandIn, outside: Any) -> None:
    process = started(stand_in, "react_to_touch")
    until_ready(process)
    outside.setFault("press", {"sensors": "Head/Touch/Front"})
    assert ended(process) == ["TouchChanged ['Head/Touch/Front']"]
    assert said(outside, "ALTextToSpeech")[-1] == [
        "say",
        ["My Head/Touch/Front was touched", "English"],
    ]
    assert said(outside, "ALLeds")[-1][:1] == ["fadeRGB"]


def test_a_module_in_the_old_style(stand_in: StandIn, outside: Any) -> None:
    process = started(stand_in, "old_style")
    until_ready(process)
    outside.setFault("press", {"sensors": "Back"})
    assert ended(process) == ["BackBumperPressed 1.0 ''", "hits 1"]


def test_a_show(stand_in: StandIn, outside: Any) -> None:
    lines = ended(started(stand_in, "show"))
    assert lines == ["version 2 battery True", "language German done 2", "ears 0.5", "touched []"]
    assert said(outside, "ALTextToSpeech")[-2:] == [
        ["say", ["\\rspd=90\\ Guten Tag!", "German"]],
        ["say", ["Good bye", "English"]],
    ]
    assert said(outside, "ALAnimatedSpeech")
    assert [call[0] for call in said(outside, "ALTabletService")] == ["showImage", "hideImage"]
