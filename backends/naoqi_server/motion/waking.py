"""Waking up and going to rest; NAOqi 2.8 pages "Stiffness control" and "Wake up and Rest effect"."""

from __future__ import annotations

from pepper_driver.backends.naoqi_server.memory import Memory
from pepper_driver.backends.naoqi_server.motion.curves import Bezier, Point
from pepper_driver.backends.naoqi_server.motion.engine import Motion
from pepper_driver.backends.naoqi_server.motion.postures import Postures
from pepper_driver.backends.naoqi_server.motion.tasks import Task
from pepper_driver.config import NaoqiServices

SPEED = 0.6
"""Share of the speed at which it goes to the posture of standing or of rest. CHOSEN."""

PREFIX = "ALMotion/Stiffness/"


class Waking:
    """Turns the motors on and off, in order. Both methods wait until it is done."""

    def __init__(
        self, motion: Motion, postures: Postures, memory: Memory, settings: NaoqiServices
    ) -> None:
        self._motion, self._postures, self._memory = motion, postures, memory
        self._settings = settings
        memory.insert("robotIsWakeUp", motion.awake)

    def wake_up(self) -> bool:
        """Motors on, then to the posture Stand; whether nothing interrupted it.

        Switches all reflexes on again but diagnosis effect and smart stiffness, also of a robot that is awake.
        """
        self._memory.raise_event(PREFIX + "wakeUpStarted", True)
        with self._motion.lock:
            self._motion.reflexes.wake_up()
            awake = self._motion.awake
            if not awake:
                self._motion.joints.kill(self._motion.joints.tasks)
                self._motion.wheel_stiffness = 1.0
                ramp = self._ramp(1.0)
        if not awake:
            if not ramp.wait():
                return False
            self._set_awake(True)
            if not self._postures.reached("Stand"):
                self._postures.go("Stand", SPEED).wait()
        self._memory.raise_event(PREFIX + "wakeUpFinished", True)
        return True

    def rest(self) -> None:
        """Stop, go to the posture of rest, then motors off. Brakes hold the leg."""
        with self._motion.lock:
            self._motion.joints.kill(self._motion.joints.tasks)
            self._motion.base.stop()
            awake = self._motion.awake
        if awake and not self._postures.go(self._settings.rest, SPEED).wait():
            return
        with self._motion.lock:
            self._motion.awake = False  # reflexes let go before the stiffness does
            ramp = self._ramp(0.0)
        if ramp.wait():
            with self._motion.lock:
                self._motion.wheel_stiffness = 0.0
            self._set_awake(False)

    def _ramp(self, stiffness: float) -> Task:
        """A straight line for all joints: that is what Bezier segments without handles are."""
        point = Point(time=self._settings.stiffness_ramp, value=stiffness)
        task = Task(
            name="stiffness",
            what="stiffness",
            joints=frozenset(self._motion.body.groups["Body"]),
            make=lambda _, start: Bezier(start[0], [point]),
        )
        self._motion.joints.tasks.add(task)
        return task

    def _set_awake(self, awake: bool) -> None:
        with self._motion.lock:
            self._motion.awake = awake
        self._memory.raise_event("robotIsWakeUp", awake)
