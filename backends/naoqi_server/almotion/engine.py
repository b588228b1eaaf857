"""The 50 Hz writer of ALMotion: actuators, its reflexes, and the cycle that joins all parts.

NAOqi 2.8 pages "ALMotion" (deactivation of safety reflexes), "External-collision avoidance", "Fall manager", "Push
Recovery", "Smart Stiffness", "Diagnosis effect". What ALMotion writes while a reflex is on is not documented, only that
it "sends new orders continuously" (NAOqi 2.5 page "DCM"). The model here is the worst that fits:

=====================  ==========================================
on                     is written in every cycle, while awake
=====================  ==========================================
self-collision, an arm     the angles of the arm
external collision, an arm the angles of the arm
external collision, Move   the speeds of the wheels
push recovery              the speeds of the wheels, the angles of the leg
fall manager               the angles of the leg
diagnosis effect           the angles of all joints
smart stiffness            the stiffnesses of all joints
=====================  ==========================================

It is a user of the DCM like any other: it gives timed orders, and the last one wins. It does not see the
orders of others: what it writes starts from what it wrote last (NAOqi 2.5 page "Motion advanced"). What it writes
without a request: ``reflexes.py``.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from threading import Event, RLock

import numpy as np

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.almotion.joints import Idle, Joints
from pepper_driver.backends.naoqi_server.almotion.kinematics import ARMS, CallError, JointGroups
from pepper_driver.backends.naoqi_server.almotion.wheels import AlmotionBase
from pepper_driver.backends.naoqi_server.dcm import UpdateType, unwrapped, wrapped
from pepper_driver.backends.naoqi_server.ipc import Robot
from pepper_driver.config import NaoqiServices, RobotConfig
from pepper_driver.config.clock import MONOTONIC_CLOCK, Clock

RETRY_PERIOD = 1.0
"""[s] from an error of the robot to the next cycle."""


class Actuators:
    """Joints by their index, wheels in the order of ``RobotConfig.wheels.names``.

    Args:
        robot: Whose.
        config: Its description.
        lead: How far ahead of the date given an order is dated [ms].
    """

    def __init__(self, robot: Robot, config: RobotConfig, lead: int) -> None:
        self._robot, self._lead = robot, lead
        names, joints, wheels = config.naoqi, config.joint_names, config.wheels.names
        self._angle = [names.prefix + names.position_command.format(joint=j) for j in joints]
        self._stiffness = [names.prefix + names.stiffness_command.format(joint=j) for j in joints]
        self._wheel = [names.prefix + names.wheel_speed_command.format(wheel=w) for w in wheels]
        self._wheel_stiffness = [
            names.prefix + names.wheel_stiffness_command.format(wheel=w) for w in wheels
        ]
        places = robot.keys
        self._sensed = [places[names.prefix + names.position.format(joint=j)] for j in joints]
        self._rolled = [places[names.prefix + names.wheel_speed.format(wheel=w)] for w in wheels]

    def read(self) -> tuple[list[float], list[float]]:
        """Measured (17) angles [rad] and (3) wheel speeds [rad/s]."""
        values = self._robot.values()
        return [values[place] for place in self._sensed], [values[place] for place in self._rolled]

    def stiffness(self) -> list[float]:
        """(17) hardnesses that the DCM sent last."""
        return [self._robot.value(key) for key in self._stiffness]

    def order_angles(
        self, date: int, angles: Mapping[int, float], update: UpdateType = "ClearAfter"
    ) -> None:
        """Order angles [rad] of some joints."""
        self._order(date, [self._angle[joint] for joint in angles], angles.values(), update)

    def order_stiffnesses(self, date: int, stiffnesses: Mapping[int, float]) -> None:
        """Order stiffnesses of some joints."""
        keys = [self._stiffness[joint] for joint in stiffnesses]
        self._order(date, keys, stiffnesses.values())

    def order_wheels(self, date: int, speeds: Sequence[float]) -> None:
        """Order the speeds of all wheels [rad/s]."""
        self._order(date, self._wheel, speeds)

    def order_wheel_stiffness(self, date: int, stiffness: float) -> None:
        """Order the stiffness of all wheels."""
        self._order(date, self._wheel_stiffness, [stiffness] * len(self._wheel_stiffness))

    def _order(
        self,
        date: int,
        keys: Sequence[str],
        values: Iterable[float],
        update: UpdateType = "ClearAfter",
    ) -> None:
        if keys:
            when = wrapped(date + self._lead)
            self._robot.order(keys, update, [[(float(value), when)] for value in values])


CONSENT = (
    "the owner of the robot has not allowed to deactivate this safety reflex: "
    "allow it on the page http://<robot>/advanced/#/settings"
)


class AlmotionReflexes:
    """Switches. All are on at the start.

    Attributes:
        self_collision: By arm.
        external: By "Move" and arm.
        diagnosis: Diagnosis effect.
        smart_stiffness: Less stiffness while nothing moves.
        fall_manager: What it does when the robot falls.
        push_recovery: What it does when the robot is pushed.
        orthogonal: Distance to obstacles ahead [m].
        tangential: To the sides [m].
    """

    def __init__(self, body: JointGroups, *, consent: bool) -> None:
        self._body = body
        self._consent = consent
        self.self_collision = dict.fromkeys(ARMS, True)
        self.external = dict.fromkeys(("Move", *ARMS), True)
        self.diagnosis = self.smart_stiffness = True
        self.fall_manager = self.push_recovery = True
        self.orthogonal, self.tangential = 0.4, 0.1

    def arms(self, name: object, where: str) -> tuple[str, ...]:
        """Return the arms that "LArm", "RArm" or "Arms" stands for.

        Raises:
            CallError: Another name.
        """
        if name == "Arms":
            return ARMS
        if name in ARMS:
            return (str(name),)
        raise CallError(where, f"unknown chain name: {name} (possible: Arms, LArm, RArm)")

    def externals(self, name: object, where: str) -> tuple[str, ...]:
        """Return the parts of the external collision protection that a name stands for.

        Raises:
            CallError: Another name.
        """
        if name == "All":
            return tuple(self.external)
        if name == "Move":
            return ("Move",)
        if name == "Arms" or name in ARMS:
            return self.arms(name, where)
        raise CallError(where, f"unknown name: {name} (possible: All, Move, Arms, LArm, RArm)")

    def check_consent(self, enable: bool, where: str) -> None:
        """Before a critical reflex is switched off.

        Raises:
            CallError: The owner has not consented.
        """
        if not enable and not self._consent:
            raise CallError(where, CONSENT)

    def wake_up(self) -> None:
        """Switch on what waking up switches on: all but diagnosis effect and smart stiffness."""
        self.self_collision = dict.fromkeys(ARMS, True)
        self.external = dict.fromkeys(("Move", *ARMS), True)
        self.fall_manager = self.push_recovery = True

    @property
    def joints(self) -> frozenset[int]:
        """Whose angles are written in every cycle."""
        if self.diagnosis:
            return frozenset(self._body.groups["Body"])
        held: set[int] = set()
        for arm in ARMS:
            if self.self_collision[arm] or self.external[arm]:
                held.update(self._body.chains[arm])
        if self.fall_manager or self.push_recovery:
            held.update(self._body.legs)
        return frozenset(held)

    @property
    def wheels(self) -> bool:
        """True if the speeds of the wheels are written in every cycle."""
        return self.external["Move"] or self.push_recovery


logger = logging.getLogger(__name__)

MAX_STEP = 0.1
"""[s] by which motions advance at most in a cycle: a process that was stopped continues where it was."""

SMART_STIFFNESS_DELAY = 0.5
"""[s] without a commanded motion after which smart stiffness reduces."""


@dataclass(frozen=True, kw_only=True)
class MotionOutput:
    """Output of one cycle, by joint: angles of joints that start again, of others, stiffnesses; and of the wheels."""

    fresh: dict[int, float]
    angles: dict[int, float]
    stiffnesses: dict[int, float]
    wheels: list[float] | None
    wheel_stiffness: float | None


class MotionEngine:
    """Commands of ALMotion. Services change its parts under ``lock``; a cycle is computed under it too.

    Args:
        robot: What to move.
        config: Its description.
        settings: How it is moved.
        consent: True if the owner allows safety reflexes to be switched off.

    Attributes:
        lock: See above.
        body: Names and limits.
        reflexes: Their switches.
        idle: Motion of unused joints.
        joints: Their commands.
        base: Its velocity and where it is.
        awake: Whether the motors are on since the last ``wakeUp``.
        wheel_stiffness: Of all wheels, 0..1.
        on_cycle: Called after each cycle, without the lock.
        clock: Time of its cycles.
        closed: Set once it is over.
    """

    def __init__(
        self,
        robot: Robot,
        config: RobotConfig,
        settings: NaoqiServices,
        *,
        consent: bool = False,
        clock: Clock = MONOTONIC_CLOCK,
    ) -> None:
        self.clock = clock
        self._robot = robot
        self._settings = settings
        self._actuators = Actuators(robot, config, round(settings.lead_time * 1000))
        self.lock = RLock()
        self.body = JointGroups(config, settings)
        self.reflexes = AlmotionReflexes(self.body, consent=consent)
        self.idle = Idle(config, settings, self.body)
        self.base = AlmotionBase(config, settings)
        stiffness = self._actuators.stiffness()  # of a robot that stayed awake while NAOqi was down
        sensed, _ = self._actuators.read()
        self.joints = Joints(self.body, self.idle, settings, sensed, list(stiffness))
        # In ALMotion only waking up and resting change the stiffness of the legs.
        self.awake = self.body.legs <= self.joints.stiff
        self.wheel_stiffness = float(self.awake)
        self.on_cycle: list[Callable[[], None]] = []
        self._stiffness_written = stiffness
        self._wheels_written = self.wheel_stiffness
        self._wheel_speeds: list[float] = []
        self._rest_time = 0.0
        self._date = robot.time()
        self.closed = Event()
        self._ended = Event()
        self._ended.set()

    def start(self) -> None:
        """Begin to write."""
        self._ended.clear()
        self.clock.start(self._run, "ALMotion")

    def close(self) -> None:
        """End the writer, and release callers that wait for a motion."""
        self.closed.set()
        self.clock.wait_for(self._ended.is_set)
        with self.lock:
            self.joints.kill(self.joints.tasks)
            self.base.stop(at_once=True)

    def cycle(self) -> None:
        """Work out and order what a cycle asks for. Only the writer's thread calls it, or a test.

        Raises:
            BackendError: The robot does not answer.
        """
        # Near the last one, so that a roll-over of the robot's clock has no consequence.
        date = unwrapped(self._robot.time(), self._date)
        dt = min((date - self._date) / 1000, MAX_STEP)
        # Speeds are differences divided by this time.
        if dt <= 0:
            return
        self._date = date
        sensed, wheel_speeds = self._actuators.read()
        with self.lock:
            orders = self._step(sensed, wheel_speeds, dt)
        # ClearAll: a joint that gets stiffness must not follow commands that wait from before.
        self._actuators.order_angles(date, orders.fresh, "ClearAll")
        self._actuators.order_angles(date, orders.angles)
        self._actuators.order_stiffnesses(date, orders.stiffnesses)
        if orders.wheel_stiffness is not None:
            self._actuators.order_wheel_stiffness(date, orders.wheel_stiffness)
        if orders.wheels is not None:
            self._actuators.order_wheels(date, orders.wheels)
        # Without the lock: callbacks raise events, and listeners may call ALMotion.
        for callback in self.on_cycle:
            callback()

    def _step(self, sensed: list[float], wheel_speeds: list[float], dt: float) -> MotionOutput:
        joints = self.joints
        joints.advance(sensed, dt)
        self._rest_time = 0.0 if joints.moving else self._rest_time + dt
        held = self.reflexes.joints if self.awake else frozenset()
        self.base.measure(np.array(wheel_speeds), dt)
        speeds = self.base.advance(dt).tolist()
        wheels_used = self.base.active or any(self._wheel_speeds)  # until their command is to stand
        if wheels_used or (self.awake and self.reflexes.wheels):
            self._wheel_speeds = wheels = speeds
        else:
            wheels = None
        changed = self.wheel_stiffness != self._wheels_written
        self._wheels_written = self.wheel_stiffness
        return MotionOutput(
            fresh={joint: joints.command[joint] for joint in joints.fresh},
            angles={
                joint: joints.command[joint]
                for joint in ((joints.used | held) & joints.stiff) - joints.fresh
            },
            stiffnesses=self._stiffnesses(),
            wheels=wheels,
            wheel_stiffness=self.wheel_stiffness if changed else None,
        )

    def _stiffnesses(self) -> dict[int, float]:
        """Return the stiffnesses to write: with smart stiffness all, in every cycle; else those that changed."""
        smart = self.awake and self.reflexes.smart_stiffness
        fraction = (
            self._settings.smart_stiffness
            if smart and self._rest_time > SMART_STIFFNESS_DELAY
            else 1.0
        )
        goal = [fraction * stiffness for stiffness in self.joints.stiffness]
        written, self._stiffness_written = self._stiffness_written, goal
        return {
            joint: value for joint, value in enumerate(goal) if smart or value != written[joint]
        }

    def _run(self) -> None:
        try:
            self._write()
        finally:
            self._ended.set()

    def _write(self) -> None:
        due = self.clock.seconds()
        while not self.closed.is_set():
            try:
                self.cycle()
            # The robot has ended or was stopped: nothing is left to move.
            except BackendError as error:
                logger.warning("ALMotion: %s", error)
                self.clock.wait_for(self.closed.is_set, RETRY_PERIOD)
            # Missed cycles are not made up for: a process that was stopped continues where it was.
            due = max(due + self._settings.cycle, self.clock.seconds())
            self.clock.sleep(max(0.0, due - self.clock.seconds()))
