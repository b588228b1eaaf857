"""ALRobotPosture and the services of autonomous life.

The service ``ALRobotPosture``; NAOqi 2.8 page "ALRobotPosture API".

NAOqi 2.8 pages "ALAutonomousLife API", "State machine management", "ALBackgroundMovement", "ALBasicAwareness". Alive,
the robot breathes and looks around: ALMotion then writes to all its joints. There are no activities and no people here.
"""

from __future__ import annotations

from threading import Lock

from pepper_driver.backends.naoqi_server.almotion.joints import AlmotionTask
from pepper_driver.backends.naoqi_server.almotion.kinematics import CallError, number
from pepper_driver.backends.naoqi_server.almotion.postures import ABILITIES, ALIVE, NAMES, STATES
from pepper_driver.backends.naoqi_server.services.calls import blocking
from pepper_driver.backends.naoqi_server.services.context import Context, switch

FAMILIES = {
    "Stand": "Standing",
    "StandInit": "Standing",
    "StandZero": "Standing",
    "Crouch": "Crouching",
}

EVENT_CYCLES = 50
"""Cycles of ALMotion between two checks for events: a second, as documented."""


class PostureService:
    """Moves to predefined postures, and reports which one the robot has."""

    __qi_threading__ = "multi"

    def __init__(self, context: Context) -> None:
        self._memory, self._postures = context.memory, context.shared.postures
        self._motion, self._clock = context.shared.motion, context.clock
        self._lock = Lock()
        self._task: AlmotionTask | None = None
        self._cycles = 0
        self._notified = ("", "")
        self._motion.on_cycle.append(self._notify)

    def getPostureList(self) -> list[str]:
        """Names of the postures."""
        return list(NAMES)

    def getPosture(self) -> str:
        """Return the posture the robot has, or "Unknown"."""
        return self._postures.now

    def getPostureFamilyList(self) -> list[str]:
        """Families of postures."""
        return sorted(set(FAMILIES.values()))

    def getPostureFamily(self) -> str:
        """Return the posture of the robot, or "Unknown"."""
        return FAMILIES.get(self._postures.now, "Unknown")

    @blocking
    def goToPosture(self, name: object, speed: object) -> bool:
        """Move to a posture, ``speed`` in 0..1; wait; return True if it was reached."""
        return self._go(name, speed, "ALRobotPosture::goToPosture")

    @blocking
    def applyPosture(self, name: object, speed: object) -> bool:
        """As ``goToPosture``: there is only one path between two postures of a robot that always stands."""
        return self._go(name, speed, "ALRobotPosture::applyPosture")

    def stopMove(self) -> None:
        """End a motion to a posture."""
        with self._lock:
            task = self._task
        if task is not None:
            with self._motion.lock:
                self._motion.joints.kill([task])

    def setMaxTryNumber(self, tries: object) -> None:
        """Set the number of tries. Once is enough here."""
        number(tries, "ALRobotPosture::setMaxTryNumber", "the number of tries")

    def _go(self, name: object, speed: object, where: str) -> bool:
        if name not in NAMES:
            raise CallError(where, f"unknown posture: {name} (possible: {', '.join(NAMES)})")
        fraction = number(speed, where, "the speed")
        if not 0 < fraction <= 1:
            raise CallError(where, f"the speed must be above 0, at most 1: {fraction}")
        with self._lock:
            task = self._task = self._postures.go(str(name), fraction)
        # Without the lock, so that stopMove() can end it.
        return task.wait(self._clock) and self._postures.reached(str(name))

    def _notify(self) -> None:
        self._cycles += 1
        if self._cycles % EVENT_CYCLES:
            return
        now = self._postures.now
        before, self._notified = self._notified, (now, FAMILIES.get(now, "Unknown"))
        for event, old, new in zip(
            ("PostureChanged", "PostureFamilyChanged"), before, self._notified, strict=True
        ):
            if old != new:
                self._memory.raise_event(event, new)


MODES = {
    "engagement": ("Unengaged", "FullyEngaged", "SemiEngaged"),
    "tracking": ("Head", "BodyRotation", "WholeBody", "MoveContextually"),
}


