"""Contacts of the simulated robot with the world and with itself."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.contact_accumulator import ContactAccumulator
from pepper_driver.backends.mujoco_.objects import Throws, body_name, check_clearance
from pepper_driver.backends.mujoco_.plant_model import PlantModel
from pepper_driver.backends.mujoco_.pushes import GrabForces, Pushes
from pepper_driver.backends.mujoco_.sensors import TouchSensors
from pepper_driver.backends.mujoco_.wheels import WheelDynamics
from pepper_driver.backends.simulated import Resumable, TrueContact
from pepper_driver.config import RobotConfig, World
from pepper_driver.config.arrays import FloatArray


class Collisions:
    """Reads the contact forces of the step just made.

    MuJoCo's kinematics after a step are those of the state the forces acted on, so J^T f is exact. The forces are read
    contact by contact, because ``qfrc_constraint`` also holds friction, limits and the floor.
    """

    def __init__(
        self, model: PlantModel, data: mujoco.MjData, world: World, touch: TouchSensors
    ) -> None:
        mj, links = model.mj, set(model.bodies.values())
        self._mj, self._data, self._touch = mj, data, touch
        self._thing = {mj.geom(body_name(name)).id: name for name in world.objects}
        bodies = enumerate(mj.geom_bodyid.tolist())
        self._link = {geom: body for geom, body in bodies if body in links}
        self._wrench = np.zeros(6)

    def take_in(self, accumulator: ContactAccumulator) -> None:
        """Add what acted between robot and objects in the step just made."""
        data = self._data
        if data.ncon == 0:
            return
        contacts = data.contact
        for number, (first, second) in enumerate(contacts.geom.tolist()):
            # The force in MuJoCo's contact frame acts on the second geometry, and against it on the first.
            if first in self._thing and second in self._link:
                thing, link, sign = self._thing[first], self._link[second], 1.0
            elif second in self._thing and first in self._link:
                thing, link, sign = self._thing[second], self._link[first], -1.0
            else:
                continue
            contact = contacts[number]
            if contact.efc_address < 0:
                continue
            mujoco.mj_contactForce(self._mj, data, number, self._wrench)
            force = sign * (self._wrench[:3] @ contact.frame.reshape(3, 3))
            size = float(np.sqrt(force @ force))
            if size == 0.0:
                continue  # near enough to be a contact, but parting
            point = contact.pos
            accumulator.add(
                accumulator.entry((link, thing), "object", link, thing), point, force, size
            )
            for sensor in self._touch.near(link, *point.tolist()):
                self._touch.press(sensor, size)


class Contacts(Resumable):
    """All contacts of the robot, applied and measured in every step of physics.

    Pushes and hands act on the kinematics of the very state they are applied to: the step is made in two halves, and
    they come between. So a simulation continues bit for bit from a saved state.

    Attributes:
        pushes, grabs: What is scheduled.
        touch: The sensors in contact.
    """

    def __init__(
        self,
        robot: RobotConfig,
        model: PlantModel,
        data: mujoco.MjData,
        wheels: WheelDynamics,
        world: World | None = None,
    ) -> None:
        self._mj, self._data, self._cycle = model.mj, data, robot.cycle
        self._steps = round(robot.cycle / model.mj.opt.timestep)
        self._joint_torque = data.qfrc_applied
        self.touch = TouchSensors(robot, model, data)
        self.pushes, self.grabs = Pushes(model, data), GrabForces(model, data, wheels)
        self._accumulator = ContactAccumulator(model, data, self.touch, self._steps)
        self._world = world if world is not None and world.objects else None
        self._collisions: Collisions | None = None
        self._throws: Throws | None = None
        if self._world is not None:
            self._collisions = Collisions(model, data, self._world, self.touch)
            self._throws = Throws(model.mj, data, self._world)
        self._scheduled = self._waiting = False
        self._idle = True

    @property
    def torque(self) -> FloatArray:
        """(17,) J^T f, mean over the last cycle [N m]."""
        return self._accumulator.torque

    @property
    def peak_torque(self) -> FloatArray:
        """(17,) largest size of J^T f in a step of the last cycle [N m]."""
        return self._accumulator.peak

    @property
    def acted(self) -> tuple[TrueContact, ...]:
        """True contacts of the last cycle."""
        return self._accumulator.contacts

    def reset(self) -> None:
        """Nothing touches, nothing is to come but what the world throws."""
        self.pushes.clear()
        self.grabs.clear()
        self.touch.reset()
        self._accumulator.reset()

    def check_clearance(self) -> None:
        """Refuse a start inside an object; see :func:`~.objects.check_clearance`. MuJoCo holds the contacts."""
        if self._world is not None:
            check_clearance(self._mj, self._data, self._world)

    def begin_cycle(self) -> None:
        """Find out what may act in the cycle to come: the rest costs its steps nothing."""
        now = self._data.time
        pushes = self.pushes.begin_cycle(now, now + self._cycle)
        hands = self.grabs.begin_cycle(now, now + self._cycle)
        self._scheduled = pushes or hands
        self._waiting = self._throws is not None and self._throws.waiting
        self._idle = not self._scheduled and self._world is None
        self._accumulator.begin()

    def step(self) -> None:
        """One step of physics with all that touches the robot."""
        mj, data = self._mj, self._data
        if self._idle:
            mujoco.mj_step(mj, data)
            return
        if self._waiting and self._throws is not None:
            self._throws.hold()
        if self._scheduled:
            accumulator, torque = self._accumulator, self._joint_torque
            mujoco.mj_step1(mj, data)
            torque.fill(0.0)
            self.pushes.apply(accumulator, torque)
            self.grabs.apply(accumulator, torque)
            mujoco.mj_step2(mj, data)
        else:
            mujoco.mj_step(mj, data)
        if self._collisions is not None:
            self._collisions.take_in(self._accumulator)
        self._accumulator.next_step()

    def end_cycle(self) -> None:
        """Finish the truth of the cycle and the answers of the sensors."""
        if self._scheduled:
            self._joint_torque.fill(0.0)
        self._accumulator.end()
        self.touch.end(self._steps)

    def save(self) -> dict[str, Any]:
        """Everything that the next cycle depends on."""
        return {name: part.save() for name, part in self._parts().items()}

    def restore(self, saved: dict[str, Any]) -> None:
        """Take on a state that :meth:`save` gave."""
        for name, part in self._parts().items():
            part.restore(saved[name])

    def _parts(self) -> dict[str, Resumable]:
        return {
            "pushes": self.pushes,
            "grabs": self.grabs,
            "touch": self.touch,
            "contacts": self._accumulator,
        }
