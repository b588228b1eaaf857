"""Signals that ask a program to end: SIGTERM and SIGHUP are exceptions, and none breaks off what must be finished."""

from __future__ import annotations

import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, ClassVar

Handler = Callable[[int, FrameType | None], Any] | int | None

MIN_INTERVAL = 1.0
"""[s] from one SIGTERM or SIGHUP to the next that counts: a terminal that closes sends two, systemd one of each."""

MAX_DEFERRAL = 30.0
"""[s] from the begin of a block after which no signal is deferred: robots take seconds, so something hangs."""

_TERMINATING = tuple(
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)
)

_WORDS = {"SIGTERM": "terminated", "SIGHUP": "hung up"}


class Terminated(KeyboardInterrupt, SystemExit):
    """SIGTERM or SIGHUP came. Uncaught, the program ends with the signal's exit code and no traceback.

    Attributes:
        code: Exit code: 128 and the number of the signal.
    """

    code: int

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.code = 128 + number


def exit_code(error: KeyboardInterrupt) -> int:
    """Return the exit code of a program that an interrupt ends."""
    return error.code if isinstance(error, Terminated) else 128 + signal.SIGINT


def describe_interrupt(error: KeyboardInterrupt) -> str:
    """Return what ended a run, and the notes on it, in one line: ``terminated; log: runs/x.mcap``."""
    return "; ".join((_WORDS.get(str(error), "interrupted"), *getattr(error, "__notes__", ())))


# -- as exceptions ------------------------------------------------------------------------------------------------


class _Blocks:
    """Open blocks of :func:`raised_signals`."""

    lock = threading.RLock()
    open: ClassVar[set[object]] = set()
    last_came = -MIN_INTERVAL  # [s] of those that count


@contextmanager
def raised_signals() -> Iterator[bool]:
    """Make SIGTERM and SIGHUP raise :class:`Terminated` in the main thread; the last block that ends restores all.

    A signal that is ignored or has a handler is left alone: also one that is deferred when the block begins. Blocks in
    other threads change nothing by themselves.

    Yields:
        True where this block has changed something.
    """
    this = object()
    try:
        with _Blocks.lock:
            _Blocks.open.add(this)
            changed = _change(signal.SIG_DFL, _raise)
            if _in_main_thread() and any(signal.getsignal(n) is _raise for n in _TERMINATING):
                _Waker.start()
        yield changed
    finally:
        with _Blocks.lock:
            _Blocks.open.discard(this)
            if not _Blocks.open:
                _change(_raise, signal.SIG_DFL)
                _Waker.stop()


def _change(before: Handler, after: Handler) -> bool:
    """Give SIGTERM and SIGHUP another handler where theirs is ``before``; return True where one was."""
    if not _in_main_thread():
        return False
    numbers = [number for number in _TERMINATING if signal.getsignal(number) is before]
    for number in numbers:
        signal.signal(number, after)
    return bool(numbers)


def _raise(number: int, frame: FrameType | None) -> None:
    if _Deferral.current is None and not _Blocks.open:
        # The last ended in another thread, which cannot put handlers back.
        _handle(number, signal.SIG_DFL)
    elif time.monotonic() - _Blocks.last_came >= MIN_INTERVAL:  # when it comes: it may wait long
        _Blocks.last_came = time.monotonic()
        if _Deferral.current is not None:
            _Deferral.current.add(number, _terminate)
        else:
            _terminate(number, frame)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated(number)


class _Waker:
    """Wakes the main thread after a signal that another thread received: it would sleep on and call no handler.

    Of two signals at once the system gives the second, and then often the first too, to any thread, also of a library.
    """

    sockets: tuple[socket.socket, socket.socket] | None = None  # reader, writer
    thread: threading.Thread | None = None

    @classmethod
    def start(cls) -> None:
        """Start in the main thread; not where SIGURG or Python's wake-up descriptor is in use already."""
        if cls.thread is not None or not hasattr(signal, "SIGURG"):  # Windows
            return
        if cls.sockets is None:
            descriptor = signal.set_wakeup_fd(-1)
            signal.set_wakeup_fd(descriptor)
            urgent = signal.getsignal(signal.SIGURG)
            if descriptor != -1 or urgent not in (signal.SIG_DFL, _wake_up):
                return
            cls.sockets = socket.socketpair()
            cls.sockets[1].setblocking(False)
            signal.set_wakeup_fd(cls.sockets[1].fileno(), warn_on_full_buffer=False)
            signal.signal(signal.SIGURG, _wake_up)
        arguments = (cls.sockets[0], threading.get_ident())
        cls.thread = threading.Thread(target=cls._run, args=arguments, name="signals", daemon=True)
        cls.thread.start()

    @classmethod
    def stop(cls) -> None:
        """End the thread; in the main thread restore all, else the next one to stop there does."""
        if cls.thread is not None and cls.sockets is not None:
            cls.sockets[1].send(_STOP)
            cls.thread.join()
            cls.thread = None
        if cls.sockets is None or not _in_main_thread():
            return
        meanwhile = signal.set_wakeup_fd(-1)
        if meanwhile not in (-1, cls.sockets[1].fileno()):
            signal.set_wakeup_fd(meanwhile)
        for end in cls.sockets:
            end.close()
        cls.sockets = None

    @staticmethod
    def _run(reader: socket.socket, main: int) -> None:
        while True:
            numbers = reader.recv(64)
            if not set(numbers) <= {*_STOP, signal.SIGURG}:
                signal.pthread_kill(main, signal.SIGURG)
            if _STOP[0] in numbers:
                return


