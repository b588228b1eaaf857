"""Joints through ALMotion as the tick uses them: take what has come, ask, tell, and never wait."""

from __future__ import annotations

import time

import numpy as np

from pepper_driver.backends.interface import BackendError, Measurement
from pepper_driver.backends.naoqi.call import Call
from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.backends.naoqi.keys import VALUES, SensorKeys, Values
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.naoqi import AnglesSettings

SENSORS = 5
"""Questions for the angles to one for the stiffness and for all other sensors, which some robots refresh twice a
second."""

STIFFNESS_STEP = 0.02
"""Smallest change of a stiffness that is passed on."""


class AnglesLink:
    """With ALMotion and the memory of one robot.

    Args:
        connection: Open.
        robot: Its description.
        keys: Of all sensors, any of which may be missing.
        settings: How often, and how fast.

    Attributes:
        newest: What was measured last.
        soft: Joints whose stiffness can be changed: ALMotion lets nobody change that of a Pepper's legs.
        places: Of these in a joint vector.

    Raises:
        BackendError: The robot does not say where its joints are.
    """

    def __init__(
        self, connection: Connection, robot: RobotConfig, keys: SensorKeys, settings: AnglesSettings
    ) -> None:
        self._settings, self._cycle, self._keys = settings, robot.cycle, keys
        self._joints = list(robot.joint_names)
        self.soft = [name for name in self._joints if name not in robot.chains["legs"]]
        self.places = [robot.joint_index(name) for name in self.soft]
        motion, memory = connection.service("ALMotion"), connection.service("ALMemory")
        uri = connection.address.uri
        self._angles = Call(motion, "getAngles", uri)
        self._sensors = Call(memory, "getListData", uri)
        self._order = Call(motion, "setAngles", uri)
        self._stiffness_order = Call(motion, "setStiffnesses", uri)
        self._stiffnesses = Call(motion, "getStiffnesses", uri)
        self._unknown = self._found = np.full(len(self._joints), np.nan)
        self._told_meanwhile = False
        position = self._position_of(connection.call("ALMotion", "getAngles", self._joints, True))
        values = keys.values(connection.call("ALMemory", "getListData", keys.names))
        if position is None or isinstance(values, str):
            raise BackendError(f"'{uri}': the robot does not say where its joints are")
        self._position: FloatArray = position
        self._values: Values = values
        self._opened = self._asked = self._sampled = time.monotonic()
        self._step = self._tick = self._withheld = 0
        self._stiffness = np.zeros(len(self.soft))
        self.newest = self._measurement()

    def start(self, stiffness: FloatArray) -> None:
        """From now on commands are counted, and changes from a stiffness (17,) are passed on."""
        self._withheld = 0
        self._stiffness = stiffness[self.places]

    @property
    def idle(self) -> bool:
        """Whether the robot has taken the last stiffness it was told."""
        return self._stiffness_order.over

    def read(self) -> Measurement:
        """Return the newest sample, and ask for the next one where that is due."""
        self._step += 1
        self._count()
        self._take()
        if self._step % self._settings.every == 0:
            self._ask()
        self.newest = self._measurement()
        return self.newest

    def write(self, position: FloatArray | None, stiffness: FloatArray | None) -> None:
        """Tell the robot where that is due; what is None is not told."""
        if self._step % self._settings.every == 1:
            if position is not None and not self._order.begin(
                self._joints, position.tolist(), self._settings.speed
            ):
                self._withheld += 1
            if stiffness is not None:
                self._tell(stiffness[self.places])

    def exchange(self, position: FloatArray | None, stiffness: FloatArray | None) -> Measurement:
        """Write, then read: for the begin and the end of a run, which follow no sample."""
        self.write(position, stiffness)
        return self.read()

    def _count(self) -> None:
        """Ticks go on by one each, but neither run ahead of the time nor stay behind it."""
        passed = (time.monotonic() - self._opened) / self._cycle
        if self._tick < passed - 2:
            self._tick = int(passed)
        elif self._tick < passed:
            self._tick += 1

    def _take(self) -> None:
        position = self._position_of(self._angles.answer())
        if position is not None:
            self._position, self._sampled = position, self._asked
        answer = self._sensors.answer()
        if answer is not None and not isinstance(values := self._keys.values(answer), str):
            self._values = values
        stiffnesses = self._stiffnesses.answer()
        if stiffnesses is not None and not self._told_meanwhile:
            self._found = self._stiffness_of(stiffnesses)

    def _ask(self) -> None:
        if self._angles.begin(self._joints, True):
            self._asked = time.monotonic()
        if self._step % (SENSORS * self._settings.every) == 0:
            self._sensors.begin(self._keys.names)
            if self._stiffness_order.over and self._stiffnesses.begin(self.soft):
                self._told_meanwhile = False

    def _tell(self, stiffness: FloatArray) -> None:
        way = np.abs(stiffness - self._stiffness)
        arrives = (way > 0) & ((stiffness == 0) | (stiffness == 1))  # however near it is
        if (way.max() >= STIFFNESS_STEP or arrives.any()) and self._stiffness_order.begin(
            self.soft, stiffness.tolist()
        ):
            self._stiffness = stiffness
            # What is on its way to the robot, it may have or not.
            self._found, self._told_meanwhile = self._unknown, True

    def _stiffness_of(self, answer: object) -> FloatArray:
        """(17,) what ALMotion says of the soft joints; NaN for the legs, and where it says nothing sensible."""
        found = self._unknown.copy()
        try:
            found[self.places] = np.array(answer, dtype=np.float64)
        except (TypeError, ValueError):
            return self._unknown
        return found

    def _position_of(self, answer: object) -> FloatArray | None:
        """(17,) angles [rad]; None where there is no answer, or no good one."""
        if answer is None:
            return None
        try:
            position = np.array(answer, dtype=np.float64)
        except (TypeError, ValueError):
            return None
        if position.shape != (len(self._joints),) or not np.isfinite(position).all():
            return None
        return position

    def _measurement(self) -> Measurement:
        usual = (self._settings.every + 1) * self._cycle
        values = {name: getattr(self._values, name) for name in VALUES} | {
            "position": self._position,
            "stiffness": self._found,
        }
        return Measurement(
            time=self._tick * self._cycle,
            tick=self._tick,
            age=max(0.0, time.monotonic() - self._sampled - usual),
            withheld=self._withheld,
            **values,
        )
