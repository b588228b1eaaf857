"""What came of an experiment."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

from pepper_driver.callbacks.events import ReflexEvent
from pepper_driver.motion_report import MotionReport
from pepper_driver.observer import Contact


@dataclass(frozen=True, kw_only=True)
class WaitReport:
    """Whether the contact that a step waited for came."""

    step: str
    heard: bool


@dataclass(frozen=True, kw_only=True)
class ExperimentReport:
    """What came of an experiment.

    Attributes:
        name: Of the experiment.
        seconds: How long it took, on the robot's clock.
        stopped_by: Name of the wait at which it stopped, since nobody came; empty if it went through.
        motion: What each step reached, in the order they were played.
        waits: For contacts.
        contacts: All contact events.
        reflexes: Their beginnings.
        pushes: How many were ordered of a simulated robot.
        skipped: Why there were none; empty if they were not left out.
    """

    name: str
    seconds: float
    stopped_by: str
    motion: MotionReport
    waits: tuple[WaitReport, ...]
    contacts: tuple[Contact, ...]
    reflexes: tuple[ReflexEvent, ...]
    pushes: int
    skipped: str

    @property
    def completed(self) -> bool:
        """Whether all steps were played, and none gave up reaching its targets."""
        return not self.stopped_by and self.motion.reached

    @property
    def felt(self) -> dict[str, int]:
        """How many contacts there were on each link, as last told; rebounds left out."""
        last = {c.id: c.link for c in self.contacts if c.kind != "rebound"}
        return dict(Counter(last.values()))

    @property
    def reacted(self) -> dict[str, int]:
        """How often each reflex began to act."""
        return dict(Counter(event.reflex for event in self.reflexes))

    def __str__(self) -> str:
        end = f"stopped: nobody came in '{self.stopped_by}'" if self.stopped_by else "completed"
        if not self.stopped_by and not self.motion.reached:
            end = "completed, though not every step reached its targets"
        parts = [
            f"{self.name}: {end} after {self.seconds:.1f} s, {len(self.motion.steps)} steps",
            f"contacts: {_counted(self.felt)}",
            f"reflexes: {_counted(self.reacted)}",
        ]
        if self.waits:
            heard = sum(wait.heard for wait in self.waits)
            parts.append(f"waits for contacts: {heard} of {len(self.waits)} came")
        if self.pushes:
            parts.append(f"pushes: {self.pushes}")
        if self.skipped:
            parts.append(self.skipped)
        return "\n".join(parts)

    def as_json(self) -> dict[str, Any]:
        """For files."""
        return {
            "experiment": self.name,
            "completed": self.completed,
            "seconds": self.seconds,
            "stopped_by": self.stopped_by or None,
            "steps": self.motion.as_json()["steps"],
            "waits": [{"step": wait.step, "heard": wait.heard} for wait in self.waits],
            "contacts": self.felt,
            "reflexes": self.reacted,
            "pushes": self.pushes,
            "pushes_skipped": self.skipped or None,
        }


def _counted(counts: dict[str, int]) -> str:
    return ", ".join(f"{name} {number}" for name, number in counts.items()) or "none"
