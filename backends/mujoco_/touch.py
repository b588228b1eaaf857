"""Touch sensors, bumpers and buttons: surfaces that answer to contact near them."""

from __future__ import annotations

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.model import PlantModel
from pepper_driver.backends.mujoco_.resumable import Resumable
from pepper_driver.config import RobotConfig, UnknownNameError
from pepper_driver.config.arrays import FloatArray


class TouchSensors(Resumable):
    """A sensor answers 1 for a cycle in which the mean force of the contacts within its radius is above its threshold.

    Sizes of forces add up, whatever their direction: a hand that pulls is felt too.
    """

    STATE = ("_answer", "_quiet")

    def __init__(self, robot: RobotConfig, model: PlantModel, data: mujoco.MjData) -> None:
        sensors = robot.sensors
        groups = (sensors.touch, sensors.bumpers, sensors.buttons)
        flat = [sensor for group in groups for sensor in group.values()]
        self._data = data
        self._ends = np.cumsum([len(group) for group in groups]).tolist()
        self._threshold = np.array([sensor.threshold for sensor in flat])
        self._places: dict[int, list[tuple[int, int, tuple[float, float, float], float]]] = {}
        for number, sensor in enumerate(flat):
            for link in (sensor.parent, *sensor.covers):
                if link not in model.bodies:
                    raise UnknownNameError("link", link, model.bodies)
                self._places.setdefault(model.bodies[link], []).append(
                    (number, model.bodies[sensor.parent], sensor.xyz, sensor.radius**2)
                )
        self._force = [0.0] * len(flat)
        self._felt, self._quiet = False, True
        self._answer = np.zeros(len(flat))

    @property
    def touch(self) -> FloatArray:
        """(5,) 1.0 where touched."""
        return self._answer[: self._ends[0]].copy()

    @property
    def bumpers(self) -> FloatArray:
        """(3,) 1.0 where pressed."""
        return self._answer[self._ends[0] : self._ends[1]].copy()

    @property
    def buttons(self) -> FloatArray:
        """(1,) 1.0 where pressed."""
        return self._answer[self._ends[1] :].copy()

    def reset(self) -> None:
        """Nothing touches."""
        self._force = [0.0] * len(self._force)
        self._felt, self._quiet = False, True
        self._answer = np.zeros(len(self._force))

    def near(self, body: int, x: float, y: float, z: float) -> tuple[int, ...]:
        """Numbers of the sensors that answer to a contact on a link at this point of the world [m]."""
        places = self._places.get(body)
        if places is None:
            return ()
        found = []
        for number, parent, (sx, sy, sz), reach in places:
            a, b, c, d, e, f, g, h, i = self._data.xmat[parent].tolist()
            px, py, pz = self._data.xpos[parent].tolist()
            dx = px + a * sx + b * sy + c * sz - x
            dy = py + d * sx + e * sy + f * sz - y
            dz = pz + g * sx + h * sy + i * sz - z
            if dx * dx + dy * dy + dz * dz <= reach:
                found.append(number)
        return tuple(found)

    def press(self, sensor: int, force: float) -> None:
        """Add to the sum of forces [N] on a sensor over the steps of this cycle."""
        self._force[sensor] += force
        self._felt = True

    def end(self, steps: int) -> None:
        """The cycle of ``steps`` is over: answer."""
        if self._felt:
            mean = np.array(self._force) / steps
            self._answer = (mean > self._threshold).astype(np.float64)
            self._force = [0.0] * len(self._force)
            self._felt = False
            self._quiet = False
        elif not self._quiet:
            self._answer = np.zeros(len(self._force))
            self._quiet = True
