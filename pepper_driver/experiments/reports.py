"""Reports of steps and of whole experiments."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from math import degrees
from typing import Any

from pepper_driver.callbacks.events import ReflexEvent
from pepper_driver.observer import Contact, KnownPush


@dataclass(frozen=True, kw_only=True)
class GoalDeviation:
    """Deviation from a target in ``metres`` and ``radians``; None for a part that the target does not have."""

    metres: float | None = None
    radians: float | None = None

    def __str__(self) -> str:
        parts = []
        if self.metres is not None:
            parts.append(f"{1e3 * self.metres:.1f} mm")
        if self.radians is not None:
            parts.append(f"{degrees(self.radians):.1f} deg")
        return " ".join(parts)

    def as_json(self) -> dict[str, float | None]:
        """For files."""
        turn = None if self.radians is None else degrees(self.radians)
        return {"m": self.metres, "deg": turn}


@dataclass(frozen=True, kw_only=True)
class GoalReport:
    """Deviation of one goal of a step from its target.

    Attributes:
        name: As the motion calls it; ``posture`` for the joints.
        commanded: How far off the controller's own state was.
        measured: How far off the robot was by its encoders and wheels: gravity, friction and slip are in it.
    """

    name: str
    commanded: GoalDeviation
    measured: GoalDeviation


@dataclass(frozen=True, kw_only=True)
class StepReport:
    """State at the end of one step.

    Attributes:
        number: From 0.
        name: Of the step.
        time: Clock of the robot then [s].
        duration: How long it took [s], with the time a reflex held the robot.
        reached: Whether ``until: reached`` came true in time; None where the step does not ask.
        goals: One for the posture, if the step says where joints go, and one for each task that acted.
    """

    number: int
    name: str
    time: float
    duration: float
    reached: bool | None
    goals: tuple[GoalReport, ...]

    def __str__(self) -> str:
        word = {True: ", reached", False: ", NOT reached", None: ""}[self.reached]
        goals = "; ".join(
            f"{goal.name} off by {goal.commanded}, measured {goal.measured}" for goal in self.goals
        )
        return f"step {self.name or self.number}: {self.duration:.2f} s{word}" + (
            f": {goals}" if goals else ""
        )

    def as_json(self) -> dict[str, Any]:
        """For files."""
        return {
            "step": self.number,
            "name": self.name,
            "time": self.time,
            "duration": self.duration,
            "reached": self.reached,
            "goals": {
                goal.name: {
                    "commanded": goal.commanded.as_json(),
                    "measured": goal.measured.as_json(),
                }
                for goal in self.goals
            },
        }


@dataclass(frozen=True, kw_only=True)
class WaitReport:
    """True in ``detected`` where the touch came that a step waited for."""

    step: str
    detected: bool


@dataclass(frozen=True, kw_only=True)
class ExperimentReport:
    """Outcome of an experiment.

    Attributes:
        name: Of the experiment.
        seconds: Time it took, on the robot's clock.
        stopped_by: Name of the wait that timed out and stopped it; empty if it went through.
        steps: What each step reached, in the order they were played.
        waits: For touches.
        contacts: All contact events.
        reflexes: Their beginnings.
        pushes: Contacts that a simulated robot was given.
    """

    name: str
    seconds: float
    stopped_by: str
    steps: tuple[StepReport, ...]
    waits: tuple[WaitReport, ...]
    contacts: tuple[Contact, ...]
    reflexes: tuple[ReflexEvent, ...]
    pushes: tuple[KnownPush, ...]

    @property
    def reached(self) -> bool:
        """True where no step that waits for its targets gave up."""
        return all(step.reached is not False for step in self.steps)

    @property
    def completed(self) -> bool:
        """True where all steps were played, and none gave up reaching its targets."""
        return not self.stopped_by and self.reached

    @property
    def contact_counts(self) -> dict[str, int]:
        """Number of contacts on each link, by their last event; rebounds excluded."""
        last = {c.id: c.link for c in self.contacts if c.kind != "rebound"}
        return dict(Counter(last.values()))

    @property
    def reflex_counts(self) -> dict[str, int]:
        """Number of times each reflex began to act."""
        return dict(Counter(event.reflex for event in self.reflexes))

    def __str__(self) -> str:
        end = f"stopped: wait '{self.stopped_by}' timed out" if self.stopped_by else "completed"
        if not self.stopped_by and not self.reached:
            end = "completed, though not every step reached its targets"
        parts = [f"{self.name}: {end} after {self.seconds:.1f} s, {len(self.steps)} steps"]
        if self.contacts or self.reflexes or self.waits or self.pushes:
            parts.append(f"contacts: {_counted(self.contact_counts)}")
            parts.append(f"reflexes: {_counted(self.reflex_counts)}")
        if self.waits:
            detected = sum(wait.detected for wait in self.waits)
            parts.append(f"waits for contacts: {detected} of {len(self.waits)} came")
        if self.pushes:
            parts.append(f"pushes: {len(self.pushes)}")
        return "\n".join(parts)

    def as_json(self) -> dict[str, Any]:
        """For files."""
        return {
            "experiment": self.name,
            "completed": self.completed,
            "seconds": self.seconds,
            "stopped_by": self.stopped_by or None,
            "steps": [step.as_json() for step in self.steps],
            "waits": [{"step": wait.step, "detected": wait.detected} for wait in self.waits],
            "contacts": self.contact_counts,
            "reflexes": self.reflex_counts,
            "pushes": [asdict(push) for push in self.pushes],
        }


def _counted(counts: dict[str, int]) -> str:
    return ", ".join(f"{name} {number}" for name, number in counts.items()) or "none"
