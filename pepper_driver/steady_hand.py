"""A hand on a simulated robot that pulls no harder than the robot stands."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends.simulated import Hand
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.support_polygon import SupportPolygon

MAX_TIPPING = 0.8
"""Moment of the hand over the one that would lift a wheel, at most; as for pushes of an experiment."""

MIN_FORCE = 1.0
"""[N] that a hand may always give."""


class Stance(Protocol):
    """Stance of a simulated robot: its :class:`pepper_driver.backends.simulated.Truth`, or what is reported of it."""

    @property
    def position(self) -> FloatArray:
        """(17,) link-side joint positions [rad]."""

    @property
    def base(self) -> FloatArray:
        """(3,) x, y [m], yaw [rad] of the base in the world."""


class SteadyHand:
    """Hand of a person, bounded by what would tip the robot; otherwise as :class:`pepper_driver.backends.Hand`.

    Args:
        hand: Of the backend.
        stance: Of the simulated robot, always the newest; None for one on a fixed base, which cannot tip over.
        robot: Its description.
        max_force: What the hand can do [N] where the robot stands firmly.

    Attributes:
        limited: True where the bound is less than the hand could do.
        max_force: What it may do now [N].
    """

    def __init__(
        self, hand: Hand, stance: Stance | None, robot: RobotConfig, *, max_force: float
    ) -> None:
        self._hand, self._stance, self._robot = hand, stance, robot
        self._strength = self.max_force = max_force
        self.limited = False

    def move(self, position: ArrayLike) -> None:
        """Set where the hand is to go, (3,) in the world [m]; to be repeated within its timeout.

        Raises:
            CommandError: Not finite numbers.
        """
        goal = np.asarray(position, dtype=np.float64)
        stance = self._stance
        if stance is not None and goal.shape == (3,) and np.isfinite(goal).all():
            point = self._hand.point
            # The force points to the hand, which comes to the goal later.
            bound = min(self._bound(stance, point, to) for to in (goal, self._hand.position))
            self.limited = bound < self._strength
            self.max_force = min(bound, self._strength)
        self._hand.move(position, max_force=self.max_force)

    def _bound(self, stance: Stance, point: FloatArray, goal: FloatArray) -> float:
        """Return the force [N] at a point towards a place, (3,) in the world [m], that the robot stands."""
        x, y, yaw = stance.base
        cos, sin = np.cos(yaw), np.sin(yaw)
        world_to_base = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        way = world_to_base @ (goal - point)
        distance = float(np.linalg.norm(way))
        if distance == 0.0:
            return self._strength
        ratio = SupportPolygon.from_robot(self._robot).tipping_ratio(
            stance.position, world_to_base @ (point - [x, y, 0.0]), way / distance
        )
        return max(MIN_FORCE, MAX_TIPPING / ratio) if ratio > 0.0 else self._strength

    def release(self) -> None:
        """Let go."""
        self._hand.release()

    @property
    def holds(self) -> bool:
        """True until it has let go."""
        return self._hand.holds

    @property
    def force(self) -> FloatArray:
        """(3,) force on the robot in the last step of physics, in the world [N]."""
        return self._hand.force

    @property
    def point(self) -> FloatArray:
        """(3,) where it holds the link, in the world [m]."""
        return self._hand.point
