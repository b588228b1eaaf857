"""Limits of motors: torque of joints, speed of wheels."""

from __future__ import annotations

from math import inf
from typing import Literal

import numpy as np
import pinocchio as pin

from pepper_driver.config import RobotConfig
from pepper_driver.config.arguments import checked_arguments, is_number
from pepper_driver.config.arrays import FloatArray, IntArray
from pepper_driver.config.kernels import Matrix, Out, kernel
from pepper_driver.controller.constraints.constraint import (
    BrakingLimits,
    Constraint,
    LinearInequality,
)
from pepper_driver.controller.errors import LimitError
from pepper_driver.controller.model import BASE, RobotModel


@kernel
def _torque_rows(
    inertia: Matrix[FloatArray],
    load: FloatArray,
    velocity: FloatArray,
    columns: IntArray,
    limits: FloatArray,
    acceleration: FloatArray,
    brake: FloatArray,
    dt: float,
    matrix: Out[Matrix[FloatArray]],
    bound: Out[FloatArray],
    numbers: Out[IntArray],
) -> int:
    """Write the rows of joints that could exceed their limit: upper limits, then lower ones.

    Args:
        inertia: (n, n) M.
        load: (n,) C v + g.
        velocity: (n,) v.
        columns: (joints,) place of each joint in these.
        limits: (joints,) [N m].
        acceleration: (n,) limits.
        brake: (n,) deceleration on the path to rest.
        dt: Cycle [s].
        matrix: (2 joints, n) to write.
        bound: (2 joints,) to write.
        numbers: (2 joints,) joint of each row, to write.

    Returns:
        Number of rows.
    """
    n, count = len(velocity), 0
    for sign in (1.0, -1.0):
        for number in range(len(columns)):
            j, limit = columns[number], limits[number]
            change = braking = 0.0
            for i in range(n):
                change += abs(inertia[j, i]) * acceleration[i]
                stop = np.minimum(np.maximum(-velocity[i] / dt, -brake[i]), brake[i])
                braking += inertia[j, i] * stop
            if not sign * load[j] + change > limit:
                continue
            for i in range(n):
                matrix[count, i] = sign * inertia[j, i]
            bound[count] = max(limit - sign * load[j], sign * braking)
            numbers[count] = number
            count += 1
    return count


@checked_arguments
class TorqueLimit(Constraint):
    """Limit of the load torque of each joint, |M qdd + C v + g|, by a fraction of the torque of motor and gear.

    The load torque is that at the start of the cycle, without friction and without the inertia of the rotors: the rest
    of the motor torque must be enough for these. At the accelerations of ``controller.yaml`` rotors take up to 3 %.
    The torque of a hand acts on its aperture, which is treated as an angle; its ratio is motor turns per aperture.

    The torque for braking to rest and for holding a posture is allowed even if it is larger: otherwise the controller
    would let the robot fall. With ``of="stall"`` this does not happen. The weight alone takes up to three times the
    nominal torque when Pepper leans as far as it can.

    Args:
        robot: Description with the motors.
        fraction: Fraction of the torque of the motors.
        of: ``"stall"``: torque of a motor at rest; ``"nominal"``: largest continuous torque.

    Attributes:
        limit: (17,) in joint order [N m].

    Raises:
        LimitError: A fraction that is not above 0 or not finite; another torque than these two.
    """

    name = "torque"
    priority = 1
    needs_kinematics = False

    def __init__(
        self, robot: RobotConfig, fraction: float = 0.8, of: Literal["stall", "nominal"] = "stall"
    ) -> None:
        if not (is_number(fraction) and 0.0 < fraction < inf):
            raise LimitError("fraction", fraction, "a finite number above 0")
        if of not in ("stall", "nominal"):
            raise LimitError("of", of, "'stall' or 'nominal'")
        motors = robot.motors
        torque = [
            (motors.of(name).stall_torque if of == "stall" else motors.of(name).nominal_torque)
            * motors.joints[name].ratio
            for name in robot.joint_names
        ]
        self.limit = fraction * np.array(torque)
        self._joints = robot.joint_names
        self._model: RobotModel | None = None
        self._rows = _torque_rows.load()

    def compute_inequality(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> LinearInequality | None:
        """Return rows of the joints that could exceed their limit, on the side where they could."""
        if model is not self._model:
            self._model = model
            self._data = (
                model.pin.createData()
            )  # of its own: other constraints use the results in model.data
            order = np.argsort(model.joint_columns)
            self._columns = model.joint_columns[order].astype(np.int64)
            self._limits = self.limit[order]
            self._names = tuple(f"{self.name} {self._joints[i]}" for i in order)
        inertia = pin.crba(model.pin, self._data, model.q)
        load = pin.nonLinearEffects(model.pin, self._data, model.q, model.v)
        most = 2 * len(self._limits)
        matrix, bound = np.empty((most, model.nv)), np.empty(most)
        numbers = np.empty(most, dtype=np.int64)
        count = self._rows(
            np.ascontiguousarray(inertia),
            load,
            model.v,
            self._columns,
            self._limits,
            braking_limits.acceleration,
            braking_limits.brake,
            braking_limits.dt,
            matrix,
            bound,
            numbers,
        )
        if not count:
            return None
        names = tuple(self._names[i] for i in numbers[:count])
        return LinearInequality(matrix[:count], bound[:count], names)


@checked_arguments
class WheelSpeedLimit(Constraint):
    """Limit of the wheel speeds after each cycle, so that no command has to be slowed afterwards.

    Wheels that are too fast at the start slow down as fast as the base may brake in its direction.

    Args:
        robot: Description with the wheels.
    """

    name = "wheel speed"
    priority = 2
    needs_kinematics = False

    def __init__(self, robot: RobotConfig) -> None:
        self._matrix, self._limit = robot.wheels.matrix, robot.wheels.speed_limit
        self._names = tuple(f"{self.name} {name}" for name in robot.wheels.names)
        self._max_entries = tuple(np.abs(self._matrix).max(axis=0).tolist())
        self._prepared: BrakingLimits | None = None
        self._safe_speed = 0.0

    def compute_inequality(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> LinearInequality | None:
        """Return rows of the wheels that could become too fast in this cycle."""
        if braking_limits is not self._prepared:
            self._prepared = braking_limits
            step = braking_limits.acceleration[:BASE] * braking_limits.dt
            self._max_change = np.abs(self._matrix) @ step
            self._safe_speed = self._limit - float(self._max_change.max())
        x, y, turn = self._max_entries
        item = model.v.item
        # A bound in plain numbers, which saves the arrays below in most cycles.
        if x * abs(item(0)) + y * abs(item(1)) + turn * abs(item(2)) <= self._safe_speed:
            return None
        twist, dt = model.v[:BASE], braking_limits.dt
        speed = self._matrix @ twist
        size = np.abs(speed)
        (near,) = np.nonzero(size + self._max_change > self._limit)
        if not len(near):
            return None
        # Fraction of a too fast twist that remains after one cycle of braking.
        remaining = 1.0 - float(
            np.min(braking_limits.brake[:BASE] * dt / np.maximum(np.abs(twist), 1e-9))
        )
        sign = np.where(speed[near] < 0, -1.0, 1.0)
        matrix = np.zeros((len(near), model.nv))
        matrix[:, :BASE] = sign[:, None] * self._matrix[near]
        allowed = np.maximum(self._limit, remaining * size[near])
        return LinearInequality(
            matrix, (allowed - size[near]) / dt, tuple(self._names[i] for i in near)
        )
