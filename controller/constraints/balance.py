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

import numpy as np
import pinocchio as pin

from pepper_driver.config import RobotConfig
from pepper_driver.config.arguments import checked_arguments, is_number
from pepper_driver.config.arrays import FloatArray, IntArray
from pepper_driver.config.kernels import Matrix, Out, Records, kernel, make_records
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


class Distances:
    """Mass of the robot, and the distances that it keeps inside the edges.

    Attributes:
        mass: m [kg].
        margin: For rest [m].
        moving_margin: In motion [m].
    """

    mass: float
    margin: float
    moving_margin: float


class Edge:
    """Line between two wheels, in base_link: its inward unit normal, and where it lies along that [m]."""

    nx: float
    ny: float
    offset: float


@kernel
def _momenta(
    q: FloatArray,
    velocity: FloatArray,
    com: FloatArray,
    momentum_map: Matrix[FloatArray],
    bias: FloatArray,
    edges: Records[Edge],
    weight: float,
    place: Out[Matrix[FloatArray]],
    tipping: Out[Matrix[FloatArray]],
) -> None:
    """Write place and momentum of the robot about the edges.

    Args:
        q: Configuration.
        velocity: (n,) v.
        com: (3,) centre of mass in the world [m].
        momentum_map: (n, 6) transposed A: (l, k) per velocity.
        bias: (6,) rate of (l, k) without accelerations.
        edges: Those of the triangle.
        weight: m g [N].
        place: (edges, 3) to write: the distance d of the centre of mass inside each edge [m]; the same minus the effect
            of a turn of the base [m]; dH/dt + m g d without accelerations [N m].
        tipping: (edges, n) to write: H per velocity.
    """
    x, y, cosine, sine = q[0], q[1], q[2], q[3]
    height = com[2]
    cx = cosine * (com[0] - x) + sine * (com[1] - y)
    cy = cosine * (com[1] - y) - sine * (com[0] - x)
    # During a turn the zero moment point is further out than the centre of mass, by the centripetal force.
    vx, vy, wz = velocity[0], velocity[1], velocity[2]
    turn_x, turn_y = -wz * (vy + wz * cx), wz * (vx - wz * cy)
    for e in range(len(edges)):
        nx, ny = edges[e].nx, edges[e].ny
        d = nx * cx + ny * cy - edges[e].offset
        # Direction t of the edge in world axes; (c - e) x l along it.
        tx, ty = cosine * ny + sine * nx, sine * ny - cosine * nx
        ax, ay = ty * height, -tx * height
        place[e, 0] = d
        place[e, 1] = d - max((nx * turn_x + ny * turn_y) * height / GRAVITY, 0.0)
        place[e, 2] = (
            ax * bias[0] + ay * bias[1] + d * (bias[2] + weight) + tx * bias[3] + ty * bias[4]
        )
        for i in range(len(velocity)):
            row = momentum_map[i]
            tipping[e, i] = ax * row[0] + ay * row[1] + d * row[2] + tx * row[3] + ty * row[4]


@kernel
def _keeps_balance(
    q: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    com: FloatArray,
    momentum_map: Matrix[FloatArray],
    bias: FloatArray,
    edges: Records[Edge],
    limits: Records[Distances],
    dt: float,
    place: Out[Matrix[FloatArray]],
    tipping: Out[Matrix[FloatArray]],
) -> bool:
    """Return True if zero moment point and capture point stay inside all edges with (n,) accelerations."""
    mass, margin, moving_margin = limits[0].mass, limits[0].margin, limits[0].moving_margin
    weight, height = mass * GRAVITY, com[2]
    _momenta(q, velocity, com, momentum_map, bias, edges, weight, place, tipping)
    rate = sqrt(GRAVITY / height)
    force = bias[2] + weight
    for i in range(len(velocity)):
        force += momentum_map[i, 2] * acceleration[i]
    for e in range(len(place)):
        pushed = place[e, 2]
        for i in range(len(velocity)):
            pushed += tipping[e, i] * acceleration[i]
        if pushed < moving_margin * force:
            return False
        # A base with constant velocity carries the triangle with it: only the momentum of the joints counts.
        momentum = change = 0.0
        for i in range(BASE, len(velocity)):
            momentum += tipping[e, i] * velocity[i]
            change += tipping[e, i] * acceleration[i]
        after = momentum + change * dt
        if after + momentum * rate * dt > mass * height * rate * (place[e, 1] - margin):
            return False
    return True


