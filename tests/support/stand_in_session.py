"""Parts of tests over the real qi; they use the fixture ``qi``, which skips them where there is none."""

from collections.abc import Iterator
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


def alive(pid: int) -> bool:
    """Return True for a process that runs or is stopped; not for one that waits to be reaped."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
