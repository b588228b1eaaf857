"""The stream of a simulated robot, received as another program does; and what comes back."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from pepper_driver import Pepper, PepperError
from pepper_driver.backends.log_file import CDR_HEADER, TICK_TOPIC, fields_of, row_type
from pepper_driver.controller import Tick
from pepper_driver.log.topics import CONTACTS
from pepper_driver.reflexes import Hold
from pepper_driver.telemetry import Kind, TelemetryClient, TelemetryError, TelemetryServer
from pepper_driver.telemetry import server as server_module
from pepper_driver.telemetry.protocol import Message
from pepper_driver.telemetry.server import Request

LONG = 20.0
"""[s] after which a test gives up waiting for another thread."""


@pytest.fixture
def server() -> Iterator[TelemetryServer]:
    server = TelemetryServer()
    yield server
    server.close()


def listen(server: TelemetryServer) -> TelemetryClient:
    return TelemetryClient(server.address, server.token)


def receive_until(client: TelemetryClient, kind: Kind, count: int = 1) -> list[Message]:
    """All messages up to the ``count``-th of a kind."""
    found: list[Message] = []
    end = time.monotonic() + LONG
    while sum(message.kind is kind for message in found) < count:
        assert time.monotonic() < end, [message.kind for message in found]
        if (message := client.receive(0.1)) is not None:
            found.append(message)
    return found


def of(messages: list[Message], kind: Kind) -> list[Message]:
    return [message for message in messages if message.kind is kind]


def wait_for(what: Any) -> None:
    end = time.monotonic() + LONG
    while not what():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_a_listener_receives_rows_poses_and_contacts_as_they_are(server: TelemetryServer) -> None:
    """Values are those of the tick, bit for bit; every contact comes, and none twice."""
    measured: dict[float, Any] = {}
    bases: dict[float, Any] = {}
    with listen(server) as client, Pepper("mujoco", reflexes=[Hold()]) as pepper:
        pepper.stream_to(server)
        about = receive_until(client, Kind.ABOUT)[-1].json
        kind = row_type(fields_of(about["layout"])[TICK_TOPIC])
        assert about["run"]["backend"] == "mujoco"
        pepper.set_posture({"LShoulderPitch": 0.6, "LElbowRoll": -0.9}, duration=2.0)

        def note(tick: Tick, _: object) -> None:
            measured[tick.measurement.time] = tick
            bases[tick.measurement.time] = pepper.backend.truth.base

        pepper.run(3.0, on_tick=note)
        pepper.grab("LForeArm", [0.0, 0.15, 0.05], hold=1.0)
        for _ in range(40):  # as slow as a thread that sends needs
            pepper.run(0.048, on_tick=note)
            time.sleep(0.015)
        server.close()
        messages = list(client)
        history = pepper.contact_history
    rows = [np.frombuffer(m.data, kind, offset=len(CDR_HEADER))[0] for m in of(messages, Kind.TICK)]
    assert len(rows) > 10
    for row in rows:
        tick = measured[float(row["time"])]
        assert np.array_equal(row["position"], tick.measurement.position)
        assert np.array_equal(row["sent_position"], tick.sent.position)
    assert all(earlier["time"] < later["time"] for earlier, later in pairwise(rows))
    poses = [m.json for m in of(messages, Kind.POSE)]
    assert len(poses) == len(rows)
    for row, pose in zip(rows, poses, strict=True):
        assert pose["base"] == bases[float(row["time"])].tolist()
    pushed = [force for pose in poses for force in pose["forces"]]
    assert {force["link"] for force in pushed} == {"LForeArm"}
    assert max(np.linalg.norm(force["force"]) for force in pushed) > 10.0
    contacts = tuple(CONTACTS.decode(m.data) for m in of(messages, Kind.CONTACT))
    assert contacts
    assert contacts == tuple(history)
    assert any(m.json["kind"] == "reflex" for m in of(messages, Kind.EVENT))
    status = of(messages, Kind.STATUS)[-1].json
    assert (status["state"], status["fault"]) == ("active", "")


def test_a_second_run_is_announced(server: TelemetryServer) -> None:
    pepper = Pepper("mujoco", observer=None)
    pepper.stream_to(server)
    with listen(server) as client:
        for seed in range(2):
            with pepper:
                pepper.run(0.1)
                about = receive_until(client, Kind.ABOUT)[-1].json
                assert about["run"]["observer"] == "none", seed


def test_a_late_listener_gets_the_description_of_the_run(server: TelemetryServer) -> None:
    with Pepper("mujoco", observer=None) as pepper:
        pepper.stream_to(server)
        pepper.run(0.2)
        with listen(server) as client:
            assert receive_until(client, Kind.ABOUT)[0].kind is Kind.ABOUT


def test_without_the_token_nothing_comes(server: TelemetryServer) -> None:
    with Pepper("mujoco", observer=None) as pepper:
        pepper.stream_to(server)
        for first in (b"GET / HTTP/1.1\r\n\r\n", b"\x00" * 40):
            with socket.create_connection(server.address, timeout=LONG) as stranger:
                stranger.sendall(first)
                pepper.run(0.1)
                assert stranger.recv(100) == b""
        wrong = TelemetryClient(server.address, "wrong")
        with pytest.raises(TelemetryError, match="ended"):
            receive_until(wrong, Kind.ABOUT)
        with listen(server) as client:  # the stream goes on
            receive_until(client, Kind.ABOUT)


def test_one_that_takes_nothing_holds_up_no_one(
    server: TelemetryServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows are left out for it, and at last it is left; ticks and others go on."""
    monkeypatch.setattr(server_module, "MAX_BACKLOG", 2**14)
    send = server_module._Listener.send
    monkeypatch.setattr(
        server_module._Listener,
        "send",
        lambda listener: None if listener.number == 1 else send(listener),
    )
    with Pepper("mujoco", observer=None) as pepper:
        pepper.stream_to(server)
        with listen(server) as silent, listen(server) as client:
            receive_until(client, Kind.ABOUT)
            ticks = 0
            for _ in range(20):
                pepper.run(0.12)
                ticks += 10
                receive_until(client, Kind.TICK)
            assert pepper.statistics.ticks == ticks
            with pytest.raises(TelemetryError, match="ended"):
                receive_until(silent, Kind.TICK)


