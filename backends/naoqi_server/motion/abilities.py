"""Autonomous life: its state, and the abilities that move a living robot."""

from __future__ import annotations

from pepper_driver.backends.naoqi_server.motion.engine import Motion

STATES = ("solitary", "interactive", "safeguard", "disabled")

ALIVE = ("solitary", "interactive")
"""States in which the abilities are on."""

ABILITIES = (
    "AutonomousBlinking",
    "BackgroundMovement",
    "BasicAwareness",
    "ListeningMovement",
    "SpeakingMovement",
)


class Life:
    """State and abilities.

    Attributes:
        state: One of ``STATES``.
        enabled: By ability.
        paused: Whether BasicAwareness was told to stop for a while.
    """

    def __init__(self, motion: Motion) -> None:
        self._motion = motion
        self.state = "disabled"
        self.enabled = dict.fromkeys(ABILITIES, False)
        self.paused = False

    def running(self, ability: str) -> bool:
        """Whether an ability is at work."""
        return self.enabled[ability] and not (ability == "BasicAwareness" and self.paused)

    def enter(self, state: str) -> None:
        """Enter a state: it switches all abilities."""
        self.state = state
        self.enabled = dict.fromkeys(ABILITIES, state in ALIVE)
        self.apply()

    def apply(self) -> None:
        """Let the abilities move the robot, or not."""
        with self._motion.lock:
            self._motion.idle.alive = self.running("BackgroundMovement")
            self._motion.idle.looking = self.running("BasicAwareness")
