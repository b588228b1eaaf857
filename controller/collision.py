"""Capsules of the robot: their places in a posture, the distances of pairs, and how joints change them."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin, sqrt
from typing import Any

import numpy as np
import pinocchio as pin

from pepper_driver.config import SelfCollisionSettings
from pepper_driver.config.arrays import FloatArray, IntArray
from pepper_driver.config.kernels import Block, Matrix, Out, Records, kernel, make_records
from pepper_driver.controller.model import RobotModel

MIN_SQUARE = 100 * float(np.finfo(np.float64).eps)
"""[m2], [m4] Squared length of an axis, or of the vector product of two, that counts as 0."""


class PlacedJoint:
    """Joint of the tree, after its parent.

    Attributes:
        parent: Its number.
        x: Unit vector of the axis about which it turns.
        y: The same.
        z: The same.
    """

    parent: int
    x: float
    y: float
    z: float


class PlacedCapsule:
    """Capsule on a joint: the ends of its axis in the frame of the joint [m].

    Attributes:
        joint: Number of the joint.
        x0: Start of the axis.
        y0: The same.
        z0: The same.
        x1: End of the axis.
        y1: The same.
        z1: The same.
        radius: [m].
    """

    joint: int
    x0: float
    y0: float
    z0: float
    x1: float
    y1: float
    z1: float
    radius: float


class CapsulePair:
    """Pair of capsules.

    Attributes:
        first: Number of the first capsule.
        second: Number of the second capsule.
        radii: Sum of their radii [m].
        reach: Sum of the largest distances of their points from their centres [m].
    """

    first: int
    second: int
    radii: float
    reach: float


@kernel
def _place_joints(
    q: FloatArray,
    joints: Records[PlacedJoint],
    placements: Block[FloatArray],
    poses: Out[Block[FloatArray]],
) -> None:
    """Write the (3, 4) poses of the joints, rotation and place in the world.

    Args:
        q: Configuration: x, y, cosine and sine of the heading of the base, then angles in the order of the joints.
        joints: The base, then the joints that turn, each after its parent.
        placements: (joints, 3, 4) poses in the frame of the parent, at angle 0.
        poses: (joints, 3, 4) to write.
    """
    poses[0] = 0.0
    poses[0, 0, 3], poses[0, 1, 3] = q[0], q[1]
    poses[0, 0, 0], poses[0, 0, 1] = q[2], -q[3]
    poses[0, 1, 0], poses[0, 1, 1] = q[3], q[2]
    poses[0, 2, 2] = 1.0
    for j in range(1, len(joints)):
        joint = joints[j]
        parent, x, y, z = joint.parent, joint.x, joint.y, joint.z
        c, s = cos(q[3 + j]), sin(q[3 + j])
        u = 1.0 - c
        for i in range(3):
            # Row of the rotation at angle 0, and the place.
            r0, r1, r2, place = 0.0, 0.0, 0.0, poses[parent, i, 3]
            for k in range(3):
                turn = poses[parent, i, k]
                r0 += turn * placements[j, k, 0]
                r1 += turn * placements[j, k, 1]
                r2 += turn * placements[j, k, 2]
                place += turn * placements[j, k, 3]
            # Turn about the axis, by Rodrigues' formula.
            poses[j, i, 0] = (
                r0 * (c + x * x * u) + r1 * (x * y * u + z * s) + r2 * (x * z * u - y * s)
            )
            poses[j, i, 1] = (
                r0 * (x * y * u - z * s) + r1 * (c + y * y * u) + r2 * (y * z * u + x * s)
            )
            poses[j, i, 2] = (
                r0 * (x * z * u + y * s) + r1 * (y * z * u - x * s) + r2 * (c + z * z * u)
            )
            poses[j, i, 3] = place


@kernel
def _place(
    q: FloatArray,
    joints: Records[PlacedJoint],
    placements: Block[FloatArray],
    capsules: Records[PlacedCapsule],
    poses: Out[Block[FloatArray]],
    ends: Out[Block[FloatArray]],
    centres: Out[Matrix[FloatArray]],
) -> None:
    """Write the (2, 3) ends of the axes of the capsules in the world, their centres, and the poses of the joints."""
    _place_joints(q, joints, placements, poses)
    for n in range(len(capsules)):
        capsule = capsules[n]
        for i in range(3):
            pose = poses[capsule.joint, i]
            x, y, z, place = pose[0], pose[1], pose[2], pose[3]
            ends[n, 0, i] = x * capsule.x0 + y * capsule.y0 + z * capsule.z0 + place
            ends[n, 1, i] = x * capsule.x1 + y * capsule.y1 + z * capsule.z1 + place
            centres[n, i] = (ends[n, 0, i] + ends[n, 1, i]) / 2


@kernel
def _fraction(length: float, whole: float) -> float:
    """Return the fraction of a length, within 0 and 1."""
    return min(max(length, 0.0), whole) / whole


@kernel
def _axis_distance(
    first: Matrix[FloatArray], second: Matrix[FloatArray], line: Out[FloatArray]
) -> float:
    """Return the distance of two line segments [m].

    As in C. Ericson, Real-Time Collision Detection, "Closest Points of Two Line Segments"; of parallel ones it takes
    the points nearest to the start of the first.

    Args:
        first: (2, 3) ends [m].
        second: (2, 3) ends [m].
        line: (6,) to write: nearest point of the first, then of the second one.
    """
    a = b = c = e = f = 0.0
    for i in range(3):
        d1, d2, r = (
            first[1, i] - first[0, i],
            second[1, i] - second[0, i],
            first[0, i] - second[0, i],
        )
        a += d1 * d1
        b += d1 * d2
        c += d1 * r
        e += d2 * d2
        f += d2 * r
    s = t = 0.0  # fractions of the segments
    if a <= MIN_SQUARE and e > MIN_SQUARE:
        t = _fraction(f, e)
    elif a > MIN_SQUARE and e <= MIN_SQUARE:
        s = _fraction(-c, a)
    elif a > MIN_SQUARE:
        sine = a * e - b * b
        if sine > MIN_SQUARE:
            s = _fraction(b * f - c * e, sine)
        t = b * s + f
        if t <= 0.0:
            s, t = _fraction(-c, a), 0.0
        elif t >= e:
            s, t = _fraction(b - c, a), 1.0
        else:
            t /= e
    square = 0.0
    for i in range(3):
        line[i] = first[0, i] + s * (first[1, i] - first[0, i])
        line[3 + i] = second[0, i] + t * (second[1, i] - second[0, i])
        square += (line[3 + i] - line[i]) ** 2
    return sqrt(square)


@kernel
def _any_near(
    ends: Block[FloatArray],
    centres: Matrix[FloatArray],
    pairs: Records[CapsulePair],
    margin: float,
    line: Out[FloatArray],
) -> bool:
    """Return True if any pair is nearer than the margin [m]; ``line`` (6,) is written to."""
    for n in range(len(pairs)):
        pair = pairs[n]
        x = centres[pair.first, 0] - centres[pair.second, 0]
        y = centres[pair.first, 1] - centres[pair.second, 1]
        z = centres[pair.first, 2] - centres[pair.second, 2]
        if x * x + y * y + z * z > (pair.reach + margin) ** 2:
            continue
        if _axis_distance(ends[pair.first], ends[pair.second], line) - pair.radii <= margin:
            return True
    return False


@kernel
def _distances(
    ends: Block[FloatArray],
    pairs: Records[CapsulePair],
    line: Out[FloatArray],
    distances: Out[FloatArray],
    wrenches: Out[Matrix[FloatArray]],
) -> None:
    """Write the distances of all pairs [m], and the wrenches along their shortest lines; 0 where axes meet."""
    for n in range(len(pairs)):
        pair = pairs[n]
        apart = _axis_distance(ends[pair.first], ends[pair.second], line)
        distances[n] = apart - pair.radii
        x, y, z = line[0], line[1], line[2]
        per = 1.0 / apart if apart > 0.0 else 0.0
        nx, ny, nz = (line[3] - x) * per, (line[4] - y) * per, (line[5] - z) * per
        wrench = wrenches[n]
        wrench[0], wrench[1], wrench[2] = nx, ny, nz
        wrench[3], wrench[4], wrench[5] = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx


class CapsuleDistances:
    """Distances of all pairs of capsules, for one posture at a time.

    Args:
        model: Model with links and joints.
        settings: Capsules by link and pairs of links.

    Attributes:
        names: Names of the pairs, by their links: ``"l_wrist-torso"``.
        signs: (pairs, 20) sign of each velocity of the model in a distance: 1 where it moves the second capsule only,
            -1 where it moves the first only, 0 where both or none.
        levers: (pairs, 20) largest change of a distance by each velocity, in any posture [m/rad].
    """

    def __init__(self, model: RobotModel, settings: SelfCollisionSettings) -> None:
        tree = model.pin
        self._joints, self._placements = _tree(tree)
        numbers: dict[str, list[int]] = {}
        carriers: list[int] = []
        ends: list[list[FloatArray]] = []
        radii: list[float] = []
        for link, capsules in settings.capsules.items():
            numbers[link] = [len(radii) + i for i in range(len(capsules))]
            frame = model.body_frame(link)
            for capsule in capsules:
                carriers.append(frame.joint)
                ends.append(
                    [frame.placement.act(np.array(p)) for p in (capsule.start, capsule.end)]
                )
                radii.append(capsule.radius)
        places, radius = np.array(ends), np.array(radii)
        self._capsules = make_records(
            PlacedCapsule,
            len(radius),
            joint=np.array(carriers) - 1,
            radius=radius,
            **{f"{axis}{end}": places[:, end, i] for end in (0, 1) for i, axis in enumerate("xyz")},
        )
        names, firsts, seconds = [], [], []
        for link, other in settings.pairs:
            for first, second in [(a, b) for a in numbers[link] for b in numbers[other]]:
                firsts.append(first)
                seconds.append(second)
                names.append(f"{link}-{other}")
        self.names = tuple(names)
        extent = np.linalg.norm(places[:, 1] - places[:, 0], axis=1) / 2 + radius
        farthest = np.linalg.norm(places.mean(axis=1), axis=1) + extent
        self._pairs = make_records(
            CapsulePair,
            len(names),
            first=firsts,
            second=seconds,
            radii=radius[firsts] + radius[seconds],
            reach=extent[firsts] + extent[seconds],
        )
        reaches = np.array(
            [_reach(tree, j, float(far)) for j, far in zip(carriers, farthest, strict=True)]
        )
        carried = (reaches > 0).astype(float)
        self.signs: FloatArray = carried[seconds] - carried[firsts]
        self.levers: FloatArray = np.abs(self.signs) * np.maximum(reaches[firsts], reaches[seconds])
        self._poses = np.zeros((len(self._joints), 3, 4))
        self._ends, self._centres = np.zeros((len(radius), 2, 3)), np.zeros((len(radius), 3))
        self._line, self._wrenches = np.zeros(6), np.zeros((len(names), 6))
        self._distances = np.zeros(len(names))
        self._place, self._any_near = _place.load(), _any_near.load()
        self._measure = _distances.load()

    def place(self, q: FloatArray) -> None:
        """Place the capsules as in a configuration of the model."""
        self._place(
            q,
            self._joints,
            self._placements,
            self._capsules,
            self._poses,
            self._ends,
            self._centres,
        )

    def any_near(self, margin: float) -> bool:
        """Return True if any pair is nearer than a margin [m]. It ends at the first such pair."""
        return self._any_near(self._ends, self._centres, self._pairs, margin, self._line)

    def distances(self) -> FloatArray:
        """Return the (pairs,) distances [m], negative where capsules overlap; overwritten by the next call."""
        self._measure(self._ends, self._pairs, self._line, self._distances, self._wrenches)
        return self._distances

    def wrenches(self, pairs: Sequence[int] | IntArray) -> FloatArray:
        """Return (n, 6) unit forces along the shortest lines of ``pairs``, with moments about the world's origin [m].

        They point from the first capsule to the second, as of the last :meth:`distances`. Their product with the
        Jacobian of the joints in the world is the rate of the distance. They are zero where the axes meet.
        """
        return self._wrenches[pairs]


def _tree(model: Any) -> tuple[Records[PlacedJoint], FloatArray]:  # noqa: ANN401 Pinocchio has no types
    """Return the base with the joints of Pinocchio's model, and their (joints, 3, 4) placements in their parents."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    # The universe, number 0 of Pinocchio, is left out.
    numbers = range(1, model.njoints)
    placements = np.array([model.jointPlacements[j].homogeneous[:3] for j in numbers])
    # A joint that turns moves with its axis, of unit length; the base, with three velocities, has none here.
    axes = np.zeros((len(numbers), 3))
    for j in numbers[1:]:
        axes[j - 1] = pin.getJointJacobian(model, data, j, pin.LOCAL)[3:, model.joints[j].idx_v]
    joints = make_records(
        PlacedJoint,
        len(numbers),
        parent=np.array([model.parents[j] for j in numbers]) - 1,
        **{axis: axes[:, i] for i, axis in enumerate("xyz")},
    )
    return joints, placements


def _reach(model: Any, joint: int, beyond: float) -> FloatArray:  # noqa: ANN401 Pinocchio has no types
    """Return the (nv,) largest distance of what ``joint`` carries from the axes that move it [m]; 0 for others.

    Args:
        model: Model of Pinocchio.
        joint: Number of a joint.
        beyond: Distance of the farthest point that it carries from its origin [m].
    """
    reach = np.zeros(model.nv)
    while joint > 0:
        start, width = model.joints[joint].idx_v, model.joints[joint].nv
        reach[start : start + width] = beyond
        beyond += float(np.linalg.norm(model.jointPlacements[joint].translation))
        joint = model.parents[joint]
    return reach
