"""Frozen files: a file that ends in hashes of itself, which show when it was changed."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from pepper_driver.config.errors import ConfigError, reason

_MARK = "\nfrozen:"


def text_hash(path: Path) -> str:
    """Return the SHA-256 of a text file, the same on all systems.

    Raises:
        ConfigError: It cannot be read.
    """
    return hashlib.sha256(_text(path).encode()).hexdigest()


def frozen_part_hash(path: Path) -> str:
    """Return the SHA-256 of what stands before the hashes: a file cannot contain its own hash.

    Raises:
        ConfigError: It cannot be read.
    """
    return hashlib.sha256(_before_hashes(path).encode()).hexdigest()


def write_frozen(path: Path, lines: Sequence[str]) -> None:
    """Replace the hashes at the end of a file by ``lines``, the first of which begins with ``frozen:``.

    Raises:
        ConfigError: It cannot be read or written.
    """
    text = _before_hashes(path) + "\n".join(lines) + "\n"
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({reason(error)})") from error


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")  # turns the line ends of all systems into one
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({reason(error)})") from error


def _before_hashes(path: Path) -> str:
    return _text(path).split(_MARK)[0].rstrip("\n") + "\n"
