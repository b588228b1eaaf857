"""Errors that callers of the controller can make."""

from __future__ import annotations

from pepper_driver.config import PepperError


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
        super().__init__(f"{name} must be {what}, got {value!r}")


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
        super().__init__(f"{name} must be {what}, got {value!r}")


class ChangesError(PepperError, RuntimeError):
    """The robot was told to run inside a group of changes, which are made only when the group is complete."""
