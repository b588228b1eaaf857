"""Balance: the robot must not tip over the lines between its wheels.

Motion: the zero moment point, the centre of pressure of the floor, must stay inside. About a line through e along t,
counter-clockwise round the triangle of the wheels, let H be the angular momentum of the robot, positive if it tips over
the line:

    H = t' ((c - e) x l + k),    dH/dt + m g d = b f,

with c the centre of mass, d its distance inside the line, l and k the momenta about it, f the vertical force of the
floor and b the distance inside the line of the zero moment point. With (l, k) = A v all terms are linear in the
accelerations: b >= moving margin is an exact row.

Rest: a braking distance as for other limits is not enough. The hardest braking of the joints may itself move the zero
moment point out, and after that the robot tips. As an inverted pendulum of height z the robot can be brought to rest if

    d - H / (m sqrt(g z)) >= margin,

This capture point moves outwards while it is outside the zero moment point (Pratt et al. 2006, Koolen et al. 2012). The
row is its condition after this cycle; at rest it requires the centre of mass inside. Only the motion of the joints
counts in it: a base with constant velocity carries the triangle with it.

One row bounds dH/dt of the joints from above, the other from below. The upper bound is widened as far as both together
require, so they do not exclude each other.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pepper_driver.config import RobotConfig
from pepper_driver.config.arguments import checked_arguments, is_number
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.constraints.constraint import (
    MIN_ROW_SIZE,
    BrakingLimits,
    Constraint,
    LinearInequality,
)
from pepper_driver.controller.errors import LimitError
from pepper_driver.controller.model import BASE, RobotModel
from pepper_driver.controller.support_polygon import WHEEL_LINK, wheel_triangle

GRAVITY = 9.81
"""[m/s2]"""

MIN_ZMP_RANGE = 0.005
"""[m] Range of the zero moment point, beyond its margin, that the row for rest must leave."""

BASE_RATIO = 0.5
"""Fraction of the acceleration of the base that the rows for rest and motion may require in a conflict."""

RETURN_RATIO = 0.3
"""Fraction of the acceleration of the joints with which the robot returns when the capture point is outside."""


class _Place(NamedTuple):
    """Place of the centre of mass between the edges, one entry for each edge.

    Attributes:
        height: Height of the centre of mass [m].
        inside: Its distance inside the edge [m].
        caught: The same minus the effect of a turn of the base [m].
        moments: (6,) moment about the edge of a force at the centre of mass and of a torque, in world axes.
    """

    height: float
    inside: list[float]
    caught: list[float]
    moments: list[list[float]]


def _product(a: list[float], b: list[float]) -> float:
    """Return the scalar product of two lists of six; the last entry of moments is zero."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4]


