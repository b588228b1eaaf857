"""Support polygon: the triangle of the wheels, and the margin of a force to tipping over its edges."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.parts import Wheels

WHEEL_LINK = "Tibia"
"""Link in which ``wheels.yaml`` has the positions of the wheels."""


def wheel_triangle(carrier: Any, wheels: Wheels) -> tuple[FloatArray, tuple[str, ...]]:  # noqa: ANN401 Pinocchio has no types
    """Return (3, 3) centres of the wheels [m], counter-clockwise seen from above, and their names.

    Args:
        carrier: Placement of ``WHEEL_LINK``, an SE3; the centres are in its target frame.
        wheels: Positions in this link.
    """
    centres = np.array([carrier.act(np.array(position)) for position in wheels.positions])
    away = centres[:, :2] - centres[:, :2].mean(axis=0)
    order = np.argsort([np.arctan2(y, x) % (2 * np.pi) for x, y in away])
    return centres[order], tuple(wheels.names[i] for i in order)


class SupportPolygon:
    """Triangle of the wheels on the floor, and the weight that holds the robot on it.

    Frames: base_link, with its origin on the floor and z up. The robot stands still; masses are those of the URDF.

    Attributes:
        corners: (3, 3) contact points of the wheels with the floor, counter-clockwise seen from above [m].
    """

    def __init__(self, urdf: Path, joint_names: tuple[str, ...], wheels: Wheels) -> None:
        # Without a joint below it, Pinocchio would leave the mass of the base out.
        self._pin = pin.buildModelFromUrdf(str(urdf), pin.JointModelPlanar())
        self._data = self._pin.createData()
        joints = [self._pin.joints[self._pin.getJointId(name)] for name in joint_names]
        self._columns = np.array([joint.idx_q for joint in joints], dtype=np.intp)
        self._weight = pin.computeTotalMass(self._pin) * np.linalg.norm(self._pin.gravity.linear)
        pin.framesForwardKinematics(self._pin, self._data, pin.neutral(self._pin))
        carrier = self._data.oMf[self._pin.getFrameId(WHEEL_LINK)]
        centres, _ = wheel_triangle(carrier, wheels)
        # In this order a moment that lifts the robot over an edge is positive about it.
        self.corners: FloatArray = centres - [0.0, 0.0, wheels.radius]

    @classmethod
    def from_robot(cls, robot: RobotConfig) -> SupportPolygon:
        """Return the support polygon of a robot; it is made once."""
        return _cached(robot.urdf, robot.joint_names, robot.wheels)

    def tipping_ratio(self, posture: FloatArray, point: FloatArray, force: FloatArray) -> float:
        """Return the largest ratio over the edges of the moments of force and weight; at 1 a wheel lifts off.

        Args:
            posture: (17,) [rad].
            point: (3,) point of action, in base_link [m].
            force: (3,) in the axes of base_link [N].
        """
        q = pin.neutral(self._pin)
        q[self._columns] = posture
        mass_centre = pin.centerOfMass(self._pin, self._data, q)
        weight = np.array([0.0, 0.0, -self._weight])
        ratios = []
        for corner, following in zip(self.corners, np.roll(self.corners, -1, axis=0), strict=True):
            edge = (following - corner) / np.linalg.norm(following - corner)
            holding = -float(edge @ np.cross(mass_centre - corner, weight))
            lifting = float(edge @ np.cross(point - corner, force))
            ratios.append(lifting / holding if holding > 0 else np.inf)
        return max(0.0, *ratios)


# Pinocchio reads the URDF again for each model.
@lru_cache(maxsize=8)
def _cached(urdf: Path, joint_names: tuple[str, ...], wheels: Wheels) -> SupportPolygon:
    return SupportPolygon(urdf, joint_names, wheels)
