"""Connecting over the real library: what it brings, and why it fails, in one line each."""

import os
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

import pytest

from pepper_driver.backends import NotConnectedError
from pepper_driver.backends.naoqi.address import Secret
from pepper_driver.backends.naoqi.connection import (
    CallTimeoutError,
    LoginError,
    MissingServiceError,
    NoAnswerError,
    ServiceError,
    connect,
)
from pepper_driver.config import NaoqiSettings, PepperError
from support.certificates import certificate_in
from support.naoqi_fakes import PATIENT, FakeRobot, address_of
from support.processes import suspend
from support.virtual_naoqi import VirtualNaoqi
from support.waiting import PATIENCE

pytestmark = pytest.mark.usefixtures("qi")

QUICK_CONNECT = replace(PATIENT, connect_time=0.5)
QUICK_PROBE = replace(QUICK_CONNECT, probe_time=0.5)
QUICK_CALL = replace(PATIENT, call_time=0.5)
"""For answers that never come."""
SECRET = Secret("xyzzy-7")

SERVER = """
import sys, threading, time
from pepper_driver.backends.naoqi.qi_library import load_qi
class Slow:
    def wait(self, seconds): print("called", flush=True); time.sleep(seconds); return seconds
    def fail(self): raise ValueError("no such thing\\n\\twith a reason")
session = load_qi().Session()
session.listenStandalone("tcp://127.0.0.1:0")
session.registerService("Slow", Slow())
print(session.endpoints()[-1].rpartition(":")[2], flush=True)
sys.stdin.read()
"""


