"""How much of the simulated motion is the error of its integration."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.board import MotorBoards
from pepper_driver.backends.mujoco_.friction import Friction
from pepper_driver.backends.mujoco_.model import build_model
from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.arrays import FloatArray

SPEED_SHARE = 0.15
"""Peak speed of the motion, as a share of each joint's limit."""

RANGE_SHARE = 0.6
"""Travel of the motion, at most, as a share of each joint's range."""


def integration_error(
    robot: RobotConfig, plant: PlantConfig, *, seconds: float = 2.0, fine_step: float = 25e-6
) -> float:
    """Error of the plant's step of physics, against a finer one.

    Both runs are of the same robot on a fixed base: all 17 joints swing together, each at its own rate, at speeds of
    normal use, and turn round at least once. The boards belong to the robot: in both runs they compute a voltage once
    in ``plant.physics.timestep`` and hold it. Only what MuJoCo integrates differs, and the friction set before each
    of its steps. Battery and motors stay at the voltage and temperature that the plant's values hold for.

    Args:
        robot: Whose joints swing.
        plant: Whose ``physics.timestep`` is to be judged.
        seconds: Length of the motion.
        fine_step: [s] of the run that counts as true; a whole fraction of the step.

    Returns:
        Root mean square over time and all joints of the difference in joint position [rad].

    Raises:
        ValueError: The fine step does not divide the plant's.
    """
    fraction = plant.physics.timestep / fine_step
    parts = round(fraction)
    if parts < 1 or abs(fraction - parts) > 1e-6:
        raise ValueError(
            f"fine_step: {fine_step:g} s does not divide the step of {plant.physics.timestep:g} s"
        )
    steps = round(seconds / plant.physics.timestep)
    error = _run(robot, plant, steps, parts) - _run(robot, plant, steps, 1)
    return float(np.sqrt(np.mean(np.square(error))))


def _run(robot: RobotConfig, plant: PlantConfig, steps: int, parts: int) -> FloatArray:
    """(steps, 17) joint positions [rad] after each step of the boards, each integrated in ``parts`` parts."""
    period = plant.physics.timestep
    fixed = replace(plant, base="fixed")
    model = build_model(
        robot, replace(fixed, physics=replace(plant.physics, timestep=period / parts))
    )
    data = mujoco.MjData(model.mj)
    boards, friction = MotorBoards(robot, fixed), Friction(robot, fixed, model, data)
    new = np.ones(len(robot.joint_names))
    boards.begin_cycle(new, plant.board.voltage)
    friction.warm(new)
    data.qpos[model.link_qpos] = data.qpos[model.motor_qpos] = _swing(robot, 0.0)
    positions = np.empty((steps, len(new)))
    for step in range(steps):
        data.ctrl[model.actuator] = boards.update(
            _swing(robot, (step + 1) * period),
            data.qpos[model.link_qpos],
            data.qvel[model.motor_dof],
        )
        for _ in range(parts):
            friction.update()
            mujoco.mj_step(model.mj, data)
        positions[step] = data.qpos[model.link_qpos]
    return positions


def _swing(robot: RobotConfig, time: float) -> FloatArray:
    """(17,) commanded positions [rad]: from one end of a part of each joint's range to the other and back."""
    n = len(robot.joint_names)
    rate = 2 * np.pi * np.linspace(0.5, 1.0, n)  # [rad/s]
    fastest = SPEED_SHARE * np.array([joint.velocity for joint in robot.joints])
    size = np.minimum(fastest / rate, RANGE_SHARE / 2 * (robot.upper - robot.lower))
    direction = np.where(np.arange(n) % 2, -1.0, 1.0)
    return np.asarray((robot.lower + robot.upper) / 2 - direction * size * np.cos(rate * time))
