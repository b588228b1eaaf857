"""Time of one tick of the controller, compared with pink and mink on the same robot.

All three hold the base and the centre of mass, keep a posture and bring both wrists to poses that jump a few
centimetres every 2.4 s: 20 degrees of freedom from the same URDF, the same weights, position and velocity limits, DAQP
for all. They take turns of some hundred ticks, so that a machine that slows down slows all of them. One tick is
`controller.step()` whole for ours, `solve_ik` and `integrate_inplace` for the peers. Ours works with accelerations: it
also keeps acceleration limits and braking distances, and gives accelerations and the load torque, which the peers do
not compute. `ours_with_bodies` has self-collision and balance as well, as the robot runs it.

Run: pip install -e ".[peers]"; python benchmarks/controller.py --json controller.json
"""

from __future__ import annotations

import argparse
import gc
import os
import platform
import sys
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import Any, NoReturn, Protocol

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from pepper_driver.config import PepperError, RobotConfig, load_controller_settings, load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.files import check_writable, write_json
from pepper_driver.controller import (
    BaseVelocityTask,
    ComTask,
    FrameTask,
    RobotModel,
    WholeBodyController,
)

WRISTS = ("l_wrist", "r_wrist")
ARM = ("ShoulderPitch", "ShoulderRoll", "ElbowYaw", "ElbowRoll", "WristYaw")
BENT = {
    "ShoulderPitch": 0.9,
    "ShoulderRoll": 0.3,
    "ElbowYaw": -0.8,
    "ElbowRoll": -0.9,
}  # [rad] left
POSTURE_WEIGHT, TASK_WEIGHT = 10.0, 1e4  # of the posture; of wrists, centre of mass and base
POSTURE_STIFFNESS, TASK_STIFFNESS, BASE_STIFFNESS = 5.0, 10.0, 3.0  # [1/s2]
HOLD = 200  # ticks from one target to the next, 2.4 s
NEAREST, FARTHEST = 0.03, 0.08  # [m] that a wrist has to go at first
ALLOWED = 0.01  # [m] of error when the next target comes
EXTRA = 'pip install -e ".[peers]"'


class Controller(Protocol):
    """One of those compared, with a state of its own."""

    def aim(self, poses: FloatArray) -> None:
        """New targets: (2, 4, 4) poses of the wrists in the world."""

    def tick(self) -> None:
        """Make the timed step."""

    def reached(self) -> FloatArray:
        """(2, 3) places of the wrists in the world [m]."""


class Ours:
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
        gains = {"weight": TASK_WEIGHT, "stiffness": TASK_STIFFNESS, "base": True}
        self._wrists = [FrameTask(link, robot=robot, **gains) for link in WRISTS]
        for task in (*self._wrists, ComTask(robot=robot, **gains)):
            self._controller.add(task)
        self._frames = [self._controller.model.body_frame(link) for link in WRISTS]
        self.tick = self._controller.step

    def aim(self, poses: FloatArray) -> None:
        for task, pose in zip(self._wrists, poses, strict=True):
            task.target = pose

    def reached(self) -> FloatArray:
        model = self._controller.model
        model.update_kinematics()
        return np.array([model.pose(frame).translation for frame in self._frames])


class OursWithBodies(Ours):
    """Our controller with self-collision and balance, as the robot runs it; the peers have neither here."""

    bodies = True


class Pink:
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
        self._pose = type(model.frames[0].placement)

    def aim(self, poses: FloatArray) -> None:
        for task, pose in zip(self._wrists, poses, strict=True):
            task.set_target(self._pose(pose))

    def tick(self) -> None:
        configuration, dt = self._configuration, self._dt
        velocity = self._solve(configuration, self._tasks, dt, solver="daqp", limits=self._limits)
        configuration.integrate_inplace(velocity, dt)

    def reached(self) -> FloatArray:
        place = self._configuration.get_transform_frame_to_world
        return np.array([place(link).translation for link in WRISTS])


class Mink:
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

    def aim(self, poses: FloatArray) -> None:
        for task, pose in zip(self._wrists, poses, strict=True):
            task.set_target(self._pose(pose))

    def tick(self) -> None:
        configuration, dt = self._configuration, self._dt
        velocity = self._solve(configuration, self._tasks, dt, solver="daqp", limits=self._limits)
        configuration.integrate_inplace(velocity, dt)

    def reached(self) -> FloatArray:
        data = self._configuration.data
        return np.array([data.body(f"robot/{link}").xpos for link in WRISTS])


def gain(stiffness: float, robot: RobotConfig) -> float:
    """Share of the error to make up in a tick: what a spring of that stiffness, critically damped, tends to."""
    return float(np.sqrt(stiffness)) * robot.cycle


def velocity_limits(robot: RobotConfig) -> tuple[FloatArray, FloatArray]:
    """(3,) of the base [m/s], [rad/s] and (17,) of the joints [rad/s]."""
    base = robot.limits.base
    twist = np.array([base.linear_velocity, base.linear_velocity, base.angular_velocity])
    return twist, load_controller_settings(robot).joint_velocity(robot)


