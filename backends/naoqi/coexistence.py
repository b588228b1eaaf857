"""ALMotion and autonomous life move the joints too: stilled before we do, and given back after.

The DCM has no priorities and no lock, the last order wins (NAOqi 2.5 page "DCM"): two who move a joint make it shake.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

import numpy as np

from pepper_driver.backends.naoqi.connection import Connection, MissingServiceError, ServiceError
from pepper_driver.backends.naoqi.fitness import awake
from pepper_driver.backends.naoqi.library import Answer
from pepper_driver.backends.naoqi.preflight import UnfitError
from pepper_driver.backends.naoqi.restoration import Restoration
from pepper_driver.backends.naoqi.switches import Switch, chosen
from pepper_driver.config import NaoqiSettings, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.naoqi import TakeOverSettings

logger = logging.getLogger("pepper_driver")

POLL = 0.1
"""[s] between two looks at what takes its time."""

SETTLE = 0.5
"""[s] in which a switch of ALMotion shows; its documentation has one of its cycles, 20 ms."""


class ConsentError(UnfitError):
    """The owner of the robot has not allowed that a protection is switched off."""


class TakeOver:
    """Stills whoever else moves the robot, on ``begin`` or entering a block; gives back on ``restore`` or leaving it.

    Giving back is in reverse order, each part whether or not another fails, and never raises.

    Args:
        connection: With the robot.
        robot: Names its joints.
        settings: How long it may take.
        policy: What is switched off, by default as the settings say.
        wake: Whether to wake up a robot at rest; it is sent to rest again in the end.

    Attributes:
        posture: (17,) where ALMotion last sent the joints [rad], NaN without ALMotion. It does not see what the DCM is
            told: joints that keep their stiffness must be back there before it moves them again, else they jerk
            (NAOqi 2.5 page "ALMotion advanced").
        kept: What is still on, because the owner did not allow that it is switched off.
        left: What could not be given back.
    """

    def __init__(
        self,
        connection: Connection,
        robot: RobotConfig,
        settings: NaoqiSettings,
        policy: TakeOverSettings | None = None,
        *,
        wake: bool = False,
    ) -> None:
        self._connection = connection
        self._robot = robot
        self._settings = settings
        self._policy = policy or settings.take_over
        self._wake = wake
        self._changes = Restoration()
        self.posture: FloatArray = np.full(len(robot.joint_names), np.nan)
        self.kept: tuple[str, ...] = ()
        self.left: tuple[str, ...] = ()

    def __enter__(self) -> Self:
        self.begin()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.restore()

    def begin(self) -> None:
        """Still all that the settings say. Where that fails, what was done is undone first.

        Raises:
            ConsentError: The owner did not allow what must be off.
            UnfitError: Something that must be off stays on, or the robot does not wake up.
            NotConnectedError: The connection is lost.
        """
        try:
            self._still()
        except BaseException:
            self.restore()
            raise
        if self.kept:
            logger.warning(
                "'%s': still on, because the robot's owner has not allowed otherwise on %s: %s; it may move base and "
                "legs against you, so move head and arms alone",
                self._connection.address.uri,
                self._consent_page(),
                ", ".join(self.kept),
            )

    def restore(self, connection: Connection | None = None) -> None:
        """Give all back. Does nothing where nothing was taken, or all is given back.

        Args:
            connection: Another one, where the first was lost.
        """
        self.kept = ()
        self.left = self._changes.undo(connection or self._connection)

    def _still(self) -> None:
        policy = self._policy
        woken = awake(self._connection)
        if policy.autonomous_life == "off":
            self._end_life()
        if policy.touch == "off":
            self._stop_touch()
        self._call_if_there("ALMotion", "killAll")
        if not awake(self._connection):
            self._wake_up(rest_in_the_end=not woken)
        for switch, must in chosen(policy):  # after waking up, which switches most of them on
            if self._is_on(switch):
                self._switch_off(switch, must=must)
        posture = self._call_if_there("ALMotion", "getAngles", list(self._robot.joint_names), False)
        if posture is not None:
            self.posture = np.array(posture, dtype=float)

    def _end_life(self) -> None:
        """Some robots lie down to rest by it."""
        state = self._call_if_there("ALAutonomousLife", "getState")
        if state in (None, "disabled"):
            return
        # Interactive and safeguard states are the robot's own to enter.
        limit = self._settings.take_over_time
        self._undo_by("autonomous life", "ALAutonomousLife", "setState", "solitary", timeout=limit)
        self._connection.call("ALAutonomousLife", "setState", "disabled", timeout=limit)
        self._until(
            lambda: self._connection.call("ALAutonomousLife", "getState") == "disabled",
            "autonomous life does not end; switch it off by pressing the chest button twice",
        )

    def _stop_touch(self) -> None:
        if "ALTouch" in self._connection.service_names:
            self._undo_by("ALTouch", "ALLauncher", "launchLocal", "altouch")
            self._connection.call("ALTouch", "exit")

    def _wake_up(self, *, rest_in_the_end: bool) -> None:
        uri, limit = self._connection.address.uri, self._settings.take_over_time
        if rest_in_the_end:
            if not self._wake:
                raise UnfitError(
                    f"'{uri}' fell asleep; wake it up by two presses of the chest button, or add ?wake=1"
                )
            self._undo_by("rest", "ALMotion", "rest", timeout=limit)
        self._connection.call("ALMotion", "wakeUp", timeout=limit)
        self._until(
            lambda: awake(self._connection),
            "it does not wake up; its notifications say why: press the chest button once",
        )

    def _is_on(self, switch: Switch) -> bool:
        """Whether it is. What a robot does not have is off."""
        return bool(self._call_if_there("ALMotion", f"get{switch.name}Enabled", *switch.arguments))

    def _switch_off(self, switch: Switch, *, must: bool) -> None:
        setter = f"set{switch.name}Enabled"
        self._undo_by(switch.text, "ALMotion", setter, *switch.arguments, True)
        reason = ""
        try:
            self._connection.call("ALMotion", setter, *switch.arguments, False)
        except ServiceError as error:
            reason = f" ({error.reason})"
        if self._reached(lambda: not self._is_on(switch), 0.0 if reason else SETTLE):
            return
        if not must:
            self.kept = (*self.kept, switch.text)
            return
        stays = f"'{self._connection.address.uri}': {switch.text} stays on{reason}"
        if switch.consent:
            raise ConsentError(
                f"{stays}; let the robot's owner allow it on {self._consent_page()} (deactivation of safety "
                f"reflexes), or set '{switch.setting}: off if allowed' in a file for ?settings="
            )
        raise UnfitError(
            f"{stays}; restart the robot, or set '{switch.setting}: keep' in a file for ?settings="
        )

    def _consent_page(self) -> str:
        return f"http://{self._connection.address.host}/advanced/#/settings"

    def _undo_by(
        self,
        text: str,
        service: str,
        method: str,
        *arguments: object,
        timeout: float | None = None,
    ) -> None:
        limit = self._settings.call_time if timeout is None else timeout
        self._changes.note(text, service, method, *arguments, timeout=limit)

    def _call_if_there(self, service: str, method: str, *arguments: object) -> Answer:
        """The answer; None where the robot has no such thing, or not of this kind."""
        try:
            return self._connection.call(service, method, *arguments)
        except (MissingServiceError, ServiceError) as error:
            logger.debug("passed over: %s", error)
            return None

    def _until(self, reached: Callable[[], bool], otherwise: str) -> None:
        if not self._reached(reached, self._settings.take_over_time):
            raise UnfitError(f"'{self._connection.address.uri}': {otherwise}")

    def _reached(self, reached: Callable[[], bool], within: float) -> bool:
        end = time.monotonic() + within
        while not reached():
            if time.monotonic() > end:
                return False
            time.sleep(POLL)
        return True
