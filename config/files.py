"""Files: written whole or not at all, with human-readable errors; hashes of their content."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pepper_driver.config.errors import ConfigError, PepperError, reason


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


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file; a failure leaves what was there before.

    Raises:
        OutputError: It cannot be written.
    """
    with replacing(path) as partial:
        partial.write_bytes(content)


def set_aside(path: Path) -> Path | None:
    """Give a file another name, where there is one: an earlier attempt is not lost.

    Returns:
        Its new place; None where there was no file.

    Raises:
        OutputError: It cannot be renamed.
    """
    if not path.exists():
        return None
    number = 1
    while (other := path.with_name(f"{path.name}.early-{number}")).exists():
        number += 1
    try:
        path.rename(other)
    except OSError as error:
        raise OutputError(f"{path}: cannot be renamed ({reason(error)})") from error
    return other


def file_hash(path: Path) -> str:
    """Return 16 hexadecimal digits of the SHA-256 of a file's bytes.

    Raises:
        ConfigError: It cannot be read.
    """
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({reason(error)})") from error


def check_same(hashes: Mapping[Path, str]) -> None:
    """Refuse files that are not what they are elsewhere.

    Args:
        hashes: By path, of the content there.

    Raises:
        ConfigError: A file cannot be read, or holds something else.
    """
    for path, expected in hashes.items():
        if file_hash(path) != expected:
            raise ConfigError(f"{path}: its content is another one there")


def content_hash(content: object) -> str:
    """Return 16 hexadecimal digits of the SHA-256 of JSON values, independent of the order of keys."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


@contextmanager
def replacing(path: Path, *, keep: bool = True) -> Iterator[Path]:
    """Yield a temporary file; it replaces ``path`` when the block ends well, and is removed when it does not.

    Args:
        path: The file.
        keep: False only to try: it is removed in any case.

    Raises:
        OutputError: It cannot be written.
    """
    # Two runs may write the same, also on two machines.
    partial = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.part")
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder")
        yield partial
        if keep:
            with partial.open("rb") as written:
                os.fsync(written.fileno())  # a power cut leaves the old file or the new one
            os.replace(partial, path)
    except OutputError:  # of another file written meanwhile
        raise
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({reason(error)})") from error
    finally:
        with suppress(OSError):
            partial.unlink()
