"""A real Pepper, or a stand-in, over NAOqi: every 12 ms through the device manager (DCM)."""

from __future__ import annotations

import logging
from typing import Literal

import numpy as np

from pepper_driver.backends.commands import checked_command
from pepper_driver.backends.interface import (
    Backend,
    BackendError,
    BackendInfo,
    Capability,
    CapabilityError,
    Command,
    DeviceError,
    Measurement,
    NotConnectedError,
    SimulatedPlant,
)
from pepper_driver.backends.naoqi import stand_in
from pepper_driver.backends.naoqi.address import Address, naoqi_address
from pepper_driver.backends.naoqi.coexistence import TakeOver
from pepper_driver.backends.naoqi.connection import Connection, connect
from pepper_driver.backends.naoqi.diagnosis import diagnosis
from pepper_driver.backends.naoqi.fitness import check_fit
from pepper_driver.backends.naoqi.handover import let_go, ramp_up
from pepper_driver.backends.naoqi.keys import SensorKeys, actuator_keys
from pepper_driver.backends.naoqi.link import Link
from pepper_driver.backends.naoqi.preflight import preflight
from pepper_driver.backends.naoqi.secret import Secret, find_secret
from pepper_driver.backends.selection import BackendUri
from pepper_driver.config import ConfigError, NaoqiSettings, RobotConfig, load_naoqi_settings
from pepper_driver.config.parts import FloatArray

logger = logging.getLogger("pepper_driver")


