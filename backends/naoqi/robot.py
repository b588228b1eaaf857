"""A robot that NAOqi moves: common parts of all its modes."""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np

from pepper_driver.backends.fields import Command, Measurement
from pepper_driver.backends.interface import (
    BackendError,
    BackendInfo,
    Capability,
    DeviceError,
    NotConnectedError,
    Serial,
    checked_command,
    serial,
)
from pepper_driver.backends.naoqi.address import Address, Secret, find_secret
from pepper_driver.backends.naoqi.connection import Connect, Connection, connect
from pepper_driver.backends.naoqi.ownership import TakeOver
from pepper_driver.backends.naoqi.preflight import Preflight, check_robot, diagnosis, preflight
from pepper_driver.backends.naoqi.presence import Presence
from pepper_driver.backends.naoqi.services import NaoqiRobotServices, abilities
from pepper_driver.backends.naoqi.stand_in import SERVICE, RemotePushMixin, simulated_parents
from pepper_driver.config import (
    NaoqiSettings,
    RobotConfig,
    load_safety_settings,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.clock import SYSTEM_CLOCK, Clock
from pepper_driver.config.naoqi import TakeOverSettings

logger = logging.getLogger("pepper_driver")


class NaoqiRobot(Serial, RemotePushMixin):
    """A Pepper over NAOqi. Subclasses say by which of its services it is moved.

    ``open`` reads only. ``activate`` switches off other sources of motion and raises the stiffness; ``deactivate``
    gives the robot back. Nothing continues by itself after a loss of connection: close, and open again.

    Args:
        address: Of the robot.
        robot: Its description.
        settings: How the driver gets on with NAOqi.
        policy: Other sources of motion to switch off meanwhile, by default as the settings say.
        wake: Whether a robot at rest is woken up, and sent to rest again.
        force: Activate also a robot that another program of this package drives.
        clock: Time of this computer.
        connect: Connects with the robot.
    """

    NEED_DCM: ClassVar[bool]
    real_time = True

    def __init__(
        self,
        address: Address,
        robot: RobotConfig,
        settings: NaoqiSettings,
        *,
        policy: TakeOverSettings | None = None,
        wake: bool = False,
        force: bool = False,
        clock: Clock = SYSTEM_CLOCK,
        connect: Connect = connect,
    ) -> None:
        super().__init__()
        self.clock, self._connect = clock, connect
        self._address, self._robot, self._settings, self._wake = address, robot, settings, wake
        self._safety = load_safety_settings()
        self._policy, self._force = policy or settings.take_over, force
        self._state: Literal["closed", "open", "active"] = "closed"
        self._secret: Secret | None = None
        self._connection: Connection | None = None
        self._lost = False
        self._info: BackendInfo | None = None
        self._presence: Presence | None = None
        self._take_over: TakeOver | None = None
        self._held: FloatArray | None = None

    # -- of each mode -------------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def _needed(self) -> Sequence[str]:
        """Keys of the robot's memory without which it is refused."""

    @abstractmethod
    def _described(self, found: Preflight) -> tuple[int, str]:
        """Delay of the answer to a command [steps], and identity: models of one mode do not fit another."""

    @abstractmethod
    def _begin(self, connection: Connection) -> Measurement:
        """Read for the first time."""

    @abstractmethod
    def _ramp_up(self) -> tuple[FloatArray, Measurement]:
        """Raise the stiffness while holding the posture, which comes back (17,) [rad] with what is measured then."""

    @abstractmethod
    def _read(self) -> Measurement:
        """Take the newest sample, without waiting."""

    @abstractmethod
    def _write(self, position: FloatArray, stiffness: FloatArray, wheel_speed: FloatArray) -> None:
        """Send, without waiting; nothing but between ``_ramp_up`` and ``_let_go``."""

    @abstractmethod
    def _let_go(self, posture: FloatArray) -> bool:
        """Stop and lower the stiffness; False where the robot does not answer.

        Args:
            posture: (17,) where ALMotion left the joints [rad], NaN where it did not say.
        """

    # -- life ---------------------------------------------------------------------------------------------------

    @property
    def uri(self) -> str:
        """The URI it was asked for, without a password."""
        return self._address.uri

    @property
    def info(self) -> BackendInfo:
        """The robot is asked who it is when this is first looked at.

        Raises:
            NotConnectedError: No robot at this address.
            BackendError: It is no Pepper, or not a complete one.
        """
        if self._info is None:
            self._meet()
        assert self._info is not None
        return self._info

    @serial
    def open(self) -> Measurement:
        """Connect to the robot and inspect it. Nothing moves."""
        if self._state != "closed":
            raise BackendError(f"'{self._address.uri}' is already open")
        connection = self._met()
        try:
            measurement = self._begin(connection)
        except BaseException:
            self._disconnect()
            raise
        self._state = "open"
        return measurement

    @serial
    def activate(self) -> Measurement:
        """Take the robot over and ramp the stiffness up, holding the posture measured.

        Raises:
            SecondDriverError: Another program of this package drives it.
            NotReadyError: It should not move now.
            NotConnectedError: Not open, or the connection was lost.
        """
        connection = self._connected()
        if self._state == "active":
            raise BackendError(f"'{self._address.uri}' is already active")
        self._presence = Presence(connection, force=self._force, clock=self.clock)
        # Before anything is switched off: a second driver must not change what the first relies on.
        self._presence.begin()
        try:
            check_robot(connection, self._robot, self._settings, self._safety, may_sleep=self._wake)
            self._take_over = TakeOver(
                connection,
                self._robot,
                self._settings,
                self._policy,
                wake=self._wake,
                clock=self.clock,
            )
            # After the checks: a robot that is refused is left as it was.
            self._take_over.begin()
        except BaseException:
            self._presence.end()
            raise
        # Before the ramp: deactivate() lowers the stiffness again in this state only.
        self._state = "active"
        try:
            self._held, measurement = self._ramp_up()
            return measurement
        except BaseException:
            self.deactivate()
            raise

    @property
    def hold_position(self) -> FloatArray | None:
        """(17,) where ``activate`` holds the joints [rad]: waking up may have moved them."""
        return self._held

    @serial
    def read(self) -> Measurement:
        """Return the newest sample, at once.

        Raises:
            NotConnectedError: Not open, or the connection was lost.
        """
        self._check_connection()
        return self._read()

    @serial
    def write(self, command: Command) -> None:
        """Send what may be sent, at once.

        Raises:
            NotConnectedError: Not open, or the connection was lost.
        """
        self._check_connection()
        position, stiffness, wheel_speed = checked_command(command, len(self._robot.joint_names))
        stiffness = np.minimum(np.maximum(stiffness, 0.0), 1.0)
        # A copy: the caller may change its array, and the history of commands keeps this one.
        self._write(position.copy(), stiffness, wheel_speed)

    @serial
    def deactivate(self) -> None:
        """Stop, release the joints, give the robot back. A robot that does not answer is left as it is."""
        if self._state != "active":
            return
        self._state = "open"
        connection, take_over, presence = self._connection, self._take_over, self._presence
        assert connection is not None
        assert take_over is not None
        assert presence is not None
        try:
            if not self._lost and not self._let_go(take_over.posture):
                logger.warning(
                    "'%s' does not answer, and is left as it is: its wheels stop by themselves, its joints stay stiff",
                    self._address.uri,
                )
                connection.close()
                self._lost = True
        finally:
            # Also after an error: without this the robot's own protections would stay off.
            take_over.restore()
            # Last: no other driver may begin before everything is restored.
            presence.end()

    @serial
    def close(self) -> None:
        """Deactivate and disconnect."""
        try:
            self.deactivate()
        finally:
            self._state = "closed"
            self._disconnect()

    # -- beyond motion ------------------------------------------------------------------------------------------

    @cached_property
    def services(self) -> NaoqiRobotServices:
        """Speech, lights, tablet, postures, waking up and resting, as far as this robot has them."""
        return NaoqiRobotServices(
            self._address.uri, self._connected, lambda: self._state == "active", self._settings
        )

    def diagnosis(self) -> tuple[DeviceError, ...] | None:
        """Return the parts that the robot's own diagnosis finds broken."""
        return diagnosis(self._connected(), self._robot)

    # -- inside -------------------------------------------------------------------------------------------------

    def _meet(self) -> None:
        """Connect, and see who that is."""
        self._disconnect()
        if self._secret is None:
            # Kept: a connection that is opened again must not ask in the terminal again.
            self._secret = find_secret(self._address)
        self._lost = False
        # `_lost` is cleared before: from here on a thread of the library may set it.
        self._connection = self._connect(self._address, self._secret, self._on_lost, self._settings)
        try:
            found = preflight(self._connection, self._robot, self._needed, need_dcm=self.NEED_DCM)
            services = self._connection.service_names
            simulated = SERVICE in services
            parents = simulated_parents(self._connection) if simulated else ()
        except BaseException:
            self._disconnect()
            raise
        capabilities: set[Capability] = set(abilities(services))
        if simulated:
            capabilities |= {"push", "grab"}
        delay, identity = self._described(found)
        # Models of one mode do not fit another, so parents get the suffix too.
        mode = identity.removeprefix(found.body_id)
        self._info = BackendInfo(
            joint_names=self._robot.joint_names,
            cycle=self._robot.cycle,
            response_delay=delay,
            capabilities=frozenset(capabilities),
            identity=identity,
            name=self.uri,
            parents=tuple(replace(parent, identity=parent.identity + mode) for parent in parents),
            robot_type=found.kind,
            system_version=found.version,
        )

    def _met(self) -> Connection:
        if self._connection is None or not self._connection.connected:
            self._meet()
        assert self._connection is not None
        return self._connection

    def _on_lost(self) -> None:
        self._lost = True

    def _disconnect(self) -> None:
        if self._connection is not None:
            self._connection.close()
        self._connection = None

    def _check_connection(self) -> None:
        """Raise where the connection is known to be lost, without a call: the library takes its time for one."""
        if self._state == "closed" or self._lost:
            self._connected()

    def _connected(self) -> Connection:
        """Return the connection of an open robot."""
        if self._state == "closed" or self._connection is None:
            raise NotConnectedError(f"'{self._address.uri}' is not open")
        if self._lost or not self._connection.connected:
            raise NotConnectedError(
                f"'{self._address.uri}': the connection was lost; the robot stops its wheels by itself and holds its "
                "joints: check it and the network, then start again"
            )
        return self._connection
