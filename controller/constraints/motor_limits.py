"""Limits of motors: torque of joints, speed of wheels."""

from __future__ import annotations

from math import inf
from typing import Literal

import numpy as np
import pinocchio as pin

from pepper_driver.config import RobotConfig
from pepper_driver.config.arguments import checked_arguments, is_number
from pepper_driver.controller.constraints.constraint import (
    BrakingLimits,
    Constraint,
    LinearInequality,
)
from pepper_driver.controller.errors import LimitError
from pepper_driver.controller.model import BASE, RobotModel


@checked_arguments
class TorqueLimit(Constraint):
    """The load torque of each joint, |M qdd + C v + g|, within a share of what its motor brings through its reduction.

    It is taken at the start of the cycle, without friction and without the inertia of the rotors: these must fit into
    the rest of the motor's torque. At the accelerations of ``controller.yaml`` rotors take up to 3 % of it.
    A hand's torque is that on its aperture, carried as if it were an angle, and its ratio is motor turns per that.

    What braking to rest and holding a posture take is allowed even where it is more: a robot that may not hold itself
    would be let down by its own controller. With ``of="stall"`` that does not happen; of the nominal torque the weight
    alone takes up to three times as much when Pepper leans as far as it can.

    Args:
        robot: Its motors.
        share: Of the motors' torque.
        of: ``"stall"``: the largest torque of a motor that stands still; ``"nominal"``: the largest continuous one.

    Attributes:
        limit: (17,) in joint order [N m].

    Raises:
        LimitError: A share that is not above 0 or not finite; another torque than these two.
    """

    name = "torque"
    priority = 1
    needs_kinematics = False

    def __init__(
        self, robot: RobotConfig, share: float = 0.8, of: Literal["stall", "nominal"] = "stall"
    ) -> None:
        if not (is_number(share) and 0.0 < share < inf):
            raise LimitError("share", share, "a finite number above 0")
        if of not in ("stall", "nominal"):
            raise LimitError("of", of, "'stall' or 'nominal'")
        motors = robot.motors
        torque = [
            (motors.of(name).stall_torque if of == "stall" else motors.of(name).nominal_torque)
            * motors.joints[name].ratio
            for name in robot.joint_names
        ]
        self.limit = share * np.array(torque)
        self._joints = robot.joint_names
        self._model: RobotModel | None = None

    def compute_inequality(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> LinearInequality | None:
        """Rows of the joints that could get beyond their limit, on the side where they could."""
        if model is not self._model:
            self._model = model
            self._data = model.pin.createData()  # of its own: others read what model.data holds
            order = np.argsort(model.joint_columns)
            self._columns = model.joint_columns[order]
            self._limits = self.limit[order]
            self._names = tuple(f"{self.name} {self._joints[i]}" for i in order)
        columns, limit = self._columns, self._limits
        inertia = pin.crba(model.pin, self._data, model.q)[columns]
        load = pin.nonLinearEffects(model.pin, self._data, model.q, model.v)[columns]
        reach = np.abs(inertia) @ braking_limits.acceleration
        if not np.any(np.abs(load) + reach > limit):
            return None
        (high,) = np.nonzero(load + reach > limit)
        (low,) = np.nonzero(reach - load > limit)
        brake = braking_limits.brake
        braking = inertia @ np.minimum(np.maximum(-model.v / braking_limits.dt, -brake), brake)
        return LinearInequality(
            np.concatenate([inertia[high], -inertia[low]]),
            np.concatenate(
                [
                    np.maximum(limit - load, braking)[high],
                    np.maximum(limit + load, -braking)[low],
                ]
            ),
            tuple(self._names[i] for i in (*high, *low)),
        )


@checked_arguments
class WheelSpeedLimit(Constraint):
    """Wheel speeds after each cycle within the wheels' limit, so that none has to be slowed on its way out.

    Wheels that are too fast at the start slow down as fast as the base may brake without leaving its direction.

    Args:
        robot: Its wheels.
    """

    name = "wheel speed"
    priority = 2
    needs_kinematics = False

    def __init__(self, robot: RobotConfig) -> None:
        self._matrix, self._limit = robot.wheels.matrix, robot.wheels.speed_limit
        self._names = tuple(f"{self.name} {name}" for name in robot.wheels.names)
        self._fastest = tuple(np.abs(self._matrix).max(axis=0).tolist())
        self._for: BrakingLimits | None = None
        self._enough = 0.0

    def compute_inequality(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> LinearInequality | None:
        """Rows of the wheels that could become too fast in this cycle."""
        if braking_limits is not self._for:
            self._for = braking_limits
            step = braking_limits.acceleration[:BASE] * braking_limits.dt
            self._gained = np.abs(self._matrix) @ step
            self._enough = self._limit - float(self._gained.max())
        x, y, turn = self._fastest
        item = model.v.item
        if x * abs(item(0)) + y * abs(item(1)) + turn * abs(item(2)) <= self._enough:
            return None
        twist, dt = model.v[:BASE], braking_limits.dt
        speed = self._matrix @ twist
        size = np.abs(speed)
        (near,) = np.nonzero(size + self._gained > self._limit)
        if not len(near):
            return None
        # Of a twist that is too fast, the share that is left when it is braked for a cycle.
        left = 1.0 - float(
            np.min(braking_limits.brake[:BASE] * dt / np.maximum(np.abs(twist), 1e-9))
        )
        sign = np.where(speed[near] < 0, -1.0, 1.0)
        matrix = np.zeros((len(near), model.nv))
        matrix[:, :BASE] = sign[:, None] * self._matrix[near]
        allowed = np.maximum(self._limit, left * size[near])
        return LinearInequality(
            matrix, (allowed - size[near]) / dt, tuple(self._names[i] for i in near)
        )
