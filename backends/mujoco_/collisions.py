"""Real contact between the robot and the objects of a world: the forces that MuJoCo's solver found."""

from __future__ import annotations

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.model import PlantModel
from pepper_driver.backends.mujoco_.objects import body_name
from pepper_driver.backends.mujoco_.tally import Tally
from pepper_driver.backends.mujoco_.touch import TouchSensors
from pepper_driver.config import World


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

    def take_in(self, tally: Tally) -> None:
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
            tally.add(tally.entry((link, thing), "object", link, thing), point, force, size)
            for sensor in self._touch.near(link, *point.tolist()):
                self._touch.press(sensor, size)
