"""The line between the NAOqi process and whoever started it: each may ask the other."""

from __future__ import annotations

import socket
from collections.abc import Callable
from itertools import count
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Any

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.messages import receive, send
from pepper_driver.config import PepperError

REPLY_TIMEOUT = 2.0
"""[s] for an answer, which takes a millisecond; a process that was stopped gives none."""


class Line:
    """One end. What the other asks is done on a thread of its own.

    Args:
        end: Of the pair.
        other: Who is at the other end, for messages.
        obey: Does what the other asks: ``obey(what, **arguments)``; its PepperError goes back as the answer.
        gone: Called once the other is gone.
    """

    def __init__(
        self,
        end: socket.socket,
        other: str,
        obey: Callable[..., None],
        gone: Callable[[], None] = lambda: None,
    ) -> None:
        self._end, self._other = end, other
        self._obey, self._gone = obey, gone
        self._lock = Lock()
        self._numbers = count()
        self._answers: SimpleQueue[dict[str, Any]] = SimpleQueue()
        end.settimeout(None)
        Thread(target=self._listen, name=f"line to {other}", daemon=True).start()

    def ask(self, what: str, **arguments: object) -> None:
        """Ask the other end, and wait until it is done.

        Raises:
            BackendError: It refuses, for the reason given, or does not answer.
        """
        with self._lock:
            number = next(self._numbers)
            try:
                send(self._end, {"number": number, "ask": what, "arguments": arguments}, wait=False)
                answer = self._answers.get(timeout=REPLY_TIMEOUT)
                while answer["number"] != number:
                    answer = self._answers.get(timeout=REPLY_TIMEOUT)  # to one that was given up
            except (OSError, Empty):
                raise BackendError(f"the stand-in's {self._other} does not answer") from None
        if "error" in answer:
            raise BackendError(str(answer["error"]))

    def _listen(self) -> None:
        try:
            while (message := receive(self._end)) is not None:
                if "ask" not in message:
                    self._answers.put(message)
                    continue
                answer = {"number": message["number"]}
                try:
                    self._obey(message["ask"], **message["arguments"])
                except PepperError as error:
                    answer["error"] = str(error)
                send(self._end, answer, wait=False)
        except OSError:
            pass  # gone in the middle of it
        self._gone()
