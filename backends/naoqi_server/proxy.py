"""A bad network in front of a server, in a process of its own: what happens to the server does not stop it."""

from __future__ import annotations

import asyncio
import multiprocessing
import selectors
import signal
import ssl
import threading
from dataclasses import dataclass
from multiprocessing.connection import Connection
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Self

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.relay import LinkState, Relay
from pepper_driver.backends.naoqi_server.tls import Login, make_certificate
from pepper_driver.config import Network, load_network

ANSWER_TIMEOUT = 20.0  # [s] for the process to start, or to do as it is told, on a busy machine


@dataclass(frozen=True, kw_only=True)
class _Setup:
    server: tuple[str, int]
    host: str
    port: int
    network: Network
    login: Login | None
    seed: int | None


class NetworkProxy:
    """Listens in place of a server, and carries each connection over a link with delays that can be blocked and cut.

    A client of qi that connects here sends everything here: the server's services belong to the service directory it
    connects to, so it opens no second connection to the endpoints that the directory tells.

    Args:
        server: Host and port of the server. A client that connects while nobody listens there is disconnected.
        host: Address to listen on.
        port: Port to listen on; 0 takes a free one.
        network: Name of a network in ``config/networks``, or a file.
        login: Makes it NAOqi 2.9's door: TLS with a certificate of its own, and a user with a token. None lets all in.
        seed: Of the delays.

    Attributes:
        address: Host and port where it listens.
        pid: Of its process.

    Raises:
        BackendError: It cannot listen there, or cannot make a certificate.
        UnknownNameError: No such network.
        ConfigError: The network's file is wrong.
    """

    def __init__(
        self,
        server: tuple[str, int],
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        network: str = "clear",
        login: Login | None = None,
        seed: int | None = None,
    ) -> None:
        setup = _Setup(
            server=server,
            host=host,
            port=port,
            network=load_network(network),
            login=login,
            seed=seed,
        )
        context = multiprocessing.get_context("spawn")
        self._lock = threading.Lock()
        self._control, child = context.Pipe()
        self._process = context.Process(target=_run, args=(setup, child), daemon=True)
        self._process.start()
        child.close()
        self.pid = self._process.pid
        try:
            self.address: tuple[str, int] = (host, self._answer())
        except BackendError:
            self.close()
            raise

    def network(self, name: str) -> None:
        """Packets from now on are delayed as in another network.

        Raises:
            UnknownNameError: No such network.
            ConfigError: The network's file is wrong.
            BackendError: The proxy is closed.
        """
        self._tell(load_network(name))

    def link(self, state: LinkState) -> None:
        """Open, block or cut the link.

        Raises:
            BackendError: The proxy is closed.
        """
        self._tell(state)

    def close(self) -> None:
        """Cut the link and end the process. Does nothing when closed."""
        self._control.close()
        self._process.join(2.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def _tell(self, change: Network | LinkState) -> None:
        with self._lock:
            if self._control.closed:
                raise BackendError("the network proxy is closed")
            self._control.send(change)
            self._answer()

    def _answer(self) -> int:
        """What the process says it has done: the port, at first. Raises what kept it from it."""
        try:
            if self._control.poll(ANSWER_TIMEOUT):
                answer = self._control.recv()
                if isinstance(answer, int):
                    return answer
                raise BackendError(str(answer))
            why = f"says nothing for {ANSWER_TIMEOUT:g} s"
        except (EOFError, OSError):
            why = "has ended"
        raise BackendError(f"the process of the network proxy {why}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def _run(setup: _Setup, control: Connection) -> None:
    """The process: serves until the other end of ``control`` closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all; this one ends with its owner
    # select takes microseconds, epoll in Python whole milliseconds
    make_loop = lambda: asyncio.SelectorEventLoop(selectors.SelectSelector())  # noqa: E731
    with asyncio.Runner(loop_factory=make_loop) as runner:
        runner.run(_serve(setup, control))


async def _serve(setup: _Setup, control: Connection) -> None:
    door = None
    try:
        if setup.login is not None:
            door = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            with TemporaryDirectory() as folder:
                door.load_cert_chain(*make_certificate(folder))
        greeting = setup.login.greet if setup.login is not None else None
        relay = Relay(setup.server, setup.network, greeting, setup.seed)
        server = await asyncio.start_server(relay.serve, setup.host, setup.port, ssl=door)
    except BackendError as error:
        control.send(str(error))
        return
    except OSError as error:
        control.send(
            f"cannot listen on {setup.host}:{setup.port} ({error.strerror}); name another port"
        )
        return
    over = asyncio.Event()

    def obey() -> None:
        try:
            change = control.recv()
        except (EOFError, OSError):
            over.set()
            return
        if isinstance(change, Network):
            relay.network = change
        else:
            relay.change(change)
        control.send(0)

    asyncio.get_running_loop().add_reader(control.fileno(), obey)
    control.send(server.sockets[0].getsockname()[1])
    await over.wait()
    asyncio.get_running_loop().remove_reader(control.fileno())
    server.close()
    await relay.close()
