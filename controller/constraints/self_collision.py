"""Self-collision: pairs of links keep their distance, now and on the whole path to rest.

The distance of two capsules is that of their axes minus their radii. Its gradient is n' (J2 - J1), with n the direction
from the first to the second where they are nearest, and both Jacobians for that point: as a wrench f = (n, p x n) along
the line of the two nearest points, f' J over the joints between the two links. It stays defined where capsules overlap.

Distances and gradients are computed on the path to rest (``braking.py``), not at the present position. That path can be
0.15 rad per joint, over which a linearised distance has an error of centimetres. Only the effect of an acceleration in
this cycle on that path is linearised, 0.03 rad at most. The end of the path alone is not enough: arms that brake past
each other are nearer before its end. A robot that satisfies the rows can satisfy them in the next cycle too: it brakes.

Two capsules that start nearer than the security distance are separated at most at the recovery speed.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import inf

import numpy as np
import pinocchio as pin

from pepper_driver.config import RobotConfig, SelfCollisionSettings, load_self_collision
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import Out, kernel
from pepper_driver.controller.collision import CapsuleDistances
from pepper_driver.controller.constraints.braking import BRAKE_RATIO, BrakingPath
from pepper_driver.controller.constraints.constraint import (
    MIN_ROW_SIZE,
    BrakingLimits,
    Constraint,
    LinearInequality,
    stack,
)
from pepper_driver.controller.model import BASE, RobotModel

CHECKED_CYCLES = (1.0, 3.0)
"""Cycles of braking after which distances are checked, in addition to rest."""

MONITORED_CYCLES = 20
"""Cycles in which the whole path is checked after a pair was near at its end: longer than braking takes."""


@kernel
def _on_path(
    q: FloatArray,
    distance: FloatArray,
    gain: FloatArray,
    acceleration: FloatArray,
    displaced: Out[FloatArray],
) -> None:
    """Write the configuration at a point of the path to rest, but for the base: it carries both links of a pair."""
    ahead = len(q) - len(distance)
    displaced[: BASE + ahead] = q[: BASE + ahead]
    for i in range(BASE, len(distance)):
        displaced[i + ahead] = q[i + ahead] + (distance[i] + gain[i] * acceleration[i])


@checked_arguments
class SelfCollision(Constraint):
    """Security distance between pairs of links.

    Args:
        robot: Its description.
        settings: Capsules, pairs and distances; by default those of ``self_collision.yaml``.

    Raises:
        ConfigError: The shipped settings do not fit the robot.
    """

    name = "self-collision"
    priority = 2
    needs_kinematics = False
    lazy = True

    def __init__(self, robot: RobotConfig, settings: SelfCollisionSettings | None = None) -> None:
        self.settings = settings = settings or load_self_collision(robot)
        model = RobotModel(robot)
        self._pin, self._data = model.pin, model.data
        self._capsules = CapsuleDistances(model, settings)
        self._displaced, self._still = np.zeros(model.pin.nq), np.zeros(model.nv)
        self._on_path = _on_path.load()
        self._names = tuple(f"{self.name} {pair}" for pair in self._capsules.names)
        self._limit = np.full(len(self._names), settings.security_distance)
        self._rest = BrakingPath(model.nv, inf)
        self._braking_points = [
            (cycles, BrakingPath(model.nv, cycles)) for cycles in CHECKED_CYCLES
        ]
        self._prepared: BrakingLimits | None = None
        self._monitored_cycles = 0

    def is_satisfied(
        self, model: RobotModel, braking_limits: BrakingLimits, acceleration: FloatArray
    ) -> bool:
        """Check that all pairs keep the security distance until rest, after a cycle with (20,) accelerations."""
        if braking_limits is not self._prepared:
            self._prepare(braking_limits)
        rest, capsules, settings = self._rest, self._capsules, self.settings
        rest.update(model.v, self._brake, braking_limits.dt)
        self._go(rest, model.q, acceleration)
        if not capsules.any_near(settings.interaction_distance):
            if not self._monitored_cycles:
                return True
            self._monitored_cycles -= 1
        else:
            self._monitored_cycles = MONITORED_CYCLES
            if capsules.any_near(settings.security_distance):
                return False
        for place in self._before_rest(model, braking_limits):
            self._go(place, model.q, acceleration)
            if capsules.any_near(settings.security_distance):
                return False
        return True

    def compute_inequality(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> LinearInequality | None:
        """Return rows for the distances on the path to rest, of pairs that an acceleration could bring too near."""
        if braking_limits is not self._prepared:
            self._prepare(braking_limits)
        self._rest.update(model.v, self._brake, braking_limits.dt)
        limit = self._limit_now(model, braking_limits.dt)
        places = (self._rest, *self._before_rest(model, braking_limits))
        parts = [self._rows_at(place, model.q, limit) for place in places]
        found = [part for part in parts if part is not None]
        return stack(found) if found else None

    def _before_rest(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> Iterator[BrakingPath]:
        """Yield the checked points of the path to rest before its end."""
        max_time = self._rest.max_time
        for cycles, place in self._braking_points:
            if max_time > cycles * braking_limits.dt:  # else the robot is at rest by then
                place.update(model.v, self._brake, braking_limits.dt)
                yield place

    def _go(self, place: BrakingPath, q: FloatArray, acceleration: FloatArray) -> None:
        """Place the capsules at a point of the path to rest, after a cycle with (20,) accelerations."""
        self._on_path(q, place.distance, place.gain, acceleration, self._displaced)
        self._capsules.place(self._displaced)

    def _prepare(self, braking_limits: BrakingLimits) -> None:
        self._brake = braking_limits.brake
        # Rows must consider all accelerations within their limits, not only braking.
        self._acceleration = self._brake / BRAKE_RATIO
        self._reach = self._capsules.levers * self._acceleration
        self._prepared = braking_limits

    def _limit_now(self, model: RobotModel, dt: float) -> FloatArray:
        """Return the (pairs,) least distances [m]: smaller than the security distance for pairs that start nearer."""
        capsules, settings = self._capsules, self.settings
        capsules.place(model.q)
        if not capsules.any_near(settings.security_distance):
            return self._limit
        recovered = capsules.distances() + settings.recovery_speed * dt
        return np.minimum(recovered, settings.security_distance)

    def _rows_at(
        self, place: BrakingPath, q: FloatArray, limit: FloatArray
    ) -> LinearInequality | None:
        """Return rows for one point of the path, without those that no acceleration within its limits violates."""
        capsules, data, gain = self._capsules, self._data, place.gain
        self._go(place, q, self._still)
        if not capsules.any_near(self.settings.interaction_distance):
            return None
        room = capsules.distances() - limit
        near = np.flatnonzero(room < self._reach @ gain)
        if not len(near):
            return None
        pin.computeJointJacobians(self._pin, data, self._displaced)
        matrix = capsules.wrenches(near) @ data.J
        matrix *= capsules.signs[near]
        matrix *= -gain
        size, room = np.abs(matrix), room[near]
        relevant = (room < size @ self._acceleration) & (size.max(axis=1) > MIN_ROW_SIZE)
        if not relevant.any():
            return None
        # Solvers judge rows by one tolerance, which suits entries near 1.
        scale = 1.0 / size[relevant].max(axis=1)
        names = tuple(self._names[pair] for pair in near[relevant])
        return LinearInequality(matrix[relevant] * scale[:, None], room[relevant] * scale, names)
