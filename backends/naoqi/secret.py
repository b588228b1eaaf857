"""Passwords: from the environment, a keyring or a prompt, and out again only to the robot."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, repr=False)
class Secret:
    """A password that no log shows by accident."""

    value: str

    def __repr__(self) -> str:
        return "Secret(...)"
