"""What joints do while nobody uses them: nothing, hold a posture, breathe, look around. NAOqi 2.8 page "Idle"."""

from __future__ import annotations

from math import pi, sin
from random import Random

from pepper_driver.backends.naoqi_server.motion.body import Body, CallError
from pepper_driver.config import NaoqiServices, RobotConfig

GROUPS = {
    "Body": ("Head", "LArm", "Leg", "RArm"),
    "Legs": ("Leg",),
    "Arms": ("LArm", "RArm"),
    "LArm": ("LArm",),
    "RArm": ("RArm",),
    "Head": ("Head",),
}
"""Chains by the names that the calls take."""


class Idle:
    """Which chains breathe or keep a posture, and where idle joints are to be now.

    Attributes:
        breathing: Chains that breathe because of a call.
        posture: Chains that go back to the posture Stand.
        alive: Whether a living robot moves by itself: all chains breathe.
        looking: Whether a living robot looks around.
    """

    def __init__(self, config: RobotConfig, settings: NaoqiServices, body: Body) -> None:
        self._settings = settings
        self._stand = config.posture("Stand").tolist()
        self._chain_of = {index: chain for chain, joints in body.chains.items() for index in joints}
        self._weights = {
            config.joint_index(joint): weight * settings.breathing.amplitude
            for joint, weight in settings.breathing.joints.items()
        }
        self._head = (config.joint_index("HeadYaw"), config.joint_index("HeadPitch"))
        self._random = Random(0)  # the same robot every time
        self._glance = dict.fromkeys(self._head, 0.0)
        self._glances = -1
        self.breathing: set[str] = set()
        self.posture: set[str] = set()
        self.alive = self.looking = False

    def chains(self, name: object, where: str) -> tuple[str, ...]:
        """The chains that a call's name stands for.

        Raises:
            CallError: Another name.
        """
        if not isinstance(name, str) or name not in GROUPS:
            raise CallError(where, f"unknown chain name: {name} (possible: {', '.join(GROUPS)})")
        return GROUPS[name]

    def moves(self, joint: int) -> bool:
        """Whether a joint that nobody uses is moved by this now."""
        chain = self._chain_of[joint]
        breathes = chain in self.breathing or self.alive
        return breathes or chain in self.posture or (self.looking and joint in self._head)

    def target(self, joint: int, anchor: float, time: float) -> float:
        """Where an idle joint is to be at a time [s], where ``anchor`` is the angle it was left at."""
        if self.looking and joint in self._head:
            self._look(time)
            return self._glance[joint]
        chain = self._chain_of[joint]
        if chain in self.posture and chain not in self.breathing:
            return float(self._stand[joint])
        phase = 2 * pi * time / self._settings.breathing.period
        return anchor + self._weights.get(joint, 0.0) * sin(phase)

    def _look(self, time: float) -> None:
        """Choose another direction when it is time for it."""
        glance = self._settings.glance
        number = int(time / glance.period)
        if number != self._glances:
            self._glances = number
            yaw = self._random.uniform(-glance.yaw, glance.yaw)
            pitch = self._random.uniform(-glance.pitch, glance.pitch)
            self._glance = dict(
                zip(self._head, (yaw, self._stand[self._head[1]] + pitch), strict=True)
            )
