"""ALMotion: motion of the base, and its own reflexes.

The base; NAOqi 2.8 page "Locomotion control", what it says of Pepper.

Switches of reflexes and of idling; NAOqi 2.8 pages "External-collision avoidance", "Fall manager", "Idle".
"""

from __future__ import annotations

import numpy as np

from pepper_driver.backends.naoqi_server.almotion.kinematics import ARMS, CallError, number
from pepper_driver.backends.naoqi_server.almotion.wheels import DriveLimits, wrapped_angle
from pepper_driver.backends.naoqi_server.services.calls import blocking
from pepper_driver.backends.naoqi_server.services.context import Context, MotionCalls, switch
from pepper_driver.config import suggestion
from pepper_driver.config.arrays import FloatArray

POLL_PERIOD = 0.02
"""[s] between two checks that it stands."""


class BaseCalls(MotionCalls):
    """A part of ALMotion. The base stands while the robot rests, its power hatch is open or a bumper is pressed."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        names = context.config.naoqi
        # The flap over the charging socket: while it is open a cable may be in it.
        self._hatch = names.prefix + "Platform/ILS/Sensor/Value"
        self._bumpers = [
            names.prefix + names.bumper.format(bumper=bumper)
            for bumper in context.config.sensors.bumpers
        ]
        self._move_arms = dict.fromkeys(ARMS, True)
        self._motion.on_cycle.append(self._stop_at_obstacles)

    def move(self, x: object, y: object, theta: object, *config: object) -> None:
        """Drive at a velocity [m/s], [m/s], [rad/s], until the next command; do not wait."""
        where = "ALMotion::move"
        twist = _three(x, y, theta, where)
        limits = self._limits(config, where)
        if self._may_move():
            with self._motion.lock:
                self._motion.base.drive(twist, limits)

    def moveToward(self, x: object, y: object, theta: object, *config: object) -> None:
        """Drive at fractions of the largest velocity, -1..1, until the next command; do not wait."""
        where = "ALMotion::moveToward"
        limits = self._limits(config, where)
        fraction = np.clip(_three(x, y, theta, where), -1.0, 1.0)
        if self._may_move():
            most = np.array([limits.speed, limits.speed, limits.turn])
            with self._motion.lock:
                self._motion.base.drive(fraction * most, limits)

    @blocking
    def moveTo(self, x: object, y: object, theta: object, *more: object) -> bool:
        """Drive to a pose as seen from the robot; waits. True if it got there, False if it was interrupted.

        ``more``: a move config, or the time for it [s] where that is more than the robot needs.
        """
        where = "ALMotion::moveTo"
        way = _three(x, y, theta, where)
        listed = bool(more) and isinstance(more[0], list | tuple)
        least = 0.0 if listed or not more else number(more[0], where, "the time")
        limits = self._limits(more if listed else (), where)
        if not self._may_move():
            return False
        with self._motion.lock:
            move = self._motion.base.move(way, limits, least)
        # Without the lock, which the writer needs to drive.
        return move.wait(self._clock)

    @blocking
    def stopMove(self) -> bool:
        """Brake; waits until the base stands."""
        with self._motion.lock:
            self._motion.base.stop()
        return self._stand()

    def killMove(self) -> None:
        """Stop the wheels at once."""
        with self._motion.lock:
            self._motion.base.stop(at_once=True)

    @blocking
    def waitUntilMoveIsFinished(self) -> None:
        """Wait until the base stands and has no target."""
        self._stand()

    def moveInit(self) -> None:
        """Get ready to drive: a base on wheels is."""

    def moveIsActive(self) -> bool:
        """Return true if the base drives, or is about to."""
        with self._motion.lock:
            return self._motion.base.active

    def getRobotPosition(self, sensors: object) -> list[float]:
        """x, y [m], heading [rad] in the world: by the wheels' sensors, or by what was commanded."""
        with self._motion.lock:
            base = self._motion.base
            x, y, heading = (base.pose if sensors else base.commanded).tolist()
        return [x, y, wrapped_angle(heading)]

    def getNextRobotPosition(self) -> list[float]:
        """Return the place that the robot cannot avoid any more: on wheels, its present one."""
        return self.getRobotPosition(False)

    def getRobotVelocity(self) -> list[float]:
        """[m/s], [m/s], [rad/s] in the robot's axes, by the wheels' sensors."""
        with self._motion.lock:
            velocity: list[float] = self._motion.base.measured.tolist()
        return velocity

    def getMoveConfig(self, kind: object) -> list[list[object]]:
        """Drive parameters: "Min", "Default" or "Max" of each."""
        kinds = ("Min", "Default", "Max")
        if kind not in kinds:
            raise CallError(
                "ALMotion::getMoveConfig", f"unknown config: {kind} (possible: {kinds})"
            )
        place = kinds.index(str(kind))
        drive = vars(self._shared.settings.drive)
        return [[name, values[place]] for name, values in drive.items()]

    def setMoveArmsEnabled(self, left: object, right: object) -> None:
        """Set if the arms swing while the base drives. They do not here; it is only kept."""
        where = "ALMotion::setMoveArmsEnabled"
        self._move_arms = {"LArm": switch(left, where), "RArm": switch(right, where)}

    def getMoveArmsEnabled(self, arm: object) -> bool:
        """Return the value that was set for an arm, or "Arms"."""
        arms = self._motion.reflexes.arms(arm, "ALMotion::getMoveArmsEnabled")
        return all(self._move_arms[name] for name in arms)

    def _limits(self, config: tuple[object, ...], where: str) -> DriveLimits:
        given: dict[str, float] = {}
        known = vars(self._shared.settings.drive)
        for pair in config[0] if config and isinstance(config[0], list | tuple) else ():
            if not isinstance(pair, list | tuple) or len(pair) != 2:
                raise CallError(where, f"a move config is [[name, value], ...], got {pair!r}")
            name = str(pair[0])
            if name in known:
                given[name] = number(pair[1], where, name)
            elif name != "Frequency":  # of steps: for robots that walk
                raise CallError(where, f"unknown move config: {name}{suggestion(name, known)}")
        return DriveLimits.of(self._shared.settings, given)

    def _may_move(self) -> bool:
        if self._motion.awake and not self._obstacle():
            return True
        self._memory.raise_event("ALMotion/MoveFailed", ["Safety", 0, [0.0, 0.0, 0.0]])
        return False

    def _obstacle(self) -> bool:
        robot = self._context.robot
        pressed = self._motion.reflexes.external["Move"] and any(
            robot.value(bumper) > 0 for bumper in self._bumpers
        )
        return pressed or robot.value(self._hatch) > 0

    def _stop_at_obstacles(self) -> None:
        with self._motion.lock:
            active = self._motion.base.active
        if active and self._obstacle():
            with self._motion.lock:
                self._motion.base.stop(at_once=True)
            self._memory.raise_event("ALMotion/MoveFailed", ["Safety", 1, [0.0, 0.0, 0.0]])

    def _stand(self) -> bool:
        """Wait until the base stands; whether nothing made it drive again."""
        closed = self._motion.closed.is_set
        self._clock.wait_for(lambda: closed() or not self.moveIsActive())
        return not self.moveIsActive()


