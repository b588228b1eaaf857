"""Requests to the robot process: answered, refused, or not answered at all; the answers of others do not count."""

import os
import socket
from collections.abc import Iterator
from threading import Thread
from typing import Any

import pytest

from pepper_driver.backends import BackendError
from pepper_driver.backends.naoqi_server.ipc import (
    MAX_PACKET_SIZE,
    RobotClient,
    make_pair,
    receive,
    send,
)
from pepper_driver.backends.naoqi_server.shared_values import Table
from pepper_driver.config import load_robot


@pytest.fixture
def table() -> Iterator[Table]:
    file = Table.make_file()
    yield Table(file, 1, load_robot())
    os.close(file)


@pytest.fixture
def ends() -> Iterator[tuple[socket.socket, socket.socket]]:
    first, second = make_pair()
    with first, second:
        yield first, second


def answering(end: socket.socket, answers: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A robot process that gives these answers to one request; returns where the request will be put."""
    asked: list[dict[str, Any]] = []

    def run() -> None:
        message = receive(end)
        assert message is not None
        asked.append(message)
        for answer in answers:
            send(end, {"number": message["number"], **answer})

    Thread(target=run, daemon=True).start()
    return asked


def test_a_request_and_its_answer(table: Table, ends: tuple[socket.socket, socket.socket]) -> None:
    link = RobotClient(table, ends[0], {"a": 0}, frozenset({"a"}))
    asked = answering(ends[1], [{}])
    link.order(["a"], "Merge", [[(0.1 + 0.2, -(2**31))]])
    arguments = {"actuators": ["a"], "update": "Merge", "commands": [[[0.1 + 0.2, -(2**31)]]]}
    assert asked[0]["ask"] == "order"
    assert asked[0]["arguments"] == arguments


def test_the_answer_to_a_caller_that_died_is_not_taken_for_ours(
    table: Table, ends: tuple[socket.socket, socket.socket]
) -> None:
    link = RobotClient(table, ends[0], {"a": 0}, frozenset({"a"}))
    send(ends[1], {"number": 1})
    answering(ends[1], [{"number": 2, "error": "not ours"}, {"error": "no such link"}])
    with pytest.raises(BackendError, match="no such link"):
        link.push(link="Tail")


def test_a_robot_that_does_not_answer(
    table: Table, ends: tuple[socket.socket, socket.socket]
) -> None:
    link = RobotClient(table, ends[0], {}, frozenset(), reply_time=0.05)
    with pytest.raises(BackendError, match="does not answer"):
        link.clear_faults()
    ends[1].close()
    with pytest.raises(BackendError, match="has ended"):
        link.clear_faults()


def test_too_much_at_once(table: Table, ends: tuple[socket.socket, socket.socket]) -> None:
    link = RobotClient(table, ends[0], {}, frozenset())
    with pytest.raises(BackendError, match="too long"):
        link.set_fault("press", sensors=["x" * MAX_PACKET_SIZE])