@contextmanager
def other_process() -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A NAOqi that can be stopped and killed, and its URI."""
    with subprocess.Popen(
        [sys.executable, "-c", SERVER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        try:
            yield process, f"naoqi://127.0.0.1:{int(process.stdout.readline())}"
        finally:
            process.kill()


def when_called(process: subprocess.Popen[str], action: Callable[[], object]) -> None:
    """Do something as soon as a call has come to the service there, in a thread of its own."""
    output = process.stdout
    assert output is not None

    def wait() -> None:
        if output.readline():
            action()

    threading.Thread(target=wait, daemon=True).start()


@contextmanager
def listener(answer: Callable[[socket.socket], None] | None) -> Iterator[int]:
    """The port of a program that takes connections, and does ``answer`` with each."""
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        while True:
            try:
                peer, _ = server.accept()
            except OSError:
                return
            if answer is not None:
                with suppress(OSError):
                    answer(peer)
                peer.close()
            else:
                kept.append(peer)

    kept: list[socket.socket] = []
    thread = threading.Thread(target=serve, daemon=True)
    if answer is not None:
        thread.start()
    yield server.getsockname()[1]
    server.close()


def web_server(peer: socket.socket) -> None:
    peer.recv(1000)
    peer.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")


@pytest.fixture
def fake() -> Iterator[FakeRobot]:
    with FakeRobot() as fake:
        yield fake


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(*certificate_in(tmp_path_factory.mktemp("tls")))
    return context


def tls_door(context: ssl.SSLContext, *, polite: bool = True) -> Callable[[socket.socket], None]:
    """Refuse all, without an answer, until the other has left."""

    def answer(peer: socket.socket) -> None:
        with context.wrap_socket(peer, server_side=True) as inner:
            inner.recv(1000)
            while not polite and inner.recv(1000):
                pass

    return answer


def failure(
    uri: str, secret: Secret | None = None, settings: NaoqiSettings = PATIENT
) -> PepperError:
    """Why one cannot connect: one line that names the URI and holds no secret."""
    with pytest.raises(PepperError) as caught:
        connect(address_of(uri), secret, settings=settings)
    assert "\n" not in str(caught.value)
    assert uri in str(caught.value)
    assert SECRET.value not in str(caught.value)
    return caught.value


def test_calls_bring_what_a_service_answers(fake: FakeRobot) -> None:
    connection = fake.connect()
    assert connection.connected
    assert {"ALMotion", "ALMemory", "DCM"} <= connection.service_names
    assert connection.call("ALSystem", "systemVersion") == "2.5.10.7"
    assert connection.service("ALMotion") is connection.service("ALMotion")
    connection.close()
    connection.close()
    assert not connection.connected
    with pytest.raises(NotConnectedError):
        connection.call("ALSystem", "systemVersion")


def test_no_program_listens() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    assert "no server listens at port" in str(failure(f"naoqi://127.0.0.1:{port}"))
    assert "9503" in str(failure(f"naoqis://127.0.0.1:{port}", SECRET))


def test_no_such_computer() -> None:
    assert "no computer is called" in str(failure("naoqi://no-robot.invalid"))
    assert "does not answer" in str(failure(f"naoqi://{'a' * 70}.invalid"))


def test_a_computer_that_cannot_be_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    def unreachable(*_: object, **__: object) -> socket.socket:
        raise OSError(113, "No route to host")

    monkeypatch.setattr(socket, "create_connection", unreachable)
    assert "same network" in str(failure("naoqi://10.0.0.9"))


def test_tls_against_plain(fake: FakeRobot) -> None:
    error = failure(f"naoqis://127.0.0.1:{fake.port}", SECRET)
    assert "speaks no TLS" in str(error)
    assert "write naoqi://127.0.0.1" in str(error)


def test_plain_against_tls(certificate: ssl.SSLContext) -> None:
    with listener(tls_door(certificate)) as port:
        assert f"write naoqis://nao@127.0.0.1:{port}" in str(failure(f"naoqi://127.0.0.1:{port}"))


def test_a_wrong_password(certificate: ssl.SSLContext) -> None:
    with listener(tls_door(certificate)) as port:
        error = failure(f"naoqis://nao@127.0.0.1:{port}", SECRET)
    assert isinstance(error, LoginError)
    assert "refuses the user 'nao'" in str(error)
    assert isinstance(error, PermissionError)


def test_a_door_that_says_nothing_about_the_password(certificate: ssl.SSLContext) -> None:
    with listener(tls_door(certificate, polite=False)) as port:
        error = failure(f"naoqis://nao@127.0.0.1:{port}", SECRET, QUICK_CONNECT)
    assert isinstance(error, NoAnswerError)


def test_another_program_listens() -> None:
    with listener(web_server) as port:
        assert "is no NAOqi" in str(failure(f"naoqi://127.0.0.1:{port}"))
        assert "speaks no TLS" in str(failure(f"naoqis://127.0.0.1:{port}", SECRET))


@pytest.mark.parametrize("scheme", ["naoqi", "naoqis"])
def test_a_program_listens_and_says_nothing(scheme: str) -> None:
    with listener(None) as port:
        started = time.monotonic()
        error = failure(f"{scheme}://127.0.0.1:{port}", SECRET, QUICK_PROBE)
    assert isinstance(error, NoAnswerError)
    assert isinstance(error, TimeoutError)
    assert time.monotonic() - started < 10, "half a second of trying, and of probing"


def test_a_robot_that_hangs_while_one_connects() -> None:
    with other_process() as (process, uri):
        suspend(process.pid)
        error = failure(uri, settings=QUICK_PROBE)
    assert "takes connections and says nothing" in str(error)


def test_the_password_reaches_the_robot_and_calls_go_through(
    fake: FakeRobot, certificate: ssl.SSLContext
) -> None:
    first: list[bytes] = []

    def relay(peer: socket.socket) -> None:
        try:
            front = certificate.wrap_socket(peer, server_side=True)
        except OSError:
            return  # a client only looked for a listener
        back = socket.create_connection(("127.0.0.1", fake.port))
        first.append(front.recv(4096))
        back.sendall(first[0])
        threading.Thread(target=pump, args=(back, front), daemon=True).start()
        pump(front, back)

    def pump(source: socket.socket, sink: socket.socket) -> None:
        try:
            while data := source.recv(4096):
                sink.sendall(data)
        except OSError:
            pass

    with listener(relay) as port:
        address = address_of(f"naoqis://nao@127.0.0.1:{port}")
        connection = connect(address, SECRET, settings=PATIENT)
        assert connection.call("ALSystem", "systemVersion") == "2.5.10.7"
        connection.close()
    assert b"nao" in first[0]
    assert SECRET.value.encode() in first[0]


def test_what_a_service_refuses_is_one_line_with_its_reason() -> None:
    with other_process() as (_, uri):
        connection = connect(address_of(uri), settings=PATIENT)
        with pytest.raises(
            ServiceError, match=r"Slow\.fail refused: .*no such thing with a reason$"
        ):
            connection.call("Slow", "fail")
        with pytest.raises(ServiceError, match=r"Slow\.wait"):
            connection.call("Slow", "wait", 1, 2, 3)
        with pytest.raises(MissingServiceError, match=r"no Slow\.walk"):
            connection.call("Slow", "walk")
        with pytest.raises(MissingServiceError, match="no service DCM"):
            connection.call("DCM", "getTime", 0)
        assert connection.call("Slow", "wait", 0.0) == 0.0
        connection.close()


def test_a_call_that_takes_too_long() -> None:
    with other_process() as (_, uri):
        connection = connect(address_of(uri), settings=QUICK_CALL)
        with pytest.raises(CallTimeoutError, match=r"in 0\.5 s"):
            connection.call("Slow", "wait", 30.0)
        with pytest.raises(CallTimeoutError, match=r"in 0\.1 s"):
            connection.call("Slow", "wait", 30.0, timeout=0.1)
        connection.close()


def test_the_robot_dies_in_a_call() -> None:
    lost = threading.Event()
    with other_process() as (process, uri):
        connection = connect(address_of(uri), on_lost=lost.set, settings=PATIENT)
        when_called(process, process.kill)
        with pytest.raises(NotConnectedError, match="lost"):
            connection.call("Slow", "wait", 2 * PATIENCE)
        assert lost.wait(PATIENCE)
        assert not connection.connected
        with pytest.raises(NotConnectedError):
            connection.call("Slow", "wait", 0.0)
        connection.close()


def test_a_call_that_is_cut_off_by_closing_is_no_refusal(fake: FakeRobot) -> None:
    """The library ends the calls under way first, and only then says that it is not connected."""
    connection = fake.connect()

    class Closing:
        def isConnected(self) -> bool:
            return True

        def close(self) -> None: ...

        def service(self, name: str, _async: bool) -> None:
            connection.close()
            raise RuntimeError("Session closed")

    session = connection._session
    connection._session = Closing()  # type: ignore[assignment]
    with pytest.raises(NotConnectedError, match="lost at Slow"):
        connection.service("Slow")
    session.close()


def test_closing_is_no_loss() -> None:
    lost: list[str] = []
    with VirtualNaoqi() as robot:
        closed = robot.connect(on_lost=lambda: lost.append("closed"))
        robot.connect(on_lost=lambda: lost.append("cut"))
        closed.close()
        robot.set_fault("cut")
        robot.time.sleep(1.0)
    assert lost == ["cut"]


def test_a_robot_that_hangs_does_not_block_the_caller() -> None:
    """Neither a call, nor closing."""
    with other_process() as (process, uri):
        connection = connect(address_of(uri), settings=QUICK_CALL)
        connection.service("Slow", PATIENCE)
        suspend(process.pid)
        started = time.monotonic()
        with pytest.raises(CallTimeoutError):
            connection.call("Slow", "wait", 0.0)
        connection.close()
        assert time.monotonic() - started < 10


def test_ctrl_c_ends_a_call() -> None:
    with other_process() as (process, uri):
        connection = connect(address_of(uri), settings=PATIENT)
        when_called(process, lambda: os.kill(os.getpid(), signal.SIGINT))
        started = time.monotonic()
        with pytest.raises(KeyboardInterrupt):
            connection.call("Slow", "wait", 2 * PATIENCE, timeout=2 * PATIENCE)
        assert time.monotonic() - started < PATIENCE
        connection.close()
