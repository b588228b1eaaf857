"""The reflexes of ALMotion that can be switched, and what each of them makes it write.

NAOqi 2.8 pages "ALMotion" (deactivation of safety reflexes), "External-collision avoidance", "Fall manager", "Push
Recovery", "Smart Stiffness", "Diagnosis effect". What ALMotion writes while a reflex is on is not documented, only that
it "sends new orders continuously" (NAOqi 2.5 page "DCM"). The model here is the worst that fits:

=====================  ==========================================
on                     is written in every cycle, while awake
=====================  ==========================================
self-collision, an arm     the angles of the arm
external collision, an arm the angles of the arm
external collision, Move   the speeds of the wheels
push recovery              the speeds of the wheels, the angles of the leg
fall manager               the angles of the leg
diagnosis effect           the angles of all joints
smart stiffness            the stiffnesses of all joints
=====================  ==========================================
"""

from __future__ import annotations

from pepper_driver.backends.naoqi_server.motion.body import ARMS, Body, CallError

CONSENT = (
    "the owner of the robot has not allowed to deactivate this safety reflex: "
    "allow it on the page http://<robot>/advanced/#/settings"
)


class Reflexes:
    """Switches. All are on at the start.

    Attributes:
        self_collision: By arm.
        external: By "Move" and arm.
        diagnosis: Diagnosis effect.
        smart_stiffness: Less stiffness while nothing moves.
        fall_manager: What it does when the robot falls.
        push_recovery: What it does when the robot is pushed.
        orthogonal: Distance to obstacles ahead [m].
        tangential: And beside [m].
    """

    def __init__(self, body: Body, *, consent: bool) -> None:
        self._body = body
        self._consent = consent
        self.self_collision = dict.fromkeys(ARMS, True)
        self.external = dict.fromkeys(("Move", *ARMS), True)
        self.diagnosis = self.smart_stiffness = True
        self.fall_manager = self.push_recovery = True
        self.orthogonal, self.tangential = 0.4, 0.1

    def arms(self, name: object, where: str) -> tuple[str, ...]:
        """The arms that "LArm", "RArm" or "Arms" stands for.

        Raises:
            CallError: Another name.
        """
        if name == "Arms":
            return ARMS
        if name in ARMS:
            return (str(name),)
        raise CallError(where, f"unknown chain name: {name} (possible: Arms, LArm, RArm)")

    def externals(self, name: object, where: str) -> tuple[str, ...]:
        """The parts of the external collision protection that a name stands for.

        Raises:
            CallError: Another name.
        """
        if name == "All":
            return tuple(self.external)
        if name == "Move":
            return ("Move",)
        if name == "Arms" or name in ARMS:
            return self.arms(name, where)
        raise CallError(where, f"unknown name: {name} (possible: All, Move, Arms, LArm, RArm)")

    def check_consent(self, enable: bool, where: str) -> None:
        """Before a critical reflex is switched off.

        Raises:
            CallError: The owner has not consented.
        """
        if not enable and not self._consent:
            raise CallError(where, CONSENT)

    def wake_up(self) -> None:
        """What waking up switches on again: all but diagnosis effect and smart stiffness."""
        self.self_collision = dict.fromkeys(ARMS, True)
        self.external = dict.fromkeys(("Move", *ARMS), True)
        self.fall_manager = self.push_recovery = True

    @property
    def joints(self) -> frozenset[int]:
        """Whose angles are written in every cycle."""
        if self.diagnosis:
            return frozenset(self._body.groups["Body"])
        held: set[int] = set()
        for arm in ARMS:
            if self.self_collision[arm] or self.external[arm]:
                held.update(self._body.chains[arm])
        if self.fall_manager or self.push_recovery:
            held.update(self._body.legs)
        return frozenset(held)

    @property
    def wheels(self) -> bool:
        """Whether the speeds of the wheels are written in every cycle."""
        return self.external["Move"] or self.push_recovery
