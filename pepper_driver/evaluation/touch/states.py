"""States in which people touch a robot, by the names of the suites; each moves it as a program of a user would."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pepper_driver.backends.fields import Measurement
from pepper_driver.config import ControllerSettings, RobotConfig, load_controller_settings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.settings import AttentiveSettings
from pepper_driver.controller import Tick
from pepper_driver.controller.tasks import PositionTask
from pepper_driver.observer import JointState, Observation, Observer
from pepper_driver.observers import friction_errors
from pepper_driver.reflexes import Comply, Reflex, ReflexRequests, StopBase
from pepper_driver.robot import Pepper

ARMS_AND_HEAD = ("head", "left_arm", "right_arm")

LOWERED_STIFFNESS = 0.6
"""Of the motors of arms and head in the state ``lowered``."""

GESTURE: dict[str, tuple[float, float]] = {
    "HeadYaw": (-0.5, 0.5),
    "HeadPitch": (-0.3, 0.1),
    "LShoulderPitch": (0.6, 1.4),
    "LShoulderRoll": (0.1, 0.5),
    "LElbowYaw": (-1.4, -0.5),
    "LElbowRoll": (-1.3, -0.5),
    "LWristYaw": (-0.8, 0.4),
    "LHand": (0.2, 0.9),
}
"""Range of each joint in gestures [rad]; the right arm mirrors it."""

BREATH: dict[str, float] = {
    "HipPitch": 0.012,
    "HeadPitch": 0.02,
    "LShoulderPitch": 0.03,
    "LShoulderRoll": 0.02,
    "LElbowRoll": 0.03,
}
"""Amplitude of each joint that breathes [rad]; the right arm mirrors it."""

BREATHS = 0.25
"""[1/s]"""

WORKSPACE = ((0.2, 0.38), (0.1, 0.32), (-0.05, 0.2))
"""[m] Box of the left hand's goals in the frame of the torso; the right hand mirrors it."""


