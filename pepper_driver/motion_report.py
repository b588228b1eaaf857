"""What a motion reached."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Miss:
    """How far from its target something is, in ``metres`` and ``radians``; None where it has no such part."""

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
    """How near one goal of a step came to its target.

    Attributes:
        name: As the motion calls it; ``posture`` for the joints.
        commanded: How far off the controller's own state was.
        measured: How far off the robot was by its encoders and wheels: gravity, friction and slip are in it.
    """

    name: str
    commanded: Miss
    measured: Miss


@dataclass(frozen=True, kw_only=True)
class StepReport:
    """What one step reached when it was over.

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
        return f"step {self.number} {self.name}: {self.duration:.2f} s{word}" + (
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
class MotionReport:
    """What the steps of a motion reached, in the order they were played."""

    name: str
    steps: tuple[StepReport, ...]

    @property
    def reached(self) -> bool:
        """Whether no step that waits for its targets gave up."""
        return all(step.reached is not False for step in self.steps)

    def __str__(self) -> str:
        return "\n".join(str(step) for step in self.steps)

    def as_json(self) -> dict[str, Any]:
        """For files."""
        return {
            "motion": self.name,
            "reached": self.reached,
            "steps": [step.as_json() for step in self.steps],
        }