def mujoco_model(robot: RobotConfig) -> Any:  # noqa: ANN401 MuJoCo has no types
    """The robot's URDF without its shapes, wheels fixed, on slides x and y and a hinge."""
    import mujoco

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
    """(17,) upright, both arms bent before the body [rad]."""
    posture = np.zeros(len(robot.joint_names))
    for joint, angle in BENT.items():
        mirrored = 1.0 if joint == "ShoulderPitch" else -1.0
        posture[robot.joint_index(f"L{joint}")] = angle
        posture[robot.joint_index(f"R{joint}")] = mirrored * angle
    return np.clip(posture, robot.lower + 0.01, robot.upper - 0.01)


def random_poses(robot: RobotConfig, start: FloatArray, count: int) -> FloatArray:
    """(count, 2, 4, 4) poses of the wrists that the arms can take, a few centimetres from where they start."""
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

    def __init__(self, controller: Controller, poses: FloatArray) -> None:
        self._controller, self._poses = controller, poses
        self._ticks = 0
        self.seconds: list[list[float]] = []
        self.errors: list[float] = []

    def run(self, ticks: int) -> None:
        """One turn: durations go to a list of their own in ``seconds``."""
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
        """Return the distance [m] of the wrists from a target that the next one replaces."""
        off = self._controller.reached() - self._poses[segment % len(self._poses), :, :3, 3]
        self.errors.append(float(np.linalg.norm(off, axis=1).max()))


class Parser(argparse.ArgumentParser):
    """Errors of one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}\n")


def arguments() -> argparse.Namespace:
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=300, help="in one turn (default: 300)")
    parser.add_argument("--rounds", type=int, default=20, help="turns of each (default: 20)")
    parser.add_argument("--without-peers", action="store_true", help="ours alone")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures to FILE")
    given = parser.parse_args()
    if given.ticks < 1 or given.rounds < 1 or given.ticks * given.rounds <= HOLD:
        parser.error(f"--ticks times --rounds must be above {HOLD}, the ticks to one target")
    if given.json is not None:
        try:
            check_writable(given.json)
        except PepperError as error:
            parser.error(str(error))
    return given


def measure(kinds: dict[str, Any], ticks: int, rounds: int) -> dict[str, Runner]:
    robot = load_robot()
    start = start_posture(robot)
    poses = random_poses(robot, start, 20)
    runners = {name: Runner(kind(robot, start), poses) for name, kind in kinds.items()}
    for runner in runners.values():  # the first ticks of a process are slow
        runner.run(ticks)
        runner.seconds.clear()
    gc.collect()
    gc.freeze()
    gc.disable()
    for _ in track(range(rounds), "measuring", transient=True):
        for runner in runners.values():
            runner.run(ticks)
    return runners


def cpu_name() -> str:
    """Return the name of the first processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    found = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return found[0] if found else platform.processor()


def main() -> int:
    """Command line: 0 well, 1 if one of them does not reach its targets, 2 a wrong input."""
    given = arguments()
    kinds: dict[str, Any] = {"ours": Ours, "ours_with_bodies": OursWithBodies}
    if not given.without_peers:
        kinds |= {"pink": Pink, "mink": Mink}
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    try:
        runners = measure(kinds, given.ticks, given.rounds)
    except ModuleNotFoundError as error:
        print(f"controller.py: {error.name} is missing: {EXTRA}", file=sys.stderr)
        return 2
    console = Console(soft_wrap=True, highlight=False)
    table = Table(
        "controller", "median [us]", "p99 [us]", "of ours", "of ours by turns", "error [mm]"
    )
    times = {name: 1e6 * np.array(runner.seconds) for name, runner in runners.items()}
    figures: dict[str, Any] = {"controller_us": {}, "ratio": {}, "ratio_by_turns": {}}
    lost = []
    for name, runner in runners.items():
        median, p99 = np.percentile(times[name], [50, 99])
        ratio = median / np.median(times["ours"])
        turns = np.median(times[name], axis=1) / np.median(times["ours"], axis=1)
        low, high = np.percentile(turns, [10, 90])
        error = max(runner.errors)
        figures["controller_us"][name] = {"median": float(median), "p99": float(p99)}
        figures.setdefault("largest_error_mm", {})[name] = 1e3 * error
        if name != "ours":
            figures["ratio"][name] = float(ratio)
            figures["ratio_by_turns"][name] = {"p10": float(low), "p90": float(high)}
        span = "" if name == "ours" else f"{low:.2f} to {high:.2f}"
        row = f"{median:.1f}", f"{p99:.1f}", f"{ratio:.2f}", span, f"{1e3 * error:.1f}"
        table.add_row(name, *row)
        if not error <= ALLOWED:
            lost.append(f"{name} is {1e3 * error:.0f} mm from a target after {HOLD} ticks")
    console.print(table)
    console.print("pink and mink compute neither accelerations nor the load torque.")
    packages = sorted(
        {package for kind in kinds.values() for package in kind.packages} | {"pin", "numpy"}
    )
    figures |= {
        "ticks": given.ticks * given.rounds,
        "rounds": given.rounds,
        "cpu": cpu_name(),
        "versions": {"python": platform.python_version(), **{p: version(p) for p in packages}},
    }
    if given.json is not None:
        write_json(given.json, figures)
        console.print(f"figures: {given.json}")
    for line in lost:
        print(f"controller.py: {line}: what does not work is not worth timing", file=sys.stderr)
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main())
