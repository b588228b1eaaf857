"""The service ``ALRobotPosture``; NAOqi 2.8 page "ALRobotPosture API"."""

from __future__ import annotations

from threading import Lock

from pepper_driver.backends.naoqi_server.context import Context
from pepper_driver.backends.naoqi_server.modules.calls import blocking
from pepper_driver.backends.naoqi_server.motion.body import CallError, number
from pepper_driver.backends.naoqi_server.motion.postures import NAMES
from pepper_driver.backends.naoqi_server.motion.tasks import Task

FAMILIES = {
    "Stand": "Standing",
    "StandInit": "Standing",
    "StandZero": "Standing",
    "Crouch": "Crouching",
}

PERIOD = 50
"""Cycles of ALMotion from one look for events to the next: a second, as documented."""


class PostureService:
    """Goes to predefined postures, and tells which one the robot has."""

    __qi_threading__ = "multi"

    def __init__(self, context: Context) -> None:
        self._memory, self._postures = context.memory, context.shared.postures
        self._motion = context.shared.motion
        self._lock = Lock()
        self._task: Task | None = None
        self._cycles = 0
        self._told = ("", "")
        self._motion.on_cycle.append(self._tell)

    def getPostureList(self) -> list[str]:
        """Names of the postures."""
        return list(NAMES)

    def getPosture(self) -> str:
        """The posture the robot has, or "Unknown"."""
        return self._postures.now

    def getPostureFamilyList(self) -> list[str]:
        """Families of postures."""
        return sorted(set(FAMILIES.values()))

    def getPostureFamily(self) -> str:
        """That of the robot, or "Unknown"."""
        return FAMILIES.get(self._postures.now, "Unknown")

    @blocking
    def goToPosture(self, name: object, speed: object) -> bool:
        """Go to a posture, ``speed`` in 0..1; waits. Whether it was reached."""
        return self._go(name, speed, "ALRobotPosture::goToPosture")

    @blocking
    def applyPosture(self, name: object, speed: object) -> bool:
        """As ``goToPosture``: there is only one way between two postures of a robot that always stands."""
        return self._go(name, speed, "ALRobotPosture::applyPosture")

    def stopMove(self) -> None:
        """End a way to a posture."""
        with self._lock:
            task = self._task
        if task is not None:
            with self._motion.lock:
                self._motion.joints.kill([task])

    def setMaxTryNumber(self, tries: object) -> None:
        """How often to try. Once is enough here."""
        number(tries, "ALRobotPosture::setMaxTryNumber", "the number of tries")

    def _go(self, name: object, speed: object, where: str) -> bool:
        if name not in NAMES:
            raise CallError(where, f"unknown posture: {name} (possible: {', '.join(NAMES)})")
        share = number(speed, where, "the speed")
        if not 0 < share <= 1:
            raise CallError(where, f"the speed must be above 0, at most 1: {share}")
        with self._lock:
            task = self._task = self._postures.go(str(name), share)
        return task.wait() and self._postures.reached(str(name))

    def _tell(self) -> None:
        self._cycles += 1
        if self._cycles % PERIOD:
            return
        now = self._postures.now
        told, self._told = self._told, (now, FAMILIES.get(now, "Unknown"))
        for event, old, new in zip(
            ("PostureChanged", "PostureFamilyChanged"), told, self._told, strict=True
        ):
            if old != new:
                self._memory.raise_event(event, new)
