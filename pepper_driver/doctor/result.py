"""What one check of the doctor says."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from enum import Enum
from typing import Any


class Outcome(Enum):
    """OK; WARNING: it may move; FAILED: it should not; UNKNOWN: this robot, or this computer, does not tell."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "FAILED"
    UNKNOWN = "not known here"


@dataclass(frozen=True, kw_only=True, slots=True)
class Result:
    """One check.

    Attributes:
        name: What was looked at.
        outcome: How it is.
        found: What was measured, for people.
        cure: What to do about it; empty where there is nothing to do.
    """

    name: str
    outcome: Outcome
    found: str
    cure: str = ""

    def as_json(self) -> dict[str, Any]:
        """All of it by name."""
        return {**asdict(self), "outcome": self.outcome.value}


def failed(results: Iterable[Result]) -> bool:
    """Whether a check failed."""
    return any(result.outcome is Outcome.FAILED for result in results)


def rated(
    name: str,
    found: str,
    *,
    failure: bool = False,
    warning: bool = False,
    cure: str = "",
) -> Result:
    """A result from what is wrong; the cure counts only when something is."""
    if failure:
        return Result(name=name, outcome=Outcome.FAILED, found=found, cure=cure)
    if warning:
        return Result(name=name, outcome=Outcome.WARNING, found=found, cure=cure)
    return Result(name=name, outcome=Outcome.OK, found=found)


def unknown(name: str, found: str) -> Result:
    """A result of a check that cannot be made."""
    return Result(name=name, outcome=Outcome.UNKNOWN, found=found)
