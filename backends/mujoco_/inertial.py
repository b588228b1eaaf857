"""The inertial unit in the base."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from pepper_driver.backends.interface import Imu
from pepper_driver.backends.mujoco_.resumable import Resumable
from pepper_driver.config import RobotConfig
from pepper_driver.config.parts import Frame


class InertialUnit(Resumable):
    """Accelerometer and gyroscope fixed to a link, without noise or drift.

    The acceleration is the mean specific force over the last cycle, in the unit's axes; what NAOqi would have put
    through its own filter.
    """

    STATE = ("_velocity",)

    def __init__(self, robot: RobotConfig, mj: mujoco.MjModel, data: mujoco.MjData) -> None:
        frame: Frame = robot.sensors.imu
        self._mj, self._data, self._cycle = mj, data, robot.cycle
        self._body = mj.body(frame.parent).id
        self._xyz = np.array(frame.xyz)
        rotation, quaternion = np.empty(9), np.empty(4)
        mujoco.mju_euler2Quat(quaternion, np.array(frame.rpy), "XYZ")  # fixed axes, as in a URDF
        mujoco.mju_quat2Mat(rotation, quaternion)
        self._rotation_unit_to_link = rotation.reshape(3, 3)
        self._velocity = np.zeros(3)
        self._twist, self._arm = np.empty(6), np.empty(3)

    def reset(self) -> Imu:
        """As if the unit had moved on as it moves now."""
        return self._reading(first=True)

    def read(self) -> Imu:
        """One cycle later."""
        return self._reading(first=False)

    def _reading(self, *, first: bool) -> Imu:
        data, twist, arm = self._data, self._twist, self._arm
        rotation_link_to_world = data.xmat[self._body].reshape(3, 3)
        mujoco.mj_objectVelocity(self._mj, data, mujoco.mjtObj.mjOBJ_XBODY, self._body, twist, 0)
        angular = twist[:3]
        mujoco.mju_cross(arm, angular, rotation_link_to_world @ self._xyz)
        velocity = twist[3:] + arm
        change = 0.0 * velocity if first else (velocity - self._velocity) / self._cycle
        self._velocity = velocity
        rotation_unit_to_world = rotation_link_to_world @ self._rotation_unit_to_link
        (xx, _, _), (yx, _, _), (zx, zy, zz) = rotation_unit_to_world.tolist()
        roll, yaw = math.atan2(zy, zz), math.atan2(yx, xx)
        pitch = math.asin(min(max(-zx, -1.0), 1.0))
        return Imu(
            acceleration=(change - self._mj.opt.gravity) @ rotation_unit_to_world,
            angular_velocity=angular @ rotation_unit_to_world,
            attitude=np.array([roll, pitch, yaw]),
        )