@checked_arguments
class Balance(Constraint):
    """Balance of the robot: zero moment point and centre of mass stay over the triangle of the wheels.

    Args:
        robot: Its description.
        margin: Distance inside the triangle within which the centre of mass can be brought to rest [m].
        moving_margin: Distance inside the triangle of the zero moment point [m], by default a third of ``margin``: it
            must be able to move beyond the centre of mass to bring it to rest.

    Attributes:
        corners: (3, 2) contact points of the wheels with the floor, in base_link [m], counter-clockwise.
        inwards: (3, 2) unit vectors across the edges that start at the corners.

    Raises:
        LimitError: A margin that is negative, not finite, or leaves no triangle; a moving margin above it.
    """

    name = "balance"
    priority = 4
    lazy = True

    def __init__(
        self, robot: RobotConfig, margin: float = 0.03, moving_margin: float | None = None
    ) -> None:
        model = RobotModel(robot)
        self.corners, self.inwards, names = _triangle(model)
        distances = np.einsum("ij,kij->ik", self.inwards, self.corners[:, None] - self.corners)
        inradius = 1 / (1 / distances.max(axis=1)).sum()
        if not (is_number(margin) and 0.0 <= margin < inradius):
            what = f"from 0 to {inradius:.3f} m, where the triangle of the wheels ends"
            raise LimitError("margin", margin, what)
        if moving_margin is None:
            moving_margin = margin / 3
        if not (is_number(moving_margin) and 0.0 <= moving_margin <= margin):
            raise LimitError("moving_margin", moving_margin, f"from 0 to the margin, {margin} m")
        self._names = tuple(
            f"balance {state}, {name}" for state in ("at rest", "moving") for name in names
        )
        # Per edge, as plain numbers: its inward normal and its offset along it. For three edges they are faster than
        # arrays.
        offset = (self.inwards * self.corners).sum(axis=1)
        self._edges = [(*n, o) for n, o in zip(self.inwards.tolist(), offset.tolist(), strict=True)]
        self._margin, self._moving_margin = margin, moving_margin
        self._mass = float(pin.computeTotalMass(model.pin))
        self._min_moment = MIN_ZMP_RANGE * self._mass * GRAVITY
        self._check_data = model.pin.createData()  # for accelerations that are only checked

    def is_satisfied(
        self, model: RobotModel, braking_limits: BrakingLimits, acceleration: FloatArray
    ) -> bool:
        """Check that zero moment point and capture point stay inside with (20,) accelerations."""
        data, dt = self._check_data, braking_limits.dt
        pin.computeCentroidalMomentumTimeVariation(model.pin, data, model.q, model.v, acceleration)
        place = self._place(model, data.com[0].tolist())
        force = data.dhg.vector.tolist()
        force[2] += self._mass * GRAVITY
        if any(_product(row, force) < self._moving_margin * force[2] for row in place.moments):
            return False
        velocity = model.v.copy()
        velocity[:BASE] = 0.0
        before = pin.ccrba(model.pin, data, model.q, velocity) @ velocity
        change = acceleration.copy()
        change[:BASE] = 0.0
        after = (before + data.Ag @ change * dt).tolist()
        rate, momentum = sqrt(GRAVITY / place.height), before.tolist()
        return all(
            _product(row, after) + _product(row, momentum) * rate * dt
            <= self._mass * place.height * rate * (d - self._margin)
            for row, d in zip(place.moments, place.caught, strict=True)
        )

    def compute_inequality(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> LinearInequality | None:
        """Return up to six rows, of the lines that an acceleration could reach."""
        acceleration, dt, data = braking_limits.acceleration, braking_limits.dt, model.data
        pin.ccrba(model.pin, data, model.q, model.v)
        pin.computeCentroidalMomentumTimeVariation(model.pin, data)
        full = data.Ag
        place = self._place(model, data.com[0].tolist())
        height, moments, inside = place.height, place.moments, place.inside
        matrix = np.empty((2 * len(moments), model.nv))
        outwards, moving = matrix[: len(moments)], matrix[len(moments) :]
        np.matmul(moments, full, outwards)
        np.subtract(self._moving_margin * full[2], outwards, moving)
        force = data.dhg.vector.tolist()
        force[2] += self._mass * GRAVITY
        pushed = [_product(row, force) - self._moving_margin * force[2] for row in moments]
        # Both rows must be possible together. The base alone can contribute this much, in either direction.
        base_reach = (BASE_RATIO * acceleration[:BASE]).tolist()
        base = [
            sum(abs(entry) * reach for entry, reach in zip(row, base_reach, strict=True))
            for row in outwards[:, :BASE].tolist()
        ]
        pushed = [max(p, -b) for p, b in zip(pushed, base, strict=True)]
        # A base with constant velocity carries the triangle with it: only the momentum of the joints counts.
        outwards[:, :BASE] = 0.0
        momentum = outwards.dot(model.v).tolist()
        rate = sqrt(GRAVITY / height)
        bounds = []
        for i, caught in enumerate(place.caught):
            allowed = min(self._min_moment - pushed[i] - base[i], 0.0)
            if inside[i] < self._moving_margin:
                # The robot tips already, or is about to: it must return, without regard to the zero moment point.
                allowed = -RETURN_RATIO * float(np.abs(outwards[i]) @ acceleration)
                pushed[i] = inf
            free = self._mass * height * rate * (caught - self._margin) / dt
            bounds.append(max(free - momentum[i] * (rate + 1 / dt), allowed))
        return self._relevant_rows(matrix, bounds + pushed, acceleration)

    def _place(self, model: RobotModel, com: list[float]) -> _Place:
        """Return the place of the centre of mass (3,) in the world between the edges."""
        x, y, cosine, sine = model.q[:4].tolist()
        cx, cy, height = com
        cx, cy = cosine * (cx - x) + sine * (cy - y), cosine * (cy - y) - sine * (cx - x)
        # During a turn the zero moment point is further out than the centre of mass, by the centripetal force.
        vx, vy, wz = model.v[:BASE].tolist()
        turn_x, turn_y = -wz * (vy + wz * cx), wz * (vx - wz * cy)
        inside, caught, moments = [], [], []
        for nx, ny, offset in self._edges:
            d = nx * cx + ny * cy - offset
            inside.append(d)
            caught.append(d - max((nx * turn_x + ny * turn_y) * height / GRAVITY, 0.0))
            # Direction of the edge in world axes.
            tx, ty = cosine * ny + sine * nx, sine * ny - cosine * nx
            moments.append([ty * height, -tx * height, d, tx, ty, 0.0])
        return _Place(height, inside, caught, moments)

    def _relevant_rows(
        self, matrix: FloatArray, bounds: list[float], acceleration: FloatArray
    ) -> LinearInequality | None:
        """Return the rows that some acceleration within its limits violates, in units of their largest entry."""
        # Solvers judge rows by one tolerance, which suits entries near 1.
        size = np.abs(matrix)
        reach = size.dot(acceleration).tolist()
        relevant = [i for i, bound in enumerate(bounds) if bound < reach[i]]
        if not relevant:
            return None
        scale = [1.0 / max(row.max(), MIN_ROW_SIZE) for row in size[relevant]]
        return LinearInequality(
            matrix[relevant] * np.array(scale)[:, None],
            np.array([bounds[i] * s for i, s in zip(relevant, scale, strict=True)]),
            tuple(self._names[i] for i in relevant),
        )


def _triangle(model: RobotModel) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """Return (3, 2) corners in base_link [m], (3, 2) inward normals of the edges from each to the next, and names."""
    placement = model.body_frame(WHEEL_LINK).placement
    centres, labels = wheel_triangle(placement, model.robot.wheels)
    corners = centres[:, :2]
    following = np.roll(corners, -1, axis=0)
    along = following - corners
    along /= np.linalg.norm(along, axis=1)[:, None]
    inwards = np.column_stack([-along[:, 1], along[:, 0]])
    names = tuple(f"{a}-{b}" for a, b in zip(labels, labels[1:] + labels[:1], strict=True))
    return corners, inwards, names
