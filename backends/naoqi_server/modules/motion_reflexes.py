"""Switches of reflexes and of idling; NAOqi 2.8 pages "External-collision avoidance", "Fall manager", "Idle"."""

from __future__ import annotations

from pepper_driver.backends.naoqi_server.modules.motion_calls import MotionCalls, switch
from pepper_driver.backends.naoqi_server.motion.body import number


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
        """Whether it is on."""
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
        """Whether it is on."""
        reflexes = self._motion.reflexes
        parts = reflexes.externals(name, "ALMotion::getExternalCollisionProtectionEnabled")
        return all(reflexes.external[part] for part in parts)

    def setDiagnosisEffectEnabled(self, enable: object) -> None:
        """Whether broken devices make the robot rest."""
        on = switch(enable, "ALMotion::setDiagnosisEffectEnabled")
        with self._motion.lock:
            self._motion.reflexes.diagnosis = on

    def getDiagnosisEffectEnabled(self) -> bool:
        """Whether it is on."""
        return self._motion.reflexes.diagnosis

    def setSmartStiffnessEnabled(self, enable: object) -> bool:
        """Whether stiffness is reduced while nothing moves."""
        on = switch(enable, "ALMotion::setSmartStiffnessEnabled")
        with self._motion.lock:
            self._motion.reflexes.smart_stiffness = on
        return True

    def getSmartStiffnessEnabled(self) -> bool:
        """Whether it is on."""
        return self._motion.reflexes.smart_stiffness

    def setFallManagerEnabled(self, enable: object) -> None:
        """What the robot does when it falls. Critical."""
        where = "ALMotion::setFallManagerEnabled"
        on = switch(enable, where)
        self._motion.reflexes.check_consent(on, where)
        with self._motion.lock:
            self._motion.reflexes.fall_manager = on

    def getFallManagerEnabled(self) -> bool:
        """Whether it is on."""
        return self._motion.reflexes.fall_manager

    def setPushRecoveryEnabled(self, enable: object) -> None:
        """What the robot does when it is pushed. Critical."""
        where = "ALMotion::setPushRecoveryEnabled"
        on = switch(enable, where)
        self._motion.reflexes.check_consent(on, where)
        with self._motion.lock:
            self._motion.reflexes.push_recovery = on

    def getPushRecoveryEnabled(self) -> bool:
        """Whether it is on."""
        return self._motion.reflexes.push_recovery

    def setOrthogonalSecurityDistance(self, distance: object) -> None:
        """Distance to obstacles ahead [m]. Nothing sees obstacles here; it is only kept."""
        where = "ALMotion::setOrthogonalSecurityDistance"
        self._motion.reflexes.orthogonal = number(distance, where, "the distance")

    def getOrthogonalSecurityDistance(self) -> float:
        """What was set [m]."""
        return self._motion.reflexes.orthogonal

    def setTangentialSecurityDistance(self, distance: object) -> None:
        """Distance to obstacles beside [m]. Nothing sees obstacles here; it is only kept."""
        where = "ALMotion::setTangentialSecurityDistance"
        self._motion.reflexes.tangential = number(distance, where, "the distance")

    def getTangentialSecurityDistance(self) -> float:
        """What was set [m]."""
        return self._motion.reflexes.tangential

    def setBreathEnabled(self, chain: object, enable: object) -> None:
        """Whether the idle joints of a chain breathe."""
        self._idle(chain, enable, "setBreathEnabled", breathe=True)

    def getBreathEnabled(self, chain: object) -> bool:
        """Whether they do."""
        chains = self._motion.idle.chains(chain, "ALMotion::getBreathEnabled")
        return set(chains) <= self._motion.idle.breathing

    def setIdlePostureEnabled(self, chain: object, enable: object) -> None:
        """Whether the idle joints of a chain go back to the posture Stand."""
        self._idle(chain, enable, "setIdlePostureEnabled", breathe=False)

    def getIdlePostureEnabled(self, chain: object) -> bool:
        """Whether they do."""
        chains = self._motion.idle.chains(chain, "ALMotion::getIdlePostureEnabled")
        return set(chains) <= self._motion.idle.posture

    def _idle(self, chain: object, enable: object, method: str, *, breathe: bool) -> None:
        """The last of the two calls says how a chain idles."""
        where = f"ALMotion::{method}"
        idle, on = self._motion.idle, switch(enable, where)
        chains = set(idle.chains(chain, where))
        with self._motion.lock:
            idle.breathing = idle.breathing | chains if breathe and on else idle.breathing - chains
            idle.posture = idle.posture | chains if on and not breathe else idle.posture - chains
