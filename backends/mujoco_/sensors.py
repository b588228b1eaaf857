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
from pepper_driver.config.kernels import Matrix, Out, kernel
from pepper_driver.config.parts import Frame


@kernel
def read_inertial_unit(
    position: FloatArray,
    rotation_link_to_world: Matrix[FloatArray],
    twist: FloatArray,
    centre: FloatArray,
    place: FloatArray,
    rotation_unit_to_link: Matrix[FloatArray],
    gravity: FloatArray,
    cycle: float,
    first: bool,
    last_velocity: Out[FloatArray],
    reading: Out[Matrix[FloatArray]],
) -> None:
    """Write acceleration, angular velocity and attitude of a unit to the rows of ``reading`` (3, 3).

    Args:
        position: (3,) of the link in the world [m].
        rotation_link_to_world: (3, 3).
        twist: (6,) rotation [rad/s] and translation [m/s] of the link, about ``centre``.
        centre: (3,) in the world [m].
        place: (3,) of the unit in the link [m].
        rotation_unit_to_link: (3, 3).
        gravity: (3,) in the world [m/s2].
        cycle: Time between two readings [s].
        first: True if the unit has moved on as it moves now.
        last_velocity: (3,) of the unit at the reading before, and then now [m/s].
        reading: In the axes of the unit.
    """
    arm, force, rotation = np.empty(3), np.empty(3), np.zeros((3, 3))  # from unit to world
    for i in range(3):
        arm[i] = position[i] - centre[i]
        for k in range(3):
            arm[i] += rotation_link_to_world[i, k] * place[k]
            for m in range(3):
                rotation[i, k] += rotation_link_to_world[i, m] * rotation_unit_to_link[m, k]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        velocity = twist[3 + i] + (twist[j] * arm[k] - twist[k] * arm[j])
        force[i] = (0.0 if first else (velocity - last_velocity[i]) / cycle) - gravity[i]
        last_velocity[i] = velocity
    for k in range(3):
        reading[0, k], reading[1, k] = 0.0, 0.0
        for i in range(3):
            reading[0, k] += force[i] * rotation[i, k]
            reading[1, k] += twist[i] * rotation[i, k]
    reading[2, 0] = math.atan2(rotation[2, 1], rotation[2, 2])
    reading[2, 1] = math.asin(min(max(-rotation[2, 0], -1.0), 1.0))
    reading[2, 2] = math.atan2(rotation[1, 0], rotation[0, 0])


class InertialUnit(Resumable):
    """Accelerometer and gyroscope fixed to a link, without noise or drift.

    The acceleration is the mean specific force over the last cycle, in the unit's axes; what NAOqi would have put
    through its own filter.
    """

    STATE = ("_velocity",)

    def __init__(self, robot: RobotConfig, mj: mujoco.MjModel, data: mujoco.MjData) -> None:
        frame: Frame = robot.sensors.imu
        body = mj.body(frame.parent).id
        rotation, quaternion = np.empty(9), np.empty(4)
        mujoco.mju_euler2Quat(quaternion, np.array(frame.rpy), "XYZ")  # fixed axes, as in a URDF
        mujoco.mju_quat2Mat(rotation, quaternion)
        self._body = (
            data.xpos[body],
            data.xmat[body].reshape(3, 3),
            data.cvel[body],
            data.subtree_com[mj.body_rootid[body]],
        )
        self._unit = (
            np.array(frame.xyz),
            rotation.reshape(3, 3),
            np.array(mj.opt.gravity),
            robot.cycle,
        )
        self._velocity = np.zeros(3)
        self._read = read_inertial_unit.load()

    def reset(self) -> Imu:
        """As if the unit had moved on as it moves now."""
        return self._reading(first=True)

    def read(self) -> Imu:
        """One cycle later."""
        return self._reading(first=False)

    def _reading(self, *, first: bool) -> Imu:
        reading = np.empty((3, 3))
        self._read(*self._body, *self._unit, first, self._velocity, reading)
        acceleration, angular_velocity, attitude = reading
        return Imu(acceleration=acceleration, angular_velocity=angular_velocity, attitude=attitude)


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
        self._pressed, self._quiet = False, True
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
        self._pressed, self._quiet = False, True
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
        self._pressed = True

    def end(self, steps: int) -> None:
        """End the cycle of ``steps``: make the readings."""
        if self._pressed:
            mean = np.array(self._force) / steps
            self._answer = (mean > self._threshold).astype(np.float64)
            self._force = [0.0] * len(self._force)
            self._pressed = False
            self._quiet = False
        elif not self._quiet:
            self._answer = np.zeros(len(self._force))
            self._quiet = True


