"""NAOqi 2.9's door: a client with the token comes in, any other gets an error and stays out."""

import socket
import ssl
import struct
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends import BackendError
from pepper_driver.backends.naoqi_server.network import NetworkProxy
from pepper_driver.backends.naoqi_server.tls import (
    AUTHENTICATE,
    CALL,
    ERROR,
    HEADER,
    MAGIC,
    Login,
    read_capabilities,
)

LOGIN = Login(user="nao", token="a token")
SERVER = """
import sys, qi
class Echo:
    def echo(self, text): return text
session = qi.Session()
session.listenStandalone("tcp://127.0.0.1:0")
session.registerService("Echo", Echo())
print("port", session.endpoints()[0].rsplit(":", 1)[1], flush=True)
sys.stdin.read()
"""


@pytest.fixture(scope="module")
def qi_server() -> Iterator[tuple[str, int]]:
    pytest.importorskip("qi")
    with subprocess.Popen(
        [sys.executable, "-c", SERVER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        lines = iter(process.stdout.readline, "")
        port = next(int(line.split()[1]) for line in lines if line.startswith("port"))
        yield "127.0.0.1", port
        process.stdin.close()
        process.wait(20.0)


@pytest.fixture(scope="module")
def door(qi_server: tuple[str, int]) -> Iterator[NetworkProxy]:
    with NetworkProxy(qi_server, login=LOGIN) as proxy:
        yield proxy


def session(user: str | None, token: str = "") -> Any:
    qi = pytest.importorskip("qi")
    made = qi.Session()

    class Authenticator:
        def initialAuthData(self) -> dict[str, Any]:
            return {"user": user, "token": token}

    class Factory:
        def newAuthenticator(self) -> Authenticator:
            return Authenticator()

    if user is not None:
        made.setClientAuthenticatorFactory(Factory())
    return made


def test_who_has_the_token_comes_in(door: NetworkProxy) -> None:
    client = session("nao", "a token")
    client.connect(f"tcps://127.0.0.1:{door.address[1]}")
    assert client.service("Echo").echo("all of it") == "all of it"
    client.close()


def test_all_services_go_through_the_door(door: NetworkProxy, qi_server: tuple[str, int]) -> None:
    """The directory gives the server's own endpoint, which a client here could reach: it does not use it."""
    client, past_the_door = session("nao", "a token"), session(None)
    client.connect(f"tcps://127.0.0.1:{door.address[1]}")
    past_the_door.connect(f"tcp://127.0.0.1:{qi_server[1]}")
    echo, directly = client.service("Echo"), past_the_door.service("Echo")
    door.link("blocked")
    answer = echo.echo("later", _async=True)
    for _ in range(200):  # the service has the time for it
        assert directly.echo("now") == "now"
    assert answer.isRunning()
    door.link("open")
    assert answer.value(20_000) == "later"
    client.close()
    past_the_door.close()


@pytest.mark.parametrize(
    ("user", "token"), [("nao", "another"), ("someone", "a token"), ("nao", ""), (None, "")]
)
def test_who_has_not_stays_out(door: NetworkProxy, user: str | None, token: str) -> None:
    client = session(user, token)
    with pytest.raises(RuntimeError):
        client.connect(f"tcps://127.0.0.1:{door.address[1]}")
    assert not client.isConnected()


def test_plain_qi_does_not_get_in(door: NetworkProxy) -> None:
    client = session("nao", "a token")
    with pytest.raises(RuntimeError):
        client.connect(f"tcp://127.0.0.1:{door.address[1]}")


def test_the_refusal_says_why_in_the_words_of_the_protocol(door: NetworkProxy) -> None:
    anyone = ssl.create_default_context()
    anyone.check_hostname, anyone.verify_mode = False, ssl.CERT_NONE
    for action, word in ((AUTHENTICATE, b"invalid user or token"), (100, b"Expected auth")):
        with (
            socket.create_connection(door.address, timeout=20.0) as raw,
            anyone.wrap_socket(raw) as connection,
        ):
            body = struct.pack("<I", 0)
            connection.sendall(HEADER.pack(MAGIC, 7, len(body), 0, CALL, 0, 0, 0, action) + body)
            _, number, size, _, kind, *_ = HEADER.unpack(connection.recv(HEADER.size))
            assert (number, kind) == (7, ERROR)
            assert word in connection.recv(size)
            assert connection.recv(1) == b""


def test_a_login_does_not_show_its_token() -> None:
    assert "a token" not in repr(LOGIN)


def test_without_openssl_the_message_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(BackendError, match="install openssl"):
        NetworkProxy(("127.0.0.1", 1), login=LOGIN)


def text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


def test_capabilities_are_read_as_qi_writes_them() -> None:
    """Recorded from qi 3.1.5: flags first, then user and token as dynamic values in dynamic values."""
    body = struct.pack("<I", 3)
    body += text("MessageFlags") + text("b") + b"\x01"
    body += text("auth_token") + text("m") + text("s") + text("secret")
    body += text("auth_user") + text("m") + text("s") + text("nao")
    assert read_capabilities(body) == {
        "MessageFlags": True,
        "auth_token": "secret",
        "auth_user": "nao",
    }


@given(st.binary(max_size=200))
def test_garbage_for_capabilities_admits_no_client(body: bytes) -> None:
    found = read_capabilities(body)
    assert "auth_token" not in found or b"auth_token" in body
