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

from itertools import compress
from math import pi, sqrt

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pepper_driver.config import RobotConfig
from pepper_driver.controller.constraints.constraint import Constraint, Rows
from pepper_driver.controller.constraints.stopping import Stopping
from pepper_driver.controller.model import BASE, RobotModel

FloatArray = NDArray[np.float64]

GRAVITY = 9.81
"""[m/s2]"""

LEAST_ROOM = 0.005
"""[m] What the row for rest leaves to the zero moment point beyond its margin."""

BASE_SHARE = 0.5
"""Of the acceleration of the base: what rest and motion may ask of it where they disagree."""

BACK_SHARE = 0.3
"""Of the acceleration of the joints: what they return with when the centre of mass is too far out to be caught."""

LEAST_SIZE = 1e-9
"""A row of smaller entries moves nothing."""


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
        ValueError: A margin that is negative, not finite, or leaves no triangle; a moving margin above it.
    """

    name = "balance"
    rank = 4

    def __init__(
        self, robot: RobotConfig, margin: float = 0.03, moving_margin: float | None = None
    ) -> None:
        model = RobotModel(robot)
        self.corners, self.inwards, names = _triangle(model)
        distances = np.einsum("ij,kij->ik", self.inwards, self.corners[:, None] - self.corners)
        inradius = 1 / (1 / distances.max(axis=1)).sum()
        if moving_margin is None:
            moving_margin = margin / 3
        if not 0.0 <= margin < inradius:
            raise ValueError(
                f"a margin of {margin} m: needs 0 to {inradius:.3f} m, where the triangle of the wheels ends"
            )
        if not 0.0 <= moving_margin <= margin:
            raise ValueError(
                f"a moving margin of {moving_margin} m: needs 0 to the margin, {margin} m"
            )
        self._names = tuple(
            f"balance {state}, {name}" for state in ("at rest", "moving") for name in names
        )
        self._offset = (self.inwards * self.corners).sum(axis=1)
        self._along = np.column_stack([self.inwards[:, 1], -self.inwards[:, 0]])
        self._margin, self._moving_margin = margin, moving_margin
        self._mass = float(pin.computeTotalMass(model.pin))
        self._least = LEAST_ROOM * self._mass * GRAVITY
        self._weight = np.array([0.0, 0.0, self._mass * GRAVITY, 0.0, 0.0, 0.0])
        self._edges = np.zeros((len(names), 6))

    def rows(self, model: RobotModel, stopping: Stopping) -> Rows | None:
        """Up to six rows, of the lines that an acceleration could reach."""
        acceleration, dt = stopping.acceleration, stopping.dt
        data, edges = model.data, self._edges
        pin.ccrba(model.pin, data, model.q, model.v)
        pin.computeCentroidalMomentumTimeVariation(model.pin, data)
        x, y, cosine, sine = model.q[:4].tolist()
        cx, cy, height = data.com[0].tolist()
        cx, cy = cosine * (cx - x) + sine * (cy - y), cosine * (cy - y) - sine * (cx - x)
        inside = self.inwards @ (cx, cy) - self._offset
        # Moments about the edges, in world axes, of a force at the centre of mass and of a torque.
        along = self._along @ np.array([[cosine, sine], [-sine, cosine]])
        edges[:, 3:5] = along
        edges[:, 0], edges[:, 1] = along[:, 1] * height, -along[:, 0] * height
        edges[:, 2] = inside
        full = data.Ag
        outwards = edges @ full
        edges[:, 2] -= self._moving_margin
        pushed = edges @ (data.dhg.vector + self._weight)
        moving = self._moving_margin * full[2] - outwards
        # What is asked for by both must be possible together. The base alone can do this much, either way.
        base = BASE_SHARE * (np.abs(outwards[:, :BASE]) @ acceleration[:BASE])
        pushed = np.maximum(pushed, -base)
        # Of a base that goes on as it does: only what joints move must be caught.
        outwards[:, :BASE] = 0.0
        momentum = outwards @ model.v
        rate = sqrt(GRAVITY / height)
        # In a turn the zero moment point lies further out than the centre of mass for as long as the turn lasts.
        vx, vy, wz = model.v[:BASE].tolist()
        turning = self.inwards @ (-wz * (vy + wz * cx), wz * (vx - wz * cy))
        caught = inside - np.maximum(turning * (height / GRAVITY), 0.0)
        room = (self._mass * height * rate) * (caught - self._margin) / dt
        room -= momentum * (rate + 1 / dt)
        allowed = np.minimum(self._least - pushed - base, 0.0)
        lost = inside < self._moving_margin
        if lost.any():
            # The robot tips already, or would: it goes back, wherever the floor pushes meanwhile.
            back = BACK_SHARE * (np.abs(outwards) @ acceleration)
            allowed, pushed = np.where(lost, -back, allowed), np.where(lost, np.inf, pushed)
        room = np.maximum(room, allowed)
        matrix = np.concatenate([outwards, moving])
        room = np.concatenate([room, pushed])
        # Rows that no acceleration within its limits can break are left out, the others in units of their largest
        # entry.
        size = np.abs(matrix)
        matters = room < size @ acceleration
        if not matters.any():
            return None
        scale = 1.0 / np.maximum(size.max(axis=1), LEAST_SIZE)
        matrix *= scale[:, None]
        room *= scale
        names = tuple(compress(self._names, matters.tolist()))
        return Rows(matrix[matters], room[matters], names)


def _triangle(model: RobotModel) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """(3, 2) corners in base_link [m], (3, 2) inward normals of the edges from each to the next, and their names."""
    wheels = model.robot.wheels
    placement = model.body_frame("Tibia").placement
    points = np.array([placement.act(np.array(position))[:2] for position in wheels.positions])
    middle = points.mean(axis=0)
    order = np.argsort([np.arctan2(*(point - middle)[::-1]) % (2 * pi) for point in points])
    corners = points[order]
    following = np.roll(corners, -1, axis=0)
    along = following - corners
    along /= np.linalg.norm(along, axis=1)[:, None]
    inwards = np.column_stack([-along[:, 1], along[:, 0]])
    labels = [wheels.names[i] for i in order]
    names = tuple(f"{a}-{b}" for a, b in zip(labels, labels[1:] + labels[:1], strict=True))
    return corners, inwards, names
