"""What holds for all tests."""

import signal

import pytest

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
