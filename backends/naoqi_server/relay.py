"""What is between two ends of TCP: packets that come late, in order; a link that holds them, or is cut."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable
from typing import Literal

from pepper_driver.config import Network

LinkState = Literal["open", "blocked", "cut"]
"""``blocked``: nothing arrives and nobody is told, as out of reach of Wi-Fi; what was sent arrives once the link is
open again, as TCP repeats it. ``cut``: connections are closed at both ends, and new ones at once."""

Greeting = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[bytes | None]]
"""Reads what a client says first. Returns what of it the server is to get, or None where the client is refused."""

PACKET = 65536  # [B] read at once


class Relay:
    """Connects each client to the server, over a link that can be changed at any time.

    Args:
        server: Host and port.
        network: Delays.
        greeting: Lets clients in; None lets all in.
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
            ways = [
                asyncio.create_task(self._carry(reader, server)),
                asyncio.create_task(self._carry(answers, writer)),
            ]
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            await _end(*ways)
        except OSError:
            pass  # an end is gone: so is the other, below
        finally:
            for end in writers:
                self._writers.discard(end)
                end.close()

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One direction, until an end closes: take packets as they come, hand each on when it is due."""
        under_way: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()
        delivery = asyncio.create_task(self._deliver(under_way, writer))
        due = 0.0
        try:
            while True:
                data = await reader.read(PACKET)
                due = max(due, asyncio.get_running_loop().time() + self._delay())
                under_way.put_nowait((due, data))
                if not data:
                    await delivery
                    return
        finally:
            await _end(delivery)

    async def _deliver(
        self, under_way: asyncio.Queue[tuple[float, bytes]], writer: asyncio.StreamWriter
    ) -> None:
        clock = asyncio.get_running_loop().time
        while True:
            due, data = await under_way.get()
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
        if draw.random() < network.stall_share:
            delay += network.stall
        return delay


async def _end(*tasks: asyncio.Task[None]) -> None:
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
