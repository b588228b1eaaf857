"""The inertial unit in the base."""

from __future__ import annotations

import mujoco
import numpy as np

from pepper_driver.backends.interface import Imu
from pepper_driver.backends.mujoco_.resumable import Resumable
from pepper_driver.config import RobotConfig
from pepper_driver.config.parts import FloatArray, Frame


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

    def reset(self) -> Imu:
        """Standing still."""
        self._velocity = np.zeros(3)
        return self._reading(np.zeros(3))

    def read(self) -> Imu:
        """One cycle later."""
        velocity, _ = self._motion()
        acceleration = (velocity - self._velocity) / self._cycle
        self._velocity = velocity
        return self._reading(acceleration)

    def _motion(self) -> tuple[FloatArray, FloatArray]:
        """(3,) velocity and (3,) angular velocity of the unit, in world axes."""
        twist = np.empty(6)
        mujoco.mj_objectVelocity(
            self._mj, self._data, mujoco.mjtObj.mjOBJ_XBODY, self._body, twist, 0
        )
        arm = self._data.xmat[self._body].reshape(3, 3) @ self._xyz
        return twist[3:] + np.cross(twist[:3], arm), twist[:3]

    def _reading(self, acceleration: FloatArray) -> Imu:
        rotation = self._data.xmat[self._body].reshape(3, 3) @ self._rotation_unit_to_link
        _, angular = self._motion()
        return Imu(
            acceleration=rotation.T @ (acceleration - self._mj.opt.gravity),
            angular_velocity=rotation.T @ angular,
            attitude=np.array(
                [
                    np.arctan2(rotation[2, 1], rotation[2, 2]),
                    np.arcsin(np.clip(-rotation[2, 0], -1.0, 1.0)),
                    np.arctan2(rotation[1, 0], rotation[0, 0]),
                ]
            ),
        )
