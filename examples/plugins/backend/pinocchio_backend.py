"""Pepper on a fixed base: rigid-body dynamics by Pinocchio, with a PD law and friction in each joint."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pepper_driver.backends import (
    Backend,
    BackendError,
    BackendInfo,
    BackendUri,
    Capability,
    Command,
    Imu,
    Measurement,
    NotConnectedError,
    Push,
    ScheduledPush,
    Serial,
    SimulatedPlant,
    TrueContact,
    Truth,
    checked_command,
    serial,
)
from pepper_driver.config import RobotConfig, UnknownNameError

Array = NDArray[np.float64]

STEPS = 12  # of physics in a cycle
SAG = 0.1  # [rad] error at which a motor gives all its torque
FRICTION = 0.02  # of that torque
FRICTION_SPEED = 0.05  # [rad/s] half of the friction acts at this speed
RESOLUTION = 2 * np.pi / 4096  # [rad] of the encoders
NOISE = 5e-4  # [rad] of the encoders, standard deviation
IDENTITY = "pinocchio-pd-1"  # models belong to it: change it with any number above


class PinocchioBackend(Serial, Backend):
    """A simulated Pepper whose base stands still and whose wheels take no commands.

    ``Serial`` and ``@serial`` let calls from several threads wait for each other.

    Args:
        robot: Its description.
        seed: Of the encoders' noise.
        posture: Name of the posture in which it starts.
        uri: URI it was asked for.
    """

    def __init__(self, robot: RobotConfig, *, seed: int, posture: str, uri: str) -> None:
        super().__init__()
        self.robot, self._seed, self._uri = robot, seed, uri
        self._start = robot.posture(posture)
        self._state: Literal["closed", "open", "active"] = "closed"
        self._build()

    def _build(self) -> None:
        """Make the model; vectors inside this class are in Pinocchio's order of joints."""
        robot, names = self.robot, self.robot.joint_names
        whole = pin.buildModelFromUrdf(str(robot.urdf))
        wheels = [whole.getJointId(name) for name in robot.wheels.names]
        self._model = model = pin.buildReducedModel(whole, wheels, pin.neutral(whole))
        self._data = model.createData()
        # Pinocchio sorts joints by itself: column of each joint of the robot.
        self._columns = np.array([model.joints[model.getJointId(name)].idx_v for name in names])
        motors = [(robot.motors.of(name), robot.motors.joints[name].ratio) for name in names]
        rotors = np.array([motor.rotor_inertia * ratio**2 for motor, ratio in motors])
        model.armature = self._sorted(rotors + robot.armature)
        self._per_ampere = self._sorted([motor.torque_constant * r for motor, r in motors])
        self._limit = self._sorted([motor.stall_torque * ratio for motor, ratio in motors])
        self._stiffness, self._friction = self._limit / SAG, FRICTION * self._limit
        inertia = np.diag(pin.crba(model, self._data, self._sorted(self._start)))
        self._damping = 1.4 * np.sqrt(self._stiffness * inertia)
        self._lower, self._upper = self._sorted(robot.lower), self._sorted(robot.upper)

    def _sorted(self, joints: ArrayLike) -> Array:
        """From the order of the robot's joints to Pinocchio's."""
        vector = np.empty(len(self._columns))
        vector[self._columns] = joints
        return vector

    # -- facts --------------------------------------------------------------------------------------------------

    @property
    def uri(self) -> str:
        """The URI it was asked for."""
        return self._uri

    @property
    def info(self) -> BackendInfo:
        """Facts about the simulated robot."""
        abilities: frozenset[Capability] = frozenset({"push", "seed", "truth"})
        return BackendInfo(
            joint_names=self.robot.joint_names,
            cycle=self.robot.cycle,
            response_delay=0,  # a sample shows the end of the cycle that the last command was for
            capabilities=abilities,
            identity=IDENTITY,
        )

    @property
    def plant(self) -> SimulatedPlant:
        """Parameters that pushes are planned with."""
        columns = self._columns
        return SimulatedPlant(
            stiffness=self._stiffness[columns],
            torque_limit=self._limit[columns],
            friction=self._friction[columns],
            rolling=False,
        )

    @property
    def truth(self) -> Truth:
        """Ground truth of the simulation."""
        return PinocchioTruth(self)

    # -- life ---------------------------------------------------------------------------------------------------

    @serial
    def open(self) -> Measurement:
        """Stand in the first posture; time begins again."""
        if self._state != "closed":
            raise BackendError(f"'{self.uri}' is already open")
        self._state, self._tick = "open", 0
        self._random = np.random.default_rng(self._seed)
        self.q, self.v = self._sorted(self._start), np.zeros(len(self._start))
        self._pushes: list[ScheduledPush] = []
        self._hold()
        self._forget_contacts()
        self.torque = np.zeros(len(self.q))
        self.saturated = np.zeros(len(self.q))
        return self._measure()

    @serial
    def activate(self) -> Measurement:
        """Take commands from now on; takes no time."""
        self._check_open()
        if self._state == "active":
            raise BackendError(f"'{self.uri}' is already active")
        self._state = "active"
        self._hold()
        return self._measure()

    @serial
    def write(self, command: Command) -> None:
        """Take the command for the cycle that the next ``read`` simulates."""
        self._check_open()
        position, stiffness, _ = checked_command(command, len(self._start))
        if self._state == "active":
            self._goal = np.clip(self._sorted(position), self._lower, self._upper)
            self._stiffness_fraction = np.clip(self._sorted(stiffness), 0.0, 1.0)

    @serial
    def read(self) -> Measurement:
        """Simulate one cycle."""
        self._check_open()
        self._tick += 1
        self._cycle()
        if not np.isfinite(self.q).all():
            self._state = "closed"
            raise BackendError(f"'{self.uri}': the simulation diverged and was closed")
        return self._measure()

    @serial
    def deactivate(self) -> None:
        """Hold the joints where they are."""
        if self._state == "active":
            self._state = "open"
            self._hold()

    @serial
    def close(self) -> None:
        """Deactivate and disconnect."""
        self.deactivate()
        self._state = "closed"

    def _hold(self) -> None:
        """Brake all joints here: without torque the robot would fall onto its knees as soon as it is open."""
        self._goal = self._target = np.clip(self.q, self._lower, self._upper)
        self._stiffness_fraction = np.ones(len(self.q))

    def _check_open(self) -> None:
        if self._state == "closed":
            raise NotConnectedError(f"'{self.uri}' is not open")

    # -- physics ------------------------------------------------------------------------------------------------

    def _cycle(self) -> None:
        """Lead the boards' targets to the goal in even steps, as the robot does."""
        self._forget_contacts()
        self.saturated[:] = 0.0
        now, dt = (self._tick - 1) * self.robot.cycle, self.robot.cycle / STEPS
        way = (self._goal - self._target) / STEPS
        for number in range(STEPS):
            self._target = self._target + way
            self._step(dt, self._touch(now + number * dt))
        self._pushes = [push for push in self._pushes if push.end > now]

    def _step(self, dt: float, external: Array) -> None:
        """One step, implicit in the new speed: (M + dt D + dt^2 K) v+ = M v + dt (K (target - q) - h + external)."""
        model, data, q, v = self._model, self._data, self.q, self.v
        mass, limit = pin.crba(model, data, q), self._limit * self._stiffness_fraction
        rest = mass @ v + dt * (external - pin.nonLinearEffects(model, data, q, v))
        rubbing = self._friction / (np.abs(v) + FRICTION_SPEED)
        free, given = np.ones(len(q)), np.zeros(len(q))
        for _ in range(2):  # again where a motor cannot give what it should
            stiffness, damping = free * self._stiffness, free * self._damping
            matrix = mass + np.diag(dt * (damping + rubbing) + dt**2 * stiffness)
            speed = np.linalg.solve(matrix, rest + dt * (stiffness * (self._target - q) + given))
            self.torque = stiffness * (self._target - q - dt * speed) - damping * speed + given
            beyond = np.abs(self.torque) > limit
            if not beyond.any():
                break
            self.saturated[beyond] = 1.0
            free, given = (
                np.where(beyond, 0.0, free),
                np.where(beyond, np.clip(self.torque, -limit, limit), given),
            )
        self.q = np.clip(q + dt * speed, self._lower, self._upper)
        self.v = np.where(self.q == q + dt * speed, speed, 0.0)  # at rest at an end stop

    @serial
    def schedule_push(self, push: Push) -> None:
        """Have a link pushed; without a point, at the origin of its frame."""
        self._check_open()
        origins = dict.fromkeys(self.robot.links, np.zeros(3))
        self._pushes.append(ScheduledPush.of(push, origins, self._tick * self.robot.cycle))

    def _forget_contacts(self) -> None:
        self.contacts: dict[ScheduledPush, list[Array]] = {}
        self.contact_torque, self.peak_torque = np.zeros((2, len(self._columns)))

    def _touch(self, time: float) -> Array:
        """J^T f of all pushes in the order of Pinocchio's joints, kept for the truth in that of the robot's."""
        total = np.zeros(len(self.q))
        for push in self._pushes:
            strength = push.strength(time)
            if strength == 0.0:
                continue
            pose = self.place(push.link)
            force = strength * (pose.rotation @ push.force if push.frame == "link" else push.force)
            frame = self._model.getFrameId(push.link)
            jacobian = pin.computeFrameJacobian(
                self._model, self._data, self.q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            )
            arm = pose.rotation @ push.point
            torque = jacobian.T @ np.concatenate([force, np.cross(arm, force)])
            self.contacts.setdefault(push, []).append(
                np.concatenate([pose.act(push.point), force, torque[self._columns]])
            )
            total += torque
        self.contact_torque += total[self._columns] / STEPS
        self.peak_torque = np.maximum(self.peak_torque, np.abs(total[self._columns]))
        return total

    def place(self, link: str) -> pin.SE3:
        """Pose of a link in the world."""
        pin.forwardKinematics(self._model, self._data, self.q)
        return pin.updateFramePlacement(self._model, self._data, self._model.getFrameId(link))

    @property
    def kinetic_energy(self) -> float:
        """Kinetic energy of links and rotors [J]."""
        return 0.5 * float(self.v @ pin.crba(self._model, self._data, self.q) @ self.v)

    def in_order(self, vector: Array) -> Array:
        """From Pinocchio's order to that of the robot's joints; a copy."""
        joints: Array = vector[self._columns]
        return joints

    def _measure(self) -> Measurement:
        """Return a sample of its own: log and callbacks read it later."""
        robot, count = self.robot, len(self._start)
        noisy = self.in_order(self.q) + self._random.normal(0.0, NOISE, count)
        return Measurement(
            time=self._tick * robot.cycle,
            tick=self._tick,
            position=RESOLUTION * np.round(noisy / RESOLUTION),
            current=self.in_order(np.abs(self.torque) / self._per_ampere),
            wheel_speed=np.zeros(3),
            imu=Imu(
                acceleration=np.array([0.0, 0.0, 9.81]),
                angular_velocity=np.zeros(3),
                attitude=np.zeros(3),
            ),
            touch=np.zeros(len(robot.sensors.touch)),
            bumpers=np.zeros(len(robot.sensors.bumpers)),
            buttons=np.zeros(len(robot.sensors.buttons)),
            temperature=np.full(count, 38.0),
            battery=1.0,
            age=0.0,
        )


