"""Scheduled forces on links."""

from __future__ import annotations

from math import sqrt

import mujoco

from pepper_driver.backends.mujoco_.model import PlantModel
from pepper_driver.backends.mujoco_.resumable import Resumable
from pepper_driver.backends.mujoco_.tally import Tally
from pepper_driver.backends.pushes import ScheduledPush
from pepper_driver.config.arrays import FloatArray


class Pushes(Resumable):
    """The pushes still to come or under way."""

    STATE = ("_pending",)

    def __init__(self, model: PlantModel, data: mujoco.MjData) -> None:
        self._bodies, self._data = model.bodies, data
        self._pending: list[ScheduledPush] = []
        self._due: list[ScheduledPush] = []

    def add(self, push: ScheduledPush) -> None:
        """Schedule a push."""
        self._pending.append(push)

    def clear(self) -> None:
        """Forget all pushes."""
        self._pending.clear()

    def begin_cycle(self, now: float, end: float) -> bool:
        """Whether any may act between ``now`` and ``end`` [s]; forgets those that are over."""
        if not self._pending:
            self._due.clear()
            return False
        self._pending = [push for push in self._pending if push.end > now]
        self._due = [push for push in self._pending if push.start < end]
        return bool(self._due)

    def apply(self, tally: Tally, joint_torque: FloatArray) -> None:
        """Add J^T f of all pushes to ``joint_torque`` (nv,), at the state whose kinematics MuJoCo holds."""
        data = self._data
        for push in self._due:
            strength = push.strength(data.time)
            if strength == 0.0:
                continue
            body = self._bodies[push.link]
            rotation = data.xmat[body].reshape(3, 3)
            force = strength * push.force
            if push.turns_with_link:
                force = rotation @ force
            px, py, pz = (data.xpos[body] + rotation @ push.point).tolist()
            x, y, z = force.tolist()
            joint_torque += tally.put(
                tally.entry(push, "push", body),
                (px, py, pz),
                (x, y, z),
                sqrt(x * x + y * y + z * z),
            )