@kernel
def _balance_rows(
    q: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    com: FloatArray,
    momentum_map: Matrix[FloatArray],
    bias: FloatArray,
    edges: Records[Edge],
    limits: Records[Distances],
    dt: float,
    place: Out[Matrix[FloatArray]],
    tipping: Out[Matrix[FloatArray]],
    matrix: Out[Matrix[FloatArray]],
    bound: Out[FloatArray],
    numbers: Out[IntArray],
) -> int:
    """Write the rows that some acceleration within its limits violates, in units of their largest entry.

    Args:
        q: As for :func:`_momenta`; so are the next six, but for ``acceleration``.
        velocity: See there.
        acceleration: (n,) limits.
        com: See there.
        momentum_map: See there.
        bias: See there.
        edges: See there.
        limits: Mass and distances.
        dt: Cycle [s].
        place: As for :func:`_momenta`.
        tipping: See there.
        matrix: (2 edges, n) to write.
        bound: (2 edges,) to write.
        numbers: (2 edges,) to write: of a row for rest, that of its edge; of one for motion, that plus the number of
            edges.

    Returns:
        Number of rows.
    """
    mass, margin, moving_margin = limits[0].mass, limits[0].margin, limits[0].moving_margin
    weight, height = mass * GRAVITY, com[2]
    _momenta(q, velocity, com, momentum_map, bias, edges, weight, place, tipping)
    n, count = len(velocity), 0
    rate = sqrt(GRAVITY / height)
    force = bias[2] + weight
    for number in range(2 * len(edges)):
        e = number % len(edges)
        at_rest = number < len(edges)
        # Both rows must be possible together. The base alone can contribute this much, in either direction.
        base = 0.0
        for i in range(BASE):
            base += abs(tipping[e, i]) * (BASE_RATIO * acceleration[i])
        pushed = max(place[e, 2] - moving_margin * force, -base)
        row = matrix[count]
        if at_rest:
            # A base with constant velocity carries the triangle with it: only the momentum of the joints counts.
            momentum = reach = 0.0
            for i in range(n):
                row[i] = tipping[e, i] if i >= BASE else 0.0
                momentum += row[i] * velocity[i]
                reach += abs(row[i]) * acceleration[i]
            allowed = min(MIN_ZMP_RANGE * weight - pushed - base, 0.0)
            if place[e, 0] < moving_margin:
                # The robot tips already, or is about to: it must return, without regard to the zero moment point.
                allowed = -RETURN_RATIO * reach
            free = mass * height * rate * (place[e, 1] - margin) / dt
            most = max(free - momentum * (rate + 1 / dt), allowed)
        else:
            for i in range(n):
                row[i] = moving_margin * momentum_map[i, 2] - tipping[e, i]
            most = inf if place[e, 0] < moving_margin else pushed
        reach = size = 0.0
        for i in range(n):
            reach += abs(row[i]) * acceleration[i]
            size = max(size, abs(row[i]))
        if not most < reach:
            continue
        # Solvers judge rows by one tolerance, which suits entries near 1.
        scale = 1.0 / max(size, MIN_ROW_SIZE)
        for i in range(n):
            row[i] *= scale
        bound[count] = most * scale
        numbers[count] = number
        count += 1
    return count


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
    needs_kinematics = False
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
        offset = (self.inwards * self.corners).sum(axis=1)
        nx, ny = self.inwards.T
        self._edges = make_records(Edge, len(names), nx=nx, ny=ny, offset=offset)
        mass = pin.computeTotalMass(model.pin)
        self._limits = make_records(
            Distances, 1, mass=mass, margin=margin, moving_margin=moving_margin
        )
        self._place, self._tipping = np.zeros((len(names), 3)), np.zeros((len(names), model.nv))
        self._keeps_balance, self._rows = _keeps_balance.load(), _balance_rows.load()

    def is_satisfied(
        self, model: RobotModel, braking_limits: BrakingLimits, acceleration: FloatArray
    ) -> bool:
        """Check that zero moment point and capture point stay inside with (20,) accelerations."""
        momentum_map, _, bias = model.centroidal_momentum()
        return self._keeps_balance(
            model.q,
            model.v,
            acceleration,
            model.centre_of_mass,
            np.ascontiguousarray(momentum_map.T),  # without a copy: Pinocchio stores columns
            bias,
            self._edges,
            self._limits,
            braking_limits.dt,
            self._place,
            self._tipping,
        )

    def compute_inequality(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> LinearInequality | None:
        """Return up to six rows, of the lines that an acceleration could reach."""
        momentum_map, _, bias = model.centroidal_momentum()
        most = 2 * len(self._edges)
        matrix, bound = np.empty((most, model.nv)), np.empty(most)
        numbers = np.empty(most, dtype=np.int64)
        count = self._rows(
            model.q,
            model.v,
            braking_limits.acceleration,
            model.centre_of_mass,
            np.ascontiguousarray(momentum_map.T),  # without a copy: Pinocchio stores columns
            bias,
            self._edges,
            self._limits,
            braking_limits.dt,
            self._place,
            self._tipping,
            matrix,
            bound,
            numbers,
        )
        if not count:
            return None
        names = tuple(self._names[number] for number in numbers[:count])
        return LinearInequality(matrix[:count], bound[:count], names)


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