class LifeService:
    """``ALAutonomousLife``."""

    __qi_threading__ = "multi"

    def __init__(self, context: Context) -> None:
        self._memory, self._life = context.memory, context.shared.life
        self._waking, self._clock = context.shared.waking, context.clock
        context.memory.insert("AutonomousLife/State", self._life.state)

    def getState(self) -> str:
        """solitary, interactive, safeguard or disabled."""
        return self._life.state

    @blocking
    def setState(self, state: object) -> None:
        """Enter a state. To be alive the robot wakes up first; what becomes of it then is left as it is."""
        where = "ALAutonomousLife::setState"
        if state not in STATES:
            raise CallError(where, f"unknown state: {state} (possible: {', '.join(STATES)})")
        if (self._life.state, state) == ("interactive", "solitary"):
            raise CallError(where, "the change from interactive to solitary is not allowed")
        if state in ALIVE:
            self._waking.wake_up()
        self._life.enter(str(state))
        self._memory.raise_event("AutonomousLife/State", state)

    def setAutonomousAbilityEnabled(self, ability: object, enabled: object) -> None:
        """Switch an ability, or "All"."""
        where = "ALAutonomousLife::setAutonomousAbilityEnabled"
        on = switch(enabled, where)
        for name in self._abilities(ability, where):
            self._life.enabled[name] = on
        self._life.apply()

    def getAutonomousAbilityEnabled(self, ability: object) -> bool:
        """Return true if an ability, or each of "All", is enabled."""
        names = self._abilities(ability, "ALAutonomousLife::getAutonomousAbilityEnabled")
        return all(self._life.enabled[name] for name in names)

    def getAutonomousAbilitiesStatus(self) -> list[dict[str, object]]:
        """Name, whether enabled and whether running of each ability."""
        return [
            {"name": name, "enabled": on, "running": self._life.running(name)}
            for name, on in self._life.enabled.items()
        ]

    def focusedActivity(self) -> str:
        """There are no activities."""
        return ""

    def stopAll(self) -> None:
        """Stop the activities; none exist here."""

    def _abilities(self, name: object, where: str) -> tuple[str, ...]:
        if name == "All":
            return ABILITIES
        if name in ABILITIES:
            return (str(name),)
        raise CallError(where, f"unknown ability: {name} (possible: All, {', '.join(ABILITIES)})")


class AbilityService:
    """Common part of the services of abilities."""

    ability = ""

    def __init__(self, context: Context) -> None:
        self._life = context.shared.life

    def setEnabled(self, enabled: object) -> None:
        """Switch it."""
        self._life.enabled[self.ability] = switch(enabled, f"AL{self.ability}::setEnabled")
        self._life.apply()

    def isEnabled(self) -> bool:
        """Return true if it is enabled."""
        return self._life.enabled[self.ability]

    def isRunning(self) -> bool:
        """Return true if it is at work."""
        return self._life.running(self.ability)


class BackgroundMovementService(AbilityService):
    """``ALBackgroundMovement``: the robot breathes."""

    ability = "BackgroundMovement"


class BlinkingService(AbilityService):
    """``ALAutonomousBlinking``: the eyes blink. They do not here; it is only kept."""

    ability = "AutonomousBlinking"


class SpeakingMovementService(AbilityService):
    """``ALSpeakingMovement``: the robot moves while it speaks. It does not here; it is only kept."""

    ability = "SpeakingMovement"


class ListeningMovementService(AbilityService):
    """``ALListeningMovement``: the robot moves while it listens. It does not here; it is only kept."""

    ability = "ListeningMovement"


class AwarenessService(AbilityService):
    """``ALBasicAwareness``: the robot looks around. It finds no people."""

    ability = "BasicAwareness"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._modes = {kind: modes[0] for kind, modes in MODES.items()}
        self._stimuli: dict[str, bool] = {}
        self._parameters = {"LookStimulusSpeed": 0.5, "LookBackSpeed": 0.3}

    def startAwareness(self) -> None:
        """As ``setEnabled(True)``."""
        self.setEnabled(True)

    def stopAwareness(self) -> None:
        """As ``setEnabled(False)``."""
        self.setEnabled(False)

    def isAwarenessRunning(self) -> bool:
        """As ``isRunning``."""
        return self.isRunning()

    def pauseAwareness(self) -> None:
        """Stop for a while."""
        self._pause(True)

    def resumeAwareness(self) -> None:
        """Go on."""
        self._pause(False)

    def isAwarenessPaused(self) -> bool:
        """Return true if it was paused."""
        return self._life.paused

    def setEngagementMode(self, mode: object) -> None:
        """Unengaged, FullyEngaged or SemiEngaged."""
        self._set("engagement", mode, "ALBasicAwareness::setEngagementMode")

    def getEngagementMode(self) -> str:
        """Return the value that was set."""
        return self._modes["engagement"]

    def setTrackingMode(self, mode: object) -> None:
        """Head, BodyRotation, WholeBody or MoveContextually."""
        self._set("tracking", mode, "ALBasicAwareness::setTrackingMode")

    def getTrackingMode(self) -> str:
        """Return the value that was set."""
        return self._modes["tracking"]

    def setStimulusDetectionEnabled(self, stimulus: str, enabled: bool) -> None:
        """Set if a kind of stimulus counts."""
        self._stimuli[stimulus] = enabled

    def isStimulusDetectionEnabled(self, stimulus: str) -> bool:
        """Return true if it is switched on."""
        return self._stimuli.get(stimulus, True)

    def setParameter(self, name: object, value: object) -> None:
        """Speeds of the head, kept only."""
        where = "ALBasicAwareness::setParameter"
        if name not in self._parameters:
            raise CallError(
                where, f"unknown parameter: {name} (possible: {', '.join(self._parameters)})"
            )
        self._parameters[str(name)] = number(value, where, str(name))

    def getParameter(self, name: object) -> float:
        """Return the value that was set."""
        if name not in self._parameters:
            raise CallError("ALBasicAwareness::getParameter", f"unknown parameter: {name}")
        return self._parameters[str(name)]

    def _pause(self, paused: bool) -> None:
        self._life.paused = paused
        self._life.apply()

    def _set(self, kind: str, mode: object, where: str) -> None:
        if mode not in MODES[kind]:
            raise CallError(where, f"unknown mode: {mode} (possible: {', '.join(MODES[kind])})")
        self._modes[kind] = str(mode)
