"""The key that stops the robot, in a terminal and without one."""

import os
import pty
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from pepper_driver import FaultError, FaultReason, Pepper
from pepper_driver.recording.terminal_keys import SpaceBar, StopKey
from support.waiting import wait_until


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """The far end of a terminal that is standard input."""
    far, near = pty.openpty()
    with os.fdopen(near) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield far
    os.close(far)


def test_the_space_bar_and_q_stop_and_other_keys_do_not(terminal: int) -> None:
    import termios

    before = termios.tcgetattr(sys.stdin.fileno())
    reported: list[str] = []
    with StopKey(reported.append) as key:
        assert key.listening
        os.write(terminal, b"xyz\n\x1b[A")
        for press, text in (
            (b" ", "the space bar was pressed"),
            (b"q", "q was pressed"),
            (b"Q", "q was pressed"),
        ):
            os.write(terminal, press)
            assert wait_until(lambda: reported), "the key was not seen"
            assert reported == [text]
            reported.clear()
    assert not key.listening
    assert termios.tcgetattr(sys.stdin.fileno()) == before


def test_q_stops_where_the_space_bar_is_a_switch(terminal: int) -> None:
    reported: list[str] = []
    with SpaceBar(reported.append) as bar:
        os.write(terminal, b"x ")
        assert wait_until(lambda: bar.on), "the key was not seen"
        assert reported == []
        os.write(terminal, b"Q")
        assert wait_until(lambda: reported), "the key was not seen"
        assert reported == ["q was pressed"]
        assert bar.on


def test_what_was_typed_before_stops_nothing(terminal: int) -> None:
    os.write(terminal, b" q\n")
    assert select.select([sys.stdin], [], [], 10.0)[0]  # terminals take their time
    reported: list[str] = []
    with StopKey(reported.append):
        time.sleep(0.3)
    assert reported == []


def test_without_a_terminal_nothing_is_read(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with (tmp_path / "empty").open("w+") as file:
        for stdin in (file, None):
            monkeypatch.setattr(sys, "stdin", stdin)
            with StopKey(lambda _: None) as key:
                assert not key.listening


def test_the_key_stops_a_robot_that_moves(terminal: int) -> None:
    pepper = Pepper("mujoco", observer=None, real_time=True)
    with StopKey(pepper.emergency_stop), pepper:
        press = threading.Timer(0.3, os.write, (terminal, b" "))
        press.start()
        with pytest.raises(FaultError, match="the space bar was pressed") as caught:
            pepper.run(30.0)
        press.join()
    assert caught.value.fault.reason is FaultReason.EMERGENCY_STOP


def test_pepper_run_in_a_terminal(tmp_path: Path) -> None:
    motion = tmp_path / "long.yaml"
    motion.write_text(
        "schema: 2\nname: long\nsteps:\n"
        "  - repeat: {times: 50, steps: [{duration: 30.0, joints: {HeadYaw: 0.5}}, {duration: 30.0, posture: Stand}]}\n"
    )
    far, near = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "pepper_driver", "run", str(motion)],
        stdin=near,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        bufsize=1,
    )
    os.close(near)
    guard = threading.Timer(120.0, process.kill)  # readline would wait for ever
    guard.start()
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "the space bar or q stops the robot\n"
        os.write(far, b"q")
        _, errors = process.communicate()
        assert process.returncode == 2
        assert errors == "pepper: the robot was stopped: q was pressed\n"
    finally:
        guard.cancel()
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
        os.close(far)
