"""Friction and tooth damping of the drives, which change with the state: set before each step of physics."""

from __future__ import annotations

from dataclasses import dataclass

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
        self._sides = [
            _Side(
                Slots(data.qvel, dof), Slots(mj.dof_frictionloss, dof), Slots(mj.dof_damping, dof)
            )
            for dof in (model.motor_dof, model.link_dof)
        ]
        self._tooth_damping = Slots(mj.tendon_damping, model.tendon)
        self._tooth_friction = Slots(mj.tendon_frictionloss, model.tendon)
        touching, apart = (
            [(each(f"{case}.{side}"), each(f"{case}.{side}_viscous")) for side in ("motor", "link")]
            for case in ("contact", "gap")
        )
        self._coulomb = [coulomb for coulomb, _ in touching]
        self._coulomb_change = [a - b for (a, _), (b, _) in zip(apart, touching, strict=True)]
        self._viscous = [viscous for _, viscous in touching]
        self._viscous_change = [a - b for (_, a), (_, b) in zip(apart, touching, strict=True)]
        self._relative, self._relative_viscous = each("gap.relative"), each("gap.relative_viscous")
        self._gear_damping = plant.per_joint("gear_damping", robot)
        self._half_gap = model.half_gap
        self._excess = each("breakaway") - 1.0
        self._inverse_stribeck = 1.0 / each("stribeck_velocity")
        self._load = each("load") * plant.per_joint("gear_stiffness", robot)
        self._ripple, self._ripple_count = each("ripple"), each("ripple_count")
        # What is the same in and out of the gap, or absent, costs nothing.
        self._has_change = bool(np.any(self._coulomb_change))
        self._has_viscous_change = bool(np.any(self._viscous_change))
        self._has_excess, self._has_load = bool(self._excess.any()), bool(self._load.any())
        self._has_ripple, self._has_relative = bool(self._ripple.any()), bool(self._relative.any())
        self._beyond, self._torque, self._factor = np.empty(n), np.empty(n), np.empty(n)
        self._in_gap = np.empty(n, dtype=np.bool_)
        self._warmth = np.ones(n)

    def warm(self, factor: FloatArray) -> None:
        """Scale all friction by ``factor`` (17,) from now on."""
        self._warmth[:] = factor
        for side, viscous in zip(self._sides, self._viscous, strict=True):
            side.damping.write(viscous * factor)

    def update(self) -> None:
        """Set friction and damping for the step of physics to come."""
        beyond, in_gap = self._beyond, self._in_gap
        # How far the teeth are pressed into each other [rad]; below 0 inside the gap.
        motor_angle = self._motor_angle.read()
        np.subtract(self._link_angle.read(), motor_angle, out=beyond)
        np.abs(beyond, out=beyond)
        beyond -= self._half_gap
        np.less_equal(beyond, 0.0, out=in_gap)
        self._tooth_damping.write(np.where(in_gap, self._relative_viscous, self._gear_damping))
        if self._has_relative:
            self._tooth_friction.write(self._relative * in_gap * self._warmth)
        for number, side in enumerate(self._sides):
            torque = self._coulomb_torque(number, side)
            if number == 0:
                if self._has_ripple:
                    torque *= 1.0 + self._ripple * np.cos(self._ripple_count * motor_angle)
                if self._has_load:
                    np.maximum(beyond, 0.0, out=beyond)
                    beyond *= self._load
                    torque += beyond
            torque *= self._warmth
            side.friction.write(torque)
            if self._has_viscous_change:
                viscous = self._viscous[number] + self._viscous_change[number] * in_gap
                side.damping.write(viscous * self._warmth)

    def _coulomb_torque(self, number: int, side: _Side) -> FloatArray:
        """(17,) C (1 + (b - 1) / (1 + (v / v_s)^2)), without warmth [N m]."""
        torque, factor = self._torque, self._factor
        if self._has_excess:
            np.multiply(side.velocity.read(), self._inverse_stribeck, out=factor)
            factor *= factor
            factor += 1.0
            np.divide(self._excess, factor, out=factor)
            factor += 1.0
            np.multiply(self._coulomb[number], factor, out=torque)
        else:
            torque[:] = self._coulomb[number]
            factor[:] = 1.0
        if self._has_change:
            factor *= self._coulomb_change[number]
            factor *= self._in_gap
            torque += factor
        return torque


@dataclass(frozen=True, slots=True)
class _Side:
    velocity: Slots
    friction: Slots
    damping: Slots
