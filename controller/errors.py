"""Errors of callers of the controller."""

from __future__ import annotations

from collections.abc import Iterable

from pepper_driver.config import PepperError
from pepper_driver.config.errors import shown

MAX_NAMES = 6
"""Largest number of names in a message."""


class TargetError(PepperError, ValueError):
    """Invalid target: not finite, wrong size, outside a limit. The task keeps its previous one.

    Attributes:
        joint: Name of the joint with the invalid value; None if it is the target as a whole.
        value: Its invalid value [rad].
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
    """Invalid margin, fraction or choice of a constraint: negative, not finite, unknown.

    Attributes:
        name: Name of the argument.
        value: As given.
    """

    def __init__(self, name: str, value: object, what: str) -> None:
        self.name, self.value = name, value
        super().__init__(f"{name} must be {what}, got {shown(value)}")


class GainError(PepperError, ValueError):
    """Invalid stiffness, damping or weight: negative or not finite.

    Attributes:
        name: Name of the gain.
        value: As given.
    """

    def __init__(
        self, name: str, value: object, what: str = "a finite number that is not negative"
    ) -> None:
        self.name, self.value = name, value
        super().__init__(f"{name} must be {what}, got {shown(value)}")


class ChangesError(PepperError, RuntimeError):
    """Attempt to run the robot inside a group of changes, which are made only when the group is complete."""


class ShapeError(PepperError, ValueError):
    """Array of another shape than expected, or a value that is no array of numbers.

    Attributes:
        name: Name in the program.
        expected: Expected shape.
        given: Shape, or type, that was given.
    """

    def __init__(self, name: str, expected: tuple[int, ...], given: tuple[int, ...] | str) -> None:
        self.name, self.expected, self.given = name, expected, given
        shown = given if isinstance(given, str) else f"an array {given}"
        super().__init__(f"{name} takes an array {expected} of numbers, got {shown}")


class PartError(PepperError, TypeError):
    """Added object that is neither a task nor a constraint."""


class RobotMismatchError(PepperError, ValueError):
    """Task for another robot than that of the controller.

    Attributes:
        task: Name of the task.
        names: Joints and links that only one of the two descriptions has; empty if only their order differs.
    """

    def __init__(self, task: str, made_for: str, moved: str, names: Iterable[str]) -> None:
        self.task, self.names = task, tuple(names)
        differing = ", ".join(self.names[:MAX_NAMES]) or "the order of joints or links"
        super().__init__(
            f"the task '{task}' was made for another description ('{made_for}') than the controller moves"
            f" ('{moved}'); they differ in {differing}: give the task robot=... as the controller has it"
        )


class TaskCountError(PepperError, ValueError):
    """Task beyond the largest number of tasks.

    Attributes:
        task: Name of the task that was refused.
        limit: Largest number of tasks in use.
    """

    def __init__(self, task: str, limit: int) -> None:
        self.task, self.limit = task, limit
        super().__init__(
            f"the task '{task}' is one too many: {limit} are in use, and more would not fit into a cycle."
            " Tasks stay until they are removed: keep one task and set its target"
        )
