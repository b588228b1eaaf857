"""Motion of joints: tasks in progress, idle motion, and the positions of a cycle.

Motion tasks: what a blocking call of ALMotion does until it is done. NAOqi 2.8 page "Motion task".

Motion of unused joints: none, hold a posture, breathe, look around. NAOqi 2.8 page "Idle".
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import count
from math import copysign, pi, sin
from random import Random
from threading import Event
from typing import Literal, Protocol

from pepper_driver.backends.naoqi_server.almotion.curves import approach
from pepper_driver.backends.naoqi_server.almotion.kinematics import CallError, JointGroups
from pepper_driver.config import NaoqiServices, RobotConfig
from pepper_driver.config.clock import Clock

_NUMBERS = count(1)


class Curve(Protocol):
    """A value over the time since a task began."""

    @property
    def duration(self) -> float:
        """Its end [s]."""

    def at(self, time: float) -> float:
        """Value at a time; at the end after it."""


@dataclass(eq=False, kw_only=True)
class AlmotionTask:
    """Angles or stiffnesses of some joints along curves. The joints are its own until it is over.

    Attributes:
        name: Method that asked for it.
        what: Which of the joints' two quantities it has.
        joints: Their indices.
        make: The curve of a joint, from its value and slope when the task begins.
        number: By which it can be killed.
        elapsed: Time since it began [s].
        completed: Whether it came to its end; False while it runs, and when it was killed.
    """

    name: str
    what: Literal["angle", "stiffness"]
    joints: frozenset[int]
    make: Callable[[int, tuple[float, float]], Curve]
    number: int = field(default_factory=lambda: next(_NUMBERS))
    elapsed: float = 0.0
    completed: bool = False
    _curves: Mapping[int, Curve] | None = None
    _over: Event = field(default_factory=Event)

    @property
    def running(self) -> bool:
        """True if it has begun."""
        return self._curves is not None

    @property
    def over(self) -> bool:
        """True if it has ended, of itself or by being killed."""
        return self._over.is_set()

    def begin(self, start: Mapping[int, tuple[float, float]]) -> None:
        """Make the curves, from value and slope of each joint now."""
        self._curves = {joint: self.make(joint, start[joint]) for joint in self.joints}

    def advance(self, dt: float) -> dict[int, float]:
        """Values by joint ``dt`` [s] later. Only of a task that has begun."""
        curves = self._curves or {}
        self.elapsed += dt
        return {joint: curve.at(self.elapsed) for joint, curve in curves.items()}

    @property
    def finished(self) -> bool:
        """True if all curves are at their end."""
        curves = self._curves or {}
        return all(self.elapsed >= curve.duration for curve in curves.values())

    def end(self, *, completed: bool) -> None:
        """Release the callers that wait."""
        self.completed = completed
        self._over.set()

    def wait(self, clock: Clock) -> bool:
        """Until it is over; whether it came to its end."""
        clock.wait_for(self._over.is_set)
        return self.completed


class AlmotionTasks:
    """The tasks there are, oldest first. A task begins once no older one has any of its joints."""

    def __init__(self) -> None:
        self._tasks: list[AlmotionTask] = []

    def __iter__(self) -> Iterator[AlmotionTask]:
        return iter(list(self._tasks))

    def add(self, task: AlmotionTask) -> None:
        """Take a task."""
        self._tasks.append(task)

    def runnable(self) -> list[AlmotionTask]:
        """Return the tasks that have their joints to themselves."""
        taken: set[tuple[str, int]] = set()
        free = []
        for task in self._tasks:
            needs = {(task.what, joint) for joint in task.joints}
            if not needs & taken:
                free.append(task)
            taken |= needs
        return free

    def of(self, joints: set[int] | frozenset[int]) -> list[AlmotionTask]:
        """Return the tasks that have, or wait for, any of the joints."""
        return [task for task in self._tasks if task.joints & joints]

    def end(self, task: AlmotionTask, *, completed: bool) -> None:
        """Remove a task, and release the callers that wait for it."""
        self._tasks.remove(task)
        task.end(completed=completed)


GROUPS = {
    "Body": ("Head", "LArm", "Leg", "RArm"),
    "Legs": ("Leg",),
    "Arms": ("LArm", "RArm"),
    "LArm": ("LArm",),
    "RArm": ("RArm",),
    "Head": ("Head",),
}
"""Chains by the names that the calls take."""


class Idle:
    """Idle motion: chains that breathe or keep a posture, and the targets of idle joints.

    Attributes:
        breathing: Chains that breathe because of a call.
        posture: Chains that return to the posture Stand.
        alive: Whether a living robot moves by itself: all chains breathe.
        looking: Whether a living robot looks around.
    """

    def __init__(self, config: RobotConfig, settings: NaoqiServices, body: JointGroups) -> None:
        self._settings = settings
        self._stand = config.posture("Stand").tolist()
        self._chain_of = {index: chain for chain, joints in body.chains.items() for index in joints}
        self._weights = {
            config.joint_index(joint): weight * settings.breathing.amplitude
            for joint, weight in settings.breathing.joints.items()
        }
        self._head = (config.joint_index("HeadYaw"), config.joint_index("HeadPitch"))
        self._random = Random(0)  # the same robot every time
        self._glance = dict.fromkeys(self._head, 0.0)
        self._glances = -1
        self.breathing: set[str] = set()
        self.posture: set[str] = set()
        self.alive = self.looking = False

    def chains(self, name: object, where: str) -> tuple[str, ...]:
        """Return the chains that a call's name stands for.

        Raises:
            CallError: Another name.
        """
        if not isinstance(name, str) or name not in GROUPS:
            raise CallError(where, f"unknown chain name: {name} (possible: {', '.join(GROUPS)})")
        return GROUPS[name]

    def moves(self, joint: int) -> bool:
        """Return True if this moves an unused joint now."""
        chain = self._chain_of[joint]
        breathes = chain in self.breathing or self.alive
        return breathes or chain in self.posture or (self.looking and joint in self._head)

    def target(self, joint: int, anchor: float, time: float) -> float:
        """Return the target of an idle joint at a time [s]; ``anchor`` is the angle at which it was left."""
        if self.looking and joint in self._head:
            self._look(time)
            return self._glance[joint]
        chain = self._chain_of[joint]
        if chain in self.posture and chain not in self.breathing:
            return float(self._stand[joint])
        phase = 2 * pi * time / self._settings.breathing.period
        return anchor + self._weights.get(joint, 0.0) * sin(phase)

    def _look(self, time: float) -> None:
        """Choose another direction when it is time for it."""
        glance = self._settings.glance
        number = int(time / glance.period)
        if number != self._glances:
            self._glances = number
            yaw = self._random.uniform(-glance.yaw, glance.yaw)
            pitch = self._random.uniform(-glance.pitch, glance.pitch)
            self._glance = dict(
                zip(self._head, (yaw, self._stand[self._head[1]] + pitch), strict=True)
            )


MIN_MOVING_SPEED = 1e-3
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
        used: Joints that a task moved in the last cycle.
    """

    def __init__(
        self,
        body: JointGroups,
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
        self.tasks = AlmotionTasks()
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
        """True if any joint with stiffness is commanded to move."""
        return any(abs(self.velocity[joint]) > MIN_MOVING_SPEED for joint in self.stiff)

    def target(self, joint: int) -> float:
        """Return the target of a joint, or its position."""
        return self._targets.get(joint, (self.command[joint], 0.0))[0]

    def set_target(self, joint: int, angle: float, fraction: float) -> None:
        """Move a joint to an angle at a fraction of its largest speed, until the next command."""
        speed = fraction * self._body.speed[joint]
        self._targets[joint] = (self._body.clipped(joint, angle), speed)

    def kill(self, tasks: Iterable[AlmotionTask]) -> None:
        """End tasks where they are, unless they have ended; their joints come to rest."""
        for task in [task for task in tasks if not task.over]:
            self.tasks.end(task, completed=False)
            for joint in task.joints if task.running and task.what == "angle" else ():
                speed = abs(self.velocity[joint])
                if speed > MIN_MOVING_SPEED:
                    # Of an even deceleration to rest within `rise`.
                    distance = self.velocity[joint] * self._settings.rise / 2
                    fraction = speed / self._body.speed[joint]
                    self.set_target(joint, self.command[joint] + distance, fraction)

    def advance(self, sensed: list[float], dt: float) -> None:
        """Bring the commands on by ``dt`` [s]. A joint without stiffness lies where it lies, and starts from there."""
        self._time += dt
        self.sensed_velocity = [
            (now - before) / dt for now, before in zip(sensed, self.sensed, strict=True)
        ]
        self.sensed = sensed
        before = list(self.command)
        # The order is that of priority: a joint that was used already is left alone by what follows.
        self.used = self._follow_tasks(dt)
        self._follow_targets(dt)
        self._idle_on(dt)
        stiff = self.stiff
        self.fresh = self._limp & stiff
        self._limp = set(range(len(sensed))) - stiff
        for joint, last in enumerate(before):
            if joint in self._limp:
                # ALMotion takes a joint without stiffness to be where it is measured.
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
        # A copy, because targets that are reached are removed.
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
            # Enough to stop the present speed, which may be higher than the one asked for now.
            acceleration=max(speed, abs(self.velocity[joint])) / self._settings.rise,
            dt=dt,
        )
