"""The page of a running robot: a process of its own, and the stream that feeds it."""

from __future__ import annotations

import json
import secrets
import subprocess
import sys
import threading
import webbrowser
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cached_property
from importlib.util import find_spec
from types import TracebackType
from typing import IO, TYPE_CHECKING, Any, Self

from pepper_driver.config import MissingExtraError, PepperError

if TYPE_CHECKING:
    from pepper_driver.robot import Pepper
    from pepper_driver.telemetry.server import Request
    from pepper_driver.viewer.controls import TouchControls
    from pepper_driver.viewer.served import ServedRobot

LOOPBACK = ("127.0.0.1", "localhost", "::1")
DEFAULT_HOST = "127.0.0.1"

START_TIME = 30.0
"""[s] in which the page must be there."""

STOP_TIME = 3.0
"""[s] for the page to end by itself."""

SERVED_ROBOT = (
    "This robot is served: the programs that are connected to it move and stop it. "
    "Only they know the contacts that their observers detect."
)
"""What the page of a served robot says where that of a program has controls."""

MIN_TOKEN = 8
"""Letters of a token that others than this computer must know."""


class ViewError(PepperError, RuntimeError):
    """The page cannot be shown; the message is one line."""


def check_access(host: str, token: str | None) -> str:
    """Return the token of a page, a new one where none is given.

    Raises:
        ViewError: Others than this computer could reach the page, and no token was chosen for them, or a short one.
    """
    if token is None:
        if host not in LOOPBACK:
            raise ViewError(
                f"--host {host}: others than this computer could reach the page; choose a --token that they must know"
            )
        return secrets.token_urlsafe(6)
    if len(token) < MIN_TOKEN or not all(c.isalnum() or c in "-_" for c in token):
        raise ViewError(f"a token has {MIN_TOKEN} letters, digits, '-' or '_' or more")
    return token


def check_extra() -> None:
    """Raise a MissingExtraError where the page cannot be shown."""
    if find_spec("viser") is None:
        raise MissingExtraError("the view", "viewer")


class View:
    """A page in the browser that shows a robot, as long as it is open.

    It runs in a process of its own, with the least priority, and gets what it shows as a stream: a page that hangs or
    ends changes nothing for the robot.

    Its process begins at once, before there is a robot: :meth:`show` says which one it shows.

    Args:
        host: Where the page is served. Others than this computer need a token.
        port: Of the page; None for 8080, or the next free one.
        token: Part of the address; None for a new one.
        allow_control: On a real robot, take requests to move it.

    Raises:
        MissingExtraError: Viser is not installed.
        ViewError: A token is missing, or of no use.
    """

    def __init__(
        self,
        *,
        host: str = DEFAULT_HOST,
        port: int | None = None,
        token: str | None = None,
        allow_control: bool = False,
    ) -> None:
        check_extra()
        token = check_access(host, token)
        self._allow_control = allow_control
        self._controls: TouchControls | None = None
        self._process = PageProcess(host=host, port=port, token=token)
        # Imported only now: meanwhile the page begins.
        from pepper_driver.telemetry.server import TelemetryServer

        try:
            self._telemetry = TelemetryServer(self._do, on_leave=self._leave, can=self._offers)
        except BaseException:
            self._process.close()
            raise
        self._process.listen_to(self._telemetry.address, self._telemetry.token)

    @property
    def address(self) -> str:
        """Address of the page, once it is served.

        Raises:
            ViewError: It is not: the port is taken.
        """
        return self._process.address

    def show(
        self,
        pepper: Pepper,
        *,
        perform: Callable[[str, Mapping[str, Any]], None] | None = None,
        choices: Callable[[], Mapping[str, object]] = dict,
    ) -> None:
        """Show a robot from its start on, or one that is active; in place of another one.

        Args:
            pepper: The robot.
            perform: Plays and restarts, see :class:`Controls`.
            choices: What ``perform`` can do, for the page to show.
        """
        from pepper_driver.viewer.controls import Controls

        self._controls = Controls(
            pepper, allow_control=self._allow_control, perform=perform, choices=choices
        )
        pepper.stream_to(self._telemetry)

    def show_served(self, served: ServedRobot) -> None:
        """Show a robot that is served to programs; on the page it can be touched, and not be moved."""
        from pepper_driver.viewer.controls import TouchControls

        self._controls = TouchControls(served, note=SERVED_ROBOT)
        served.stream_to(self._telemetry)

    def open(self) -> None:
        """Open the page in the browser of this computer."""
        webbrowser.open(self.address)

    def _do(self, listener: int, request: Request) -> object:
        if self._controls is None:
            raise ViewError("there is no robot yet")
        return self._controls(listener, request)

    def _leave(self, listener: int) -> None:
        if self._controls is not None:
            self._controls.leave(listener)

    def _offers(self) -> Mapping[str, object]:
        return {} if self._controls is None else self._controls.can

    @property
    def is_open(self) -> bool:
        """True until the page has ended."""
        return self._process.running

    def close(self) -> None:
        """End the page. Does nothing when closed."""
        self._telemetry.close()
        self._process.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _repr_html_(self) -> str:
        """Return the page as a part of a notebook."""
        return f'<iframe src="{self.address}" width="100%" height="600" style="border:0"></iframe>'


class PageProcess:
    """The process that serves the page; it ends with the one that started it.

    Args:
        host: Where the page is served.
        port: Of the page; None for the first free one.
        token: Part of the address.
    """

    def __init__(self, *, host: str, port: int | None, token: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "pepper_driver.viewer.process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C is for the robot's program, which ends this one
        )
        self._send({"host": host, "port": port, "token": token})

    def listen_to(self, address: tuple[str, int], token: str) -> None:
        """Say where the stream of the robot is."""
        self._send([*address, token])

    def _send(self, settings: object) -> None:
        with suppress(OSError):  # it ended
            self._stdin.write(json.dumps(settings) + "\n")
            self._stdin.flush()

    @cached_property
    def address(self) -> str:
        """Address of the page.

        Raises:
            ViewError: It does not begin; the message says why.
        """
        answer: dict[str, str] = {}
        with suppress(OSError, ValueError):  # it ended
            answer = self._read_answer()
        if "address" not in answer:
            self.close()
            raise ViewError(answer.get("error", "the page does not begin"))
        return answer["address"]

    def _read_answer(self) -> dict[str, str]:
        """Return the first line that the process prints."""
        stdout = self._process.stdout
        assert stdout is not None
        timer = threading.Timer(START_TIME, self._process.kill)
        timer.daemon = True
        timer.start()
        try:
            line = stdout.readline()
        finally:
            timer.cancel()
        answer: dict[str, str] = json.loads(line)
        return answer

    @property
    def _stdin(self) -> IO[str]:
        assert self._process.stdin is not None
        return self._process.stdin

    @property
    def running(self) -> bool:
        """True until the process has ended."""
        return self._process.poll() is None

    def close(self) -> None:
        """End the process."""
        with suppress(OSError):
            self._stdin.close()  # this ends it
        try:
            self._process.wait(STOP_TIME)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
