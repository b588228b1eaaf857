"""``?mode=angles``: joints by ALMotion, for NAOqi 2.9.

Limits of this mode: ALMotion smooths commands and follows late, by a time that varies, so that no touch is detected
in the encoders; the stiffness of the legs does not change; the base stands still, since ALMotion drives on until a
program stops it. In return its own protections stay on. NAOqi 2.5 and 2.8 pages "Joint control API", "Locomotion
control API" and "Stiffness control".
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pepper_driver.backends.fields import Measurement
from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi.address import Address
from pepper_driver.backends.naoqi.connection import Call, Connect, Connection, connect
from pepper_driver.backends.naoqi.handover import cycle_timer
from pepper_driver.backends.naoqi.memory_keys import VALUES, SensorKeys, Values
from pepper_driver.backends.naoqi.preflight import Preflight
from pepper_driver.backends.naoqi.robot import NaoqiRobot
from pepper_driver.config import NaoqiSettings, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.clock import SYSTEM_CLOCK, Clock
from pepper_driver.config.naoqi import AnglesSettings
from pepper_driver.config.signals import check_signals

SENSORS = 5
"""Questions for the angles to one for the stiffness and for all other sensors, which some robots refresh twice a
second."""

STIFFNESS_STEP = 0.02
"""Smallest change of a stiffness that is passed on."""


class AnglesChannel:
    """With ALMotion and the memory of one robot.

    Args:
        connection: Open.
        robot: Its description.
        keys: Of all sensors, any of which may be missing.
        settings: How often, and how fast.
        clock: Time by which samples age.

    Attributes:
        newest: What was measured last.
        soft: Joints whose stiffness can be changed: ALMotion refuses to change that of a Pepper's legs.
        places: Of these in a joint vector.

    Raises:
        BackendError: The robot does not say where its joints are.
    """

    def __init__(
        self,
        connection: Connection,
        robot: RobotConfig,
        keys: SensorKeys,
        settings: AnglesSettings,
        *,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._clock = clock
        self._settings, self._cycle, self._keys = settings, robot.cycle, keys
        self._joints = list(robot.joint_names)
        self.soft = [name for name in self._joints if name not in robot.chains["legs"]]
        self.places = [robot.joint_index(name) for name in self.soft]
        motion, memory = connection.service("ALMotion"), connection.service("ALMemory")
        uri = connection.address.uri
        self._angles = Call(motion, "getAngles", uri, clock=clock)
        self._sensors = Call(memory, "getListData", uri, clock=clock)
        self._order = Call(motion, "setAngles", uri, clock=clock)
        self._stiffness_order = Call(motion, "setStiffnesses", uri, clock=clock)
        self._stiffnesses = Call(motion, "getStiffnesses", uri, clock=clock)
        self._unknown = self._found = np.full(len(self._joints), np.nan)
        self._sent_meanwhile = False
        position = self._position_of(connection.call("ALMotion", "getAngles", self._joints, True))
        values = keys.values(connection.call("ALMemory", "getListData", keys.names))
        if position is None or isinstance(values, str):
            raise BackendError(f"'{uri}': the robot does not say where its joints are")
        self._position: FloatArray = position
        self._values: Values = values
        self._opened = self._asked = self._sampled = self._clock.seconds()
        self._step = self._tick = self._dropped_commands = 0
        self._stiffness = np.zeros(len(self.soft))
        self.newest = self._measurement()

    def start(self, stiffness: FloatArray) -> None:
        """From now on commands are counted, and changes from a stiffness (17,) are passed on."""
        self._dropped_commands = 0
        self._stiffness = stiffness[self.places]

    @property
    def idle(self) -> bool:
        """True when the robot has accepted the last stiffness that was sent."""
        return self._stiffness_order.over

    def read(self) -> Measurement:
        """Return the newest sample, and ask for the next one where that is due."""
        self._step += 1
        self._count()
        self._take()
        if self._step % self._settings.command_period == 0:
            self._ask()
        self.newest = self._measurement()
        return self.newest

    def write(self, position: FloatArray | None, stiffness: FloatArray | None) -> None:
        """Send the values that are due; a value of None is not sent."""
        if self._step % self._settings.command_period == 1:
            if position is not None and not self._order.begin(
                self._joints, position.tolist(), self._settings.speed
            ):
                self._dropped_commands += 1
            if stiffness is not None:
                self._send_stiffness(stiffness[self.places])

    def exchange(self, position: FloatArray | None, stiffness: FloatArray | None) -> Measurement:
        """Write, then read: for the begin and the end of a run, which follow no sample."""
        self.write(position, stiffness)
        return self.read()

    def _count(self) -> None:
        """Ticks increase by one each, and stay in step with the time."""
        passed = (self._clock.seconds() - self._opened) / self._cycle
        if self._tick < passed - 2:
            self._tick = int(passed)
        elif self._tick < passed:
            self._tick += 1

    def _take(self) -> None:
        position = self._position_of(self._angles.answer())
        if position is not None:
            # The time of the request: the angles may be as old as that.
            self._position, self._sampled = position, self._asked
        answer = self._sensors.answer()
        if answer is not None and not isinstance(values := self._keys.values(answer), str):
            self._values = values
        stiffnesses = self._stiffnesses.answer()
        # A reply from before our own command would look like stiffness that another program lowered.
        if stiffnesses is not None and not self._sent_meanwhile:
            self._found = self._stiffness_of(stiffnesses)

    def _ask(self) -> None:
        if self._angles.begin(self._joints, True):
            self._asked = self._clock.seconds()
        if self._step % (SENSORS * self._settings.command_period) == 0:
            self._sensors.begin(self._keys.names)
            if self._stiffness_order.over and self._stiffnesses.begin(self.soft):
                self._sent_meanwhile = False

    def _send_stiffness(self, stiffness: FloatArray) -> None:
        change = np.abs(stiffness - self._stiffness)
        arrives = (change > 0) & ((stiffness == 0) | (stiffness == 1))  # however near it is
        if (change.max() >= STIFFNESS_STEP or arrives.any()) and self._stiffness_order.begin(
            self.soft, stiffness.tolist()
        ):
            self._stiffness = stiffness
            # A command in flight may have reached the robot or not.
            self._found, self._sent_meanwhile = self._unknown, True

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
        usual = (self._settings.command_period + 1) * self._cycle
        values = {name: getattr(self._values, name) for name in VALUES} | {
            "position": self._position,
            "stiffness": self._found,
        }
        return Measurement(
            time=self._tick * self._cycle,
            tick=self._tick,
            age=max(0.0, self._clock.seconds() - self._sampled - usual),
            dropped_commands=self._dropped_commands,
            **values,
        )


logger = logging.getLogger("pepper_driver")


FRESH, LAST = 6, 40
"""Ticks in which a new sample arrives, and in which the last change of stiffness is accepted."""


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
        clock: Clock = SYSTEM_CLOCK,
        connect: Connect = connect,
    ) -> None:
        policy = replace(
            settings.take_over,
            # ALMotion commands the joints in this mode, so its own protections work.
            diagnosis_effect="keep",
            self_collision="keep",
            arm_obstacles="keep",
            base_obstacles="keep",
            fall_manager="keep",
            push_recovery="keep",
        )
        super().__init__(
            address,
            robot,
            settings,
            policy=policy,
            wake=wake,
            force=force,
            clock=clock,
            connect=connect,
        )
        self._link: AnglesChannel | None = None
        self._moving = self._warned = False

    @property
    def _needed(self) -> Sequence[str]:
        return ()

    def _described(self, found: Preflight) -> tuple[int, str]:
        return self._settings.angles.response_delay, f"{found.body_id}/angles"

    def _begin(self, connection: Connection) -> Measurement:
        keys = SensorKeys(self._robot, complete=False)
        self._link = AnglesChannel(
            connection, self._robot, keys, self._settings.angles, clock=self.clock
        )
        return self._link.newest

    def _ramp_up(self) -> tuple[FloatArray, Measurement]:
        """No joint gets less stiffness than it has already."""
        link, connection = self._open_link, self._connected()
        logger.warning(
            "'%s' moves through ALMotion: some 40 commands a second, followed late; touch is not detected, "
            "the base stands still",
            self._address.uri,
        )
        before = np.ones(len(self._robot.joint_names))
        # 1 for the legs, whose stiffness ALMotion does not change.
        before[link.places] = connection.call("ALMotion", "getStiffnesses", link.soft)
        cycle = self._robot.cycle
        for _ in cycle_timer(
            cycle, FRESH, clock=self.clock
        ):  # taking over may have lasted, and moved the robot
            measurement = link.exchange(None, None)
        hold = np.clip(measurement.position, self._robot.lower, self._robot.upper)
        link.start(before)
        ticks = round(self._settings.timing.ramp_up / cycle)
        for tick in cycle_timer(cycle, ticks, clock=self.clock):
            self._connected()
            check_signals()
            measurement = link.exchange(hold, np.maximum(before, (tick + 1) / ticks))
            if not measurement.age <= self._safety.stale_fault:
                raise BackendError(
                    f"'{self._address.uri}' stopped answering while its stiffness was raised: the newest sample is "
                    f"{1e3 * measurement.age:.0f} ms old; check the network, then start again"
                )
        self._moving, self._warned = True, False
        return hold, measurement

    def _read(self) -> Measurement:
        return self._open_link.read()

    def _write(self, position: FloatArray, stiffness: FloatArray, wheel_speed: FloatArray) -> None:
        if not self._moving:
            return
        # ALMotion drives on when a command to stop is lost: a hazard for people nearby.
        if wheel_speed.any() and not self._warned:
            self._warned = True
            logger.warning("'%s' keeps its base still in this mode", self._address.uri)
        self._open_link.write(position, stiffness)

    def _let_go(self, posture: FloatArray) -> bool:
        """ALMotion has all joint positions, so no joint has to return; the legs keep their stiffness.

        No joint regains stiffness that another program has lowered.
        """
        link, self._moving = self._open_link, False
        stiffness_shown, ones = link.newest.stiffness, np.ones(len(posture))
        stiffness_before = (
            ones if stiffness_shown is None else np.fmin(stiffness_shown, ones)
        )  # 1 where it is unknown
        ticks = round(self._settings.timing.ramp_down / self._robot.cycle)
        for tick in cycle_timer(self._robot.cycle, ticks + LAST, clock=self.clock):
            measurement = link.exchange(None, stiffness_before * max(0.0, 1.0 - (tick + 1) / ticks))
            if self._lost or measurement.age > 2.0 * self._settings.end_silence:
                return False
            if tick >= ticks and link.idle:
                return True
        return False

    @property
    def _open_link(self) -> AnglesChannel:
        assert self._link is not None
        return self._link
