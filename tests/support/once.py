"""Results that take long to make: made once in a run of the tests, whichever worker needs them first."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from pepper_driver.config.file_lock import FileLock, InUseError, lock_file
from support.waiting import PATIENCE, wait_until


def made_once(request: pytest.FixtureRequest, name: str, make: Callable[[Path], object]) -> Path:
    """Return a copy of a folder of results, which the caller may change.

    Args:
        request: Of the fixture.
        name: Of the folder; another one for each ``make``.
        make: Fills the folder, which does not exist yet.
    """
    factory: pytest.TempPathFactory = request.getfixturevalue("tmp_path_factory")
    base = factory.getbasetemp()
    # A worker of pytest-xdist has a folder of its own inside that of the run.
    shared = (base.parent if hasattr(request.config, "workerinput") else base) / f"once-{name}"
    with _lock(shared):
        if not shared.exists():
            unfinished = factory.mktemp(name) / "results"
            make(unfinished)
            unfinished.rename(shared)
    return Path(shutil.copytree(shared, factory.mktemp(name) / name))


def _lock(path: Path) -> FileLock:
    """Wait for the worker that makes it."""
    locks: list[FileLock] = []

    def acquired() -> list[FileLock]:
        with suppress(InUseError):
            locks.append(lock_file(path))
        return locks

    assert wait_until(acquired, 20 * PATIENCE)
    return locks[0]
