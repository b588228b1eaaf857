"""Friction and tooth damping of the drives, which change with the state: set before each step of physics."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.model import PlantModel
from pepper_driver.backends.mujoco_.slots import Slots
from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.parts import FloatArray


class Friction:
    """Eq. 7 of the paper, its two sets of coefficients, with what a real gear adds.

    On each side, Coulomb friction C (1 + (b - 1) / (1 + (v / v_s)^2)) with the set of coefficients of the gap or of
    teeth in contact, breakaway b and Stribeck velocity v_s; all of it shrinks as the grease warms. The motor's side
    also has load-dependent friction, a share of the torque through the teeth, and a ripple over the turn of the joint.
    Inside the gap the two sides may drag at each other. MuJoCo solves Coulomb friction as a constraint: it sticks.
    """

    def __init__(
        self, robot: RobotConfig, plant: PlantConfig, model: PlantModel, data: mujoco.MjData
    ) -> None:
        def each(key: str) -> FloatArray:
            return plant.per_joint(f"friction.{key}", robot)

        mj, n = model.mj, len(model.half_gap)
        self._motor_angle = Slots(data.qpos, model.motor_qpos)
        self._link_angle = Slots(data.qpos, model.link_qpos)
        dofs = (model.motor_dof, model.link_dof)
        self._velocities = [Slots(data.qvel, dof) for dof in dofs]
        self._frictions = [Slots(mj.dof_frictionloss, dof) for dof in dofs]
        self._dampings = [Slots(mj.dof_damping, dof) for dof in dofs]
        self._tooth_damping = Slots(mj.tendon_damping, model.tendon)
        self._tooth_friction = Slots(mj.tendon_frictionloss, model.tendon)
        # Rows: motor's side, link's side. What the gap changes is added where the teeth are apart.
        coulomb = _both_sides(each, "contact", "")
        self._cold_coulomb = coulomb, _both_sides(each, "gap", "") - coulomb
        self._viscous = _both_sides(each, "contact", "_viscous")
        self._viscous_change = _both_sides(each, "gap", "_viscous") - self._viscous
        self._relative = each("gap.relative")
        self._gear_damping = plant.per_joint("gear_damping", robot)
        self._relative_viscous = each("gap.relative_viscous")
        self._half_gap = model.half_gap
        self._excess = each("breakaway") - 1.0
        self._inverse_stribeck = 1.0 / each("stribeck_velocity")
        self._cold_load = each("load") * plant.per_joint("gear_stiffness", robot)
        self._ripple, self._ripple_count = each("ripple"), each("ripple_count")
        # What is absent costs nothing.
        self._has_viscous_change = bool(self._viscous_change.any())
        self._has_ripple, self._has_relative = bool(self._ripple.any()), bool(self._relative.any())
        self._torque, self._factor = np.empty((2, n)), np.empty((2, n))
        self._motor_torque, self._wave = self._torque[0], np.empty(n)
        self._beyond, self._damping = np.empty(n), np.empty(n)
        self._in_gap = np.empty(n, dtype=np.bool_)
        self._zero, self._one = (
            np.zeros(n),
            np.ones(n),
        )  # NumPy takes arrays in half the time of numbers
        self.warm(self._one)

    def warm(self, factor: FloatArray) -> None:
        """Scale all friction by ``factor`` (17,) from now on."""
        self._warmth = factor
        coulomb, change = self._cold_coulomb
        self._coulomb, self._coulomb_change = coulomb * factor, change * factor
        self._load = self._cold_load * factor
        self._gear_damping_change = self._relative_viscous * factor - self._gear_damping
        for damping, viscous in zip(self._dampings, self._viscous, strict=True):
            damping.write(viscous * factor)

    def update(self) -> None:
        """Set friction and damping for the step of physics to come."""
        beyond, in_gap, damping = self._beyond, self._in_gap, self._damping
        # How far the teeth are pressed into each other [rad]; below 0 inside the gap.
        motor_angle = self._motor_angle.read()
        np.subtract(self._link_angle.read(), motor_angle, out=beyond)
        np.abs(beyond, out=beyond)
        beyond -= self._half_gap
        np.less_equal(beyond, self._zero, out=in_gap)
        np.multiply(self._gear_damping_change, in_gap, out=damping)
        damping += self._gear_damping
        self._tooth_damping.write(damping)
        self._set_coulomb(motor_angle)
        if self._has_relative:
            self._tooth_friction.write(self._relative * in_gap * self._warmth)
        if self._has_viscous_change:
            viscous = (self._viscous + self._viscous_change * in_gap) * self._warmth
            for slots, row in zip(self._dampings, viscous, strict=True):
                slots.write(row)

    def _set_coulomb(self, motor_angle: FloatArray) -> None:
        torque, factor, beyond, wave = self._torque, self._factor, self._beyond, self._wave
        for velocity, row in zip(self._velocities, factor, strict=True):
            np.multiply(velocity.read(), self._inverse_stribeck, out=row)
        factor *= factor
        factor += self._one
        np.divide(self._excess, factor, out=factor)
        factor += self._one
        np.multiply(self._coulomb_change, self._in_gap, out=torque)
        torque += self._coulomb
        torque *= factor
        if self._has_ripple:
            np.multiply(self._ripple_count, motor_angle, out=wave)
            np.cos(wave, out=wave)
            wave *= self._ripple
            wave += 1.0
            self._motor_torque *= wave
        np.maximum(beyond, self._zero, out=beyond)
        beyond *= self._load
        self._motor_torque += beyond
        for friction, row in zip(self._frictions, torque, strict=True):
            friction.write(row)


def _both_sides(each: Callable[[str], FloatArray], case: str, suffix: str) -> FloatArray:
    """(2, 17) one coefficient of the motor's and of the link's side."""
    return np.stack([each(f"{case}.{side}{suffix}") for side in ("motor", "link")])