def _three(x: object, y: object, theta: object, where: str) -> FloatArray:
    return np.array([number(x, where, "x"), number(y, where, "y"), number(theta, where, "theta")])


class ReflexCalls(MotionCalls):
    """A part of ALMotion. Critical reflexes can be switched off only where the owner of the robot allowed it."""

    def setCollisionProtectionEnabled(self, chain: object, enable: object) -> bool:
        """Protection of "Arms", "LArm" or "RArm" against the robot itself."""
        where = "ALMotion::setCollisionProtectionEnabled"
        on = switch(enable, where)
        with self._motion.lock:
            for arm in self._motion.reflexes.arms(chain, where):
                self._motion.reflexes.self_collision[arm] = on
        return True

    def getCollisionProtectionEnabled(self, chain: object) -> bool:
        """Return true if it is switched on."""
        reflexes = self._motion.reflexes
        arms = reflexes.arms(chain, "ALMotion::getCollisionProtectionEnabled")
        return all(reflexes.self_collision[arm] for arm in arms)

    def setExternalCollisionProtectionEnabled(self, name: object, enable: object) -> None:
        """Protection of others by "All", "Move", "Arms", "LArm" or "RArm". "All" and "Move" are critical."""
        where = "ALMotion::setExternalCollisionProtectionEnabled"
        reflexes, on = self._motion.reflexes, switch(enable, where)
        parts = reflexes.externals(name, where)
        if "Move" in parts:
            reflexes.check_consent(on, where)
        with self._motion.lock:
            reflexes.external.update(dict.fromkeys(parts, on))

    def getExternalCollisionProtectionEnabled(self, name: object) -> bool:
        """Return true if it is switched on."""
        reflexes = self._motion.reflexes
        parts = reflexes.externals(name, "ALMotion::getExternalCollisionProtectionEnabled")
        return all(reflexes.external[part] for part in parts)

    def setDiagnosisEffectEnabled(self, enable: object) -> None:
        """Set if broken devices make the robot rest."""
        on = switch(enable, "ALMotion::setDiagnosisEffectEnabled")
        with self._motion.lock:
            self._motion.reflexes.diagnosis = on

    def getDiagnosisEffectEnabled(self) -> bool:
        """Return true if it is switched on."""
        return self._motion.reflexes.diagnosis

    def setSmartStiffnessEnabled(self, enable: object) -> bool:
        """Set if stiffness is reduced while nothing moves."""
        on = switch(enable, "ALMotion::setSmartStiffnessEnabled")
        with self._motion.lock:
            self._motion.reflexes.smart_stiffness = on
        return True

    def getSmartStiffnessEnabled(self) -> bool:
        """Return true if it is switched on."""
        return self._motion.reflexes.smart_stiffness

    def setFallManagerEnabled(self, enable: object) -> None:
        """Set the reaction to a fall. Critical."""
        where = "ALMotion::setFallManagerEnabled"
        on = switch(enable, where)
        self._motion.reflexes.check_consent(on, where)
        with self._motion.lock:
            self._motion.reflexes.fall_manager = on

    def getFallManagerEnabled(self) -> bool:
        """Return true if it is switched on."""
        return self._motion.reflexes.fall_manager

    def setPushRecoveryEnabled(self, enable: object) -> None:
        """Set the reaction to a push. Critical."""
        where = "ALMotion::setPushRecoveryEnabled"
        on = switch(enable, where)
        self._motion.reflexes.check_consent(on, where)
        with self._motion.lock:
            self._motion.reflexes.push_recovery = on

    def getPushRecoveryEnabled(self) -> bool:
        """Return true if it is switched on."""
        return self._motion.reflexes.push_recovery

    def setOrthogonalSecurityDistance(self, distance: object) -> None:
        """Distance to obstacles ahead [m]. Nothing sees obstacles here; it is only kept."""
        where = "ALMotion::setOrthogonalSecurityDistance"
        self._motion.reflexes.orthogonal = number(distance, where, "the distance")

    def getOrthogonalSecurityDistance(self) -> float:
        """Return the value that was set [m]."""
        return self._motion.reflexes.orthogonal

    def setTangentialSecurityDistance(self, distance: object) -> None:
        """Distance to obstacles at the sides [m]. Nothing detects obstacles here; it is only kept."""
        where = "ALMotion::setTangentialSecurityDistance"
        self._motion.reflexes.tangential = number(distance, where, "the distance")

    def getTangentialSecurityDistance(self) -> float:
        """Return the value that was set [m]."""
        return self._motion.reflexes.tangential

    def setBreathEnabled(self, chain: object, enable: object) -> None:
        """Set if the idle joints of a chain breathe."""
        self._idle(chain, enable, "setBreathEnabled", breathe=True)

    def getBreathEnabled(self, chain: object) -> bool:
        """Return true if it is switched on."""
        chains = self._motion.idle.chains(chain, "ALMotion::getBreathEnabled")
        return set(chains) <= self._motion.idle.breathing

    def setIdlePostureEnabled(self, chain: object, enable: object) -> None:
        """Set if the idle joints of a chain return to the posture Stand."""
        self._idle(chain, enable, "setIdlePostureEnabled", breathe=False)

    def getIdlePostureEnabled(self, chain: object) -> bool:
        """Return true if it is switched on."""
        chains = self._motion.idle.chains(chain, "ALMotion::getIdlePostureEnabled")
        return set(chains) <= self._motion.idle.posture

    def _idle(self, chain: object, enable: object, method: str, *, breathe: bool) -> None:
        """Set the idle motion of a chain: the last of the two calls counts."""
        where = f"ALMotion::{method}"
        idle, on = self._motion.idle, switch(enable, where)
        chains = set(idle.chains(chain, where))
        with self._motion.lock:
            idle.breathing = idle.breathing | chains if breathe and on else idle.breathing - chains
            idle.posture = idle.posture | chains if on and not breathe else idle.posture - chains
