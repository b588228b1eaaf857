"""What holds for all tests."""

import signal
from typing import Any

import pytest

# Started in the background of a shell, tests ignore Ctrl-C, and so do the commands that they start and interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def qi() -> Any:
    """NAOqi's library, for which there is no package for every computer."""
    return pytest.importorskip("qi", reason="qi exists for Linux on x86-64, Python 3.11 and 3.12")
