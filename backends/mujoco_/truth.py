"""What really happens in the simulation."""

from __future__ import annotations

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.rolling import FALLEN
from pepper_driver.backends.mujoco_.simulation import Simulation
from pepper_driver.backends.simulated import TrueContact, Truth
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.errors import check_name

LYING = 0.05
"""[rad] Before the tilt at which the base lies, where it still rocks."""


class MujocoTruth(Truth):
    """Ground truth of the simulated robot."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        mj, names = simulation.model.mj, ("base_x", "base_y", "base_yaw", "base_pitch", "base_roll")
        self._places = None
        if simulation.wheels.rolling:
            self._places = np.array([mj.joint(name).qposadr[0] for name in names])

    @property
    def contact_torque(self) -> FloatArray:
        """(17,) J^T f, mean over the last cycle [N m]."""
        return self._simulation.contacts.torque.copy()

    @property
    def peak_torque(self) -> FloatArray:
        """(17,) largest |J^T f| in a step of the last cycle [N m]."""
        return self._simulation.contacts.peak_torque.copy()

    @property
    def contacts(self) -> tuple[TrueContact, ...]:
        """What touched the robot in the last cycle."""
        return self._simulation.contacts.acted

    @property
    def base(self) -> FloatArray:
        """(3,) x, y [m], yaw [rad] of base_link."""
        return self._base()[:3]

    @property
    def tilt(self) -> FloatArray:
        """(2,) pitch and roll of the base [rad]."""
        return self._base()[3:]

    @property
    def fallen(self) -> bool:
        """Whether the base has come to lie."""
        return bool(np.abs(self.tilt).max() > FALLEN - LYING)

    @property
    def wheel_load(self) -> FloatArray:
        """(3,) force of the floor on each wheel [N]."""
        return self._simulation.wheels.load.copy()

    @property
    def kinetic_energy(self) -> float:
        """Of all links, rotors and wheels, with the objects of the world [J]."""
        mj, data = self._simulation.model.mj, self._simulation.data
        momentum = np.empty(mj.nv)
        mujoco.mj_mulM(mj, data, momentum, data.qvel)
        return 0.5 * float(momentum @ data.qvel)

    def _base(self) -> FloatArray:
        """(5,) x, y, yaw, pitch, roll."""
        if self._places is None:
            return np.zeros(5)
        base: FloatArray = self._simulation.data.qpos[self._places]  # an index array copies
        return base

    @property
    def in_gap(self) -> BoolArray:
        """(17,) whether the joint is inside its backlash."""
        return self._simulation.model.in_gap(self._simulation.data)

    @property
    def saturated(self) -> BoolArray:
        """(17,) whether the board met its current or voltage limit in the last cycle."""
        return self._simulation.boards.saturated.copy()

    @property
    def position(self) -> FloatArray:
        """(17,) link-side joint positions [rad]."""
        return self._simulation.position

    def link_pose(self, link: str) -> FloatArray:
        """(4, 4) transform of a link in the world."""
        model = self._simulation.model
        check_name("link", link, model.bodies)
        # In a place of its own: the simulation goes on from what its last step left behind.
        scratch = mujoco.MjData(model.mj)
        scratch.qpos[:] = self._simulation.data.qpos
        mujoco.mj_kinematics(model.mj, scratch)
        pose = np.eye(4)
        pose[:3, :3] = scratch.xmat[model.bodies[link]].reshape(3, 3)
        pose[:3, 3] = scratch.xpos[model.bodies[link]]
        return pose
