"""What holds for all tests."""

import signal
from typing import Any

import pytest

from pepper_driver.backends.naoqi.library import NoQiError, load_qi

# Started in the background of a shell, tests ignore Ctrl-C, and so do the commands that they start and interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def qi() -> Any:
    """NAOqi's library, for which there is no package for every computer."""
    try:
        return load_qi()
    except NoQiError as error:
        pytest.skip(str(error))
