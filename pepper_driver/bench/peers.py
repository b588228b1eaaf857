"""Time of one tick of the controller, compared with pink and mink on the same robot.

All three hold the base and the centre of mass, keep a posture and bring both wrists to poses that jump a few
centimetres every 2.4 s: 20 degrees of freedom from the same URDF, the same weights, position and velocity limits, DAQP
for all. They take turns of some hundred ticks, so that a machine that slows down slows all of them. One tick is
``controller.step()`` whole for ours, ``solve_ik`` and ``integrate_inplace`` for the peers. Ours works with
accelerations: it also keeps acceleration limits and braking distances, and gives accelerations and the load torque,
which the peers do not compute. ``ours_with_bodies`` has self-collision and balance as well, as the robot runs it.
"""

from __future__ import annotations

import gc
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from time import perf_counter
from typing import Any, ClassVar

import mujoco
import numpy as np

from pepper_driver.bench.machine import machine_as_json, one_core
from pepper_driver.config import (
    MissingExtraError,
    RobotConfig,
    load_controller_settings,
    load_robot,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import (
    BaseVelocityTask,
    ComTask,
    FrameTask,
    RobotModel,
    WholeBodyController,
)

WRISTS = ("l_wrist", "r_wrist")
ARM = ("ShoulderPitch", "ShoulderRoll", "ElbowYaw", "ElbowRoll", "WristYaw")

BENT = {"ShoulderPitch": 0.9, "ShoulderRoll": 0.3, "ElbowYaw": -0.8, "ElbowRoll": -0.9}
"""[rad] of the left arm at the start."""

POSTURE_WEIGHT, TASK_WEIGHT = 10.0, 1e4
"""Of the posture; of wrists, centre of mass and base."""

POSTURE_STIFFNESS, TASK_STIFFNESS, BASE_STIFFNESS = 5.0, 10.0, 3.0
"""[1/s2]"""

TURN = 300
"""[ticks] of one controller before the next has its turn."""

HOLD = 200
"""[ticks] from one target to the next, 2.4 s."""

NEAREST, FARTHEST = 0.03, 0.08
"""[m] that a wrist has to go at first."""

ALLOWED = 0.01
"""[m] of error when the next target comes: what does not work is not worth timing."""

OURS = "ours"


class Contestant(ABC):
    """One of the controllers compared, with a state of its own.

    Args:
        robot: Description of the robot.
        start: (17,) posture at the start [rad].
    """

    packages: ClassVar[tuple[str, ...]]

    @abstractmethod
    def __init__(self, robot: RobotConfig, start: FloatArray) -> None: ...

    @abstractmethod
    def aim(self, poses: FloatArray) -> None:
        """Set new targets: (2, 4, 4) poses of the wrists in the world."""

    @abstractmethod
    def tick(self) -> None:
        """Make the timed step."""

    @abstractmethod
    def reached(self) -> FloatArray:
        """Return (2, 3) places of the wrists in the world [m]."""


class Ours(Contestant):
    """All five tasks, all limits of joints, base and wheels, integration and load torque."""

    packages = ("pepper-driver", "daqp")
    bodies = False

    def __init__(self, robot: RobotConfig, start: FloatArray) -> None:
        settings = load_controller_settings(robot)
        switches = replace(settings.constraints, self_collision=self.bodies, balance=self.bodies)
        self._controller = WholeBodyController(robot, replace(settings, constraints=switches))
        self._controller.reset(start)
        posture = self._controller.posture
        posture.weight, posture.stiffness = POSTURE_WEIGHT, POSTURE_STIFFNESS
        # Not the controller's own, which would give way: the peers hold the base with this weight too.
        self._controller.remove(self._controller.base_velocity)
        self._controller.add(BaseVelocityTask(weight=TASK_WEIGHT, stiffness=BASE_STIFFNESS))
        gains: dict[str, Any] = {"weight": TASK_WEIGHT, "stiffness": TASK_STIFFNESS, "base": True}
        self._wrists = [FrameTask(link, robot=robot, **gains) for link in WRISTS]
        for task in (*self._wrists, ComTask(robot=robot, **gains)):
            self._controller.add(task)
        self._frames = [self._controller.model.body_frame(link) for link in WRISTS]
        self._step = self._controller.step

    def aim(self, poses: FloatArray) -> None:
        """Set new targets."""
        for task, pose in zip(self._wrists, poses, strict=True):
            task.target = pose

    def tick(self) -> None:
        """Make the timed step."""
        self._step()

    def reached(self) -> FloatArray:
        """Return the places of the wrists."""
        model = self._controller.model
        model.update_kinematics()
        return np.array([model.pose(frame).translation for frame in self._frames])


class OursWithBodies(Ours):
    """Our controller with self-collision and balance, as the robot runs it; the peers have neither here."""

    bodies = True


class Peer(Contestant):
    """Velocities by pink or mink, which have the same interface."""

    _configuration: Any
    _solve: Any
    _pose: Any
    _dt: float
    _wrists: list[Any]
    _tasks: list[Any]
    _limits: list[Any]

    def aim(self, poses: FloatArray) -> None:
        """Set new targets."""
        for task, pose in zip(self._wrists, poses, strict=True):
            task.set_target(self._pose(pose))

    def tick(self) -> None:
        """Make the timed step."""
        configuration, dt = self._configuration, self._dt
        velocity = self._solve(configuration, self._tasks, dt, solver="daqp", limits=self._limits)
        configuration.integrate_inplace(velocity, dt)


class Pink(Peer):
    """Velocities by pink, on the same Pinocchio model."""

    packages = ("pin-pink", "qpsolvers")

    def __init__(self, robot: RobotConfig, start: FloatArray) -> None:
        import pink
        from pink import limits, tasks

        own = RobotModel(robot)
        model = own.pin
        self._configuration = pink.Configuration(
            model, model.createData(), own.configuration(start)
        )
        self._solve, self._dt = pink.solve_ik, robot.cycle
        self._pose = type(model.frames[0].placement)
        cost = float(np.sqrt(TASK_WEIGHT))
        gains = {"gain": gain(TASK_STIFFNESS, robot)}
        self._wrists = [tasks.FrameTask(link, cost, cost, **gains) for link in WRISTS]
        self._tasks = [
            *self._wrists,
            tasks.ComTask(cost, **gains),
            tasks.PostureTask(float(np.sqrt(POSTURE_WEIGHT)), gain=gain(POSTURE_STIFFNESS, robot)),
            tasks.FrameTask("base_link", cost, cost, gain=gain(BASE_STIFFNESS, robot)),
        ]
        for task in self._tasks:
            task.set_target_from_configuration(self._configuration)
        base, joints = velocity_limits(robot)
        velocity = np.concatenate([base, np.zeros(len(joints))])
        velocity[own.joint_columns] = joints
        self._limits = [limits.ConfigurationLimit(model), limits.VelocityLimit(model, velocity)]

    def reached(self) -> FloatArray:
        """Return the places of the wrists."""
        place = self._configuration.get_transform_frame_to_world
        return np.array([place(link).translation for link in WRISTS])


class Mink(Peer):
    """Velocities by mink, on MuJoCo's model of the same URDF."""

    packages = ("mink", "mujoco", "qpsolvers")

    def __init__(self, robot: RobotConfig, start: FloatArray) -> None:
        import mink

        model = mujoco_model(robot)
        names = ("x", "y", "yaw", *(f"robot/{name}" for name in robot.joint_names))
        columns = np.array([model.joint(name).dofadr[0] for name in names])
        q = np.zeros(model.nq)  # slides and hinges alone: positions in the places of velocities
        q[columns[3:]] = start
        self._configuration = mink.Configuration(model, q)
        self._solve, self._dt, self._pose = mink.solve_ik, robot.cycle, mink.SE3.from_matrix
        cost = float(np.sqrt(TASK_WEIGHT))
        posture = np.zeros(model.nv)
        posture[columns[3:]] = np.sqrt(POSTURE_WEIGHT)
        gains = {"gain": gain(TASK_STIFFNESS, robot)}
        self._wrists = [
            mink.FrameTask(f"robot/{link}", "body", cost, cost, **gains) for link in WRISTS
        ]
        self._tasks = [
            *self._wrists,
            mink.ComTask(cost, **gains),
            mink.PostureTask(model, posture, gain=gain(POSTURE_STIFFNESS, robot)),
            mink.FrameTask("base", "body", cost, cost, gain=gain(BASE_STIFFNESS, robot)),
        ]
        for task in self._tasks:
            task.set_target_from_configuration(self._configuration)
        speeds = np.concatenate(velocity_limits(robot))
        velocity = mink.VelocityLimit(model, dict(zip(names, speeds, strict=True)))
        self._limits = [mink.ConfigurationLimit(model), velocity]

    def reached(self) -> FloatArray:
        """Return the places of the wrists."""
        data = self._configuration.data
        return np.array([data.body(f"robot/{link}").xpos for link in WRISTS])


def gain(stiffness: float, robot: RobotConfig) -> float:
    """Return the fraction of the error made up in a tick, as by a critically damped spring of that stiffness."""
    return float(np.sqrt(stiffness)) * robot.cycle


def velocity_limits(robot: RobotConfig) -> tuple[FloatArray, FloatArray]:
    """Return (3,) of the base [m/s], [rad/s] and (17,) of the joints [rad/s]."""
    base = robot.limits.base
    twist = np.array([base.linear_velocity, base.linear_velocity, base.angular_velocity])
    return twist, load_controller_settings(robot).joint_velocity(robot)


def mujoco_model(robot: RobotConfig) -> Any:  # noqa: ANN401 MuJoCo has no types
    """Return the robot's URDF without its shapes, wheels fixed, on slides x and y and a hinge."""
    spec = mujoco.MjSpec()
    base = spec.worldbody.add_body(name="base")
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    base.add_joint(name="x", type=slide, axis=[1, 0, 0])
    base.add_joint(name="y", type=slide, axis=[0, 1, 0])
    base.add_joint(name="yaw", type=hinge, axis=[0, 0, 1])
    urdf = mujoco.MjSpec.from_file(str(robot.urdf))
    for name in robot.wheels.names:
        urdf.delete(urdf.joint(name))
    for geom in urdf.geoms:
        urdf.delete(geom)
    spec.attach(urdf, prefix="robot/", frame=base.add_frame())
    return spec.compile()


def start_posture(robot: RobotConfig) -> FloatArray:
    """Return (17,) upright, both arms bent before the body [rad]."""
    posture = np.zeros(len(robot.joint_names))
    for joint, angle in BENT.items():
        mirrored = 1.0 if joint == "ShoulderPitch" else -1.0
        posture[robot.joint_index(f"L{joint}")] = angle
        posture[robot.joint_index(f"R{joint}")] = mirrored * angle
    return np.clip(posture, robot.lower + 0.01, robot.upper - 0.01)


def random_poses(robot: RobotConfig, start: FloatArray, count: int) -> FloatArray:
    """Return (count, 2, 4, 4) poses of the wrists that the arms can take, a few centimetres from where they start."""
    model, random = RobotModel(robot), np.random.default_rng(0)
    poses = np.zeros((count, len(WRISTS), 4, 4))
    for number in range(count):
        for i, link in enumerate(WRISTS):
            joints = [robot.joint_index(link[0].upper() + joint) for joint in ARM]
            here = model.link_pose(link, start)[:3, 3]
            way = 0.0
            while not NEAREST <= way <= FARTHEST:
                posture = start.copy()
                posture[joints] += random.uniform(-0.3, 0.3, len(joints))
                posture = np.clip(posture, robot.lower + 0.05, robot.upper - 0.05)
                poses[number, i] = model.link_pose(link, posture)
                way = float(np.linalg.norm(poses[number, i, :3, 3] - here))
    return poses


class Runner:
    """Runs one controller through the targets and keeps the times and the errors."""

    def __init__(self, controller: Contestant, poses: FloatArray) -> None:
        self._controller, self._poses = controller, poses
        self._ticks = 0
        self.seconds: list[list[float]] = []
        self.errors: list[float] = []

    def run(self, ticks: int) -> None:
        """Make one turn: its durations go to a list of their own in ``seconds``."""
        tick, durations = self._controller.tick, []
        for _ in range(ticks):
            segment, since = divmod(self._ticks, HOLD)
            if since == 0:
                if segment:
                    self._check(segment - 1)
                self._controller.aim(self._poses[segment % len(self._poses)])
            self._ticks += 1
            begin = perf_counter()
            tick()
            durations.append(perf_counter() - begin)
        self.seconds.append(durations)

    def _check(self, segment: int) -> None:
        """Keep the distance [m] of the wrists from a target that the next one replaces."""
        off = self._controller.reached() - self._poses[segment % len(self._poses), :, :3, 3]
        self.errors.append(float(np.linalg.norm(off, axis=1).max()))


@dataclass(frozen=True, kw_only=True)
class PeerTimes:
    """Times of one controller.

    Attributes:
        median, p99: Of its ticks [us].
        ratio: Of the median to that of ours.
        turns: The same turn by turn: 10th and 90th percentile.
        error: Largest distance of a wrist from its target when the next one came [m].
    """

    median: float
    p99: float
    ratio: float
    turns: tuple[float, float]
    error: float

    @property
    def reached(self) -> bool:
        """True where it reached all targets."""
        return self.error <= ALLOWED


@dataclass(frozen=True, kw_only=True)
class PeerBench:
    """Times of all controllers by name, ``ours`` first, and of how many ticks each."""

    times: dict[str, PeerTimes]
    ticks: int
    packages: frozenset[str]

    def as_json(self) -> dict[str, Any]:
        """``controller_us``, ``ratio``, ``ratio_by_turns``, ``largest_error_mm``, ``ticks``, ``cpu``, ``versions``."""
        others = {name: times for name, times in self.times.items() if name != OURS}
        return {
            "controller_us": {
                name: {"median": times.median, "p99": times.p99}
                for name, times in self.times.items()
            },
            "ratio": {name: times.ratio for name, times in others.items()},
            "ratio_by_turns": {
                name: dict(zip(("p10", "p90"), times.turns, strict=True))
                for name, times in others.items()
            },
            "largest_error_mm": {name: 1e3 * times.error for name, times in self.times.items()},
            "ticks": self.ticks,
            **machine_as_json(*self.packages),
        }


def run_peer_bench(
    seconds: float = 20.0,
    *,
    peers: bool = True,
    on_progress: Callable[[float], None] | None = None,
) -> PeerBench:
    """Time the controllers in turns, on one core.

    Args:
        seconds: Time of the ticks of each controller, were they 12 ms apart [s].
        peers: Also those of other projects.
        on_progress: Called with the fraction done, 0..1.

    Raises:
        MissingExtraError: They are not installed.
    """
    report_progress = on_progress or (lambda fraction: None)
    kinds: dict[str, type[Contestant]] = {OURS: Ours, "ours_with_bodies": OursWithBodies}
    if peers:
        kinds |= {"pink": Pink, "mink": Mink}
        for name in ("pink", "mink"):
            try:
                import_module(name)
            except ImportError as error:
                raise MissingExtraError("the comparison with pink and mink", "peers") from error
    robot = load_robot()
    start = start_posture(robot)
    poses = random_poses(robot, start, 20)
    runners = {name: Runner(kind(robot, start), poses) for name, kind in kinds.items()}
    turns = max(1, round(seconds / (TURN * robot.cycle)))
    with one_core():
        for runner in runners.values():  # the first ticks of a process are slow
            runner.run(TURN)
            runner.seconds.clear()
        with _no_collection():
            for turn in range(turns):
                for runner in runners.values():
                    runner.run(TURN)
                report_progress((turn + 1) / turns)
    times = {name: 1e6 * np.array(runner.seconds) for name, runner in runners.items()}
    return PeerBench(
        times={
            name: _summary(times[name], times[OURS], max(runner.errors))
            for name, runner in runners.items()
        },
        ticks=turns * TURN,
        packages=frozenset(package for kind in kinds.values() for package in kind.packages),
    )


def _summary(times: FloatArray, ours: FloatArray, error: float) -> PeerTimes:
    """Return the figures of (turns, ticks) times [us]."""
    median, p99 = np.percentile(times, [50, 99])
    low, high = np.percentile(np.median(times, axis=1) / np.median(ours, axis=1), [10, 90])
    return PeerTimes(
        median=float(median),
        p99=float(p99),
        ratio=float(median / np.median(ours)),
        turns=(float(low), float(high)),
        error=error,
    )


@contextmanager
def _no_collection() -> Iterator[None]:
    """No garbage is collected inside the block, as inside the ticks of a robot in real time."""
    enabled = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.unfreeze()
        if enabled:
            gc.enable()
