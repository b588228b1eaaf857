"""A Pepper whose DCM cannot be reached, as with NAOqi 2.9: joints through ALMotion, some forty times a second.

What that costs: ALMotion smooths what it is told and follows late, by a time that varies, so that no touch can be felt
in the encoders; the stiffness of the legs does not change; the base stands still, since ALMotion drives on when nobody
tells it to stop. In return its own protections stay on. NAOqi 2.5 and 2.8 pages "Joint control API", "Locomotion
control API" and "Stiffness control".
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from pepper_driver.backends.interface import BackendError, Measurement
from pepper_driver.backends.naoqi.address import Address
from pepper_driver.backends.naoqi.angles_link import AnglesLink
from pepper_driver.backends.naoqi.base import NaoqiRobot
from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.backends.naoqi.keys import SensorKeys
from pepper_driver.backends.naoqi.preflight import Preflight
from pepper_driver.backends.signals import check_signals
from pepper_driver.config import NaoqiSettings, RobotConfig
from pepper_driver.config.arrays import FloatArray

logger = logging.getLogger("pepper_driver")

STALE = 0.1
"""[s] age of samples at which the stiffness is not raised any further, as the safety gate has it."""

PATIENCE = 0.3
"""[s] age of samples at which the end waits for the robot no longer."""

FRESH, LAST = 6, 40
"""Ticks in which a new sample comes, and in which the last change of stiffness is taken."""


class AnglesBackend(NaoqiRobot):
    """Joints of a Pepper through ALMotion. Chosen by ``?mode=angles``, never by itself.

    A loop reads and writes every 12 ms; every second time a command goes out. When the connection is lost, the
    joints stay where they are.

    Args:
        address: Of the robot.
        robot: Its description.
        settings: How the driver gets on with NAOqi.
        wake: Whether a robot at rest is woken up.
        force: Activate also a robot that another program of this package drives.
    """

    NEED_DCM = False

    def __init__(
        self,
        address: Address,
        robot: RobotConfig,
        settings: NaoqiSettings,
        *,
        wake: bool = False,
        force: bool = False,
    ) -> None:
        policy = replace(
            settings.take_over,
            diagnosis_effect="keep",
            self_collision="keep",
            arm_obstacles="keep",
            base_obstacles="keep",
            fall_manager="keep",
            push_recovery="keep",
        )
        super().__init__(address, robot, settings, policy=policy, wake=wake, force=force)
        self._link: AnglesLink | None = None
        self._moving = self._told = False

    @property
    def _needed(self) -> Sequence[str]:
        return ()

    def _described(self, found: Preflight) -> tuple[int, str]:
        return self._settings.angles.response_delay, f"{found.body_id}/angles"

    def _begin(self, connection: Connection) -> Measurement:
        keys = SensorKeys(self._robot, complete=False)
        self._link = AnglesLink(connection, self._robot, keys, self._settings.angles)
        return self._link.newest

    def _ramp_up(self) -> tuple[FloatArray, Measurement]:
        """No joint gets less stiffness than it has already."""
        link, connection = self._open_link, self._connected()
        logger.warning(
            "'%s' moves through ALMotion: some 40 commands a second, followed late; touch is not felt, the base stands "
            "still",
            self._address.uri,
        )
        before = np.ones(len(self._robot.joint_names))
        before[link.places] = connection.call("ALMotion", "getStiffnesses", link.soft)
        for _ in self._beats(FRESH):  # taking over may have lasted, and moved the robot
            measurement = link.exchange(None, None)
        hold = np.clip(measurement.position, self._robot.lower, self._robot.upper)
        link.start(before)
        ticks = round(self._settings.timing.ramp_up / self._robot.cycle)
        for tick in self._beats(ticks):
            self._connected()
            check_signals()
            measurement = link.exchange(hold, np.maximum(before, (tick + 1) / ticks))
            if not measurement.age <= STALE:
                raise BackendError(
                    f"'{self._address.uri}' stopped answering while its stiffness was raised: the newest sample is "
                    f"{1e3 * measurement.age:.0f} ms old; look at the network, then start again"
                )
        self._moving, self._told = True, False
        return hold, measurement

    def _read(self) -> Measurement:
        return self._open_link.read()

    def _write(self, position: FloatArray, stiffness: FloatArray, wheel_speed: FloatArray) -> None:
        if not self._moving:
            return
        if wheel_speed.any() and not self._told:
            self._told = True
            logger.warning("'%s' keeps its base still in this mode", self._address.uri)
        self._open_link.write(position, stiffness)

    def _let_go(self, posture: FloatArray) -> bool:
        """ALMotion knows where all joints are, so nothing has to go back; the legs keep their stiffness.

        No joint gets back what somebody else took away.
        """
        link, self._moving = self._open_link, False
        told, ones = link.newest.stiffness, np.ones(len(posture))
        had = ones if told is None else np.fmin(told, ones)  # 1 where nobody knows
        ticks = round(self._settings.timing.ramp_down / self._robot.cycle)
        for tick in self._beats(ticks + LAST):
            measurement = link.exchange(None, had * max(0.0, 1.0 - (tick + 1) / ticks))
            if self._lost or measurement.age > PATIENCE:
                return False
            if tick >= ticks and link.idle:
                return True
        return False

    def _beats(self, ticks: int) -> Iterator[int]:
        """Ticks a cycle apart, by number."""
        due = time.monotonic()
        for tick in range(ticks):
            yield tick
            due = max(due + self._robot.cycle, time.monotonic())
            time.sleep(due - time.monotonic() if due > time.monotonic() else 0.0)

    @property
    def _open_link(self) -> AnglesLink:
        assert self._link is not None
        return self._link
