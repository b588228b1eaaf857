"""One driver at a time: over the real library, whose service directory is the lock."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Iterator
from typing import Any, cast

import pytest

from pepper_driver.backends.interface import NotConnectedError
from pepper_driver.backends.naoqi import presence as module
from pepper_driver.backends.naoqi.connection import (
    CallTimeoutError,
    Connection,
    ServiceError,
)
from pepper_driver.backends.naoqi.presence import NAME, Presence, SecondDriverError
from pepper_driver.backends.naoqi.qi_library import QiSession
from support.naoqi_fakes import FakeRobot, address_of
from support.virtual_naoqi import URI, VirtualNaoqi
from support.waiting import PATIENCE, wait_until

pytestmark = pytest.mark.usefixtures("qi")


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine may take its time to take a service out."""
    monkeypatch.setattr(module, "ASK_TIME", PATIENCE)


@pytest.fixture(scope="module")
def robot() -> Iterator[FakeRobot]:
    with FakeRobot() as running:
        yield running


@pytest.fixture
def connections(robot: FakeRobot) -> Iterator[list[Connection]]:
    made = [robot.connect() for _ in range(3)]
    yield made
    for connection in made:
        connection.close()


def registered(connection: Connection) -> int:
    return sum(service["name"] == NAME for service in connection.services)


def test_the_first_drives_and_the_second_is_refused_until_it_ends(
    connections: list[Connection],
) -> None:
    one, two, witness = connections
    first, second = Presence(one, force=False), Presence(two, force=False)
    first.begin()
    with pytest.raises(SecondDriverError, match=r"already: this very program.*\?force=1") as caught:
        second.begin()
    assert "\n" not in str(caught.value)
    assert one.address.uri in str(caught.value)
    second.end()
    assert registered(witness) == 1, "who was refused takes nothing out"
    first.end()
    first.end()
    assert registered(witness) == 0
    second.begin()
    second.end()


def test_it_goes_with_the_connection(connections: list[Connection]) -> None:
    one, two, witness = connections
    Presence(one, force=False).begin()
    one.close()
    assert wait_until(lambda: registered(witness) == 0)
    Presence(two, force=False).begin()


def test_force_takes_the_place_of_the_other(
    connections: list[Connection], caplog: pytest.LogCaptureFixture
) -> None:
    one, two, third = connections
    first, second = Presence(one, force=False), Presence(two, force=True)
    first.begin()
    second.begin()
    assert "as well" in caplog.text
    first.end()
    assert registered(third) == 1, "not the one that was its own"
    with pytest.raises(SecondDriverError):
        Presence(third, force=False).begin()
    second.end()
    assert registered(third) == 0


def test_of_two_that_begin_at_once_one_is_refused(connections: list[Connection]) -> None:
    one, two, witness = connections
    start = threading.Barrier(2)

    def begin(presence: Presence, refused: list[SecondDriverError]) -> None:
        start.wait()
        try:
            presence.begin()
        except SecondDriverError as error:
            refused.append(error)

    for _ in range(20):
        presences = [Presence(connection, force=False) for connection in (one, two)]
        refused: list[SecondDriverError] = []
        threads = [threading.Thread(target=begin, args=[made, refused]) for made in presences]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(refused) == 1
        assert registered(witness) == 1
        for presence in presences:
            presence.end()


def test_others_can_ask_who_drives(connections: list[Connection]) -> None:
    one, two, _ = connections
    presence = Presence(one, force=False)
    presence.begin()
    assert two.call(NAME, "pid") == os.getpid()
    assert str(two.call(NAME, "since")).startswith("20")
    presence.end()


def test_each_end_is_one_question() -> None:
    """A start is not held up: all that takes time over a network are questions."""
    with VirtualNaoqi() as robot:
        session = robot.session()
        time = robot.time.clock()
        connection = Connection(address_of(URI), cast(QiSession, session), None, 3.0, time)
        presence = Presence(connection, force=False, clock=time)
        presence.begin()
        presence.end()
        presence.end()
        assert [what for _, what in session.asked] == ["registerService", "unregisterService"]


# -- a robot that does otherwise ----------------------------------------------------------------------------------


class Refusing:
    """A connection with a robot whose directory takes nothing.

    Args:
        error: Raised by it.
        services: In its directory.
    """

    def __init__(self, error: Exception, services: list[dict[str, Any]]) -> None:
        self.address = self
        self.uri = "naoqi://old"
        self.services = services
        self._error = error

    def register(self, name: str, service: object) -> int:
        raise self._error

    def call(self, service: str, method: str, *, timeout: float) -> None:
        raise CallTimeoutError("it gave no answer")


def presence_at(error: Exception, services: list[dict[str, Any]]) -> Presence:
    return Presence(cast(Connection, Refusing(error, services)), force=False)


def test_a_robot_that_allows_no_services_is_driven_with_a_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    presence = presence_at(ServiceError("registering PepperDriver refused: not allowed"), [])
    presence.begin()
    presence.end()
    (warning,) = (record for record in caplog.records if record.levelno == logging.WARNING)
    assert "a second driver would not be noticed" in warning.message
    assert "not allowed" in warning.message


def test_a_driver_that_cannot_be_asked_is_named_by_its_process() -> None:
    other = {"name": NAME, "serviceId": 40, "processId": os.getpid() + 1}
    presence = presence_at(ServiceError("already registered"), [other])
    with pytest.raises(SecondDriverError, match=rf"process {os.getpid() + 1}, .*another computer"):
        presence.begin()


def test_a_lost_connection_is_no_second_driver() -> None:
    class Lost(Refusing):
        @property
        def services(self) -> list[dict[str, Any]]:
            raise NotConnectedError("the connection was lost")

        @services.setter
        def services(self, _: object) -> None: ...

    presence = Presence(cast(Connection, Lost(NotConnectedError("lost"), [])), force=False)
    with pytest.raises(NotConnectedError):
        presence.begin()
