"""The motors can bring the torque that a motion takes."""

from __future__ import annotations

from math import inf
from typing import Literal

import numpy as np
import pinocchio as pin

from pepper_driver.config import RobotConfig
from pepper_driver.config.arguments import checked_arguments, is_number
from pepper_driver.controller.constraints.braking_limits import BrakingLimits
from pepper_driver.controller.constraints.constraint import Constraint, LinearInequality
from pepper_driver.controller.errors import LimitError
from pepper_driver.controller.model import RobotModel


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
