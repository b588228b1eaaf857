"""Balance: the robot does not tip over the lines between its wheels.

Motion: what counts is the zero moment point, where the floor pushes. About a line through e along t, counter-clockwise
round the triangle of the wheels, let H be the angular momentum of the robot, positive where it tips over the line:

    H = t' ((c - e) x l + k),    dH/dt + m g d = b f,

with c the centre of mass, d its distance inside the line, l and k the momenta about it, f the vertical force of the
floor and b the distance inside the line of the zero moment point. With (l, k) = A v all of it is linear in the
accelerations: b >= moving margin is an exact row.

Rest: a braking distance as for other limits does not do. Braking as hard as the joints can may itself push the zero
moment point out, and who is late can only fall. As an inverted pendulum of height z the robot can be caught where

    d - H / (m sqrt(g z)) >= margin,

which moves outwards as long as it is outside of the zero moment point (the capture point; Pratt et al. 2006, Koolen et
al. 2012). The row keeps it after this cycle; at rest it says that the centre of mass is inside. Only what the joints
move counts in it: a base that goes on as it does carries the triangle along.

One row bounds dH/dt of the joints from above, the other from below. The upper bound gives way as far as both leave
something to choose, so they do not exclude each other.
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

LEAST_ROOM = 0.005
"""[m] What the row for rest leaves to the zero moment point beyond its margin."""

BASE_RATIO = 0.5
"""Of the acceleration of the base: what rest and motion may ask of it where they disagree."""

RETURN_RATIO = 0.3
"""Of the acceleration of the joints: what they return with when the centre of mass is too far out to be caught."""


class _Place(NamedTuple):
    """The centre of mass between the edges, one entry for each edge.

    Attributes:
        height: Of the centre of mass [m].
        inside: Its distance inside the edge [m].
        caught: The same less what a turn of the base takes of it [m].
        moments: (6,) moment about the edge of a force at the centre of mass and of a torque, in world axes.
    """

    height: float
    inside: list[float]
    caught: list[float]
    moments: list[list[float]]


def _product(a: list[float], b: list[float]) -> float:
    """Multiply two lists of six; the last entry of moments is zero."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4]


