"""What holds for all tests."""

import signal
from typing import Any

import pytest

import pepper_driver.backends.naoqi.before_pinocchio  # noqa: F401
from pepper_driver.backends.naoqi.library import NoQiError, load_qi

# Started in the background of a shell, tests ignore Ctrl-C, and so do the commands that they start and interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of single suites: pytest takes them here only."""
    parser.addoption(
        "--backend",
        action="append",
        metavar="URI",
        help="run tests/backends/conformance on this backend in place of those of the package; it moves",
    )


@pytest.fixture(scope="session")
def qi() -> Any:
    """NAOqi's library, for which there is no package for every computer."""
    try:
        return load_qi()
    except NoQiError as error:
        pytest.skip(str(error))