def test_requests_are_done_and_answered() -> None:
    done: list[tuple[int, Request]] = []
    left: list[int] = []

    def act(listener: int, request: Request) -> object:
        done.append((listener, request))
        if request["do"] == "refuse":
            raise PepperError("not today")
        return {"was": request["do"]} if request["do"] == "ask" else request["nothing"]

    server = TelemetryServer(act, on_leave=left.append)
    try:
        with listen(server) as client:
            numbers = [client.request(do, value=1) for do in ("ask", "refuse", "break")]
            answers = [m.json for m in receive_until(client, Kind.ANSWER, 3)]
            assert [answer["number"] for answer in answers] == numbers
            assert answers[0]["result"] == {"was": "ask"}
            assert answers[1]["error"] == "not today"
            assert "no request" in answers[2]["error"]
            assert "\n" not in answers[2]["error"]
            assert [request["do"] for _, request in done] == ["ask", "refuse", "break"]
            assert not left
        wait_for(lambda: left)
        assert left == [done[0][0]]
    finally:
        server.close()


def test_a_stream_without_requests_refuses_them(server: TelemetryServer) -> None:
    with listen(server) as client:
        client.request("stop")
        assert "no requests" in receive_until(client, Kind.ANSWER)[-1].json["error"]


def test_where_nothing_listens_the_error_is_one_line(server: TelemetryServer) -> None:
    server.close()
    with pytest.raises(TelemetryError) as error:
        listen(server)
    assert "\n" not in str(error.value)
    assert str(server.address[1]) in str(error.value)


def test_the_end_of_the_stream_is_reported(server: TelemetryServer) -> None:
    with listen(server) as client:
        client.request("anything")
        receive_until(client, Kind.ANSWER)
        server.close()
        with pytest.raises(TelemetryError, match="ended"):
            receive_until(client, Kind.ABOUT)
        assert list(client) == []
