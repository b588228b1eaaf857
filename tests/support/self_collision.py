"""Distances between capsules, computed by hand, and braking paths."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pepper_driver.config import load_self_collision
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import RobotModel
from pepper_driver.controller.collision import CapsuleDistances
from support.controller import ACCELERATION, DT, ROBOT

SETTINGS = load_self_collision(ROBOT)


SECURITY = SETTINGS.security_distance


def limits(model: RobotModel) -> FloatArray:
    limit = LIMIT.copy()
    limit[model.joint_columns] = ACCELERATION
    return limit


class Ruler:
    """Distances of all pairs in a posture."""

    def __init__(self) -> None:
        self.model = RobotModel(ROBOT)
        self.capsules = CapsuleDistances(self.model, SETTINGS)

    def __call__(self, q: FloatArray) -> FloatArray:
        pin.computeJointJacobians(self.model.pin, self.model.data, q)
        self.capsules.place(q)
        return self.capsules.distances().copy()


def braked(q: FloatArray, v: FloatArray, a: FloatArray, brake: FloatArray) -> list[FloatArray]:
    """Postures after one cycle with acceleration ``a`` and in each cycle of braking after it."""
    model = RobotModel(ROBOT)
    postures = []
    for cycle in range(120):
        if cycle:
            a = np.clip(-v / DT, -brake, brake)
        q = model.integrate(q, v * DT + a * DT**2 / 2)
        v = v + a * DT
        postures.append(q)
    assert np.abs(v).max() < 1e-9
    return postures


LIMIT = np.concatenate([[0.3, 0.3, 0.75], np.zeros(17)])
