"""A Pepper whose DCM cannot be reached, as with NAOqi 2.9: joints through ALMotion, some forty times a second.

What that costs: ALMotion smooths what it is told and follows late, by a time that varies, so that no touch can be felt
in the encoders; a stiffness changes at once, without a ramp, and that of the legs not at all; the base stands still,
since ALMotion drives on when nobody tells it to stop. In return its own protections stay on. NAOqi 2.5 and 2.8 pages
"Joint control API", "Locomotion control API" and "Stiffness control".
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pepper_driver.backends.interface import Measurement
from pepper_driver.backends.naoqi.address import Address
from pepper_driver.backends.naoqi.angles_link import AnglesLink
from pepper_driver.backends.naoqi.base import NaoqiRobot
from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.backends.naoqi.keys import SensorKeys
from pepper_driver.backends.naoqi.preflight import Preflight
from pepper_driver.config import NaoqiSettings, PepperError, RobotConfig
from pepper_driver.config.parts import FloatArray

logger = logging.getLogger("pepper_driver")

PATIENCE = 0.3
"""[s] beyond the time that a ramp takes after which the end waits for the robot no longer."""


class AnglesBackend(NaoqiRobot):
    """Joints of a Pepper through ALMotion. Chosen by ``?mode=angles``, never by itself.

    A loop calls ``step`` every 12 ms as ever; every second time a command goes out. When the connection is lost, the
    joints stay where they are.

    Args:
        address: Of the robot.
        robot: Its description.
        settings: How the driver gets on with NAOqi.
        wake: Whether a robot at rest is woken up.
    """

    NEED_DCM = False

    def __init__(
        self, address: Address, robot: RobotConfig, settings: NaoqiSettings, *, wake: bool = False
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
        super().__init__(address, robot, settings, policy=policy, wake=wake)
        self._link: AnglesLink | None = None
        self._moving = self._told = False

    @property
    def _needed(self) -> Sequence[str]:
        return ()

    def _described(self, found: Preflight) -> tuple[int, str]:
        return self._settings.angles.response_delay, f"{found.body_id}/angles"

    def _begin(self, connection: Connection) -> Measurement:
        self._link = self._new_link(connection)
        return self._link.newest

    def _new_link(self, connection: Connection) -> AnglesLink:
        keys = SensorKeys(self._robot, complete=False)
        return AnglesLink(connection, self._robot, keys, self._settings.angles)

    def _ramp_up(self) -> tuple[FloatArray, Measurement]:
        logger.warning(
            "'%s' moves through ALMotion: some 40 commands a second, followed late; touch is not felt, the base stands "
            "still, stiffness is not ramped",
            self._address.uri,
        )
        connection = self._connected()
        link = self._new_link(connection)  # taking over may have lasted, and moved the robot
        hold = np.clip(link.newest.position, self._robot.lower, self._robot.upper)
        names, speed = list(self._robot.joint_names), self._settings.angles.speed
        connection.call("ALMotion", "setAngles", names, hold.tolist(), speed)
        self._ramp(connection, link, 1.0, self._settings.timing.ramp_up, connection.call_time)
        self._link = link = self._new_link(connection)
        link.start()
        self._moving, self._told = True, False
        return hold, link.newest

    def _tick(
        self, position: FloatArray, stiffness: FloatArray, wheel_speed: FloatArray
    ) -> Measurement:
        assert self._link is not None
        if self._moving and wheel_speed.any() and not self._told:
            self._told = True
            logger.warning("'%s' keeps its base still in this mode", self._address.uri)
        return self._link.tick(position if self._moving else None, stiffness)

    def _let_go(self, posture: FloatArray) -> bool:
        """ALMotion knows where all joints are, so nothing has to go back; the legs keep their stiffness."""
        assert self._link is not None
        self._moving = False
        try:
            self._ramp(
                self._connected(), self._link, 0.0, self._settings.timing.ramp_down, PATIENCE
            )
        except PepperError as error:
            logger.warning("%s", error)
            return False
        return True

    @staticmethod
    def _ramp(
        connection: Connection, link: AnglesLink, goal: float, duration: float, patience: float
    ) -> None:
        """Of the stiffness of arms and head, by ALMotion itself."""
        goals, times = [[goal]] * len(link.soft), [[duration]] * len(link.soft)
        connection.call(
            "ALMotion",
            "stiffnessInterpolation",
            link.soft,
            goals,
            times,
            timeout=duration + patience,
        )