_STOP = b"\0"  # the number of no signal


def _wake_up(number: int, frame: FrameType | None) -> None:
    """Do nothing: the main thread is awake, and calls all handlers that are due. Stays: one may still be running."""


# -- deferred -----------------------------------------------------------------------------------------------------


@contextmanager
def deferred_signals(*, checked: bool = False) -> Iterator[None]:
    """Handle SIGINT, SIGTERM and SIGHUP after this block, for any handlers; in other threads nothing changes.

    Blocks may be nested: signals wait for the end of the outermost.

    Args:
        checked: Signals may also be handled inside, where :func:`check_signals` is called, until one has raised an
            exception, or a nested block begins that is not ``checked``.
    """
    if not _in_main_thread():
        yield
        return
    if _Deferral.current is not None:
        _Deferral.current.nest(checked)
        yield
        return
    deferral = _Deferral(checked)
    try:
        deferral.begin()
        yield
    finally:
        deferral.end()


@contextmanager
def immediate_signals() -> Iterator[None]:
    """Handle signals at once inside this block of a ``checked`` one; after the first that raises they wait again."""
    deferral = _Deferral.current if _in_main_thread() else None
    if deferral is None or not deferral.checked:
        yield
        return
    try:
        deferral.immediate = True
        deferral.handle()
        yield
    finally:
        deferral.immediate = False


def check_signals() -> None:
    """Handle the signals that wait, where the block allows it: to be called where a beginning can be broken off."""
    deferral = _Deferral.current if _in_main_thread() else None
    if deferral is not None and deferral.checked:
        deferral.handle()


class _Deferral:
    """Signals that wait, and the handlers they wait for."""

    current: _Deferral | None = None

    def __init__(self, checked: bool) -> None:
        self.checked, self.immediate = checked, False
        self._waiting: dict[int, Handler] = {}
        self._handlers: dict[int, Handler] = {}
        self.nest(checked)

    def nest(self, checked: bool) -> None:
        """Begin a further block."""
        self.checked &= checked
        self._end = time.monotonic() + MAX_DEFERRAL

    def begin(self) -> None:
        _Deferral.current = self
        for number in (*_TERMINATING, signal.SIGINT):
            handler = signal.getsignal(number)
            if handler not in (signal.SIG_IGN, None, _raise):  # the last one asks by itself
                self._handlers[number] = handler
                signal.signal(number, self._defer)

    def end(self) -> None:
        try:  # SIGINT, the last of them, may raise as soon as it is put back
            for number, handler in self._handlers.items():
                if signal.getsignal(number) == self._defer:  # and not a new one
                    signal.signal(number, handler)
        finally:
            _Deferral.current = None
            self.handle()

    def add(self, number: int, handler: Handler) -> None:
        """Delay a signal inside the block."""
        self._waiting[number] = handler
        if self.immediate or time.monotonic() > self._end:
            self.handle()

    def handle(self) -> None:
        """Handle all that wait, each even if another raises."""
        if self._waiting:
            checked, immediate = self.checked, self.immediate
            self.checked = self.immediate = False
            number = next(iter(self._waiting))
            try:
                _handle(number, self._waiting.pop(number))
            finally:
                self.handle()
            self.checked, self.immediate = checked, immediate

    def _defer(self, number: int, frame: FrameType | None) -> None:
        handler = self._handlers[number]
        if _Deferral.current is self:
            self.add(number, handler)
        else:  # this signal came before its handler was put back, or after another's raised an exception
            signal.signal(number, handler)
            _handle(number, handler)


def _handle(number: int, handler: Handler) -> None:
    if callable(handler):
        handler(number, None)
    else:
        signal.signal(number, handler)
        signal.raise_signal(number)


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
