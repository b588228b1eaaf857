"""What a caller of the controller can do wrong."""

from __future__ import annotations

from pepper_driver.config import PepperError


class TargetError(PepperError, ValueError):
    """A target that no robot can be sent to: not finite, wrong size, outside a limit. The task keeps its old one."""


class GainError(PepperError, ValueError):
    """A stiffness, damping or weight that is negative or not finite."""
