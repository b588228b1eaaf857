"""The library qi: imported when needed, its types, the priority of its threads.

It has no types: what is used of it here is named here.
"""

from __future__ import annotations

import importlib
import logging
import os
import platform
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol, Self, TypeAlias

from pepper_driver.config import MissingExtraError, PepperError

PLATFORMS = "Linux on x86-64 with Python 3.11 or 3.12"
"""For which there is a package ``qi``."""

Answer: TypeAlias = Any
"""Reply of a service: plain Python values, whose types the service defines."""

Proxy: TypeAlias = Any
"""A service of a robot, as ``qi`` makes it: its methods are known only at run time.

Called with ``_async=True`` each gives a :class:`Future`; without, it waits. Errors are RuntimeErrors.
"""


class Future(Protocol):
    """The answer of a service, to come."""

    def isRunning(self) -> bool:
        """Return true while the answer is still to come."""

    def wait(self, timeout: int) -> object:
        """Wait for the answer, at most so many [ms]; returns the state it is in then, one of ``qi.FutureState``."""

    def hasError(self) -> bool:
        """Return true if the call failed; wait for it."""

    def error(self) -> str:
        """Why it failed."""

    def value(self) -> Answer:
        """Return the answer; waits for it, and raises a RuntimeError where it failed."""

    def addCallback(self, callback: Callable[[Self], object]) -> object:
        """Have ``callback`` called with this once it is over, on a thread of the library."""


class QiSignal(Protocol):
    """Something that happens, such as the loss of a connection."""

    def connect(self, callback: Callable[..., object]) -> object:
        """Have ``callback`` called each time, on a thread of the library."""


class QiSession(Protocol):
    """A connection with a NAOqi."""

    disconnected: QiSignal

    def isConnected(self) -> bool:
        """Return true while the connection stands."""

    def service(self, name: str, *, _async: bool) -> Future:
        """Return the :data:`Proxy` of a service."""

    def services(self, *, _async: bool) -> Future:
        """Return the services."""

    def registerService(self, name: str, service: object, *, _async: bool) -> Future:
        """Offer a service to others; its number."""

    def unregisterService(self, number: int, *, _async: bool) -> Future:
        """Take it out again."""

    def close(self) -> None:
        """Disconnect."""


class NoQiError(MissingExtraError):
    """The library ``qi`` is not there; the message says whether it can be had for this computer."""

    def __init__(self, here: str, *, possible: bool) -> None:
        super().__init__("a robot over NAOqi", "naoqi")
        if not possible:  # then the extra would install nothing
            ImportError.__init__(
                self,
                f"a robot over NAOqi needs the library qi (extra 'naoqi'), which exists for {PLATFORMS}; this is "
                f"{here}: run pepper_driver on such a computer, or in a container of that kind",
            )


class ImportOrderError(PepperError, ImportError):
    """The library ``qi`` would crash this process; the message says how to avoid it."""


def load_qi() -> ModuleType:
    """Return the module ``qi``, quiet, and set to notice a link that was cut within about ten seconds.

    Raises:
        NoQiError: It is not installed.
        ImportOrderError: Pinocchio is there before it; see :func:`preload_qi`.
    """
    late = "pinocchio" in sys.modules and "qi" not in sys.modules
    if late and find_spec("qi") is not None:  # without a library no order helps
        raise ImportOrderError(
            "pinocchio was imported before NAOqi's library qi, and in this order they crash the process; in your "
            "program import pepper_driver, or qi, before pinocchio"
        )
    # Read by qi at import; without them it writes into standard output, and its timeout is 30 s, not 10.
    os.environ.setdefault("QI_LOG_LEVEL", "0")
    os.environ.setdefault("QI_TCP_PING_TIMEOUT", "10")
    try:
        return importlib.import_module("qi")
    except ImportError as error:
        system, machine = platform.system(), platform.machine()
        here = f"{system} on {machine} with Python {platform.python_version()}"
        fits = (system, machine) == ("Linux", "x86_64") and sys.version_info < (3, 13)
        raise NoQiError(here, possible=fits) from error


def preload_qi() -> None:
    """Load NAOqi's library, where it is installed; to be called before pinocchio is imported.

    Both bring boost::asio, of different versions (qi 3.1.5: 1.83, pin 4.1: 1.90), with symbols that are one for the
    whole process (STB_GNU_UNIQUE): the first serve both. With those of pinocchio, libqi corrupts memory: the process
    crashes when a connection is lost during calls (15 of 15 times). With those of libqi nothing happens, since
    pinocchio's Python package never runs asio. ``RTLD_LOCAL`` does not help against such symbols.
    """
    with suppress(ImportError):  # not installed, or too late: reported when a robot is asked for
        load_qi()


def one_line(error: str) -> str:
    """Return the error of a service in one line, without its traceback."""
    text = " ".join(error.partition("\n\nAt:")[0].split())
    return text if len(text) <= 300 else f"{text[:300]}..."


logger = logging.getLogger("pepper_driver")

THREADS = ("EventLoop", "MainEventLoop")
"""How the names of libqi's threads begin, which send and receive."""

QI_PRIORITY = 39
"""Of SCHED_FIFO: just below that of ticks."""


def prefer_messages(prefer: bool) -> None:
    """Give libqi's threads of this process real-time priority, or take it from them, where that is permitted.

    At normal priority they waited up to 50 ms for a processor when other programs kept both busy. Callbacks that a
    program has called by ``qi`` run on them too, and should be short.
    """
    if not Path("/proc/self/task").is_dir():
        return
    for task in Path("/proc/self/task").iterdir():
        try:
            if (task / "comm").read_text().startswith(THREADS):
                scheduler = os.SCHED_FIFO if prefer else os.SCHED_OTHER
                param = os.sched_param(QI_PRIORITY if prefer else 0)
                os.sched_setscheduler(int(task.name), scheduler, param)
        except OSError as error:  # not permitted; or the thread has ended meanwhile
            logger.debug("priority of libqi's thread %s: %s", task.name, error)


@contextmanager
def preferred() -> Iterator[None]:
    """Give this thread real-time priority as well, where that is permitted: what it measures, ticks will find."""
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(QI_PRIORITY))
    except (OSError, AttributeError) as error:
        logger.debug("priority of measurements: %s", error)
        yield
        return
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)