class State:
    """The robot stands in its first posture and was never moved; base of the other states.

    Attributes:
        period: Time between two calls of :meth:`advance` [s].
        lead: Time of its own before the first touch [s].
        world: Of the simulation.
        speed: Of the changes of the posture: stiffness of the posture task [1/s2].
        reacts: True if its reflexes answer to what the robot's own observer detects.
    """

    period = math.inf
    lead = 0.0
    world = "empty"
    speed: float | None = None
    reacts = False

    def __init__(self, robot: RobotConfig, generator: np.random.Generator) -> None:
        self.robot, self.generator = robot, generator

    def reflexes(self) -> Sequence[Reflex]:
        """Return the reflexes of the robot."""
        return ()

    def controller(
        self, models: Path | None, attentive: AttentiveSettings | None = None
    ) -> ControllerSettings | None:
        """Return the settings of the controller of a robot with these models; None for the shipped ones.

        Args:
            models: Of the robot; None for none.
            attentive: Oscillation of an attentive robot; None for the shipped one.
        """
        return None

    def begin(self, pepper: Pepper) -> None:
        """Start what it does, before the first tick."""

    def advance(self, pepper: Pepper, time: float) -> None:
        """Continue at ``time`` [s] since the first tick."""

    def next_period(self) -> float:
        """Return the time until the next call of :meth:`advance` [s]."""
        return self.period

    def goals(self, ranges: dict[str, tuple[float, float]]) -> dict[str, float]:
        """Draw a goal of each joint, evenly."""
        return {joint: float(self.generator.uniform(*ends)) for joint, ends in ranges.items()}

    def middle(self, chains: Sequence[str], fraction: float) -> dict[str, tuple[float, float]]:
        """Return the middle ``fraction`` of the range of each joint of some chains."""
        ranges = {}
        for name in (joint for chain in chains for joint in self.robot.chains[chain]):
            joint = self.robot.joints[self.robot.joint_index(name)]
            centre, half = (joint.upper + joint.lower) / 2, (joint.upper - joint.lower) / 2
            ranges[name] = (centre - fraction * half, centre + fraction * half)
        return ranges

    def mirrored(self, values: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        """Return ranges of the left arm with those of the right one."""
        robot, both = self.robot, dict(values)
        for name, (low, high) in values.items():
            other, sign = robot.mirror[robot.joint_index(name)]
            both[robot.joint_names[other]] = (low, high) if sign > 0 else (-high, -low)
        return both


class AfterMotion(State):
    """It moves for a while, then stands in a posture that it came to."""

    period, lead, speed = 3.0, 21.0, 12.0

    def advance(self, pepper: Pepper, time: float) -> None:
        """Set goals of arms and head until it is to stand."""
        if time < self.lead - 2 * self.period:
            pepper.set_posture(self.goals(self.middle(ARMS_AND_HEAD, 0.7)), stiffness=self.speed)


class Attentive(State):
    """It stands attentive: as ``Pepper.attentive`` has it, with the robot's own models."""

    def controller(
        self, models: Path | None, attentive: AttentiveSettings | None = None
    ) -> ControllerSettings | None:
        """Return settings with the friction of its joints."""
        settings = load_controller_settings(self.robot)
        if attentive is not None:
            settings = replace(settings, attentive=attentive)
        return settings.with_friction(friction_errors(models))

    def begin(self, pepper: Pepper) -> None:
        """Switch it on."""
        pepper.attentive = True


class Breathing(State):
    """Hips, head and arms go to and fro, as people breathe."""

    period, speed = 0.06, 60.0

    def begin(self, pepper: Pepper) -> None:
        """Find the posture to breathe in."""
        sizes = self.mirrored({joint: (size, size) for joint, size in BREATH.items()})
        self._sizes = {joint: size for joint, (size, _) in sizes.items()}
        self._centre = {joint: pepper.target[joint] for joint in sizes}

    def advance(self, pepper: Pepper, time: float) -> None:
        """Set the posture of now."""
        phase = math.sin(2.0 * math.pi * BREATHS * time)
        posture = {joint: self._centre[joint] + size * phase for joint, size in self._sizes.items()}
        pepper.set_posture(posture, stiffness=self.speed)


class Gesturing(State):
    """Arms and head go to new goals every second or so, as if it spoke."""

    speed = 14.0
    period = 1.0

    def next_period(self) -> float:
        """Return the time until the next gesture [s]."""
        return float(self.generator.uniform(0.8, 2.0))

    def advance(self, pepper: Pepper, time: float) -> None:
        """Begin a gesture."""
        pepper.set_posture(self.goals(self.mirrored(GESTURE)), stiffness=self.speed)


class WholeBody(State):
    """All joints go to new goals every three seconds, the legs a little."""

    period, speed = 3.0, 8.0

    def advance(self, pepper: Pepper, time: float) -> None:
        """Set new goals."""
        ranges = {**self.middle(ARMS_AND_HEAD, 0.7), **self.middle(("legs",), 0.08)}
        pepper.set_posture(self.goals(ranges), stiffness=self.speed)


class Cartesian(State):
    """Both hands go to places before the robot."""

    period = 2.5

    def begin(self, pepper: Pepper) -> None:
        """Add the tasks."""
        self._tasks = tuple(
            PositionTask(link, root="torso", robot=self.robot) for link in ("l_wrist", "r_wrist")
        )
        with pepper.changes():
            for task, place in zip(self._tasks, self._places(), strict=True):
                task.target = place
                pepper.add(task)

    def _places(self) -> tuple[FloatArray, FloatArray]:
        left, right = (
            np.array([self.generator.uniform(*ends) for ends in WORKSPACE]) for _ in "lr"
        )
        return left, right * [1.0, -1.0, 1.0]

    def advance(self, pepper: Pepper, time: float) -> None:
        """Set new places."""
        with pepper.changes():
            for task, place in zip(self._tasks, self._places(), strict=True):
                task.target = place


class Driving(State):
    """The base drives to and fro and turns; the arms are bent and at rest."""

    period = 3.0

    def begin(self, pepper: Pepper) -> None:
        """Bend the arms."""
        bent = {"LShoulderPitch": 1.0, "LElbowRoll": -1.0}
        arms = self.mirrored({joint: (angle, angle) for joint, angle in bent.items()})
        pepper.set_posture({joint: angle for joint, (angle, _) in arms.items()}, duration=1.5)

    def advance(self, pepper: Pepper, time: float) -> None:
        """Drive on, or stand still one time in four."""
        if self.generator.uniform() < 0.25:
            pepper.drive(0.0, 0.0, 0.0, hold=True)
            return
        angle, speed = self.generator.uniform(-math.pi, math.pi), self.generator.uniform(0.05, 0.15)
        turn = float(self.generator.uniform(-0.4, 0.4))
        pepper.drive(speed * math.cos(angle), speed * math.sin(angle), turn, hold=True)


class WithReflexes(State):
    """It stands; the joints of a touched arm comply, and the base stops."""

    reacts = True

    def reflexes(self) -> Sequence[Reflex]:
        """Return the reflexes."""
        return (Comply(limb=("left_arm", "right_arm")), StopBase())


class Deaf(Observer):
    """Observer that detects nothing: reflexes are asked only where there is one."""

    def __init__(self, joints: int) -> None:
        unknown = np.full(joints, np.nan)
        self._nothing = Observation(
            contacts=(),
            expected=unknown,
            residual=unknown,
            threshold=unknown,
            torque=unknown,
            torque_std=unknown,
            state=np.full(joints, JointState.BLIND, dtype=np.int8),
        )

    def step(self, tick: Tick) -> Observation:
        """Detect nothing."""
        return self._nothing

    def reset(self) -> None:
        """Do nothing."""

    def describe(self) -> str:
        """Return one line."""
        return "detects nothing"


class _LowerStiffness(Reflex):
    """Lower the stiffness of arms and head, touched or not."""

    def step(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        """Request it in every tick."""
        names = [joint for chain in ARMS_AND_HEAD for joint in self.robot.chains[chain]]
        mask = np.isin(self.robot.joint_names, names)
        requests.lower_stiffness(mask, LOWERED_STIFFNESS)


class Lowered(State):
    """It stands, and the motors of arms and head are less stiff."""

    def reflexes(self) -> Sequence[Reflex]:
        """Return the reflex that lowers it."""
        return (_LowerStiffness(),)


class Table(State):
    """The arms are raised forward, and a forearm meets the edge of a table."""

    world, period = "table", 4.0

    def begin(self, pepper: Pepper) -> None:
        """Let the arms hang."""
        self._raised = True

    def advance(self, pepper: Pepper, time: float) -> None:
        """Raise the arms, or let them hang."""
        self._raised = not self._raised
        angle = 0.7 if self._raised else 1.5
        pepper.set_posture({"LShoulderPitch": angle, "RShoulderPitch": angle}, duration=2.5)


STATES: dict[str, type[State]] = {
    "standing": State,
    "after-motion": AfterMotion,
    "attentive": Attentive,
    "breathing": Breathing,
    "gesturing": Gesturing,
    "whole-body": WholeBody,
    "cartesian": Cartesian,
    "driving": Driving,
    "reflexes": WithReflexes,
    "lowered": Lowered,
    "table": Table,
}
"""By name."""

STANDING = ("standing", "after-motion", "attentive", "reflexes", "lowered")
"""States in which no program moves the robot; of results, the others are `in motion`."""
