"""The commanded angles and stiffnesses of all joints, and who moves them: tasks, targets, idling, in this order."""

from __future__ import annotations

from collections.abc import Iterable
from math import copysign

from pepper_driver.backends.naoqi_server.motion.body import Body
from pepper_driver.backends.naoqi_server.motion.curves import approach
from pepper_driver.backends.naoqi_server.motion.idle import Idle
from pepper_driver.backends.naoqi_server.motion.tasks import Task, Tasks
from pepper_driver.config import NaoqiServices

MOVING = 1e-3
"""[rad/s] A joint commanded to be faster than this moves."""


class Joints:
    """Joints by their index. Not safe for several threads: the engine locks.

    Attributes:
        command: (17,) angles commanded last [rad]. Of a joint without stiffness: as measured.
        velocity: (17,) of the commands [rad/s].
        sensed: (17,) angles measured last [rad].
        sensed_velocity: (17,) of the measured angles [rad/s].
        stiffness: (17,) asked for, 0..1.
        tasks: What was asked for by blocking calls.
        fresh: Joints that got stiffness in the last cycle.
        used: Joints that somebody moved in the last cycle.
    """

    def __init__(
        self,
        body: Body,
        idle: Idle,
        settings: NaoqiServices,
        sensed: list[float],
        stiffness: list[float],
    ) -> None:
        self._body, self._idle, self._settings = body, idle, settings
        self.sensed, self.stiffness = sensed, stiffness
        self.command, self._anchors = list(sensed), list(sensed)
        self.velocity = [0.0] * len(sensed)
        self.sensed_velocity = [0.0] * len(sensed)
        self.tasks = Tasks()
        self.fresh: set[int] = set()
        self.used: set[int] = set()
        self._limp = {joint for joint, value in enumerate(stiffness) if value <= 0}
        self._targets: dict[int, tuple[float, float]] = {}  # of setAngles: angle, speed
        self._time = 0.0

    @property
    def stiff(self) -> set[int]:
        """Joints with stiffness."""
        return {joint for joint, value in enumerate(self.stiffness) if value > 0}

    @property
    def moving(self) -> bool:
        """Whether any joint with stiffness is commanded to move."""
        return any(abs(self.velocity[joint]) > MOVING for joint in self.stiff)

    def target(self, joint: int) -> float:
        """Where a joint is going, or is."""
        return self._targets.get(joint, (self.command[joint], 0.0))[0]

    def set_target(self, joint: int, angle: float, fraction: float) -> None:
        """Let a joint go to an angle at a fraction of its largest speed, until told otherwise."""
        speed = fraction * self._body.speed[joint]
        self._targets[joint] = (self._body.clipped(joint, angle), speed)

    def kill(self, tasks: Iterable[Task]) -> None:
        """End tasks where they are, unless they have ended; their joints come to rest."""
        for task in [task for task in tasks if not task.over]:
            self.tasks.end(task, completed=False)
            for joint in task.joints if task.running and task.what == "angle" else ():
                speed = abs(self.velocity[joint])
                if speed > MOVING:
                    way = self.velocity[joint] * self._settings.rise / 2
                    fraction = speed / self._body.speed[joint]
                    self.set_target(joint, self.command[joint] + way, fraction)

    def advance(self, sensed: list[float], dt: float) -> None:
        """Bring the commands on by ``dt`` [s]. A joint without stiffness lies where it lies, and starts from there."""
        self._time += dt
        self.sensed_velocity = [
            (now - before) / dt for now, before in zip(sensed, self.sensed, strict=True)
        ]
        self.sensed = sensed
        before = list(self.command)
        self.used = self._follow_tasks(dt)
        self._follow_targets(dt)
        self._idle_on(dt)
        stiff = self.stiff
        self.fresh = self._limp & stiff
        self._limp = set(range(len(sensed))) - stiff
        for joint, last in enumerate(before):
            if joint in self._limp:
                self.command[joint] = self._anchors[joint] = sensed[joint]
                self._targets.pop(joint, None)
            else:
                most = self._body.speed[joint] * dt
                if abs(self.command[joint] - last) > most:
                    self.command[joint] = last + copysign(most, self.command[joint] - last)
            self.velocity[joint] = (self.command[joint] - last) / dt
        self._end_tasks()

    def _follow_tasks(self, dt: float) -> set[int]:
        used: set[int] = set()
        for task in self.tasks.runnable():
            angles = task.what == "angle"
            values = self.command if angles else self.stiffness
            if not task.running:
                rates = self.velocity if angles else [0.0] * len(values)
                task.begin({joint: (values[joint], rates[joint]) for joint in task.joints})
                for joint in task.joints if angles else ():
                    self._targets.pop(joint, None)
            for joint, value in task.advance(dt).items():
                if angles:
                    self.command[joint] = self._anchors[joint] = self._body.clipped(joint, value)
                    used.add(joint)
                else:
                    self.stiffness[joint] = min(max(value, 0.0), 1.0)
        return used

    def _end_tasks(self) -> None:
        """End those whose time is over and whose joints came as far as they were to."""
        for task in self.tasks.runnable():
            if task.running and task.finished:
                goals = task.advance(0.0) if task.what == "angle" else {}
                if all(
                    joint in self._limp or self.command[joint] == self._body.clipped(joint, goal)
                    for joint, goal in goals.items()
                ):
                    self.tasks.end(task, completed=True)

    def _follow_targets(self, dt: float) -> None:
        for joint, (angle, speed) in list(self._targets.items()):
            if joint not in self.used:
                self._approach(joint, angle, speed, dt)
                self._anchors[joint] = self.command[joint]
                self.used.add(joint)
                if self.command[joint] == angle:
                    del self._targets[joint]

    def _idle_on(self, dt: float) -> None:
        for joint in range(len(self.command)):
            if joint not in self.used and self._idle.moves(joint):
                angle = self._idle.target(joint, self._anchors[joint], self._time)
                speed = self._settings.glance.fraction * self._body.speed[joint]
                self._approach(joint, self._body.clipped(joint, angle), speed, dt)
                self.used.add(joint)

    def _approach(self, joint: int, angle: float, speed: float, dt: float) -> None:
        self.command[joint], self.velocity[joint] = approach(
            self.command[joint],
            self.velocity[joint],
            angle,
            speed=speed,
            acceleration=max(speed, abs(self.velocity[joint])) / self._settings.rise,
            dt=dt,
        )
