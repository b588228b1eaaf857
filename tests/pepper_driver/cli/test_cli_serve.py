"""``pepper serve``: one line when it is ready, one line when it cannot, and nothing left when it ends."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pepper_driver.cli.app import run
from support.waiting import wait_until

pytestmark = pytest.mark.usefixtures("qi")


@contextmanager
def served(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command at work, and its first line."""
    process = subprocess.Popen(
        [sys.executable, "-m", "pepper_driver", "serve", "--port", "0", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        yield process, process.stdout.readline().strip()
    finally:
        process.kill()
        process.communicate()


def children(pid: int) -> list[int]:
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text()
    return [int(child) for child in text.split()]


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_it_says_when_it_is_ready_and_ends_on_a_signal(number: signal.Signals, code: int) -> None:
    with served("--seed", "3", "--posture", "Crouch") as (process, line):
        match = re.fullmatch(r"ready on tcp://127\.0\.0\.1:(\d+)", line)
        assert match, line
        socket.create_connection(("127.0.0.1", int(match[1])), timeout=30).close()
        pids = children(process.pid)
        assert len(pids) == 2
        begin = time.monotonic()
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
        assert time.monotonic() - begin < 15.0
        assert process.returncode == code
        assert not out
        assert "Traceback" not in err
        assert not any(os.path.exists(f"/proc/{pid}") for pid in pids)


def test_nothing_is_left_of_one_that_is_killed() -> None:
    with served("--network", "wired") as (process, line):
        assert line.startswith("ready")
        pids = children(process.pid)
        assert len(pids) == 3
        process.kill()
        process.wait()
        assert wait_until(lambda: not any(os.path.exists(f"/proc/{pid}") for pid in pids), 10.0)


def test_it_starts_naoqi_again_and_ends_with_the_robot() -> None:
    with served() as (process, line):
        assert line.startswith("ready")
        assert process.stdout is not None
        assert process.stderr is not None
        robot, naoqi = children(process.pid)
        os.kill(naoqi, signal.SIGKILL)
        assert "NAOqi ended by signal 9; the robot goes on" in process.stderr.readline()
        assert process.stdout.readline().strip() == line
        assert children(process.pid)[0] == robot
        os.kill(robot, signal.SIGKILL)
        _, err = process.communicate(timeout=60)
        assert process.returncode == 1
        assert err == "pepper: the stand-in's robot process ended by signal 9\n"


def test_with_a_view_it_prints_the_page_which_ends_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("viser")
    monkeypatch.setenv("BROWSER", "true")  # the command
    with served("--view") as (process, line):
        assert line.startswith("ready on tcp://127.0.0.1:")
        assert process.stdout is not None
        match = re.fullmatch(
            r"view: (http://127\.0\.0\.1:\d+/\S+/)", process.stdout.readline().strip()
        )
        assert match
        with urllib.request.urlopen(match[1], timeout=30) as answer:
            assert b"<html" in answer.read()
        # For a moment the browser is one of them.
        assert wait_until(lambda: len(children(process.pid)) == 3, 10.0)
        pids = children(process.pid)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
        assert "Traceback" not in err
        assert wait_until(lambda: not any(os.path.exists(f"/proc/{pid}") for pid in pids), 10.0)


def test_without_the_viewer_it_names_the_extra(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pepper_driver.viewer.view.find_spec", lambda _: None)
    assert run(["serve", "--port", "0", "--view"]) == 2
    captured = capsys.readouterr()
    assert "pepper-driver[viewer]" in captured.err
    assert captured.err.count("\n") == 1
    assert not captured.out, "nothing was started"


def test_other_machines_are_warned_of() -> None:
    with served("--host", "0.0.0.0") as (process, line):
        assert line.startswith("ready on tcp://0.0.0.0:")
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
        assert "other machines" in err


def test_what_it_cannot_do_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        for arguments, words in (
            (["--port", port], f"tcp://127.0.0.1:{port}: Address already in use"),
            (["--plant", "nix"], "unknown plant 'nix'"),
            (["--port", "70000"], "port"),
            (["--host", "nowhere.invalid", "--port", "0"], "nowhere.invalid"),
        ):
            assert run(["serve", *arguments]) == 2
            captured = capsys.readouterr()
            assert words in captured.err
            assert captured.err.count("\n") == 1


def test_without_qi_it_names_the_extra(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pepper_driver.backends.naoqi_server.launch.find_spec", lambda _: None)
    assert run(["serve"]) == 2
    assert "pepper-driver[naoqi]" in capsys.readouterr().err
