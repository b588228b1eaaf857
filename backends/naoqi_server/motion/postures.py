"""Predefined postures: ways to them, and which of them the robot has."""

from __future__ import annotations

from pepper_driver.backends.naoqi_server.motion.curves import Spline
from pepper_driver.backends.naoqi_server.motion.engine import Motion
from pepper_driver.backends.naoqi_server.motion.tasks import Task
from pepper_driver.config import NaoqiServices, RobotConfig

NAMES = ("Crouch", "Stand", "StandInit", "StandZero")
"""Those of Pepper, NAOqi 2.8 page "Predefined postures"."""

SAME = 0.15
"""[rad] A joint this near to a posture's has it. CHOSEN."""

SHORTEST = 0.5
"""[s] of a way to a posture."""


class Postures:
    """Ways to postures for ``motion``."""

    def __init__(self, motion: Motion, config: RobotConfig, settings: NaoqiServices) -> None:
        self._motion = motion
        self._settings = settings
        self._angles = {name: config.posture(name).tolist() for name in {*NAMES, settings.rest}}

    def go(self, name: str, speed: float) -> Task:
        """Begin to go to a posture, ``speed`` in 0..1."""
        motion, angles = self._motion, self._angles[name]
        with motion.lock:
            command = motion.joints.command
            way = max(abs(angle - now) for angle, now in zip(angles, command, strict=True))
            time = max(way / (speed * self._settings.posture_speed), SHORTEST)
            task = Task(
                name="goToPosture",
                what="angle",
                joints=frozenset(range(len(angles))),
                make=lambda joint, start: Spline(start, [time], [angles[joint]]),
            )
            motion.joints.tasks.add(task)
        return task

    def reached(self, name: str) -> bool:
        """Whether the robot has a posture, by its sensors."""
        with self._motion.lock:
            sensed = self._motion.joints.sensed
        hands = self._motion.body.hands
        return all(
            joint in hands or abs(angle - sensed[joint]) < SAME
            for joint, angle in enumerate(self._angles[name])
        )

    @property
    def now(self) -> str:
        """The posture the robot has, or "Unknown"."""
        return next((name for name in NAMES if self.reached(name)), "Unknown")