@checked_arguments
class Balance(Constraint):
    """Keeps zero moment point and centre of mass over the triangle of the wheels.

    Args:
        robot: Its description.
        margin: How far inside the triangle the centre of mass can be brought to rest [m].
        moving_margin: How far inside the zero moment point stays [m], by default a third of the other: it must be able
            to go beyond the centre of mass to bring it to rest.

    Attributes:
        corners: (3, 2) where the wheels touch the floor, in base_link [m], counter-clockwise.
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
        # Per edge, as plain numbers: its inward normal and how far along that it lies. For three edges they are
        # quicker than arrays.
        offset = (self.inwards * self.corners).sum(axis=1)
        self._edges = [(*n, o) for n, o in zip(self.inwards.tolist(), offset.tolist(), strict=True)]
        self._margin, self._moving_margin = margin, moving_margin
        self._mass = float(pin.computeTotalMass(model.pin))
        self._least = LEAST_ROOM * self._mass * GRAVITY
        self._own = model.pin.createData()  # for accelerations that are only looked at

    def is_satisfied(
        self, model: RobotModel, braking_limits: BrakingLimits, acceleration: FloatArray
    ) -> bool:
        """Check that zero moment point and capture point stay inside with (20,) accelerations."""
        own, dt = self._own, braking_limits.dt
        pin.computeCentroidalMomentumTimeVariation(model.pin, own, model.q, model.v, acceleration)
        place = self._place(model, own.com[0].tolist())
        force = own.dhg.vector.tolist()
        force[2] += self._mass * GRAVITY
        if any(_product(row, force) < self._moving_margin * force[2] for row in place.moments):
            return False
        velocity = model.v.copy()
        velocity[:BASE] = 0.0
        before = pin.ccrba(model.pin, own, model.q, velocity) @ velocity
        change = acceleration.copy()
        change[:BASE] = 0.0
        after = (before + own.Ag @ change * dt).tolist()
        rate, momentum = sqrt(GRAVITY / place.height), before.tolist()
        return all(
            _product(row, after) + _product(row, momentum) * rate * dt
            <= self._mass * place.height * rate * (d - self._margin)
            for row, d in zip(place.moments, place.caught, strict=True)
        )

    def compute_inequality(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> LinearInequality | None:
        """Up to six rows, of the lines that an acceleration could reach."""
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
        # What is asked for by both must be possible together. The base alone can do this much, either way.
        base_reach = (BASE_RATIO * acceleration[:BASE]).tolist()
        base = [
            sum(abs(entry) * reach for entry, reach in zip(row, base_reach, strict=True))
            for row in outwards[:, :BASE].tolist()
        ]
        pushed = [max(p, -b) for p, b in zip(pushed, base, strict=True)]
        # Of a base that goes on as it does: only what joints move must be caught.
        outwards[:, :BASE] = 0.0
        momentum = outwards.dot(model.v).tolist()
        rate = sqrt(GRAVITY / height)
        room = []
        for i, caught in enumerate(place.caught):
            allowed = min(self._least - pushed[i] - base[i], 0.0)
            if inside[i] < self._moving_margin:
                # The robot tips already, or would: it goes back, wherever the floor pushes meanwhile.
                allowed = -RETURN_RATIO * float(np.abs(outwards[i]) @ acceleration)
                pushed[i] = inf
            free = self._mass * height * rate * (caught - self._margin) / dt
            room.append(max(free - momentum[i] * (rate + 1 / dt), allowed))
        return self._that_matter(matrix, room + pushed, acceleration)

    def _place(self, model: RobotModel, com: list[float]) -> _Place:
        """Return the place of the centre of mass (3,) in the world between the edges."""
        x, y, cosine, sine = model.q[:4].tolist()
        cx, cy, height = com
        cx, cy = cosine * (cx - x) + sine * (cy - y), cosine * (cy - y) - sine * (cx - x)
        # In a turn the zero moment point lies further out than the centre of mass for as long as the turn lasts.
        vx, vy, wz = model.v[:BASE].tolist()
        turn_x, turn_y = -wz * (vy + wz * cx), wz * (vx - wz * cy)
        inside, caught, moments = [], [], []
        for nx, ny, offset in self._edges:
            d = nx * cx + ny * cy - offset
            inside.append(d)
            caught.append(d - max((nx * turn_x + ny * turn_y) * height / GRAVITY, 0.0))
            tx, ty = (
                cosine * ny + sine * nx,
                sine * ny - cosine * nx,
            )  # along the edge, in world axes
            moments.append([ty * height, -tx * height, d, tx, ty, 0.0])
        return _Place(height, inside, caught, moments)

    def _that_matter(
        self, matrix: FloatArray, room: list[float], acceleration: FloatArray
    ) -> LinearInequality | None:
        """Without rows that no acceleration within its limits can break; the others in units of their largest entry."""
        size = np.abs(matrix)
        reach = size.dot(acceleration).tolist()
        matters = [i for i, least in enumerate(room) if least < reach[i]]
        if not matters:
            return None
        scale = [1.0 / max(row.max(), MIN_ROW_SIZE) for row in size[matters]]
        return LinearInequality(
            matrix[matters] * np.array(scale)[:, None],
            np.array([room[i] * s for i, s in zip(matters, scale, strict=True)]),
            tuple(self._names[i] for i in matters),
        )


def _triangle(model: RobotModel) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """(3, 2) corners in base_link [m], (3, 2) inward normals of the edges from each to the next, and their names."""
    placement = model.body_frame(WHEEL_LINK).placement
    centres, labels = wheel_triangle(placement, model.robot.wheels)
    corners = centres[:, :2]
    following = np.roll(corners, -1, axis=0)
    along = following - corners
    along /= np.linalg.norm(along, axis=1)[:, None]
    inwards = np.column_stack([-along[:, 1], along[:, 0]])
    names = tuple(f"{a}-{b}" for a, b in zip(labels, labels[1:] + labels[:1], strict=True))
    return corners, inwards, names
