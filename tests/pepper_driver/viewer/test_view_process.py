"""The page's process: served with its token alone, ended with the robot's program, refused in one line."""

from __future__ import annotations

import os
import signal
import socket
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

pytest.importorskip("viser")
from pepper_driver import Pepper
from pepper_driver.cli.app import run
from pepper_driver.config import MissingExtraError
from pepper_driver.viewer import view as view_module
from pepper_driver.viewer.view import View, ViewError, check_access

TOKEN = "test-token"


@pytest.fixture
def shown() -> Iterator[tuple[Pepper, View]]:
    with (
        Pepper("mujoco", observer=None) as pepper,
        View(port=0, token=TOKEN) as view,
    ):
        view.show(pepper)
        _ = view.address  # served by now
        yield pepper, view


def wait_for(what: Callable[[], bool]) -> None:
    end = time.monotonic() + 20.0
    while not what():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_the_page_is_served_with_its_token_alone(shown: tuple[Pepper, View]) -> None:
    _, view = shown
    with urllib.request.urlopen(view.address, timeout=20) as answer:
        page = answer.read()
    assert b"<html" in page
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(view.address.replace(TOKEN, "test-tokem"), timeout=20)
    assert view.address.startswith("http://127.0.0.1:")


def test_the_page_loads_nothing_from_elsewhere(shown: tuple[Pepper, View]) -> None:
    """Works without internet: no script, style, font or picture of another host."""
    _, view = shown
    with urllib.request.urlopen(view.address, timeout=20) as answer:
        text = answer.read().decode()
    head = text[: text.index("<script")] if "<script" in text else text
    for tag in ('src="http', 'href="http', "@import url(http"):
        assert tag not in head


def test_the_robot_goes_on_when_the_page_ends(shown: tuple[Pepper, View]) -> None:
    pepper, view = shown
    pepper.run(0.1)
    os.kill(view._process._process.pid, signal.SIGKILL)
    wait_for(lambda: not view.is_open)
    pepper.run(0.5)
    assert pepper.state.value == "active"


def test_the_page_ends_with_its_program(shown: tuple[Pepper, View]) -> None:
    _, view = shown
    process = psutil.Process(view._process._process.pid)
    assert process.nice() == min(psutil.Process().nice() + 10, 19)
    view.close()
    assert not process.is_running()


def test_a_port_that_is_taken_is_reported() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with (
            View(port=port) as view,
            pytest.raises(ViewError, match=f"127.0.0.1:{port}.*--port") as error,
        ):
            _ = view.address
    assert "\n" not in str(error.value)


def test_beyond_this_computer_a_token_must_be_chosen() -> None:
    with pytest.raises(ViewError, match="--token"):
        check_access("0.0.0.0", None)
    with pytest.raises(ViewError, match="8 letters"):
        check_access("0.0.0.0", "short")
    assert check_access("0.0.0.0", "long-enough") == "long-enough"
    assert len(check_access("127.0.0.1", None)) >= 8
    assert check_access("127.0.0.1", None) != check_access("127.0.0.1", None)


def test_without_the_extra_the_error_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view_module, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"pepper-driver\[viewer\]"):
        View()


def test_show_gives_one_page_that_a_notebook_embeds(monkeypatch: pytest.MonkeyPatch) -> None:
    with Pepper("mujoco", observer=None) as pepper:
        view = pepper.show(port=0)
        try:
            assert pepper.show() is view
            assert f'src="{view.address}"' in view._repr_html_()
        finally:
            view.close()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nosuch.mcap"], ["nosuch.mcap", "no such file"]),
        (["mujoko"], ["mujoko", "mujoco"]),
        (["--host", "0.0.0.0"], ["--token"]),
        (["--observer", "fusoin"], ["fusoin", "fusion"]),
        (["--reflex", "hodl"], ["hodl", "hold"]),
        (["mujoco", "--port", "0"], ["--port"]),
    ],
)
def test_a_wrong_input_is_one_line(
    arguments: list[str], words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["view", "--no-open", *arguments]) != 0
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    for word in words:
        assert word in error


@pytest.mark.parametrize("text", ["", "no log", "\x89MCAP0\r\n"])
def test_what_is_no_log_is_one_line(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.mcap"
    path.write_text(text)
    assert run(["view", "--no-open", str(path)]) != 0
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert str(path) in error
