"""Other sources of motion: switched off for the time of a run, and restored.

NAOqi 2.5 and 2.8 pages "ALMotion" (deactivation of safety reflexes), "Idle", "Self-collision avoidance API",
"External-collision avoidance API", "Fall manager API", "Push recovery API", "Smart Stiffness API" and "Diagnosis effect
API".

The DCM has no priorities and no lock, the last order wins (NAOqi 2.5 page "DCM"): two who move a joint make it shake.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np

from pepper_driver.backends.interface import NotConnectedError
from pepper_driver.backends.naoqi.connection import (
    CallTimeoutError,
    Connection,
    MissingServiceError,
    ServiceError,
)
from pepper_driver.backends.naoqi.preflight import awake
from pepper_driver.backends.naoqi.qi_library import Answer
from pepper_driver.backends.readiness import NotReadyError
from pepper_driver.config import NaoqiSettings, PepperError, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.clock import SYSTEM_CLOCK, Clock
from pepper_driver.config.naoqi import TakeOverSettings

CHAINS = ("Head", "LArm", "RArm", "Legs")
"""Of ALMotion, each with an idle movement of its own."""

ARMS = ("LArm", "RArm")
"""Asked for one by one: of both together ALMotion cannot say whether they are protected."""


CRITICAL = ("base_obstacles", "fall_manager", "push_recovery")
"""Settings of what NAOqi calls critical: only the owner of the robot can allow that it is switched off."""


@dataclass(frozen=True, kw_only=True)
class Switch:
    """One of ALMotion's, with ``getXEnabled`` and ``setXEnabled``.

    Attributes:
        setting: Key of ``naoqi_settings.yaml`` that says what is done about it.
        name: What stands for X.
        chain: What both methods take first, if anything.
        text: Human-readable name.
    """

    setting: str
    name: str
    chain: str | None
    text: str

    @property
    def arguments(self) -> tuple[str, ...]:
        """First arguments of both methods."""
        return () if self.chain is None else (self.chain,)

    @property
    def consent(self) -> bool:
        """True if the robot's owner must have allowed that it is switched off."""
        return self.setting in CRITICAL


SWITCHES = (
    *(
        Switch(setting="idle", name=name, chain=chain, text=f"{text} of {chain}")
        for name, text in (("Breath", "breathing"), ("IdlePosture", "idle posture"))
        for chain in CHAINS
    ),
    Switch(setting="smart_stiffness", name="SmartStiffness", chain=None, text="smart stiffness"),
    Switch(setting="diagnosis_effect", name="DiagnosisEffect", chain=None, text="diagnosis effect"),
    *(
        Switch(
            setting="self_collision",
            name="CollisionProtection",
            chain=arm,
            text=f"self-collision avoidance of {arm}",
        )
        for arm in ARMS
    ),
    *(
        Switch(
            setting=setting,
            name="ExternalCollisionProtection",
            chain=chain,
            text=f"external-collision avoidance of {chain}",
        )
        for setting, chain in (
            *(("arm_obstacles", arm) for arm in ARMS),
            ("base_obstacles", "Move"),
        )
    ),
    Switch(setting="fall_manager", name="FallManager", chain=None, text="fall manager"),
    Switch(setting="push_recovery", name="PushRecovery", chain=None, text="push recovery"),
)
"""In the order in which they are switched off."""


def chosen(settings: TakeOverSettings) -> list[tuple[Switch, bool]]:
    """Return the switches to turn off, each with true if it must be."""
    policies = {switch: getattr(settings, switch.setting) for switch in SWITCHES}
    return [(switch, policy == "off") for switch, policy in policies.items() if policy != "keep"]


logger = logging.getLogger("pepper_driver")


@dataclass(frozen=True, kw_only=True)
class _Change:
    """Undone by calling ``method`` of ``service``; ``text`` says what that gives back."""

    text: str
    service: str
    method: str
    arguments: tuple[object, ...]
    timeout: float


class Restoration:
    """Changes in their order, undone in reverse."""

    def __init__(self, alive_time: float) -> None:
        self._changes: list[_Change] = []
        self._alive_time = alive_time

    def note(
        self, text: str, service: str, method: str, *arguments: object, timeout: float
    ) -> None:
        """Record how a change is undone. To be called before it is made: half a change is undone too.

        Args:
            text: Human-readable name of what is given back.
            service: That does it.
            method: Of the service.
            arguments: For the method.
            timeout: How long it may take [s].
        """
        change = _Change(
            text=text, service=service, method=method, arguments=arguments, timeout=timeout
        )
        self._changes.append(change)

    def undo(self, connection: Connection) -> tuple[str, ...]:
        """Undo all, each whether or not another fails, and forget them; returns what could not be undone.

        Does not wait for a robot that hangs or is disconnected. Raises nothing.
        """
        left = []
        answers = _alive(connection, self._alive_time)
        for change in reversed(self._changes):
            if not answers:
                left.append(change.text)
                continue
            try:
                connection.call(
                    change.service, change.method, *change.arguments, timeout=change.timeout
                )
            except PepperError as error:
                left.append(change.text)
                logger.warning("not given back: %s (%s)", change.text, error)
                # One short call after a time-out: else each change would wait its full time for a robot that hangs.
                answers = not isinstance(error, CallTimeoutError | NotConnectedError) or _alive(
                    connection, self._alive_time
                )
        self._changes.clear()
        if left:
            logger.error(
                "'%s': NAOqi did not get back: %s; restart the robot to have it as it was",
                connection.address.uri,
                ", ".join(left),
            )
        return tuple(left)


