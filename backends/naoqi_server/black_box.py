"""The black box: what the stand-in robot really did in the last minutes, whoever was there to see it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray, IntArray

CYCLES = 10_000
"""Kept: two minutes."""


def row_type(robot: RobotConfig) -> np.dtype[np.void]:
    """One cycle in the black box; fields as in :class:`BlackBox`."""
    joints, wheels = len(robot.joint_names), len(robot.wheels.names)
    return np.dtype(
        [
            ("cycle", np.int64),
            ("date", np.int32),
            ("begin", np.int64),
            ("end", np.int64),
            ("orders", np.int64),
            ("wheel_order", np.int64),
            ("position", np.float64, joints),
            ("wheel_speed", np.float64, wheels),
            ("base", np.float64, 3),
            ("position_command", np.float64, joints),
            ("stiffness", np.float64, joints),
            ("wheel_command", np.float64, wheels),
            ("wheel_stiffness", np.float64, wheels),
        ]
    )


@dataclass(frozen=True, kw_only=True)
class BlackBox:
    """Cycles of the robot, oldest first; n rows each.

    Attributes:
        cycle: (n,) number of the cycle since the robot started; numbers are left out where the machine was too slow.
        date: (n,) DCM time of the cycle [ms], 32 bits.
        begin: (n,) when it was due, on the machine's monotonic clock [s]: ``time.monotonic()`` of any process.
        end: (n,) when its values were published [s].
        orders: (n,) orders the DCM had taken by then.
        wheel_order: (n,) when the last one for a wheel's speed was taken, on the same clock [s]; 0 before the first.
        position: (n, 17) true joint positions at the end of the cycle [rad], without encoder and transport.
        wheel_speed: (n, 3) true speeds [rad/s].
        base: (n, 3) where the base is: x, y [m], yaw [rad].
        position_command: (n, 17) what the DCM sent to the joints [rad].
        stiffness: (n, 17) what it sent as their hardness.
        wheel_command: (n, 3) what it sent to the wheels [rad/s].
        wheel_stiffness: (n, 3) and as their stiffness.
    """

    cycle: IntArray
    date: NDArray[np.int32]
    begin: FloatArray
    end: FloatArray
    orders: IntArray
    wheel_order: FloatArray
    position: FloatArray
    wheel_speed: FloatArray
    base: FloatArray
    position_command: FloatArray
    stiffness: FloatArray
    wheel_command: FloatArray
    wheel_stiffness: FloatArray

    @classmethod
    def of(cls, rows: NDArray[np.void]) -> BlackBox:
        """From rows of the type :func:`row_type`."""
        columns = {name: np.array(rows[name]) for name in rows.dtype.names or ()}
        columns |= {name: rows[name] / 1e9 for name in ("begin", "end", "wheel_order")}
        return cls(**columns)

    def __len__(self) -> int:
        return len(self.cycle)
