"""The stream of a running robot: a ring that the tick fills, a thread that sends it to all who listen.

No listener can hold up a tick, nor another listener: what one does not take in time is left out for it.
"""

from __future__ import annotations

import json
import logging
import secrets
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from pepper_driver.backends.fields import TICK_FIELDS
from pepper_driver.backends.simulated import TrueContact, Truth
from pepper_driver.config import PepperError, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import reason
from pepper_driver.log.schema import Rows, TickRow, layout_metadata, unobserved
from pepper_driver.log.topics import CONTACTS, EVENTS, LogEvent
from pepper_driver.telemetry.protocol import (
    Kind,
    Message,
    MessageBuffer,
    TelemetryError,
    pack,
    pack_json,
)

if TYPE_CHECKING:
    from pepper_driver.loop import TickRecord

logger = logging.getLogger("pepper_driver")

STRIDE = 3
"""Every third tick is sent: 28 a second at 12 ms, enough for pictures."""

POLL = 0.012
"""[s] between two looks at the ring."""

STATUS_PERIOD = 0.25
"""[s] between two messages on the state of the run."""

RING = 4096
"""Entries that wait to be sent, at most; the oldest go."""

BACKLOG = 2**18
"""[bytes] that wait for a slow listener, at most: then rows are left out for it, as pictures would be late."""

MAX_BACKLOG = 2**22
"""[bytes] at which a listener that takes nothing is left."""

GREETING_TIME = 5.0
"""[s] for a new connection to show its token."""

Request = Mapping[str, Any]
OnRequest = Callable[[int, Request], object]
"""Does what a listener asks, given its number, and returns what JSON can hold; raises a PepperError. Must be quick."""


class _Entry(NamedTuple):
    record: TickRecord | None  # whose contacts and events are sent
    row: TickRow | None  # that no loop has made
    shown: bool  # with a picture, not only with its events
    base: FloatArray | None = None
    tilt: FloatArray | None = None
    forces: tuple[TrueContact, ...] = ()


class _Listener:
    """One connection: bytes that wait for it, and its requests."""

    def __init__(self, connection: socket.socket, number: int) -> None:
        self.socket, self.number = connection, number
        self.greeted, self.since = False, time.monotonic()
        self.waiting = bytearray()
        self.messages = MessageBuffer()

    @property
    def hangs(self) -> bool:
        """True where it takes nothing, or has shown no token in time."""
        return len(self.waiting) > MAX_BACKLOG or not (
            self.greeted or time.monotonic() < self.since + GREETING_TIME
        )

    def send(self) -> None:
        """Send what it takes now."""
        while self.waiting:
            try:
                sent = self.socket.send(self.waiting)
            except BlockingIOError:
                return
            del self.waiting[:sent]


