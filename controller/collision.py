"""Capsules of the robot: geometry model of Pinocchio with the closed-form distances of coal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from pepper_driver.config import Capsule, SelfCollisionSettings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.model import RobotModel


class CapsuleDistances:
    """Distances of all pairs of capsules, for one posture at a time.

    Args:
        model: Model with links and joints.
        settings: Capsules by link and pairs of links.
        margin: [m] Distance of :meth:`any_near`.

    Attributes:
        names: Names of the pairs, by their links: ``"l_wrist-torso"``.
        signs: (pairs, 20) sign of each velocity of the model in a distance: 1 where it moves the second capsule only,
            -1 where it moves the first only, 0 where both or none.
        levers: (pairs, 20) largest change of a distance by each velocity, in any posture [m/rad].
    """

    def __init__(self, model: RobotModel, settings: SelfCollisionSettings, margin: float) -> None:
        self._model = model.pin
        self._geometry = pin.GeometryModel()
        numbers = {
            link: [self._add(model, link, capsule, i) for i, capsule in enumerate(capsules)]
            for link, capsules in settings.capsules.items()
        }
        names = []
        for first, second in settings.pairs:
            for pair in [(a, b) for a in numbers[first] for b in numbers[second]]:
                self._geometry.addCollisionPair(pin.CollisionPair(*pair))
                names.append(f"{first}-{second}")
        self.names = tuple(names)
        objects = self._geometry.geometryObjects
        pairs = self._geometry.collisionPairs
        ends = [np.linalg.norm(o.placement.translation) + o.geometry.halfLength for o in objects]
        reaches = [
            _reach(self._model, item.parentJoint, float(end) + item.geometry.radius)
            for item, end in zip(objects, ends, strict=True)
        ]
        carried = [(reach > 0).astype(float) for reach in reaches]
        self.signs: FloatArray = np.array([carried[p.second] - carried[p.first] for p in pairs])
        self.levers: FloatArray = np.abs(self.signs) * np.array(
            [np.maximum(reaches[p.first], reaches[p.second]) for p in pairs]
        )
        self._data = pin.GeometryData(self._geometry)
        for request in self._data.collisionRequests:
            request.security_margin = margin
            request.enable_contact = False
        self._results = list(self._data.distanceResults)

    def _add(self, model: RobotModel, link: str, capsule: Capsule, number: int) -> int:
        start, end = np.array(capsule.start), np.array(capsule.end)
        length = float(np.linalg.norm(end - start))
        axis = (end - start) / length if length > 0 else np.array([0.0, 0.0, 1.0])
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix()
        frame = model.body_frame(link, (start + end) / 2, turn)
        # coal has a closed form for two capsules, but none for a capsule and a sphere.
        shape = coal.Capsule(capsule.radius, length)
        item = pin.GeometryObject(
            f"{link} {number}", frame.joint, model.frame_id(link), frame.placement, shape
        )
        index: int = self._geometry.addGeometryObject(item)
        return index

    def place(self, data: Any) -> None:  # noqa: ANN401 Pinocchio has no types
        """Place the capsules by the joint placements of Pinocchio's ``data``."""
        pin.updateGeometryPlacements(self._model, data, self._geometry, self._data)

    def any_near(self) -> bool:
        """Return True if any pair is nearer than the margin."""
        # It stops at the first such pair, so it is much cheaper than all distances.
        near: bool = pin.computeCollisions(self._geometry, self._data, True)
        return near

    def distances(self) -> FloatArray:
        """Return the (pairs,) distances [m], negative where capsules overlap."""
        pin.computeDistances(self._geometry, self._data)
        return np.array([result.min_distance for result in self._results])

    def wrenches(self, pairs: Sequence[int]) -> FloatArray:
        """Return (n, 6) unit forces along the shortest lines of ``pairs``, with moments about the world's origin [m].

        They point from the first capsule to the second, as of the last :meth:`distances`. Their product with the
        Jacobian of the joints in the world is the rate of the distance.
        """
        wrenches = np.empty((len(pairs), 6))
        for row, pair in zip(wrenches, pairs, strict=True):
            result = self._results[pair]
            nx, ny, nz = result.normal.tolist()
            x, y, z = result.getNearestPoint1().tolist()
            row[:] = nx, ny, nz, y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
        return wrenches


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
