"""Scheduled forces on links, and the torque they put on the joints."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.model import PlantModel
from pepper_driver.config.parts import FloatArray

RISE = 0.1
"""[s] in which a push rises, and falls, along half a cosine; a third of the push where that is shorter."""


@dataclass(frozen=True, kw_only=True)
class Push:
    """One push: ``force`` (3,) [N] at ``point`` (3,) of the body [m], from ``start`` [s] for ``duration`` [s]."""

    body: int
    force: FloatArray
    point: FloatArray
    turns_with_link: bool
    start: float
    duration: float

    def strength(self, time: float) -> float:
        """Share of the force that acts at ``time`` [s], 0..1."""
        since, until = time - self.start, self.start + self.duration - time
        if since <= 0.0 or until <= 0.0:
            return 0.0
        rise = min(RISE, self.duration / 3)
        edge = min(since, until)
        return 1.0 if edge >= rise else 0.5 - 0.5 * cos(pi * edge / rise)


class Pushes:
    """The pushes still to come or under way."""

    def __init__(self, model: PlantModel, data: mujoco.MjData) -> None:
        self._model = model
        self._data = data
        self._pending: list[Push] = []
        self._jacobian_position = np.zeros((3, model.mj.nv))
        self._jacobian_rotation = np.zeros((3, model.mj.nv))
        self._acting: list[int] = []

    def add(self, push: Push) -> None:
        """Schedule a push."""
        self._pending.append(push)

    def clear(self) -> None:
        """Forget all pushes."""
        self._pending.clear()
        self._acting.clear()
        self._data.xfrc_applied[:] = 0.0

    def apply(self) -> None:
        """Set the external wrenches for the step to come."""
        if not self._pending and not self._acting:
            return
        data = self._data
        data.xfrc_applied[self._acting] = 0.0
        self._acting.clear()
        now = data.time
        for push in self._pending:
            strength = push.strength(now)
            if strength == 0.0:
                continue
            rotation_link_to_world = data.xmat[push.body].reshape(3, 3)
            force = strength * push.force
            if push.turns_with_link:
                force = rotation_link_to_world @ force
            arm = data.xpos[push.body] + rotation_link_to_world @ push.point - data.xipos[push.body]
            data.xfrc_applied[push.body, :3] += force
            data.xfrc_applied[push.body, 3:] += np.cross(arm, force)
            self._acting.append(push.body)
        self._pending = [push for push in self._pending if push.start + push.duration > now]

    def add_joint_torque(self, total: FloatArray) -> None:
        """Add to ``total`` (17,) the torque J^T f [N m] of the wrenches that acted in the step just made.

        MuJoCo's kinematics after a step are those of the state the forces acted on, so this is exact.
        """
        for body in set(self._acting):
            mujoco.mj_jacBodyCom(
                self._model.mj, self._data, self._jacobian_position, self._jacobian_rotation, body
            )
            wrench = self._data.xfrc_applied[body]
            torque = self._jacobian_position.T @ wrench[:3] + self._jacobian_rotation.T @ wrench[3:]
            total += torque[self._model.link_dof]
