"""What holds for all tests, and the stand-in robot that many of them share."""

import signal
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest

from pepper_driver.backends.naoqi_server.launch import StandIn

# Started in the background of a shell, tests ignore Ctrl-C, and so do the commands that they start and interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def qi() -> ModuleType:
    """The library; where it cannot be installed, tests that need it are skipped."""
    module: ModuleType = pytest.importorskip("qi")
    return module


@pytest.fixture(scope="module")
def stand_in(qi: ModuleType) -> Iterator[StandIn]:
    with StandIn("mujoco://?seed=3", network="clear") as running:
        yield running


@pytest.fixture
def session(qi: ModuleType, stand_in: StandIn) -> Iterator[Any]:
    """A client, on a stand-in with nothing wrong before and afterwards."""
    stand_in.clear_faults()
    made = qi.Session()
    made.connect(stand_in.url)
    yield made
    made.close()
    stand_in.clear_faults()
