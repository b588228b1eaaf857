"""Adds up, step by step, what touches the robot in one cycle; at its end that is the truth of the cycle."""

from __future__ import annotations

from collections.abc import Hashable

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.plant_model import PlantModel
from pepper_driver.backends.mujoco_.sensors import TouchSensors
from pepper_driver.backends.simulated import ContactKind, Resumable, TrueContact
from pepper_driver.config.arrays import FloatArray


class Entry:
    """Effect of one object on one link in the steps of a cycle.

    Attributes:
        kind, body, thing: See :class:`~pepper_driver.backends.interface.TrueContact`; ``body`` is the link's number.
        point: (steps, 3) where it acts, in the world [m].
        force: (steps, 3) on the robot, in the world [N].
        size: (steps,) sum of the sizes of its forces [N].
        torque: (steps, nv) J^T f.
        last: The last step in which it acted.
        near: Touch sensors within reach of the point.
    """

    __slots__ = ("body", "force", "kind", "last", "near", "point", "size", "thing", "torque")

    def __init__(
        self, kind: ContactKind, body: int, thing: str | None, steps: int, freedoms: int
    ) -> None:
        self.kind, self.body, self.thing = kind, body, thing
        self.point, self.force = np.zeros((steps, 3)), np.zeros((steps, 3))
        self.size, self.torque = np.zeros(steps), np.zeros((steps, freedoms))
        self.last = -1
        self.near: tuple[int, ...] = ()


class ContactAccumulator(Resumable):
    """All contacts of a cycle. Its state is what the last cycle came to.

    Attributes:
        contacts: What touched the robot in the last cycle.
        torque: (17,) J^T f of all contacts, mean over the last cycle [N m].
        peak: (17,) largest size of it in a step of the last cycle [N m].
    """

    STATE = ("contacts", "peak", "torque")

    def __init__(
        self, model: PlantModel, data: mujoco.MjData, touch: TouchSensors, steps: int
    ) -> None:
        self._mj, self._data, self._touch, self._steps = model.mj, data, touch, steps
        self._link_dof = model.link_dof
        self._names = {body: link for link, body in model.bodies.items()}
        self._mean = np.full(steps, 1.0 / steps)
        self._entries: dict[Hashable, Entry] = {}
        self._step = 0
        self._still = np.zeros(3)
        self.reset()

    def reset(self) -> None:
        """Nothing touched in the last cycle."""
        self._entries.clear()
        self.contacts: tuple[TrueContact, ...] = ()
        self.torque, self.peak = np.zeros(len(self._link_dof)), np.zeros(len(self._link_dof))

    def begin(self) -> None:
        """Begin a cycle."""
        self._step = 0

    def next_step(self) -> None:
        """End a step of physics."""
        self._step += 1

    def entry(self, key: Hashable, kind: ContactKind, body: int, thing: str | None = None) -> Entry:
        """Return the entry under ``key``; a new one if it has not acted in this cycle yet."""
        entry = self._entries.get(key)
        if entry is None:
            entry = Entry(kind, body, thing, self._steps, self._mj.nv)
            self._entries[key] = entry
        return entry

    def place(self, entry: Entry) -> tuple[FloatArray, FloatArray]:
        """Return the (3,) point [m] and force [N] of an entry in this step, in the world, for the caller to write."""
        return entry.point[self._step], entry.force[self._step]

    def put(self, entry: Entry, size: float) -> FloatArray:
        """Take in the one force of an entry in this step, as it was written to :meth:`place`.

        Args:
            entry: As :meth:`entry` gave it; its point is that of the state whose kinematics MuJoCo holds.
            size: Of the force [N].

        Returns:
            J^T f (nv,), not to be kept.
        """
        step = self._step
        point, force = entry.point[step], entry.force[step]
        torque: FloatArray = entry.torque[step]
        entry.size[step] = size
        if entry.last < 0:
            entry.near = self._touch.near(entry.body, *point.tolist())
        entry.last = step
        mujoco.mj_applyFT(self._mj, self._data, force, self._still, point, entry.body, torque)
        return torque

    def add(self, entry: Entry, point: FloatArray, force: FloatArray, size: float) -> None:
        """Take in one of several forces of an object in this step: (3,) [N] of ``size`` at (3,) [m], in the world."""
        step = self._step
        torque = entry.torque[step]
        mujoco.mj_applyFT(self._mj, self._data, force, self._still, point, entry.body, torque)
        entry.force[step] += force
        entry.size[step] += size
        if entry.size[step] > 0.0:
            entry.point[step] += (point - entry.point[step]) * (size / entry.size[step])
        entry.last = step

    def end(self) -> None:
        """End the cycle: make its truth."""
        if not self._entries:
            if self.contacts:
                self.reset()
            return
        torques = [entry.torque.take(self._link_dof, axis=1) for entry in self._entries.values()]
        self.contacts = tuple(map(self._summary, self._entries.values(), torques))
        total, self.torque = torques[0], self.contacts[0].torque.copy()
        for torque, contact in zip(torques[1:], self.contacts[1:], strict=True):
            total = total + torque
            self.torque = self.torque + contact.torque
        self.peak = np.maximum.reduce(np.abs(total))
        self._entries.clear()

    def _summary(self, entry: Entry, torque: FloatArray) -> TrueContact:
        """Sum an entry up; ``torque`` is its own (steps, 17) part. NumPy's shortest calls: time matters."""
        sizes = entry.size.tolist()
        whole = sum(sizes)
        if whole > 0.0:
            point = entry.size.dot(entry.point)
            point /= whole
        else:
            point = entry.point[entry.last].copy()
        for sensor in entry.near:
            self._touch.press(sensor, whole)
        if entry.kind == "object":  # of several forces in a step it is their sum that counts
            sizes = np.linalg.norm(entry.force, axis=1).tolist()
        return TrueContact(
            kind=entry.kind,
            link=self._names[entry.body],
            object=entry.thing,
            point=point,
            force=self._mean.dot(entry.force),
            peak=max(sizes),
            torque=self._mean.dot(torque),
        )
