"""Sensors: encoders, currents, inertial unit, touch; with noise, delay and loss."""

from __future__ import annotations

import math
from collections import deque

import mujoco
import numpy as np

from pepper_driver.backends.fields import Imu
from pepper_driver.backends.mujoco_.plant_model import PlantModel
from pepper_driver.backends.simulated import Resumable
from pepper_driver.config import PlantConfig, RobotConfig, UnknownNameError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.parts import Frame


class InertialUnit(Resumable):
    """Accelerometer and gyroscope fixed to a link, without noise or drift.

    The acceleration is the mean specific force over the last cycle, in the unit's axes; what NAOqi would have put
    through its own filter.
    """

    STATE = ("_velocity",)

    def __init__(self, robot: RobotConfig, mj: mujoco.MjModel, data: mujoco.MjData) -> None:
        frame: Frame = robot.sensors.imu
        self._mj, self._data, self._cycle = mj, data, robot.cycle
        self._body = mj.body(frame.parent).id
        self._xyz = np.array(frame.xyz)
        rotation, quaternion = np.empty(9), np.empty(4)
        mujoco.mju_euler2Quat(quaternion, np.array(frame.rpy), "XYZ")  # fixed axes, as in a URDF
        mujoco.mju_quat2Mat(rotation, quaternion)
        self._rotation_unit_to_link = rotation.reshape(3, 3)
        self._velocity = np.zeros(3)
        self._twist, self._arm = np.empty(6), np.empty(3)

    def reset(self) -> Imu:
        """As if the unit had moved on as it moves now."""
        return self._reading(first=True)

    def read(self) -> Imu:
        """One cycle later."""
        return self._reading(first=False)

    def _reading(self, *, first: bool) -> Imu:
        data, twist, arm = self._data, self._twist, self._arm
        rotation_link_to_world = data.xmat[self._body].reshape(3, 3)
        mujoco.mj_objectVelocity(self._mj, data, mujoco.mjtObj.mjOBJ_XBODY, self._body, twist, 0)
        angular = twist[:3]
        mujoco.mju_cross(arm, angular, rotation_link_to_world @ self._xyz)
        velocity = twist[3:] + arm
        change = 0.0 * velocity if first else (velocity - self._velocity) / self._cycle
        self._velocity = velocity
        rotation_unit_to_world = rotation_link_to_world @ self._rotation_unit_to_link
        (xx, _, _), (yx, _, _), (zx, zy, zz) = rotation_unit_to_world.tolist()
        roll, yaw = math.atan2(zy, zz), math.atan2(yx, xx)
        pitch = math.asin(min(max(-zx, -1.0), 1.0))
        return Imu(
            acceleration=(change - self._mj.opt.gravity) @ rotation_unit_to_world,
            angular_velocity=angular @ rotation_unit_to_world,
            attitude=np.array([roll, pitch, yaw]),
        )


class TouchSensors(Resumable):
    """A sensor answers 1 for a cycle in which the mean force of the contacts within its radius is above its threshold.

    Magnitudes of forces add up, independent of their direction: a hand that pulls is detected too.
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
        """End the cycle of ``steps``: make the readings."""
        if self._felt:
            mean = np.array(self._force) / steps
            self._answer = (mean > self._threshold).astype(np.float64)
            self._force = [0.0] * len(self._force)
            self._felt = False
            self._quiet = False
        elif not self._quiet:
            self._answer = np.zeros(len(self._force))
            self._quiet = True


class Encoders(Resumable):
    """Joint encoders: noise, 12-bit counts, a delay of whole cycles, and samples that come late.

    Attributes:
        age: How many cycles the last reading is older than the delay that is always there.
    """

    STATE = ("age", "_delayed", "_read", "_rng")

    def __init__(self, robot: RobotConfig, plant: PlantConfig, rng: np.random.Generator) -> None:
        transport = plant.transport
        self._step = robot.sensors.encoder.step
        self._noise = transport.encoder_noise
        self._late = transport.late if transport.longest_late else 0.0
        self._longest_late = transport.longest_late
        self._rng = rng
        self._delayed: deque[FloatArray] = deque(maxlen=transport.encoder_delay + 1)

    def reset(self, position: FloatArray) -> FloatArray:
        """Fill the delay line as if the robot had stood at ``position`` (17,) [rad]; returns the first reading."""
        for _ in range(self._delayed.maxlen or 1):
            self._delayed.append(self._count(position))
        self.age = 0
        self._read = self._delayed[0]
        return self._read

    def read(self, position: FloatArray) -> FloatArray:
        """One cycle later: sample ``position`` (17,) [rad], return the sample that arrives now."""
        self._delayed.append(self._count(position))
        if self._late and self.age < self._longest_late and self._rng.random() < self._late:
            self.age += 1
        else:
            self.age = 0
            self._read = self._delayed[0]
        return self._read

    def _count(self, position: FloatArray) -> FloatArray:
        noisy = position + self._noise * self._rng.standard_normal(position.shape)
        return np.rint(noisy / self._step) * self._step


class CurrentSensors(Resumable):
    """Absolute motor current, low-passed, with noise, in steps of the converter."""

    STATE = ("_smoothed", "_rng")

    def __init__(self, robot: RobotConfig, plant: PlantConfig, rng: np.random.Generator) -> None:
        self._step = robot.sensors.current.step
        self._noise = plant.transport.current_noise
        self._gain = 1.0 - float(np.exp(-robot.cycle / plant.transport.current_time))
        self._rng = rng
        self._smoothed = np.zeros(len(robot.joint_names))

    def reset(self) -> FloatArray:
        """Start from no current; returns the first reading (17,) [A]."""
        self._smoothed[:] = 0.0
        return self._quantised()

    def read(self, current: FloatArray) -> FloatArray:
        """Take in the size of the mean current (17,) of one cycle [A]; returns the reading."""
        self._smoothed += self._gain * (current - self._smoothed)
        return self._quantised()

    def _quantised(self) -> FloatArray:
        noisy = self._smoothed + self._noise * self._rng.standard_normal(self._smoothed.shape)
        return np.asarray(np.rint(np.abs(noisy) / self._step) * self._step)


class CommandDelayLine(Resumable):
    """Commands in flight to the motor boards: each acts whole cycles after it was sent."""

    STATE = ("_delayed",)

    def __init__(self, plant: PlantConfig) -> None:
        self._delayed: deque[FloatArray] = deque(maxlen=plant.transport.command_delay + 1)

    def reset(self, position: FloatArray) -> None:
        """Fill the line with ``position`` (17,) [rad]."""
        for _ in range(self._delayed.maxlen or 1):
            self._delayed.append(position.copy())

    def send(self, position: FloatArray) -> FloatArray:
        """Send ``position`` (17,) [rad]; returns the command that reaches the boards now."""
        self._delayed.append(position)
        return self._delayed[0]
