"""Questions to the person at the robot."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Protocol

from pepper_driver.config import ConfigError, PepperError

YES, NO = ("y", "yes"), ("n", "no", "")


class OperatorLeftError(PepperError, TimeoutError):
    """The person at the robot did not answer, or said no."""


class Operator(Protocol):
    """A person, or what stands for one."""

    def confirm(self, question: str) -> None:
        """Ask whether the robot may go on.

        Raises:
            OperatorLeftError: It may not, or there was no answer in time.
        """

    def offer(self, question: str) -> bool:
        """Ask whether something is to be done that may as well be left."""


class Consent:
    """Says yes to all that is necessary, and no to all that is not: the option ``--yes``.

    Args:
        show: Prints the questions.
    """

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show

    def confirm(self, question: str) -> None:
        """Say yes."""
        self._show(f"{question} yes (--yes)")

    def offer(self, question: str) -> bool:
        """Say no."""
        self._show(f"{question} no (--yes)")
        return False


class TerminalOperator:
    """A person at the terminal, who must answer within a time.

    Args:
        show: Prints the questions.
        seconds: For an answer [s].

    Raises:
        ConfigError: There is no terminal.
    """

    def __init__(self, show: Callable[[str], None], seconds: float) -> None:
        if sys.stdin is None or not sys.stdin.isatty():
            raise ConfigError(
                "there is no terminal to ask on before the robot moves: start it in one, or give --yes"
            )
        self._show, self._seconds = show, seconds

    def confirm(self, question: str) -> None:
        """Ask, and wait for an answer."""
        if not self._ask(question):
            raise OperatorLeftError("the question was answered with no")

    def offer(self, question: str) -> bool:
        """Ask, and wait for an answer."""
        return self._ask(question)

    def _ask(self, question: str) -> bool:
        while True:
            self._show(f"{question} [y/N]")
            answer = _read_line(self._seconds)
            if answer is None:
                raise OperatorLeftError(f"no answer for {self._seconds:g} s, or a closed terminal")
            if answer.strip().lower() in YES:
                return True
            if answer.strip().lower() in NO:
                return False
            self._show("answer with y or n")


def _read_line(seconds: float) -> str | None:
    """Return what is typed in a line; None after a time without one, or where the terminal was closed."""
    try:
        import select
        import termios
    except ImportError:  # Windows: a question there waits for ever
        return sys.stdin.readline() or None
    try:
        # What was typed while the robot moved is no answer.
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
        ready, _, _ = select.select([sys.stdin], [], [], seconds)
        return (sys.stdin.readline() or None) if ready else None
    except (OSError, termios.error):  # the terminal was closed
        return None
