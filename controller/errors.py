"""Errors that callers of the controller can make."""

from __future__ import annotations

from collections.abc import Iterable

from pepper_driver.config import PepperError
from pepper_driver.config.errors import shown

MAX_NAMES = 6
"""Names in a message."""


class TargetError(PepperError, ValueError):
    """A target that no robot can be sent to: not finite, wrong size, outside a limit. The task keeps its old one.

    Attributes:
        joint: Name of the joint at fault; None where the target as a whole is.
        value: What it was told [rad].
        lower: Its limit [rad].
        upper: Its limit [rad].
    """

    def __init__(
        self,
        message: str,
        *,
        joint: str | None = None,
        value: float | None = None,
        lower: float | None = None,
        upper: float | None = None,
    ) -> None:
        self.joint, self.value, self.lower, self.upper = joint, value, lower, upper
        super().__init__(message)


class LimitError(PepperError, ValueError):
    """A margin, share or choice of a constraint that limits nothing: negative, not finite, unknown.

    Attributes:
        name: Which.
        value: As given.
    """

    def __init__(self, name: str, value: object, what: str) -> None:
        self.name, self.value = name, value
        super().__init__(f"{name} must be {what}, got {shown(value)}")


class GainError(PepperError, ValueError):
    """A stiffness, damping or weight that is negative or not finite.

    Attributes:
        name: Which.
        value: As given.
    """

    def __init__(
        self, name: str, value: object, what: str = "a finite number that is not negative"
    ) -> None:
        self.name, self.value = name, value
        super().__init__(f"{name} must be {what}, got {shown(value)}")


class ChangesError(PepperError, RuntimeError):
    """The robot was told to run inside a group of changes, which are made only when the group is complete."""


class ShapeError(PepperError, ValueError):
    """An array of another shape than is expected, or something that is no array of numbers.

    Attributes:
        name: Which, as it stands in a program.
        expected: Its shape.
        given: The shape, or the type, that was given.
    """

    def __init__(self, name: str, expected: tuple[int, ...], given: tuple[int, ...] | str) -> None:
        self.name, self.expected, self.given = name, expected, given
        shown = given if isinstance(given, str) else f"an array {given}"
        super().__init__(f"{name} takes an array {expected} of numbers, got {shown}")


class PartError(PepperError, TypeError):
    """An object to be added that is neither a task nor a constraint."""


class RobotMismatchError(PepperError, ValueError):
    """A task for another robot than the controller's.

    Attributes:
        task: Name of the task.
        names: Joints and links that only one of the two descriptions has; none where only their order differs.
    """

    def __init__(self, task: str, made_for: str, moved: str, names: Iterable[str]) -> None:
        self.task, self.names = task, tuple(names)
        differing = ", ".join(self.names[:MAX_NAMES]) or "the order of joints or links"
        super().__init__(
            f"the task '{task}' was made for another description ('{made_for}') than the controller moves"
            f" ('{moved}'); they differ in {differing}: give the task robot=... as the controller has it"
        )


class TaskCountError(PepperError, ValueError):
    """One task more than a controller takes.

    Attributes:
        task: Name of the task that was refused.
        limit: Number of tasks that may be in use.
    """

    def __init__(self, task: str, limit: int) -> None:
        self.task, self.limit = task, limit
        super().__init__(
            f"the task '{task}' is one too many: {limit} are in use, and more would not fit into a cycle."
            " Tasks stay until they are removed: keep one task and set its target"
        )
