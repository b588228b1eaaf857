"""The network between a client and the stand-in: a relay with delays, in a process of its own."""

from __future__ import annotations

import argparse
import asyncio
import random
import selectors
import signal
import socket
import ssl
import subprocess
import sys
import threading
from collections.abc import Awaitable, Callable
from dataclasses import asdict
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Literal, Self

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.ipc import receive, send, spawn, wait_until_ready
from pepper_driver.backends.naoqi_server.tls import Login, make_certificate
from pepper_driver.config import Network, PepperError, load_network

LinkState = Literal["open", "blocked", "cut"]
"""``blocked``: nothing arrives, without an error, as out of reach of Wi-Fi; what was sent arrives once the link is
open again, as TCP repeats it. ``cut``: connections are closed at both ends, and new ones at once."""

Greeting = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[bytes | None]]
"""Reads what a client says first. Returns what of it the server is to get, or None where the client is refused."""

READ_SIZE = 65536  # [B] read at once


class Relay:
    """Connects each client to the server, over a link that can be changed at any time.

    Args:
        server: Host and port.
        network: Delays.
        greeting: Admits clients; None admits all.
        seed: Of the delays.
    """

    def __init__(
        self,
        server: tuple[str, int],
        network: Network,
        greeting: Greeting | None = None,
        seed: int | None = None,
    ) -> None:
        self.network = network
        self._server = server
        self._greeting = greeting
        self._random = random.Random(seed)
        self._state: LinkState = "open"
        self._passing = asyncio.Event()
        self._passing.set()
        self._writers: set[asyncio.StreamWriter] = set()
        self._connections: set[asyncio.Task[None]] = set()

    def change(self, state: LinkState) -> None:
        """Open, block or cut the link, from now on."""
        self._state = state
        if state == "blocked":
            self._passing.clear()
        else:
            self._passing.set()
        if state == "cut":
            for writer in self._writers:
                # Not close(), which would still send what waits.
                writer.transport.abort()

    async def close(self) -> None:
        """Cut the link, and wait until nothing is left of its connections."""
        self.change("cut")
        if self._connections:
            await asyncio.wait(self._connections)

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Carry one connection until either end closes it."""
        task = asyncio.current_task()
        assert task is not None
        self._connections.add(task)
        task.add_done_callback(self._connections.discard)
        writers = [writer]
        self._writers.add(writer)
        try:
            first = b"" if self._greeting is None else await self._greeting(reader, writer)
            if first is None or self._state == "cut":
                return
            answers, server = await asyncio.open_connection(*self._server)
            writers.append(server)
            self._writers.add(server)
            server.write(first)
            directions = [
                asyncio.create_task(self._carry(reader, server)),
                asyncio.create_task(self._carry(answers, writer)),
            ]
            await asyncio.wait(directions, return_when=asyncio.FIRST_COMPLETED)
            await _end(*directions)
        except OSError:
            pass  # one end is closed: the other is closed below
        finally:
            for end in writers:
                self._writers.discard(end)
                end.close()

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One direction, until an end closes: take packets as they come, hand each on when it is due."""
        in_flight: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()
        delivery = asyncio.create_task(self._deliver(in_flight, writer))
        due = 0.0
        try:
            while True:
                data = await reader.read(READ_SIZE)
                # TCP keeps the order: a packet with a short delay waits for the one before it.
                due = max(due, asyncio.get_running_loop().time() + self._delay())
                in_flight.put_nowait((due, data))
                if not data:
                    await delivery
                    return
        finally:
            await _end(delivery)

    async def _deliver(
        self, in_flight: asyncio.Queue[tuple[float, bytes]], writer: asyncio.StreamWriter
    ) -> None:
        clock = asyncio.get_running_loop().time
        while True:
            due, data = await in_flight.get()
            if (rest := due - clock()) > 0:
                await asyncio.sleep(rest)
            await self._passing.wait()
            if not data:
                return
            writer.write(data)
            await writer.drain()

    def _delay(self) -> float:
        """[s] of the next packet."""
        network, draw = self.network, self._random
        delay = network.delay
        if network.jitter:
            delay += draw.expovariate(1.0 / network.jitter)
        if draw.random() < network.stall_probability:
            delay += network.stall
        return delay


