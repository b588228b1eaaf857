"""Locks on results: a folder or a log is written by one run at a time."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from textwrap import shorten
from types import TracebackType
from typing import Self

from pepper_driver.config.errors import reason
from pepper_driver.config.files import OutputError, make_folder
from pepper_driver.config.passwords import without_secrets

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

FOLDER_LOCK = ".pepper.lock"
"""Name of the lock file in a folder that is in use."""

_LOCKED_BYTE = 2**30  # of Windows, where others cannot read what is locked


class InUseError(OutputError):
    """Another run writes to this folder or file; the message names its process and command."""


class FileLock:
    """Lock of a folder or file that is being written. It ends with the process, however that ends.

    Made by :func:`lock_folder` and :func:`lock_file`; use it as a context manager, or call :meth:`release`.

    Args:
        path: Lock file. It says who has the lock, and is removed when the lock is released.
        locked: Folder or file that it stands for.
        advice: Tail of the error message.
        made: Folders that were made for it, the innermost first; removed when it is released, if they are empty.

    Raises:
        InUseError: Another run has the lock.
        OutputError: The lock file cannot be written.
    """

    def __init__(self, path: Path, locked: Path, advice: str, made: Sequence[Path] = ()) -> None:
        self._path, self._made = path, tuple(made)
        try:
            self._descriptor: int | None = self._acquire(locked, advice)
        except OutputError:
            raise
        except OSError as error:
            raise OutputError(f"{locked}: cannot be written ({reason(error)})") from error

    def release(self) -> None:
        """Allow other runs to write. Does nothing when released."""
        if self._descriptor is None:
            return
        descriptor, self._descriptor = self._descriptor, None
        with suppress(OSError):  # Windows removes no open file; one that stays blocks nothing
            self._path.unlink()
        os.close(descriptor)
        with suppress(OSError):  # nothing was written: what was asked for was wrong
            for folder in self._made:
                folder.rmdir()

    def _acquire(self, locked: Path, advice: str) -> int:
        while True:
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o644)
            try:
                if not _lock(descriptor):
                    holder = os.read(descriptor, 4096).decode(errors="replace")
                    raise InUseError(
                        f"{locked}: is being written by {holder or 'another run'}; {advice}"
                    )
                if self._is_current(descriptor):
                    os.ftruncate(descriptor, 0)  # of a process that was killed
                    os.write(descriptor, _describe_process().encode())
                    return descriptor
            except BaseException:
                os.close(descriptor)
                raise
            os.close(descriptor)

    def _is_current(self, descriptor: int) -> bool:
        """Return True unless the previous holder removed the file after it was opened here."""
        try:
            return os.path.samestat(os.fstat(descriptor), self._path.stat())
        except FileNotFoundError:
            return False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.release()


def lock_folder(path: Path) -> FileLock:
    """Make a folder for results, and lock it.

    Raises:
        InUseError: Another run writes to it.
        OutputError: It cannot be made, or nothing can be written into it.
    """
    made = [folder for folder in (path, *path.parents) if not folder.exists()]
    make_folder(path)
    advice = "wait until it has ended, or choose another folder"
    return FileLock(path / FOLDER_LOCK, path, advice, made)


def lock_file(path: Path) -> FileLock:
    """Lock a file in an existing folder.

    Raises:
        InUseError: Another run writes it.
        OutputError: Nothing can be written into its folder.
    """
    lock = path.with_name(f".{path.name}.lock")
    return FileLock(lock, path, "wait until it has ended, or choose another file")


def _lock(descriptor: int) -> bool:
    """Return True once the file is locked, False where another has it."""
    try:
        if sys.platform == "win32":
            os.lseek(descriptor, _LOCKED_BYTE, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            os.lseek(descriptor, 0, os.SEEK_SET)
        else:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):  # Unix, Windows
        os.lseek(descriptor, 0, os.SEEK_SET)
        return False
    except OSError:  # a file system without locks
        return True
    return True


def _describe_process() -> str:
    """Return who has a lock: ``process 4242 since 2026-05-04 14:03:05 (pepper demo --out runs/demo)``."""
    program = Path(sys.argv[0]).name if sys.argv and sys.argv[0] else "python"
    name = "pepper" if program == "__main__.py" else program
    arguments = shlex.join([name, *map(without_secrets, sys.argv[1:])])
    command = shorten(arguments, 200, placeholder=" ...")
    since = datetime.now().astimezone().isoformat(" ", "seconds")[:19]
    return f"process {os.getpid()} since {since} ({command})"
