"""The error of the log."""

from __future__ import annotations

from pepper_driver.config import PepperError


class LogError(PepperError, OSError):
    """A log cannot be written or read; the message is one line with path and reason."""
