"""The writer of ALMotion: 50 times a second it works out where joints and wheels are to be, and tells the DCM.

It is a user of the DCM like any other: it gives timed orders, and whoever gives the last one wins. It does not see the
orders of others: what it writes starts from what it wrote last (NAOqi 2.5 page "Motion advanced"). What it writes
though nobody asked it to: ``reflexes.py``.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Event, RLock, Thread

import numpy as np

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.clock import unwrapped
from pepper_driver.backends.naoqi_server.motion.actuators import Actuators
from pepper_driver.backends.naoqi_server.motion.base import Base
from pepper_driver.backends.naoqi_server.motion.body import Body
from pepper_driver.backends.naoqi_server.motion.idle import Idle
from pepper_driver.backends.naoqi_server.motion.joints import Joints
from pepper_driver.backends.naoqi_server.motion.reflexes import Reflexes
from pepper_driver.backends.naoqi_server.robot import Robot
from pepper_driver.config import NaoqiServices, RobotConfig

logger = logging.getLogger(__name__)

LONGEST_STEP = 0.1
"""[s] by which motions go on at most in a cycle: a process that was stopped goes on where it was."""

STILL = 0.5
"""[s] without a commanded motion after which smart stiffness reduces."""


@dataclass(frozen=True, kw_only=True)
class Orders:
    """What one cycle orders, by joint: angles of joints that start anew, of others, stiffnesses; and of the wheels."""

    fresh: dict[int, float]
    angles: dict[int, float]
    stiffnesses: dict[int, float]
    wheels: list[float] | None
    wheel_stiffness: float | None


class Motion:
    """What ALMotion commands. Services change its parts under ``lock``; a cycle is worked out under it too.

    Args:
        robot: What to move.
        config: Its description.
        settings: How it is moved.
        consent: Whether the owner lets safety reflexes be switched off.

    Attributes:
        lock: See above.
        body: Names and limits.
        reflexes: Their switches.
        idle: What joints do that nobody uses.
        joints: Their commands.
        base: Its velocity and where it is.
        awake: Whether the motors are on since the last ``wakeUp``.
        wheel_stiffness: Of all wheels, 0..1.
        on_cycle: Called after each cycle, without the lock.
        closed: Set once it is over.
    """

    def __init__(
        self, robot: Robot, config: RobotConfig, settings: NaoqiServices, *, consent: bool = False
    ) -> None:
        self._robot = robot
        self._settings = settings
        self._actuators = Actuators(robot, config, round(settings.lead * 1000))
        self.lock = RLock()
        self.body = Body(config, settings)
        self.reflexes = Reflexes(self.body, consent=consent)
        self.idle = Idle(config, settings, self.body)
        self.base = Base(config, settings)
        stiffness = self._actuators.stiffness()  # of a robot that stayed awake while NAOqi was gone
        sensed, _ = self._actuators.read()
        self.joints = Joints(self.body, self.idle, settings, sensed, list(stiffness))
        self.awake = self.body.legs <= self.joints.stiff
        self.wheel_stiffness = float(self.awake)
        self.on_cycle: list[Callable[[], None]] = []
        self._stiffness_written = stiffness
        self._wheels_written = self.wheel_stiffness
        self._wheels_told: list[float] = []
        self._still = 0.0
        self._date = robot.time()
        self.closed = Event()
        self._thread = Thread(target=self._run, name="ALMotion", daemon=True)

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def close(self) -> None:
        """End the writer, and let go whoever waits for a motion."""
        self.closed.set()
        if self._thread.is_alive():
            self._thread.join()
        with self.lock:
            self.joints.kill(self.joints.tasks)
            self.base.stop(at_once=True)

    def cycle(self) -> None:
        """Work out and order what a cycle asks for. Only the writer's thread calls it, or a test.

        Raises:
            BackendError: The robot does not answer.
        """
        date = unwrapped(self._robot.time(), self._date)
        dt = min((date - self._date) / 1000, LONGEST_STEP)
        if dt <= 0:
            return
        self._date = date
        sensed, wheel_speeds = self._actuators.read()
        with self.lock:
            orders = self._step(sensed, wheel_speeds, dt)
        self._actuators.order_angles(date, orders.fresh, "ClearAll")
        self._actuators.order_angles(date, orders.angles)
        self._actuators.order_stiffnesses(date, orders.stiffnesses)
        if orders.wheel_stiffness is not None:
            self._actuators.order_wheel_stiffness(date, orders.wheel_stiffness)
        if orders.wheels is not None:
            self._actuators.order_wheels(date, orders.wheels)
        for told in self.on_cycle:
            told()

    def _step(self, sensed: list[float], wheel_speeds: list[float], dt: float) -> Orders:
        joints = self.joints
        joints.advance(sensed, dt)
        self._still = 0.0 if joints.moving else self._still + dt
        held = self.reflexes.joints if self.awake else frozenset()
        self.base.measure(np.array(wheel_speeds), dt)
        speeds = self.base.advance(dt).tolist()
        wheels_used = self.base.active or any(self._wheels_told)  # until they were told to stand
        if wheels_used or (self.awake and self.reflexes.wheels):
            self._wheels_told = wheels = speeds
        else:
            wheels = None
        changed = self.wheel_stiffness != self._wheels_written
        self._wheels_written = self.wheel_stiffness
        return Orders(
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
        """Those to be ordered: with smart stiffness all, in every cycle; else those that changed."""
        smart = self.awake and self.reflexes.smart_stiffness
        share = self._settings.smart_stiffness if smart and self._still > STILL else 1.0
        wanted = [share * stiffness for stiffness in self.joints.stiffness]
        written, self._stiffness_written = self._stiffness_written, wanted
        return {
            joint: value for joint, value in enumerate(wanted) if smart or value != written[joint]
        }

    def _run(self) -> None:
        due = time.monotonic()
        while not self.closed.is_set():
            try:
                self.cycle()
            except (
                BackendError
            ) as error:  # the robot is gone or was stopped: there is nothing to move
                logger.warning("ALMotion: %s", error)
                self.closed.wait(1.0)
            due = max(due + self._settings.cycle, time.monotonic())
            self.closed.wait(due - time.monotonic())
