"""Reactions to touch inside the tick."""

from pepper_driver.reflexes.hold import Hold
from pepper_driver.reflexes.reflex import Control, Reflex

__all__ = ["Control", "Hold", "Reflex"]
