"""Friction and tooth damping of the drives, which change with the state: set before each step of physics."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.model import PlantModel
from pepper_driver.backends.mujoco_.slots import Slots
from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.arrays import FloatArray


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
        motor, link = model.motor_dof, model.link_dof
        self._velocities = Slots(data.qvel, motor), Slots(data.qvel, link)
        self._frictions = Slots(mj.dof_frictionloss, motor), Slots(mj.dof_frictionloss, link)
        self._dampings = Slots(mj.dof_damping, motor), Slots(mj.dof_damping, link)
        self._tooth_damping = Slots(mj.tendon_damping, model.tendon)
        self._tooth_friction = Slots(mj.tendon_frictionloss, model.tendon)
        # Motor's sides, then links' sides. What the gap changes is added where the teeth are apart.
        coulomb = _both_sides(each, "contact", "")
        self._cold_coulomb = coulomb, _both_sides(each, "gap", "") - coulomb
        self._viscous = _both_sides(each, "contact", "_viscous")
        self._viscous_change = _both_sides(each, "gap", "_viscous") - self._viscous
        self._relative = each("gap.relative")
        self._gear_damping = plant.per_joint("gear_damping", robot)
        self._relative_viscous = each("gap.relative_viscous")
        self._half_gap = model.half_gap
        self._excess = np.tile(each("breakaway") - 1.0, 2)
        self._inverse_stribeck = 1.0 / each("stribeck_velocity")
        self._cold_load = each("load") * plant.per_joint("gear_stiffness", robot)
        self._ripple, self._ripple_count = each("ripple"), each("ripple_count")
        # What is absent costs nothing.
        self._has_viscous_change = bool(self._viscous_change.any())
        self._has_ripple, self._has_relative = bool(self._ripple.any()), bool(self._relative.any())
        self._beyond, self._damping, self._wave = np.empty(n), np.empty(n), np.empty(n)
        self._in_gap = np.empty(n, dtype=np.bool_)
        # All of one length and type, with views made once: so NumPy takes half the time.
        self._gap, self._torque, self._factor = np.empty(2 * n), np.empty(2 * n), np.empty(2 * n)
        self._motor_gap, self._link_gap = self._gap[:n], self._gap[n:]
        self._motor_torque, self._link_torque = self._torque[:n], self._torque[n:]
        self._motor_factor, self._link_factor = self._factor[:n], self._factor[n:]
        self._zero, self._one = np.zeros(n), np.ones(2 * n)
        self.warm(np.ones(n))

    def warm(self, factor: FloatArray) -> None:
        """Scale all friction by ``factor`` (17,) from now on."""
        self._warmth = factor
        coulomb, change = self._cold_coulomb
        both = np.tile(factor, 2)
        self._coulomb, self._coulomb_change = coulomb * both, change * both
        self._load = self._cold_load * factor
        self._gear_damping_change = self._relative_viscous * factor - self._gear_damping
        self._write(self._dampings, self._viscous * both)

    def update(self) -> None:
        """Set friction and damping for the step of physics to come."""
        beyond, damping = self._beyond, self._damping
        # How far the teeth are pressed into each other [rad]; below 0 inside the gap.
        motor_angle = self._motor_angle.read()
        np.subtract(self._link_angle.read(), motor_angle, out=beyond)
        np.abs(beyond, out=beyond)
        np.subtract(beyond, self._half_gap, out=beyond)
        np.less_equal(beyond, self._zero, out=self._in_gap)
        self._motor_gap[:] = self._in_gap
        self._link_gap[:] = self._in_gap
        np.multiply(self._gear_damping_change, self._motor_gap, out=damping)
        np.add(damping, self._gear_damping, out=damping)
        self._tooth_damping.write(damping)
        self._set_coulomb(motor_angle)
        if self._has_relative:
            self._tooth_friction.write(self._relative * self._motor_gap * self._warmth)
        if self._has_viscous_change:
            viscous = self._viscous + self._viscous_change * self._gap
            self._write(self._dampings, viscous * np.tile(self._warmth, 2))

    def _set_coulomb(self, motor_angle: FloatArray) -> None:
        torque, factor, beyond, wave = self._torque, self._factor, self._beyond, self._wave
        motor, link = self._velocities
        np.multiply(motor.read(), self._inverse_stribeck, out=self._motor_factor)
        np.multiply(link.read(), self._inverse_stribeck, out=self._link_factor)
        np.multiply(factor, factor, out=factor)
        np.add(factor, self._one, out=factor)
        np.divide(self._excess, factor, out=factor)
        np.add(factor, self._one, out=factor)
        np.multiply(self._coulomb_change, self._gap, out=torque)
        np.add(torque, self._coulomb, out=torque)
        np.multiply(torque, factor, out=torque)
        if self._has_ripple:
            np.multiply(self._ripple_count, motor_angle, out=wave)
            np.cos(wave, out=wave)
            wave *= self._ripple
            wave += 1.0
            self._motor_torque *= wave
        np.maximum(beyond, self._zero, out=beyond)
        np.multiply(beyond, self._load, out=beyond)
        np.add(self._motor_torque, beyond, out=self._motor_torque)
        motor, link = self._frictions
        motor.write(self._motor_torque)
        link.write(self._link_torque)

    @staticmethod
    def _write(sides: tuple[Slots, Slots], values: FloatArray) -> None:
        for side, part in zip(sides, np.split(values, 2), strict=True):
            side.write(part)


def _both_sides(each: Callable[[str], FloatArray], case: str, suffix: str) -> FloatArray:
    """(34,) one coefficient of the motors' sides, then of the links'."""
    return np.concatenate([each(f"{case}.{side}{suffix}") for side in ("motor", "link")])
