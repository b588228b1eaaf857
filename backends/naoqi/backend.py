"""A Pepper over NAOqi as a backend."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pepper_driver.backends.fields import Measurement
from pepper_driver.backends.naoqi.address import Address, naoqi_address
from pepper_driver.backends.naoqi.angles import AnglesBackend
from pepper_driver.backends.naoqi.connection import Connect, Connection, connect
from pepper_driver.backends.naoqi.dcm_channel import DcmChannel
from pepper_driver.backends.naoqi.handover import ramp_up, release_robot
from pepper_driver.backends.naoqi.memory_keys import SensorKeys, actuator_keys
from pepper_driver.backends.naoqi.preflight import Preflight
from pepper_driver.backends.naoqi.qi_library import prefer_messages, preferred
from pepper_driver.backends.naoqi.robot import NaoqiRobot
from pepper_driver.backends.selection import BackendUri
from pepper_driver.config import (
    ConfigError,
    NaoqiSettings,
    RobotConfig,
    load_naoqi_settings,
    suggestion,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.clock import SYSTEM_CLOCK, Clock

MODES = ("dcm", "angles")
SWITCHES = ("wake", "force")


class NaoqiBackend(NaoqiRobot):
    """Joints, wheels and sensors of a Pepper, through DCM and ALMemory.

    ``deactivate`` stops the wheels, leads the legs back to where ALMotion left them, and lowers the stiffness of all
    other joints. When the connection is lost, the wheels stop by themselves and the joints stay where they are.

    Args:
        address: Of the robot.
        robot: Its description.
        settings: How the driver gets on with NAOqi.
        delay: Cycles from the date of a command to the sample that shows it; by default that of the settings.
        wake: Whether a robot at rest is woken up.
        force: Activate also a robot that another program of this package drives.
        clock: Time of this computer.
        connect: Connects with the robot.
    """

    NEED_DCM = True

    def __init__(
        self,
        address: Address,
        robot: RobotConfig,
        settings: NaoqiSettings,
        *,
        delay: int | None = None,
        wake: bool = False,
        force: bool = False,
        clock: Clock = SYSTEM_CLOCK,
        connect: Connect = connect,
    ) -> None:
        super().__init__(
            address, robot, settings, wake=wake, force=force, clock=clock, connect=connect
        )
        self._delay = settings.timing.response_delay if delay is None else delay
        self._link: DcmChannel | None = None

    @property
    def _needed(self) -> Sequence[str]:
        commanded = [key for keys in actuator_keys(self._robot).values() for key in keys]
        # The stiffness commands are in both lists.
        return list(dict.fromkeys([*SensorKeys(self._robot).needed, *commanded]))

    def _described(self, found: Preflight) -> tuple[int, str]:
        return self._delay, found.body_id

    def _begin(self, connection: Connection) -> Measurement:
        """Measure the connection to the robot for almost a second."""
        # Before the measurement, which must be of the round trips that ticks will have.
        prefer_messages(True)
        with preferred():
            self._link = DcmChannel(
                connection, self._robot, self._settings, self._delay, clock=self.clock
            )
        return self._link.newest

    def _ramp_up(self) -> tuple[FloatArray, Measurement]:
        """No joint gets less stiffness than it has already."""
        return ramp_up(self._open_link, self._robot, self._settings, self._safety, self._connected)

    def _read(self) -> Measurement:
        return self._open_link.read()

    def _write(self, position: FloatArray, stiffness: FloatArray, wheel_speed: FloatArray) -> None:
        self._open_link.write(position, stiffness, wheel_speed)

    def _let_go(self, posture: FloatArray) -> bool:
        try:
            return release_robot(
                self._open_link, self._robot, self._settings, self._safety, posture
            )
        finally:
            self._open_link.end()

    def phase_error(self, due: int) -> float:
        """Return how much later than ``due`` [ns] a tick best begins [s]: well after the robot's cycle."""
        link = self._link  # another thread may close
        return 0.0 if link is None else link.phase_error(due)

    @property
    def request_lead(self) -> float:
        """Round trip of a sample, 99th percentile of a burst at ``open``, and a margin [s]; 0 on a slow connection."""
        link = self._link
        return 0.0 if link is None else link.request_lead

    def request(self) -> None:
        """Ask for the sample of the tick that begins ``request_lead`` later; not where another thread is at work."""
        if self._lock.acquire(blocking=False):  # a start or an end takes seconds
            try:
                if self._link is not None and not self._lost:
                    self._link.request()
            finally:
                self._lock.release()

    def close(self) -> None:
        """Deactivate and disconnect."""
        try:
            super().close()
        finally:
            self._link = None
            prefer_messages(False)

    @property
    def _open_link(self) -> DcmChannel:
        assert self._link is not None
        return self._link


def from_uri(uri: BackendUri, robot: RobotConfig) -> NaoqiRobot:
    """``naoqi://host[:9559]?mode=dcm|angles&wake=1&force=1&delay=N&settings=FILE``, ``naoqis://user@host[:9503]?...``.

    All keys are optional; ``settings`` is a file in the form of ``naoqi_settings.yaml``.
    """
    mode = uri.query.get("mode", MODES[0])
    if mode not in MODES:
        raise ConfigError(f"backend '{uri.text}': unknown mode '{mode}'{suggestion(mode, MODES)}")
    known = {"mode", "settings", *SWITCHES} | ({"delay"} if mode == "dcm" else set())
    address = naoqi_address(uri, known)
    for key in SWITCHES:
        if uri.query.get(key, "0") not in ("0", "1"):
            raise ConfigError(f"backend '{uri.text}': {key} takes 0 or 1")
    wake, force = (uri.integer(key, 0) == 1 for key in SWITCHES)
    file = uri.query.get("settings")
    settings = load_naoqi_settings(None if file is None else Path(file))
    if mode == "angles":
        return AnglesBackend(address, robot, settings, wake=wake, force=force)
    delay = uri.integer("delay", settings.timing.response_delay)
    return NaoqiBackend(address, robot, settings, delay=delay, wake=wake, force=force)