class NaoqiBackend(Backend):
    """Joints, wheels and sensors of a Pepper, through DCM and ALMemory.

    ``open`` reads only. ``activate`` stills whoever else moves the robot and raises the stiffness; ``deactivate`` stops
    the wheels, leads the legs back to where ALMotion left them, lowers the stiffness of all other joints, and gives the
    robot back. When the connection is lost, the wheels stop by themselves and the joints stay where they are; nothing
    goes on by itself: close, and open again.

    Args:
        address: Of the robot.
        robot: Its description.
        settings: How the driver gets on with NAOqi.
        delay: Cycles from the date of a command to the sample that shows it; by default that of the settings.
        wake: Whether a robot at rest is woken up.
    """

    def __init__(
        self,
        address: Address,
        robot: RobotConfig,
        settings: NaoqiSettings,
        *,
        delay: int | None = None,
        wake: bool = False,
    ) -> None:
        self._address, self._robot, self._settings, self._wake = address, robot, settings, wake
        self._delay = settings.timing.response_delay if delay is None else delay
        self._state: Literal["closed", "open", "active"] = "closed"
        self._secret: Secret | None = None
        self._connection: Connection | None = None
        self._lost = False
        self._info: BackendInfo | None = None
        self._plant: SimulatedPlant | None = None
        self._link: Link | None = None
        self._take_over: TakeOver | None = None

    # -- life ---------------------------------------------------------------------------------------------------

    @property
    def info(self) -> BackendInfo:
        """The robot is asked who it is when this is first looked at.

        Raises:
            NotConnectedError: Nobody there.
            BackendError: It is no Pepper, or has no DCM.
        """
        if self._info is None:
            self._meet()
        assert self._info is not None
        return self._info

    def open(self) -> Measurement:
        """Connect, look at the robot, measure the way to it for half a second. Nothing moves."""
        if self._state != "closed":
            raise BackendError(f"'{self._address.uri}' is already open")
        if self._connection is None or not self._connection.connected:
            self._meet()
        assert self._connection is not None
        try:
            self._link = Link(self._connection, self._robot, self._settings.timing, self._delay)
        except BaseException:
            self._disconnect()
            raise
        self._state = "open"
        return self._link.newest

    def activate(self) -> Measurement:
        """Take the robot over and ramp the stiffness up, holding the posture measured.

        No joint gets less stiffness than it has already.
        """
        if self._state != "open":
            raise BackendError(f"'{self._address.uri}' cannot be activated: it is {self._state}")
        link, connection = self._connected()
        check_fit(connection, self._robot, self._settings, may_sleep=self._wake)
        self._take_over = TakeOver(connection, self._robot, self._settings, wake=self._wake)
        self._take_over.begin()
        self._state = "active"
        try:
            return ramp_up(link, self._robot, self._settings, self._connected)
        except BaseException:
            self.deactivate()
            raise

    def step(self, command: Command) -> Measurement:
        """Send what may be sent and return the newest sample, at once.

        Raises:
            NotConnectedError: Not open, or the connection was lost.
        """
        link = self._link
        if (
            link is None or self._lost
        ):  # no call: the library takes its time, even for whether it is connected
            link, _ = self._connected()
        position, stiffness, wheel_speed = checked_command(command, len(self._robot.joint_names))
        stiffness = np.minimum(np.maximum(stiffness, 0.0), 1.0)
        return link.tick(position.copy(), stiffness, wheel_speed)

    def deactivate(self) -> None:
        """Stop the wheels, let the joints go, give the robot back. A robot that does not answer is left as it is."""
        if self._state != "active":
            return
        self._state = "open"
        link, connection, take_over = self._link, self._connection, self._take_over
        assert link is not None
        assert connection is not None
        assert take_over is not None
        try:
            if not self._lost and not let_go(link, self._robot, self._settings, take_over.posture):
                logger.warning(
                    "'%s' does not answer, and is left as it is: its wheels stop by themselves, its joints stay stiff",
                    self._address.uri,
                )
                connection.close()
        finally:
            link.end()
            take_over.restore()

    def close(self) -> None:
        """Deactivate and disconnect."""
        try:
            self.deactivate()
        finally:
            self._state = "closed"
            self._disconnect()

    def off_beat(self, due: int) -> float:
        """How much later than ``due`` [ns] a tick would best begin [s]: well after the robot's cycle."""
        return 0.0 if self._link is None else self._link.off_beat(due)

    # -- beyond motion ------------------------------------------------------------------------------------------

    def diagnosis(self) -> tuple[DeviceError, ...] | None:
        """What the robot's own diagnosis finds broken now."""
        _, connection = self._connected()
        return diagnosis(connection, self._robot)

    def push(
        self,
        link: str,
        force: FloatArray,
        point: FloatArray | None = None,
        duration: float = 0.5,
        *,
        frame: Literal["world", "link"] = "world",
        delay: float = 0.0,
        rise: float = 0.1,
    ) -> None:
        """Push a link of a stand-in; see :meth:`Backend.push`."""
        self._handle(
            "push",
            link,
            force=force,
            point=point,
            duration=duration,
            frame=frame,
            delay=delay,
            rise=rise,
        )

    def grab(
        self,
        link: str,
        pull: FloatArray,
        point: FloatArray | None = None,
        *,
        stiffness: float = 1000.0,
        rise: float = 0.5,
        hold: float = 1.0,
        release: float = 0.1,
        largest_force: float = 100.0,
        frame: Literal["world", "link"] = "world",
        delay: float = 0.0,
    ) -> None:
        """Take a link of a stand-in in a springy hand; see :meth:`Backend.grab`."""
        self._handle(
            "grab",
            link,
            pull=pull,
            point=point,
            stiffness=stiffness,
            rise=rise,
            hold=hold,
            release=release,
            largest_force=largest_force,
            frame=frame,
            delay=delay,
        )

    @property
    def plant(self) -> SimulatedPlant:
        """What a stand-in simulates."""
        if "push" not in self.info.capabilities:
            return super().plant
        if self._plant is None:
            assert self._connection is not None
            self._plant = stand_in.simulated_plant(self._connection, self._robot)
        return self._plant

    def _handle(self, method: Literal["push", "grab"], link: str, **arguments: object) -> None:
        _, connection = self._connected()
        if method not in self.info.capabilities:
            raise CapabilityError(
                f"'{self._address.uri}' cannot {method} itself: only simulated robots can"
            )
        stand_in.handle(connection, self._robot, method, link, **arguments)

    # -- inside -------------------------------------------------------------------------------------------------

    def _meet(self) -> None:
        """Connect, and see who that is."""
        self._disconnect()
        if self._secret is None:
            self._secret = find_secret(self._address)
        self._lost = False
        self._connection = connect(self._address, self._secret, self._on_lost, self._settings)
        try:
            keys = [key for keys in actuator_keys(self._robot).values() for key in keys]
            found = preflight(
                self._connection, self._robot, [*SensorKeys(self._robot).needed, *keys]
            )
            touchable = stand_in.SERVICE in self._connection.service_names
        except BaseException:
            self._disconnect()
            raise
        capabilities: frozenset[Capability] = frozenset({"push", "grab"} if touchable else ())
        self._info = BackendInfo(
            uri=self._address.uri,
            joint_names=self._robot.joint_names,
            cycle=self._robot.cycle,
            real_time=True,
            response_delay=self._delay,
            capabilities=capabilities,
            identity=found.body_id,
        )

    def _on_lost(self) -> None:
        self._lost = True

    def _disconnect(self) -> None:
        if self._connection is not None:
            self._connection.close()
        self._connection = self._link = None

    def _connected(self) -> tuple[Link, Connection]:
        if self._state == "closed" or self._link is None or self._connection is None:
            raise NotConnectedError(f"'{self._address.uri}' is not open")
        if self._lost or not self._connection.connected:
            raise NotConnectedError(
                f"'{self._address.uri}': the connection was lost; the robot stops its wheels by itself and holds its "
                "joints: look after it and the network, then start again"
            )
        return self._link, self._connection


def from_uri(uri: BackendUri, robot: RobotConfig) -> NaoqiBackend:
    """``naoqi://host[:9559]?delay=N&wake=1``, ``naoqis://user@host[:9503]?...``; all keys optional."""
    address = naoqi_address(uri, {"delay", "wake"})
    if uri.query.get("wake", "0") not in ("0", "1"):
        raise ConfigError(f"backend '{uri.text}': wake takes 0 or 1")
    settings = load_naoqi_settings()
    delay = uri.integer("delay", settings.timing.response_delay)
    return NaoqiBackend(address, robot, settings, delay=delay, wake=uri.integer("wake", 0) == 1)
