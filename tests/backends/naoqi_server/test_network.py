"""The bad network: bytes arrive whole, in order and late; the link can be blocked and cut while they are under way."""

import random
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from pepper_driver.backends import BackendError
from pepper_driver.backends.naoqi_server.network import NetworkProxy
from pepper_driver.config import UnknownNameError

STALLS = "name: stalls\ndelay: 0.0\njitter: 0.002\nstall_probability: 0.2\nstall: 0.02\n"
SLOW = "name: slow\ndelay: 0.1\njitter: 0.0\nstall_probability: 0.0\nstall: 0.0\n"
Starter = Callable[..., NetworkProxy]


@pytest.fixture
def echo() -> Iterator[tuple[str, int]]:
    """A server that returns what it gets."""
    listener = socket.create_server(("127.0.0.1", 0))

    def answer(connection: socket.socket) -> None:
        with connection:
            try:
                while data := connection.recv(65536):
                    connection.sendall(data)
            except OSError:
                pass

    def serve() -> None:
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            threading.Thread(target=answer, args=(connection,), daemon=True).start()

    threading.Thread(target=serve, daemon=True).start()
    yield listener.getsockname()[:2]
    listener.shutdown(socket.SHUT_RDWR)
    listener.close()


@pytest.fixture
def make_proxy(echo: tuple[str, int]) -> Iterator[Starter]:
    made: list[NetworkProxy] = []

    def make(**options: object) -> NetworkProxy:
        made.append(NetworkProxy(echo, **options))  # type: ignore[arg-type]
        return made[-1]

    yield make
    for proxy in made:
        proxy.close()


def connect(proxy: NetworkProxy) -> socket.socket:
    connection = socket.create_connection(proxy.address, timeout=20.0)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def read(connection: socket.socket, size: int) -> bytes:
    got = b""
    while len(got) < size:
        data = connection.recv(size - len(got))
        if not data:
            break
        got += data
    return got


def nothing_has_come(connection: socket.socket) -> bool:
    return not select.select([connection], [], [], 0.0)[0]


def test_bytes_keep_their_order_however_the_delays_fall(
    make_proxy: Starter, tmp_path: Path
) -> None:
    """Packets drawn to take 0 ms follow ones that stall: each has its own delay, none overtakes another."""
    file = tmp_path / "stalls.yaml"
    file.write_text(STALLS)
    draw = random.Random(3)
    sent = bytes(draw.randrange(256) for _ in range(30_000))
    with connect(make_proxy(network=str(file), seed=1)) as connection:

        def send() -> None:
            at = 0
            while at < len(sent):
                size = draw.randrange(1, 600)
                connection.sendall(sent[at : at + size])
                at += size
                time.sleep(0.001)

        thread = threading.Thread(target=send)
        thread.start()
        assert read(connection, len(sent)) == sent
        thread.join()


def test_each_way_takes_its_delay_and_a_new_network_holds_at_once(
    make_proxy: Starter, tmp_path: Path
) -> None:
    file = tmp_path / "slow.yaml"
    file.write_text(SLOW)
    proxy = make_proxy(network=str(file))
    with connect(proxy) as connection:

        def round_trip() -> float:
            begin = time.perf_counter()
            connection.sendall(b"x")
            assert read(connection, 1) == b"x"
            return time.perf_counter() - begin

        assert all(round_trip() >= 0.2 for _ in range(3))
        proxy.network("clear")
        assert min(round_trip() for _ in range(20)) < 0.1


def test_a_blocked_link_is_silent_and_delivers_all_when_it_opens(make_proxy: Starter) -> None:
    """Bytes of another link come meanwhile."""
    proxy = make_proxy()
    with connect(proxy) as connection, connect(make_proxy()) as other:
        connection.sendall(b"a")
        assert read(connection, 1) == b"a"
        proxy.link("blocked")
        connection.sendall(b"bcd")
        for _ in range(200):
            other.sendall(b"a")
            assert read(other, 1) == b"a"
        assert nothing_has_come(connection)
        proxy.link("open")
        assert read(connection, 3) == b"bcd"


def test_a_cut_link_closes_what_there_is_and_refuses_new(make_proxy: Starter) -> None:
    proxy = make_proxy()
    with connect(proxy) as connection:
        connection.sendall(b"a")
        assert read(connection, 1) == b"a"
        proxy.link("cut")
        assert closed(connection)
    with connect(proxy) as connection:
        assert closed(connection)
    proxy.link("open")
    with connect(proxy) as connection:
        connection.sendall(b"b")
        assert read(connection, 1) == b"b"


def closed(connection: socket.socket) -> bool:
    """Wait for what comes; return True if it is the end of the connection."""
    try:
        return connection.recv(1) == b""
    except ConnectionError:
        return True


def test_who_connects_while_no_server_listens_is_disconnected() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = listener.getsockname()[:2]
    with NetworkProxy(address) as proxy, connect(proxy) as connection:
        assert closed(connection)


def test_mistakes_are_reported(make_proxy: Starter) -> None:
    proxy = make_proxy()
    with pytest.raises(BackendError, match=r"cannot listen on 127.0.0.1:\d+ .*another port"):
        make_proxy(port=proxy.address[1])
    with pytest.raises(UnknownNameError, match="wifi"):
        make_proxy(network="wify")
    proxy.close()
    proxy.close()
    with pytest.raises(BackendError, match="ended"):
        proxy.link("open")


def test_the_process_ends_when_its_owner_has_ended(make_proxy: Starter) -> None:
    """Its only bond is the pipe: whatever kills the owner closes that."""
    proxy = make_proxy()
    connection = connect(proxy)
    proxy._end.close()
    assert proxy._process.wait(20.0) == 0
    assert closed(connection)
    connection.close()