class TelemetryServer:
    """Streams runs of a robot to other processes on this computer, and hands over what they request.

    It outlives a run: the next one begins with a new ``ABOUT``. One thread sends and receives.

    Args:
        on_request: Called for each request, on this server's thread; None refuses all.
        on_leave: Called with the number of a listener that has left, on the same thread.
        can: Returns at the begin of a run what may be requested, for listeners to show.

    Attributes:
        address: Host and port; always of this computer alone.
        token: Text that a listener must know.

    Raises:
        TelemetryError: There is no free port.
    """

    def __init__(
        self,
        on_request: OnRequest | None = None,
        *,
        on_leave: Callable[[int], None] | None = None,
        can: Callable[[], Mapping[str, object]] = dict,
    ) -> None:
        self.token = secrets.token_urlsafe(16)
        self._on_request, self._on_leave = on_request, on_leave
        self._can = can
        try:
            self._socket = socket.create_server(("127.0.0.1", 0))
        except OSError as error:
            raise TelemetryError(f"no port is free for telemetry ({reason(error)})") from error
        self._socket.setblocking(False)
        self.address: tuple[str, int] = self._socket.getsockname()
        self._ring: deque[_Entry] = deque(maxlen=RING)
        self._run: _Run | None = None
        self._count = 0
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._socket, selectors.EVENT_READ)
        self._listeners: dict[int, _Listener] = {}
        self._connections = 0
        self._closing = threading.Event()
        self._thread = threading.Thread(
            target=self._serve, name="pepper_driver.telemetry", daemon=True
        )
        self._thread.start()

    # -- called by the run ----------------------------------------------------------------------------------------

    def begin(
        self,
        truth: Truth | None,
        robot: RobotConfig,
        metadata: Mapping[str, str],
        status: Callable[[], Mapping[str, object]],
    ) -> None:
        """Announce a run.

        Args:
            truth: Of a simulation, which the pictures of :meth:`append` then show; or None.
            robot: Its description.
            metadata: Text about the run, as in a log.
            status: Called a few times a second on this server's thread; returns what JSON can hold.
        """
        self._ring.clear()
        self._run = _Run(truth, robot, metadata, status, self._can())

    def append(self, record: TickRecord) -> None:
        """Take a tick, inside it. Never raises, never waits."""
        run, observation = self._run, record.observation
        if run is None:
            return
        self._count += 1
        if self._count % STRIDE == 0:
            self._ring.append(run.entry(record))
        elif record.events or (observation is not None and observation.contacts):
            self._ring.append(_Entry(record, None, shown=False))

    def show(
        self,
        row: TickRow,
        *,
        base: FloatArray,
        tilt: FloatArray | None = None,
        forces: tuple[TrueContact, ...] = (),
    ) -> None:
        """Take a row that no loop has made, as often as it is to be shown.

        Args:
            row: As in a log.
            base: (3,) x, y [m], yaw [rad] of the base.
            tilt: (2,) pitch, roll of the base [rad]; None where unknown.
            forces: Contacts that a simulation knows.
        """
        if self._run is not None:
            self._ring.append(_Entry(None, row, True, base, tilt, forces))

    def log_event(self, event: LogEvent) -> None:
        """Send what happened outside any tick."""
        if self._run is not None:
            self._run.events.append(event)

    def close(self) -> None:
        """Send what waits, and end all connections. Does nothing when closed."""
        self._closing.set()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    # -- the thread -----------------------------------------------------------------------------------------------

    def _serve(self) -> None:
        announced: _Run | None = None
        next_status = 0.0
        while not self._closing.is_set():
            self._handle_sockets()
            run = self._run
            if run is not announced:
                announced = run
                for listener in self._listeners.values():
                    self._introduce(listener)
            if run is None:
                continue
            self._send_entries(run)
            if time.monotonic() >= next_status:
                next_status = time.monotonic() + STATUS_PERIOD
                self._send(run.status())
        if announced is not None:
            self._send_entries(announced)
        for listener in tuple(self._listeners.values()):
            self._drop(listener)
        self._selector.close()
        self._socket.close()

    def _send_entries(self, run: _Run) -> None:
        """Send all events that wait, and the newest row."""
        newest: _Entry | None = None
        while self._ring:
            entry = self._ring.popleft()
            newest = entry if entry.shown else newest
            if entry.record is not None:
                self._send(run.events_of(entry.record))
        while run.events:
            self._send(pack(Kind.EVENT, EVENTS.encode(run.events.popleft())))
        if newest is not None and self._listeners:
            self._send(run.picture(newest), least=True)

    def _send(self, data: bytes, *, least: bool = False) -> None:
        """Send to all; what matters ``least`` not to those with a backlog."""
        if not data:
            return
        for listener in tuple(self._listeners.values()):
            if listener.greeted and not (least and len(listener.waiting) > BACKLOG):
                listener.waiting += data
                self._flush(listener)

    def _flush(self, listener: _Listener) -> None:
        try:
            listener.send()
        except OSError:
            self._drop(listener)
            return
        if listener.hangs:
            logger.warning("a listener of the telemetry takes nothing, and is left")
            self._drop(listener)
            return
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if listener.waiting else 0)
        self._selector.modify(listener.socket, events, listener)

    def _handle_sockets(self) -> None:
        for key, events in self._selector.select(POLL):
            listener: _Listener | None = key.data
            if listener is None:
                self._accept()
                continue
            if events & selectors.EVENT_READ:
                self._receive(listener)
            if events & selectors.EVENT_WRITE and listener.number in self._listeners:
                self._flush(listener)
        for listener in tuple(self._listeners.values()):
            if listener.hangs:
                self._drop(listener)

    def _accept(self) -> None:
        try:
            connection, _ = self._socket.accept()
        except OSError:  # it has left again
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._connections += 1
        listener = _Listener(connection, self._connections)
        self._listeners[listener.number] = listener
        self._selector.register(connection, selectors.EVENT_READ, listener)

    def _receive(self, listener: _Listener) -> None:
        try:
            data = listener.socket.recv(2**16)
            if not data:
                raise TelemetryError("left")
            for message in listener.messages.feed(data):
                self._take(listener, message)
        except BlockingIOError:
            return
        except (OSError, ValueError, TelemetryError):  # it has left, or is no listener of ours
            self._drop(listener)

    def _take(self, listener: _Listener, message: Message) -> None:
        contents = message.json
        if not listener.greeted:
            token = str(contents.get("token", ""))
            if message.kind is not Kind.HELLO or not secrets.compare_digest(token, self.token):
                raise TelemetryError("wrong token")
            listener.greeted = True
            self._introduce(listener)
        elif message.kind is Kind.REQUEST:
            listener.waiting += self._answer(listener, contents)
            self._flush(listener)

    def _introduce(self, listener: _Listener) -> None:
        if self._run is not None and listener.greeted:
            listener.waiting += self._run.about
            self._flush(listener)

    def _answer(self, listener: _Listener, request: dict[str, Any]) -> bytes:
        number = request.pop("number", 0)
        try:
            if self._on_request is None:
                raise TelemetryError("this stream takes no requests")
            result = self._on_request(listener.number, request)
        except PepperError as error:
            return pack_json(Kind.ANSWER, number=number, error=str(error).splitlines()[0])
        except Exception as error:  # arguments from outside may be anything
            logger.debug("request %s", request, exc_info=True)
            text = f"that is no request: {reason(error)}"
            return pack_json(Kind.ANSWER, number=number, error=text)
        return pack_json(Kind.ANSWER, number=number, result=result)

    def _drop(self, listener: _Listener) -> None:
        if self._listeners.pop(listener.number, None) is None:
            return
        self._selector.unregister(listener.socket)
        listener.socket.close()
        if listener.greeted and self._on_leave is not None:
            self._on_leave(listener.number)


