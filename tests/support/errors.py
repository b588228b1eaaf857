"""The way of errors between processes."""

from __future__ import annotations

from multiprocessing import Pipe
from typing import Any


def sent(error: Exception) -> Any:
    """Return an error as another process receives it."""
    here, there = Pipe()
    there.send(error)
    return here.recv()


def is_copy(copy: Any, error: Exception) -> bool:
    """Return True for an error of the same type, message and data."""
    return type(copy) is type(error) and str(copy) == str(error) and vars(copy) == vars(error)
