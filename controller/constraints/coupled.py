"""Position limits that depend on another joint: HeadPitch's on HeadYaw, ElbowRoll's on ElbowYaw.

An upper limit is phi <= f(theta), with f linear between the rows of a table. A lower limit is an upper one with the
sign of the driven joint reversed. Each joint on its path to rest moves in one direction, but for different times. The
path may therefore be anywhere in the rectangle between the present position and rest. The whole rectangle must be in
the region. With phi* the furthest position of the driven joint, theta+ the driver after this cycle and theta* the
driver at rest, every cycle requires

    phi* <= f(theta+)  and  phi* <= f(theta*),

which is enough for the whole rectangle if f rises to one peak and falls from it, as the limits of Pepper do. Braking
makes the rectangle smaller, so a condition that holds now can hold in every later cycle.

phi* and theta* are not linear in the acceleration; phi* is convex. Its chord over all accelerations of the joint lies
above it, so rows of chords are never too lenient. They are too strict by at most a dt^2 / 2 of each joint, a
milliradian: joints come to rest that much before the limit.

The region is not convex. f is the maximum of several concave pieces, each the minimum of some lines. The rows are the
lines of the piece that is the highest where the joints would come to rest if they braked now. They let the joints
cross from one piece to the next wherever both allow it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import inf

import numpy as np

from pepper_driver.config import ConfigError, RobotConfig
from pepper_driver.config.arguments import checked_arguments, is_number
from pepper_driver.controller.constraints.braking import BRAKE_RATIO
from pepper_driver.controller.constraints.constraint import (
    BrakingLimits,
    Constraint,
    LinearInequality,
)
from pepper_driver.controller.errors import LimitError
from pepper_driver.controller.model import RobotModel

Line = tuple[float, float, float, float]
"""Slope, value at 0 [rad]; first and last angle of the driver at which it is the limit [rad]."""

Row = tuple[str, int, float, int, float, float]
"""Name; column and entry of the driven joint, and of the driver; bound."""

SLOPE_TOLERANCE = 1e-6
"""[rad], or as a slope: nearer limits are the same one, written with fewer digits."""


class Span:
    """Distance of a joint in one direction until it rests, as a function of its acceleration in this cycle.

    Args:
        acceleration: Limit [rad/s2].
        dt: Cycle [s].
    """

    def __init__(self, acceleration: float, dt: float) -> None:
        self.acceleration, self.dt = acceleration, dt
        self.brake = BRAKE_RATIO * acceleration
        self._step = acceleration * dt
        self._half = self._step * dt / 2
        # Bound of `furthest` at speed |v| for any acceleration: a polynomial, for a quick check.
        self.far = (
            self._half + self._step**2 / (2 * self.brake) + self.brake * dt**2 / 2,
            dt + self._step / self.brake,
            1 / (2 * self.brake),
        )

    def stopping_distance(self, velocity: float) -> float:
        """Return the distance to rest [rad] from a velocity [rad/s]; 0 for a negative one."""
        if velocity <= self.brake * self.dt:
            return velocity * self.dt if velocity > 0 else 0.0
        return velocity**2 / (2 * self.brake) + self.brake * self.dt**2 / 2

    def furthest(self, velocity: float) -> tuple[float, float, float]:
        """Return constant [rad] and gain [s2] of the chord: the largest distance is at most constant + gain * a.

        The third value is the acceleration that brakes, and leads on to the slow return of a joint beyond a limit,
        b dt / 2 [rad/s2].
        """
        dt, step, limit = self.dt, self._step, self.acceleration
        least = velocity * dt - self._half + self.stopping_distance(velocity - step)
        most = velocity * dt + self._half + self.stopping_distance(velocity + step)
        back = max(-limit, min(limit, -self.brake / 2 - velocity / dt))
        return (most + least) / 2, (most - least) / (2 * limit), back

    def rest(self, velocity: float) -> tuple[float, float, float]:
        """Return the distances to the end of this cycle and to rest, braking at the limit [rad]; its acceleration."""
        change = max(-self._step, min(self._step, -velocity))
        after = velocity + change
        end = (velocity + change / 2) * self.dt
        return (
            end,
            end + self.stopping_distance(after) - self.stopping_distance(-after),
            change / self.dt,
        )


class Ceiling:
    """Upper limit of the driven joint, linear between the points of a table.

    Args:
        driver: Angles of the driver, increasing [rad].
        limit: Limit of the driven joint at each [rad].

    Raises:
        ConfigError: The angles do not increase, or the limit has more than one peak.
    """

    def __init__(self, driver: Sequence[float], limit: Sequence[float]) -> None:
        points = list(zip(driver, limit, strict=True))
        slopes = []
        for (x0, y0), (x1, y1) in pairwise(points):
            if x1 <= x0:
                raise ConfigError(
                    "a coupled limit: the driver's angles must increase from row to row"
                )
            slopes.append((y1 - y0) / (x1 - x0))
        falling = False
        for slope in slopes:
            if falling and slope > SLOPE_TOLERANCE:
                raise ConfigError("a coupled limit: it must rise to one peak and fall from it")
            falling = falling or slope < -SLOPE_TOLERANCE
        self.tightest = min(limit)
        self._ends: list[float] = []
        self._pieces: list[list[Line]] = []
        for i, slope in enumerate(slopes):
            first = points[i][0] if i else -np.inf
            last = points[i + 1][0] if i + 1 < len(slopes) else np.inf
            line = (slope, points[i][1] - slope * points[i][0], first, last)
            if i and slope <= slopes[i - 1] + SLOPE_TOLERANCE:
                self._pieces[-1].append(line)
            else:
                if i:
                    self._ends.append(points[i][0])
                self._pieces.append([line])

    def piece(self, driver: float) -> list[Line]:
        """Return the lines of the concave piece that holds at an angle of the driver [rad]."""
        for end, lines in zip(self._ends, self._pieces, strict=False):
            if driver < end:
                return lines
        return self._pieces[-1]


class CoupledPair:
    """Driven joint and its driver, with the limits of one ``CoupledLimit`` minus the margin."""

    def __init__(self, robot: RobotConfig, index: int, margin: float) -> None:
        limit = robot.limits.coupled[index]
        driver, lower, upper = zip(*limit.table, strict=True)
        self.name = f"{limit.driven} by {limit.driver}"
        self.driver, self.driven = (
            robot.joint_index(limit.driver),
            robot.joint_index(limit.driven),
        )
        top, bottom = robot.upper[self.driven], -robot.lower[self.driven]
        sides = [(1.0, upper, float(top)), (-1.0, [-x for x in lower], float(bottom))]
        # A limit that is nowhere tighter than that of the joint alone is left to the acceleration bounds; so is a
        # single line of a limit.
        self.sides = [
            (sign, Ceiling(driver, [x - margin for x in limits]), own - margin - SLOPE_TOLERANCE)
            for sign, limits, own in sides
            if min(limits) < own - SLOPE_TOLERANCE
        ]
        self.high = min((c.tightest for sign, c, _ in self.sides if sign > 0), default=np.inf)
        self.low = -min((c.tightest for sign, c, _ in self.sides if sign < 0), default=np.inf)


@checked_arguments
class CoupledLimits(Constraint):
    """Region of coupled joints between their common limits.

    Joints that start outside return at a few hundredths of a radian per second, as with limits of single joints. They
    return faster if a task requests it. With ``jerk_limit`` set, joints cannot brake at once: rows may then be violated
    for some cycles.

    Args:
        robot: Description with the coupled limits.
        margin: Distance from them [rad].

    Raises:
        ConfigError: A table that is not increasing in the driver, or has a limit with more than one peak.
        LimitError: A margin that is negative or not finite.
    """

    name = "coupled limits"
    priority = 3
    needs_kinematics = False

    def __init__(self, robot: RobotConfig, margin: float = 0.005) -> None:
        if not (is_number(margin) and 0.0 <= margin < inf):
            raise LimitError("margin", margin, "a finite angle that is not negative")
        self._pairs = [CoupledPair(robot, i, margin) for i in range(len(robot.limits.coupled))]
        self._prepared: tuple[RobotModel, BrakingLimits] | None = None
        self._quick_checks: list[tuple[int, int, float, float, float, float, float]] = []

    def _prepare(self, model: RobotModel, braking_limits: BrakingLimits) -> None:
        """Prepare columns and accelerations."""
        self._prepared = (model, braking_limits)
        self._offset = len(model.q) - model.nv
        self._columns, self._quick_checks, self._spans = [], [], []
        for number, pair in enumerate(self._pairs):
            driver, driven = (int(model.joint_columns[i]) for i in (pair.driver, pair.driven))
            spans = [
                Span(float(braking_limits.acceleration[i]), braking_limits.dt)
                for i in (driver, driven)
            ]
            self._columns.append((driver, driven))
            self._spans.append((spans[0], spans[1]))
            self._quick_checks.append((number, driven, pair.low, pair.high, *spans[1].far))

    def compute_inequality(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> LinearInequality | None:
        """Return rows of the lines that joints could exceed; None while the driven joints are far from all of them."""
        if (
            self._prepared is None
            or self._prepared[0] is not model
            or self._prepared[1] is not braking_limits
        ):
            self._prepare(model, braking_limits)
        position, velocity, offset = model.q.item, model.v.item, self._offset
        found: list[Row] = []
        for number, driven, low, high, far, gain, bend in self._quick_checks:
            phi, speed = position(driven + offset), abs(velocity(driven))
            far += speed * (gain + speed * bend)
            if not low + far <= phi <= high - far:
                self._find(number, model, found)
        if not found:
            return None
        matrix, bound = np.zeros((len(found), model.nv)), np.zeros(len(found))
        for i, (_, driven, entry, driver, other, most) in enumerate(found):
            matrix[i, driven], matrix[i, driver], bound[i] = entry, other, most
        return LinearInequality(matrix, bound, tuple(row[0] for row in found))

    def _find(self, number: int, model: RobotModel, found: list[Row]) -> None:
        """Append the rows of one pair, in units of the driven joint's acceleration."""
        pair, (driver, driven) = self._pairs[number], self._columns[number]
        driver_span, driven_span = self._spans[number]
        theta, w = model.q.item(driver + self._offset), model.v.item(driver)
        phi, v = model.q.item(driven + self._offset), model.v.item(driven)
        limit, driver_limit = driven_span.acceleration, driver_span.acceleration
        end, rest, braking = driver_span.rest(w)
        up, down = driver_span.furthest(w), driver_span.furthest(-w)
        # Range that the driver can reach: lines of other segments of the table do not act.
        first = theta - (down[0] + down[1] * driver_limit)
        last = theta + up[0] + up[1] * driver_limit
        for sign, ceiling, level in pair.sides:
            constant, gain, back = driven_span.furthest(sign * v)
            constant += sign * phi
            if constant + gain * limit <= ceiling.tightest:
                continue
            here, there = ceiling.piece(theta + end), ceiling.piece(theta + rest)
            # At rest, only lines in the direction of motion act, or all if that is in the same piece.
            lines = [(line, True) for line in there if here is there or line[0] * w <= 0]
            if here is not there:
                lines += [(line, False) for line in here]
            for (slope, value, start, stop), at_rest in lines:
                if start > last or stop < first or (slope == 0.0 and value >= level):
                    continue
                if at_rest:
                    # The driver at its furthest in the direction in which the limit falls.
                    out, (distance, lever, slow) = (-1.0, down) if slope > 0 else (1.0, up)
                    known = constant - slope * (theta + out * distance)
                    lever, slow = -slope * lever, out * slow
                else:
                    known = constant - slope * (theta + w * driver_span.dt)
                    lever, slow = -slope * driver_span.dt**2 / 2, braking
                room = value - known
                if gain * limit + abs(lever) * driver_limit <= room:
                    continue
                # Braking and the slow return are always allowed: they are within the acceleration bounds.
                room = max(room, gain * back + lever * slow)
                found.append((pair.name, driven, sign, driver, lever / gain, room / gain))