class _Run:
    """One run: makes its messages."""

    def __init__(
        self,
        truth: Truth | None,
        robot: RobotConfig,
        metadata: Mapping[str, str],
        status: Callable[[], Mapping[str, object]],
        can: Mapping[str, object],
    ) -> None:
        self.about = pack_json(
            Kind.ABOUT, layout=layout_metadata(robot), run=dict(metadata), can=dict(can)
        )
        self.events: deque[LogEvent] = deque()
        self._status = status
        self._truth = truth
        self._rows, self._unobserved = Rows(TICK_FIELDS, robot), unobserved(robot)

    def entry(self, record: TickRecord) -> _Entry:
        """Return a tick with the pose of the base, and the forces that a simulation knows."""
        truth = self._truth
        if truth is None:
            return _Entry(record, None, True, record.base_pose)
        return _Entry(record, None, True, truth.base, truth.tilt, truth.contacts)

    def events_of(self, record: TickRecord) -> bytes:
        """Return contacts and events of a tick."""
        contacts = () if record.observation is None else record.observation.contacts
        return b"".join(
            [
                *(pack(Kind.CONTACT, CONTACTS.encode(contact)) for contact in contacts),
                *(pack(Kind.EVENT, EVENTS.encode(LogEvent.of(e))) for e in record.events),
            ]
        )

    def _row(self, record: TickRecord) -> TickRow:
        tick, observation = record.tick, record.observation
        return TickRow(
            tick.measurement,
            tick.reference,
            tick.sent,
            tick.limited,
            self._unobserved if observation is None else observation,
            0,
            record.tick_end,
            record.missed,
        )

    def picture(self, entry: _Entry) -> bytes:
        """Return row and pose of an entry that is shown."""
        row = entry.row if entry.record is None else self._row(entry.record)
        assert row is not None
        forces = [
            {"link": c.link, "point": c.point.tolist(), "force": c.force.tolist()}
            for c in entry.forces
        ]
        base, tilt = (None if v is None else v.tolist() for v in (entry.base, entry.tilt))
        return pack(Kind.TICK, self._rows.message(row)) + pack_json(
            Kind.POSE, base=base, tilt=tilt, forces=forces
        )

    def status(self) -> bytes:
        """Return the state of the run."""
        return pack(Kind.STATUS, json.dumps(self._status()).encode())
