"""Scheduled forces on links."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sqrt

import mujoco

from pepper_driver.backends.mujoco_.resumable import Resumable
from pepper_driver.backends.mujoco_.tally import Tally
from pepper_driver.config.parts import FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Push:
    """One push: ``force`` (3,) [N] at ``point`` (3,) of the body [m], from ``start`` [s] for ``duration`` [s].

    It rises and falls along half a cosine, in ``rise`` [s] each.
    """

    body: int
    force: FloatArray
    point: FloatArray
    turns_with_link: bool
    start: float
    duration: float
    rise: float

    @property
    def end(self) -> float:
        """When it is over [s]."""
        return self.start + self.duration

    def strength(self, time: float) -> float:
        """Share of the force that acts at ``time`` [s], 0..1."""
        since, until = time - self.start, self.end - time
        if since <= 0.0 or until <= 0.0:
            return 0.0
        edge = min(since, until)
        return 1.0 if edge >= self.rise else 0.5 - 0.5 * cos(pi * edge / self.rise)


class Pushes(Resumable):
    """The pushes still to come or under way."""

    STATE = ("_pending",)

    def __init__(self, data: mujoco.MjData) -> None:
        self._data = data
        self._pending: list[Push] = []
        self._due: list[Push] = []

    def add(self, push: Push) -> None:
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
            rotation = data.xmat[push.body].reshape(3, 3)
            force = strength * push.force
            if push.turns_with_link:
                force = rotation @ force
            px, py, pz = (data.xpos[push.body] + rotation @ push.point).tolist()
            x, y, z = force.tolist()
            joint_torque += tally.put(
                tally.entry(push, "push", push.body),
                (px, py, pz),
                (x, y, z),
                sqrt(x * x + y * y + z * z),
            )
