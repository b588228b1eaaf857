"""Motion tasks: what a blocking call of ALMotion does until it is done. NAOqi 2.8 page "Motion task"."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import count
from threading import Event
from typing import Literal, Protocol

_NUMBERS = count(1)


class Curve(Protocol):
    """A value over the time since a task began."""

    @property
    def duration(self) -> float:
        """Its end [s]."""

    def at(self, time: float) -> float:
        """Value at a time; at the end after it."""


@dataclass(eq=False, kw_only=True)
class Task:
    """Angles or stiffnesses of some joints along curves. The joints are its own until it is over.

    Attributes:
        name: Method that asked for it.
        what: Which of the joints' two quantities it has.
        joints: Their indices.
        make: The curve of a joint, from its value and slope when the task begins.
        number: By which it can be killed.
        elapsed: Time since it began [s].
        completed: Whether it came to its end; False while it runs, and when it was killed.
    """

    name: str
    what: Literal["angle", "stiffness"]
    joints: frozenset[int]
    make: Callable[[int, tuple[float, float]], Curve]
    number: int = field(default_factory=lambda: next(_NUMBERS))
    elapsed: float = 0.0
    completed: bool = False
    _curves: Mapping[int, Curve] | None = None
    _over: Event = field(default_factory=Event)

    @property
    def running(self) -> bool:
        """Whether it has begun."""
        return self._curves is not None

    @property
    def over(self) -> bool:
        """Whether it has ended, of itself or by being killed."""
        return self._over.is_set()

    def begin(self, start: Mapping[int, tuple[float, float]]) -> None:
        """Make the curves, from value and slope of each joint now."""
        self._curves = {joint: self.make(joint, start[joint]) for joint in self.joints}

    def advance(self, dt: float) -> dict[int, float]:
        """Values by joint ``dt`` [s] later. Only of a task that has begun."""
        curves = self._curves or {}
        self.elapsed += dt
        return {joint: curve.at(self.elapsed) for joint, curve in curves.items()}

    @property
    def finished(self) -> bool:
        """Whether all curves are at their end."""
        curves = self._curves or {}
        return all(self.elapsed >= curve.duration for curve in curves.values())

    def end(self, *, completed: bool) -> None:
        """Let go whoever waits."""
        self.completed = completed
        self._over.set()

    def wait(self) -> bool:
        """Until it is over; whether it came to its end."""
        self._over.wait()
        return self.completed


class Tasks:
    """The tasks there are, oldest first. A task begins once no older one has any of its joints."""

    def __init__(self) -> None:
        self._tasks: list[Task] = []

    def __iter__(self) -> Iterator[Task]:
        return iter(list(self._tasks))

    def add(self, task: Task) -> None:
        """Take a task."""
        self._tasks.append(task)

    def runnable(self) -> list[Task]:
        """Those that have their joints to themselves."""
        taken: set[tuple[str, int]] = set()
        free = []
        for task in self._tasks:
            needs = {(task.what, joint) for joint in task.joints}
            if not needs & taken:
                free.append(task)
            taken |= needs
        return free

    def of(self, joints: set[int] | frozenset[int]) -> list[Task]:
        """Those that have, or wait for, any of the joints."""
        return [task for task in self._tasks if task.joints & joints]

    def end(self, task: Task, *, completed: bool) -> None:
        """Take a task out, and let go whoever waits for it."""
        self._tasks.remove(task)
        task.end(completed=completed)
