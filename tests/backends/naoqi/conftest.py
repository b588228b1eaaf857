"""What speaks with NAOqi is tested over the real library; there is none for every computer."""

from collections.abc import Iterator

import pytest
from naoqi_fakes import FakeRobot

from pepper_driver.backends.naoqi.connection import Connection, connect


@pytest.fixture(autouse=True, scope="session")
def _library() -> None:
    pytest.importorskip("qi", reason="qi exists for Linux on x86-64 with Python 3.11 or 3.12")


@pytest.fixture
def fake() -> Iterator[FakeRobot]:
    """A robot that is well, at ``fake.uri``."""
    with FakeRobot() as fake:
        yield fake


@pytest.fixture
def connection(fake: FakeRobot) -> Iterator[Connection]:
    connection = connect(fake.address)
    yield connection
    connection.close()
