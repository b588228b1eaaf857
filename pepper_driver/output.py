"""Writing results: whole or not at all, with errors for people."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pepper_driver.config import PepperError
from pepper_driver.config.errors import reason


class OutputError(PepperError, OSError):
    """A result cannot be written."""


def make_folder(path: Path) -> None:
    """Make a folder for results, with its parents.

    Raises:
        OutputError: It cannot be made, or nothing can be written into it.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{path}: cannot be made ({reason(error)})") from error
    if not os.access(path, os.W_OK | os.X_OK):
        raise OutputError(f"{path}: no permission to write there")


def check_writable(path: Path) -> None:
    """Refuse a file that cannot be written, before the work for it is done rather than after.

    Raises:
        OutputError: It cannot be written.
    """
    with replacing(path, keep=False) as partial:
        partial.touch()


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file; a failure leaves what was there before.

    Raises:
        OutputError: It cannot be written.
    """
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


def write_text(path: Path, text: str) -> None:
    """Write a text file, its folder too; a failure leaves what was there before.

    Raises:
        OutputError: It cannot be written.
    """
    make_folder(path.parent)
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


@contextmanager
def replacing(path: Path, *, keep: bool = True) -> Iterator[Path]:
    """A file to write beside ``path``, which takes its place when the block ends well, and is gone when it does not.

    Args:
        path: The file.
        keep: False only to try: it is gone in any case.

    Raises:
        OutputError: It cannot be written.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")  # two runs may write the same
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder")
        yield partial
        if keep:
            os.replace(partial, path)
    except OutputError:  # of another file written meanwhile
        raise
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({reason(error)})") from error
    finally:
        with suppress(OSError):
            partial.unlink()