def _alive(connection: Connection, timeout: float) -> bool:
    try:
        connection.call("ALMotion", "robotIsWakeUp", timeout=timeout)
    # An error is a reply too: the robot is alive.
    except (MissingServiceError, ServiceError):
        return True
    except PepperError:
        return False
    return True


POLL_PERIOD = 0.1
"""[s] between two checks of a slow operation."""


class ConsentError(NotReadyError):
    """The owner of the robot has not allowed that a protection is switched off."""


class TakeOver:
    """Switches off other sources of motion on ``begin`` or entering a block; restores them on ``restore`` or its end.

    Giving back is in reverse order, each part whether or not another fails, and never raises.

    Args:
        connection: With the robot.
        robot: Names its joints.
        settings: How long it may take.
        policy: What is switched off, by default as the settings say.
        wake: Whether to wake up a robot at rest; it is sent to rest again in the end.
        clock: Time in which NAOqi must show a change.

    Attributes:
        posture: (17,) where ALMotion last sent the joints [rad], NaN without ALMotion. It does not see the commands to
            the DCM: joints that keep their stiffness must be back there before it moves them again, else they jerk
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
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._clock = clock
        self._connection = connection
        self._robot = robot
        self._settings = settings
        self._policy = policy or settings.take_over
        self._wake = wake
        self._changes = Restoration(settings.alive_time)
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
            NotReadyError: Something that must be off stays on, or the robot does not wake up.
            NotConnectedError: The connection is lost.
        """
        try:
            self._disable_others()
        # Also on Ctrl-C: half of the robot's protections would stay off.
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
        """Restore everything. Does nothing if nothing was switched off, or all is restored.

        Args:
            connection: Another one, where the first was lost.
        """
        self.kept = ()
        self.left = self._changes.undo(connection or self._connection)

    def _disable_others(self) -> None:
        policy = self._policy
        woken = awake(self._connection)
        if policy.autonomous_life == "off":
            self._end_life()
        if policy.touch == "off":
            self._stop_touch()
        # Tasks in progress would go on commanding the joints.
        self._call_if_there("ALMotion", "killAll")
        # Asked again: some robots lie down when autonomous life ends.
        if not awake(self._connection):
            self._wake_up(rest_in_the_end=not woken)
        for switch, must in chosen(policy):  # after waking up, which switches most of them on
            if self._is_on(switch):
                self._switch_off(switch, must=must)
        # False: where ALMotion sent the joints, not where they are measured.
        posture = self._call_if_there("ALMotion", "getAngles", list(self._robot.joint_names), False)
        if posture is not None:
            self.posture = np.array(posture, dtype=float)

    def _end_life(self) -> None:
        """Turn a switch by which some robots lie down to rest."""
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
            # It is uncertain whether a real robot can start it again.
            self._undo_by("ALTouch", "ALLauncher", "launchLocal", "altouch")
            self._connection.call("ALTouch", "exit")

    def _wake_up(self, *, rest_in_the_end: bool) -> None:
        uri, limit = self._connection.address.uri, self._settings.take_over_time
        if rest_in_the_end:
            if not self._wake:
                raise NotReadyError(
                    f"'{uri}' fell asleep; wake it up by two presses of the chest button, or add ?wake=1"
                )
            self._undo_by("rest", "ALMotion", "rest", timeout=limit)
        self._connection.call("ALMotion", "wakeUp", timeout=limit)
        self._until(
            lambda: awake(self._connection),
            "it does not wake up; its notifications say why: press the chest button once",
        )

    def _is_on(self, switch: Switch) -> bool:
        """Return true if the switch is on. A switch that a robot does not have is off."""
        return bool(self._call_if_there("ALMotion", f"get{switch.name}Enabled", *switch.arguments))

    def _switch_off(self, switch: Switch, *, must: bool) -> None:
        setter = f"set{switch.name}Enabled"
        # Noted first: a call that times out may take effect all the same.
        self._undo_by(switch.text, "ALMotion", setter, *switch.arguments, True)
        reason = ""
        try:
            self._connection.call("ALMotion", setter, *switch.arguments, False)
        except ServiceError as error:
            reason = f" ({error.reason})"
        # A refusal is final; only an accepted call may take effect a moment later.
        if self._reached(
            lambda: not self._is_on(switch), 0.0 if reason else self._settings.switch_time
        ):
            return
        if not must:
            self.kept = (*self.kept, switch.text)
            return
        stays = f"'{self._connection.address.uri}': {switch.text} stays on{reason}"
        if switch.consent:
            raise ConsentError(
                f"{stays}; the robot's owner must allow it on {self._consent_page()} (deactivation of safety "
                f"reflexes), or set '{switch.setting}: off if allowed' in a file for ?settings="
            )
        raise NotReadyError(
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
        """Return the reply; None if the robot has no such service or method."""
        try:
            return self._connection.call(service, method, *arguments)
        except (MissingServiceError, ServiceError) as error:
            logger.debug("passed over: %s", error)
            return None

    def _until(self, reached: Callable[[], bool], otherwise: str) -> None:
        if not self._reached(reached, self._settings.take_over_time):
            raise NotReadyError(f"'{self._connection.address.uri}': {otherwise}")

    def _reached(self, reached: Callable[[], bool], within: float) -> bool:
        end = self._clock.seconds() + within
        while not reached():
            if self._clock.seconds() > end:
                return False
            self._clock.sleep(POLL_PERIOD)
        return True
