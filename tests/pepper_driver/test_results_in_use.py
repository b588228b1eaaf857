"""Results that another run is writing: commands and logs refuse them, and leave them as they are."""

from __future__ import annotations

from pathlib import Path

import pytest

from pepper_driver.cli.app import run
from pepper_driver.config.file_lock import FOLDER_LOCK, InUseError, lock_folder
from pepper_driver.log import LogWriter
from support.log_samples import ROBOT


def refusal(capsys: pytest.CaptureFixture[str]) -> str:
    (said,) = capsys.readouterr().err.splitlines()
    return said


def test_a_log_that_is_being_written_stays_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, ROBOT, {}):
        before = path.read_bytes()
        with pytest.raises(InUseError):
            LogWriter(path, ROBOT, {})
        assert path.read_bytes() == before
    assert path.read_bytes() != before
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


@pytest.mark.parametrize(
    "command",
    [
        ["demo", "--out", "PATH", "--seconds", "8"],
        ["identify", "--out", "new.json", "--recordings", "PATH", "--joints", "HeadYaw"],
        ["evaluate", "--suite", "paper", "--cache", "PATH", "--quick"],
    ],
)
def test_commands_refuse_a_folder_in_use(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "used"
    with lock_folder(folder):
        assert run([str(folder) if word == "PATH" else word for word in command]) == 2
        assert [p.name for p in folder.iterdir()] == [FOLDER_LOCK]
    assert refusal(capsys).startswith(f"pepper: {folder}: is being written by process ")


@pytest.mark.parametrize(
    "command",
    [
        ["run", "wave", "--log", "PATH"],
        ["record", "--out", "PATH", "--label", "head", "--seconds", "1"],
    ],
)
def test_commands_refuse_a_log_in_use(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    log = tmp_path / "a.mcap"
    with LogWriter(log, ROBOT, {}):
        before = log.read_bytes()
        assert run([str(log) if word == "PATH" else word for word in command]) == 2
        assert log.read_bytes() == before
    assert refusal(capsys).startswith(f"pepper: {log}: is being written by process ")
