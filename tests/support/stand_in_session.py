"""What tests over the real qi share; they use the fixture ``qi``, which skips them where there is none."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

PREFIX = "Device/SubDeviceList/"


@contextmanager
def connected(url: str) -> Iterator[Any]:
    """A session with the stand-in."""
    import qi

    session = qi.Session()
    session.connect(url, _async=True).value(30_000)
    try:
        yield session
    finally:
        session.close()


def stays(value: Callable[[], object], seconds: float = 0.2) -> bool:
    """Whether a value does not change for a while."""
    before = value()
    time.sleep(seconds)
    return value() == before


def alive(pid: int) -> bool:
    """Whether a process runs, or is stopped; one that waits to be reaped does not."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