@kernel
def count_positions(
    position: FloatArray, noise: FloatArray, amplitude: float, step: float, counts: Out[FloatArray]
) -> None:
    """Write (n,) positions [rad], with normal ``noise`` (n,) times an ``amplitude`` [rad], in whole ``step`` [rad]."""
    for j in range(len(position)):
        counts[j] = np.rint((position[j] + amplitude * noise[j]) / step) * step


@kernel
def count_currents(
    current: FloatArray,
    noise: FloatArray,
    amplitude: float,
    step: float,
    gain: float,
    smoothed: Out[FloatArray],
    counts: Out[FloatArray],
) -> None:
    """Take (n,) currents [A] into a low-pass; write its size with noise in whole ``step`` [A]."""
    for j in range(len(current)):
        smoothed[j] += gain * (current[j] - smoothed[j])
        counts[j] = np.rint(abs(smoothed[j] + amplitude * noise[j]) / step) * step


class Encoders(Resumable):
    """Joint encoders: noise, 12-bit counts, a delay of whole cycles, samples that come late and samples that are lost.

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
        self._lost = transport.lost
        self._rng = rng
        self._count_positions = count_positions.load()
        self._delayed: deque[FloatArray] = deque(maxlen=transport.sensor_delay + 1)

    def reset(self, position: FloatArray) -> FloatArray:
        """Fill the delay line as if the robot had stood at ``position`` (17,) [rad]; returns the first reading."""
        for _ in range(self._delayed.maxlen or 1):
            self._delayed.append(self._count(position))
        self.age = 0
        self._read = self._delayed[0]
        return self._read

    def read(self, position: FloatArray) -> FloatArray:
        """One cycle later: sample ``position`` (17,) [rad], return the sample that arrives now."""
        sample = self._count(position)
        if self._lost:
            lost = self._rng.random(len(sample)) < self._lost
            sample = np.where(lost, self._delayed[-1], sample)
        self._delayed.append(sample)
        if self._late and self.age < self._longest_late and self._rng.random() < self._late:
            self.age += 1
        else:
            self.age = 0
            self._read = self._delayed[0]
        return self._read

    def _count(self, position: FloatArray) -> FloatArray:
        counts = np.empty(len(position))
        noise = self._rng.standard_normal(len(position))
        self._count_positions(position, noise, self._noise, self._step, counts)
        return counts


class CurrentSensors(Resumable):
    """Absolute motor current, low-passed, with noise, in steps of the converter, as late as the encoders.

    The DCM reads all sensors of a cycle at once.
    """

    STATE = ("_smoothed", "_rng", "_delayed")

    def __init__(self, robot: RobotConfig, plant: PlantConfig, rng: np.random.Generator) -> None:
        self._step = robot.sensors.current.step
        self._noise = plant.transport.current_noise
        self._gain = 1.0 - float(np.exp(-robot.cycle / plant.transport.current_time))
        self._rng = rng
        self._smoothed = np.zeros(len(robot.joint_names))
        self._none = np.zeros(len(robot.joint_names))
        self._count_currents = count_currents.load()
        self._delayed: deque[FloatArray] = deque(maxlen=plant.transport.sensor_delay + 1)

    def reset(self) -> FloatArray:
        """Fill the delay line as if there had been no current; returns the first reading (17,) [A]."""
        self._smoothed[:] = 0.0
        for _ in range(self._delayed.maxlen or 1):
            reading = self.read(self._none)
        return reading

    def read(self, current: FloatArray) -> FloatArray:
        """Take in the size of the mean current (17,) of one cycle [A]; returns the reading."""
        counts = np.empty(len(current))
        noise = self._rng.standard_normal(len(current))
        self._count_currents(
            current, noise, self._noise, self._step, self._gain, self._smoothed, counts
        )
        self._delayed.append(counts)
        return self._delayed[0]


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
