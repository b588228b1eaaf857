"""Locks on results: the second of two runs is refused, and nothing that ended keeps a lock."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pepper_driver.config.file_lock import FOLDER_LOCK, InUseError, lock_file, lock_folder

HOLD = """
import sys
from pathlib import Path
from pepper_driver.config.file_lock import lock_folder
sys.argv = ["/usr/bin/pepper", "demo", "--out", "my runs", "naoqi://nao:secret@robot"]
lock = lock_folder(Path({folder!r}))
print("locked", flush=True)
sys.stdin.read()
"""


@contextmanager
def other_process(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that has the lock until it is asked to end, or killed."""
    pipe, program = subprocess.PIPE, HOLD.format(folder=str(folder))
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=pipe, stdout=pipe, text=True
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "locked\n"
            yield process
        finally:
            process.kill()


def test_another_process_is_named_and_a_killed_one_has_no_lock(tmp_path: Path) -> None:
    with other_process(tmp_path) as process:
        with pytest.raises(InUseError) as caught:
            lock_folder(tmp_path)
        message = str(caught.value)
        assert re.fullmatch(
            rf"{tmp_path}: is being written by process {process.pid} since \d{{4}}-\d\d-\d\d \d\d:\d\d:\d\d "
            r"\(pepper demo --out 'my runs' naoqi://robot\); wait until it has ended, or choose another folder",
            message,
        )
        process.kill()
        process.wait()
        with lock_folder(tmp_path):
            assert f"process {os.getpid()} " in (tmp_path / FOLDER_LOCK).read_text()
    assert list(tmp_path.iterdir()) == []


def test_a_lock_is_free_after_its_release(tmp_path: Path) -> None:
    first = lock_file(tmp_path / "a.mcap")
    with pytest.raises(InUseError, match=r"a\.mcap: is being written by process .*another file"):
        lock_file(tmp_path / "a.mcap")
    lock_file(tmp_path / "b.mcap").release()
    first.release()
    first.release()
    lock_file(tmp_path / "a.mcap").release()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_was_made_for_nothing_is_removed_with_its_lock(tmp_path: Path) -> None:
    """As after a mistake that only the run itself finds out."""
    lock_folder(tmp_path / "a" / "b").release()
    assert list(tmp_path.iterdir()) == []
    with lock_folder(tmp_path / "a" / "b"):
        (tmp_path / "a" / "result").write_text("kept")
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["result"]
    (tmp_path / "mine").mkdir()
    lock_folder(tmp_path / "mine").release()
    assert (tmp_path / "mine").is_dir(), "it was there before"