async def _end(*tasks: asyncio.Task[None]) -> None:
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


PROCESS_TIMEOUT = 10.0
"""[s] for the process to execute a request, on a busy machine."""


class NetworkProxy:
    """Listens in place of a server, and carries each connection over a link with delays that can be blocked and cut.

    A client of qi that connects here sends everything here: the server's services belong to the service directory it
    connects to, so it opens no second connection to the endpoints of the directory.

    Args:
        server: Host and port of the server. A client that connects while no server listens there is disconnected.
        host: Address to listen on.
        port: Port to listen on; 0 takes a free one.
        network: Name of a network in ``config/networks``, or a file.
        login: Makes it NAOqi 2.9's door: TLS with a certificate of its own, and a user with a token. None admits all.
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
        setup = {
            "server": server,
            "host": host,
            "port": port,
            "network": network,
            "login": asdict(login) if login is not None else None,
            "seed": seed,
        }
        load_network(network)  # says here what is wrong with it
        self._lock = threading.Lock()
        self._process, self._end = spawn("network", {}, {}, setup)
        ready = wait_until_ready(self._process, self._end)
        self._end.settimeout(PROCESS_TIMEOUT)
        self.pid = self._process.pid
        self.address: tuple[str, int] = (host, int(ready["port"]))

    def network(self, name: str) -> None:
        """Packets from now on are delayed as in another network.

        Raises:
            UnknownNameError: No such network.
            ConfigError: The network's file is wrong.
            BackendError: The proxy is closed.
        """
        # Checked here, where an error reaches the caller.
        load_network(name)
        self._send_change({"network": name})

    def link(self, state: LinkState) -> None:
        """Open, block or cut the link.

        Raises:
            BackendError: The proxy is closed.
        """
        self._send_change({"link": state})

    def close(self) -> None:
        """Cut the link and end the process. Does nothing when closed."""
        self._end.close()
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _send_change(self, change: dict[str, str]) -> None:
        """Have the process change the connection, and wait until it has."""
        with self._lock:
            try:
                send(self._end, change)
                if receive(self._end) is not None:
                    return
            except OSError:
                pass
        raise BackendError("the network proxy has ended")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


async def _serve(owner: socket.socket) -> None:
    """Serve until the other end of ``owner`` closes."""
    setup = receive(owner)
    if setup is None:
        return
    host, port, door, login = setup["host"], setup["port"], None, None
    try:
        if setup["login"] is not None:
            login = Login(**setup["login"])
            door = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            with TemporaryDirectory() as folder:
                door.load_cert_chain(*make_certificate(folder))
        relay = Relay(
            (setup["server"][0], setup["server"][1]),
            load_network(setup["network"]),
            login.greet if login is not None else None,
            setup["seed"],
        )
        server = await asyncio.start_server(relay.serve, host, port, ssl=door)
    except PepperError as error:
        send(owner, {"error": str(error)})
        return
    except OSError as error:
        reason = f"cannot listen on {host}:{port} ({error.strerror}); name another port"
        send(owner, {"error": reason})
        return
    over = asyncio.Event()

    def handle_request() -> None:
        change = receive(owner)
        if change is None:
            over.set()
            return
        if "network" in change:
            relay.network = load_network(change["network"])
        else:
            relay.change(change["link"])
        send(owner, {"done": change})

    loop = asyncio.get_running_loop()
    loop.add_reader(owner.fileno(), handle_request)
    send(owner, {"ready": {"port": server.sockets[0].getsockname()[1]}})
    await over.wait()
    loop.remove_reader(owner.fileno())
    server.close()
    await relay.close()


def main(arguments: list[str]) -> int:
    """Entry of the process."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--owner", type=int, required=True, metavar="DESCRIPTOR")
    owner = socket.socket(fileno=parser.parse_args(arguments).owner)
    signal.signal(
        signal.SIGINT, signal.SIG_IGN
    )  # handled by the parent process, which then ends us
    # select takes microseconds, epoll in Python whole milliseconds
    loop = asyncio.SelectorEventLoop(selectors.SelectSelector())
    loop.run_until_complete(_serve(owner))
    loop.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
