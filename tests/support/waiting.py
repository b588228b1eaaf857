"""Waits of tests: for a condition, and not for a time in which a busy machine may get nothing done."""

import time
from collections.abc import Callable

PATIENCE = 30.0  # [s] only a failing test waits this long


def wait_until(condition: Callable[[], object], seconds: float = PATIENCE) -> bool:
    """Wait for a condition; return True if it came true."""
    end = time.monotonic() + seconds
    while not (true := bool(condition())) and time.monotonic() < end:
        time.sleep(0.005)
    return true