class PinocchioTruth(Truth):
    """Ground truth, for the log and for evaluation: no observer may see it."""

    def __init__(self, backend: PinocchioBackend) -> None:
        self._backend = backend

    @property
    def contact_torque(self) -> Array:
        """(17,) J^T f, mean over the last cycle [N m]."""
        return self._backend.contact_torque.copy()

    @property
    def peak_torque(self) -> Array:
        """(17,) largest |J^T f| in a step of the last cycle [N m]."""
        return self._backend.peak_torque.copy()

    @property
    def contacts(self) -> tuple[TrueContact, ...]:
        """Pushes of the last cycle: means over its steps."""
        return tuple(
            TrueContact(
                kind="push",
                link=push.link,
                object=None,
                point=np.mean(steps, axis=0)[:3],
                force=np.sum(steps, axis=0)[3:6] / STEPS,
                peak=float(max(np.linalg.norm(step[3:6]) for step in steps)),
                torque=np.sum(steps, axis=0)[6:] / STEPS,
            )
            for push, steps in self._backend.contacts.items()
        )

    @property
    def base(self) -> Array:
        """(3,) where it stands: at the origin."""
        return np.zeros(3)

    @property
    def kinetic_energy(self) -> float:
        """Kinetic energy of links and rotors [J]."""
        return self._backend.kinetic_energy

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """(17,) True where a motor was at its limit in the last cycle."""
        return self._backend.in_order(self._backend.saturated) > 0.0

    @property
    def position(self) -> Array:
        """(17,) joint positions now [rad]."""
        return self._backend.in_order(self._backend.q)

    def link_pose(self, link: str) -> Array:
        """(4, 4) transform of a link in the world."""
        if link not in self._backend.robot.links:
            raise UnknownNameError("link", link, self._backend.robot.links)
        return np.array(self._backend.place(link).homogeneous)


def from_uri(uri: BackendUri, robot: RobotConfig) -> PinocchioBackend:
    """``pinocchio://?seed=N&posture=NAME``; both optional."""
    uri.check_keys({"seed", "posture"}, host=False)
    return PinocchioBackend(
        robot,
        seed=uri.integer("seed", 0),
        posture=uri.query.get("posture", "Stand"),
        uri=uri.text,
    )
