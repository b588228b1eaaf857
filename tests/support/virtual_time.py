"""Virtual time: it passes as soon as all threads wait for it, and events come in the same order each time."""

from __future__ import annotations

import heapq
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count

from pepper_driver.config.clock import Clock
from support.waiting import PATIENCE

Action = Callable[[], None]


class _Ended(BaseException):
    """The end of virtual time, raised in threads that wait for it."""


@dataclass(eq=False)
class _Thread:
    """A thread that runs only while all others wait."""

    group: str
    ident: int = 0
    turn: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))
    target: Action | None = None


@dataclass(order=True)
class _Entry:
    time: int
    number: int
    group: str = field(compare=False)
    what: _Thread | Action = field(compare=False)
    cancelled: bool = field(default=False, compare=False)

    def cancel(self) -> None:
        """Keep it from happening."""
        self.cancelled = True


class Flag:
    """An event of :mod:`threading`, in virtual time."""

    def __init__(self, time: VirtualTime) -> None:
        self._time, self._waiting = time, list[tuple[_Entry, _Thread]]()
        self.is_set = False

    def set(self) -> None:
        """Wake up all that wait."""
        self.is_set = True
        for timeout, thread in self._waiting:
            timeout.cancel()
            self._time._plan(self._time.now, thread.group, thread)
        self._waiting.clear()

    def clear(self) -> None:
        """Have threads that come wait again."""
        self.is_set = False

    def wait(self, seconds: float) -> bool:
        """Wait until it is set, at most for some time."""
        if not self.is_set:
            thread = self._time._thread
            entry = self._time._plan(self._time.now + round(1e9 * seconds), thread.group, thread)
            self._waiting.append((entry, thread))
            self._time._wait()
            self._waiting = [waiting for waiting in self._waiting if waiting[0] is not entry]
        return self.is_set


class VirtualTime:
    """Time, and threads of which one runs at a time.

    The thread that makes it is the first of them. Threads belong to groups, which can be suspended as processes can.

    Attributes:
        now: [ns].
    """

    def __init__(self, start: int = 1_000_000_000_000) -> None:
        self.now = start
        self._agenda: list[_Entry] = []
        self._numbers = count()
        self._thread = _Thread("client", threading.get_ident())
        self._idle: list[_Thread] = []
        self._threads: list[_Thread] = []
        self._suspended: dict[str, list[_Entry]] = {}
        self._error: BaseException | None = None
        self._over = False

    def seconds(self) -> float:
        """Return the time [s]."""
        return 1e-9 * self.now

    def clock(self, group: str = "client") -> Clock:
        """Return the clock of the threads of a group."""
        return Clock(
            now=lambda: self.now,
            sleep=self.sleep,
            start=lambda target, _: self.start(target, group),
        )

    def sleep(self, seconds: float) -> None:
        """Let everything happen that happens in some time."""
        thread = self._thread
        self._plan(self.now + max(0, round(1e9 * seconds)), thread.group, thread)
        self._wait()

    def later(self, seconds: float, action: Action, group: str = "") -> _Entry:
        """Have an action, which must not wait, happen after some time."""
        return self._plan(self.now + round(1e9 * seconds), group, action)

    def start(self, target: Action, group: str) -> None:
        """Start a thread."""
        if self._idle:
            thread = self._idle.pop()
        else:
            thread = _Thread(group)
            self._threads.append(thread)
            threading.Thread(target=self._run, args=(thread,), daemon=True).start()
        thread.group, thread.target = group, target
        self._plan(self.now, group, thread)

    def suspend(self, group: str) -> None:
        """Stop a group, as SIGSTOP does a process."""
        self._suspended.setdefault(group, [])

    def resume(self, group: str) -> None:
        """Let a group continue with all that was to happen meanwhile."""
        for entry in self._suspended.pop(group, []):
            self._push(entry)

    def kill(self, group: str) -> None:
        """End a group: nothing of it happens any more."""
        self._suspended.pop(group, None)
        for entry in self._agenda:
            if entry.group == group:
                entry.cancel()

    def close(self) -> None:
        """End all threads."""
        self._over = True
        for thread in self._threads:
            thread.turn.release()

    # -- inside -------------------------------------------------------------------------------------------------

    def _plan(self, when: int, group: str, what: _Thread | Action) -> _Entry:
        entry = _Entry(when, next(self._numbers), group, what)
        self._push(entry)
        return entry

    def _push(self, entry: _Entry) -> None:
        heapq.heappush(self._agenda, entry)

    def _next(self) -> _Thread:
        """Let actions happen up to the next turn of a thread, and return that."""
        while True:
            entry = heapq.heappop(self._agenda)
            if entry.cancelled:
                continue
            if entry.group in self._suspended:
                self._suspended[entry.group].append(entry)
                continue
            self.now = max(self.now, entry.time)
            if isinstance(entry.what, _Thread):
                return entry.what
            try:
                entry.what()
            except BaseException as error:  # raised where the test waits
                self._error = error

    def _wait(self) -> None:
        """Wait for the turn of this thread."""
        if self._over:
            raise _Ended
        me = self._thread
        assert me.ident == threading.get_ident(), (
            "a thread that is not of virtual time waits for it"
        )
        following = self._next()
        if following is not me:
            self._thread = following
            following.turn.release()
            assert me.turn.acquire(timeout=PATIENCE), (
                "threads of virtual time wait for something else"
            )
            if self._over and me in self._threads:
                raise _Ended
        if self._error is not None and me not in self._threads:
            error, self._error = self._error, None
            raise error

    def _run(self, me: _Thread) -> None:
        """Run the targets of a thread."""
        me.ident = threading.get_ident()
        while True:
            me.turn.acquire()
            if self._over:
                return
            assert me.target is not None
            try:
                me.target()
            except _Ended:
                return
            except BaseException as error:
                self._error = error
            self._idle.append(me)
            following = self._next()
            self._thread = following
            following.turn.release()
