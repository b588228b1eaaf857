"""Bench on which a simulated robot is measured as real ones were.

Ramps and holds run on a copy of the plant whose base is fixed, in an empty world. Runs are independent of one another
and seeded: results do not depend on the number of processes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import TypeVar

import mujoco
import numpy as np

from pepper_driver.backends.fields import Command
from pepper_driver.backends.motion_profile import minimum_jerk
from pepper_driver.backends.mujoco_.backend import MujocoBackend
from pepper_driver.backends.mujoco_.motors import JointFriction, MotorBoards
from pepper_driver.backends.mujoco_.plant_model import build_model
from pepper_driver.backends.mujoco_.simulation import Simulation
from pepper_driver.config import ChaseProtocol, PlantConfig, RampProtocol, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.steps import Holds
from pepper_driver.config.workers import Workers, run_jobs

T = TypeVar("T")
G = TypeVar("G", Holds, ChaseProtocol)

SPEED_FRACTION = 0.15
"""Peak speed of the motion, as a fraction of each joint's limit."""

RANGE_FRACTION = 0.6
"""Largest travel of the motion, as a fraction of each joint's range."""


def integration_error(
    robot: RobotConfig, plant: PlantConfig, *, seconds: float = 2.0, fine_step: float = 25e-6
) -> float:
    """Error of the plant's step of physics, against a finer one.

    Both runs are of the same robot on a fixed base: all 17 joints oscillate together, each at its own rate, at speeds
    of normal use, and turn round at least once. The boards belong to the robot: in both runs they compute a voltage
    once in ``plant.physics.timestep`` and hold it. Only what MuJoCo integrates differs, and the friction set before
    each of its steps. Battery and motors stay at the voltage and temperature that the plant's values hold for.

    Args:
        robot: Robot whose joints oscillate.
        plant: Whose ``physics.timestep`` is to be judged.
        seconds: Length of the motion.
        fine_step: [s] of the run that counts as true; a whole fraction of the step.

    Returns:
        Root mean square over time and all joints of the difference in joint position [rad].

    Raises:
        ValueError: The fine step does not divide the plant's.
    """
    fraction = plant.physics.timestep / fine_step
    parts = round(fraction)
    if parts < 1 or abs(fraction - parts) > 1e-6:
        raise ValueError(
            f"fine_step: {fine_step:g} s does not divide the step of {plant.physics.timestep:g} s"
        )
    steps = round(seconds / plant.physics.timestep)
    error = _integrate(robot, plant, steps, parts) - _integrate(robot, plant, steps, 1)
    return float(np.sqrt(np.mean(np.square(error))))


def _integrate(robot: RobotConfig, plant: PlantConfig, steps: int, parts: int) -> FloatArray:
    """Return (steps, 17) positions [rad] after each step of the boards, each integrated in ``parts`` parts."""
    period = plant.physics.timestep
    fixed = replace(plant, base="fixed")
    model = build_model(
        robot, replace(fixed, physics=replace(plant.physics, timestep=period / parts))
    )
    data = mujoco.MjData(model.mj)
    boards, friction = MotorBoards(robot, fixed), JointFriction(robot, fixed, model, data)
    new = np.ones(len(robot.joint_names))
    boards.begin_cycle(new, plant.board.voltage)
    friction.warm(new)
    data.qpos[model.link_qpos] = data.qpos[model.motor_qpos] = _swing(robot, 0.0)
    positions = np.empty((steps, len(new)))
    for step in range(steps):
        data.ctrl[model.actuator] = boards.update(
            _swing(robot, (step + 1) * period),
            data.qpos[model.link_qpos],
            data.qvel[model.motor_dof],
        )
        for _ in range(parts):
            friction.update()
            mujoco.mj_step(model.mj, data)
        positions[step] = data.qpos[model.link_qpos]
    return positions


def _swing(robot: RobotConfig, time: float) -> FloatArray:
    """(17,) commanded positions [rad]: from one end of a part of each joint's range to the other and back."""
    n = len(robot.joint_names)
    rate = 2 * np.pi * np.linspace(0.5, 1.0, n)  # [rad/s]
    fastest = SPEED_FRACTION * np.array([joint.velocity for joint in robot.joints])
    size = np.minimum(fastest / rate, RANGE_FRACTION / 2 * (robot.upper - robot.lower))
    direction = np.where(np.arange(n) % 2, -1.0, 1.0)
    return np.asarray((robot.lower + robot.upper) / 2 - direction * size * np.cos(rate * time))


Progress = Callable[[int, int], None]
"""Called with (runs done, runs in all)."""

GOALS_EACH = 20
"""Goals of one robot, one after the other."""

CURRENT_TIME = 0.1
"""[s] before the end of a hold over which the current is averaged."""

GRABBED, PULL = "RForeArm", (0.05, 0.0, 0.0)
"""Link held by a hand while the speed of the simulation is measured, and how far that goes [m]."""


@dataclass(frozen=True, kw_only=True)
class HoldEnds:
    """Ends of holds, arrays (n, joints).

    Attributes:
        joints: Names, in order of the columns.
        error: Commanded minus measured position [rad].
        current: Measured, mean over the end of the hold [A], unsigned.
        load: Torque that gravity asks of each joint at the goal [N m].
    """

    joints: tuple[str, ...]
    error: FloatArray
    current: FloatArray
    load: FloatArray


def ramp_errors(
    robot: RobotConfig,
    plant: PlantConfig,
    joint: str,
    velocities: Sequence[float],
    torques: Sequence[float],
    protocol: RampProtocol,
    *,
    workers: Workers = -1,
    progress: Progress | None = None,
) -> FloatArray:
    """Tracking error of a joint in steady ramps under constant load.

    For each cell the robot stands still in posture Stand, base fixed, gravity off, the load already on the link. The
    joint comes to the start of the ramp in a minimum-jerk move of ``protocol.arrival``, against the direction of the
    ramp or in it, waits, and runs at constant velocity around the middle of its range. The error is the command minus
    what the encoder reports then, transport included, without noise and counts, averaged over the last part of the
    ramp. Both arms work at once, each on cells of its own: the drives left and right are the same.

    Args:
        robot: The robot.
        plant: Its parameters; the base is fixed for this.
        joint: Of an arm.
        velocities: (n,) [rad/s], none of them 0.
        torques: (m,) that the motor must give against the load [N m].
        protocol: Distances and times.
        workers: Processes, -1 for one per core; or a cluster.
        progress: Called after each part.

    Returns:
        (m, n) mean error [rad].
    """
    fixed = replace(plant, base="fixed")
    cells = [(v, torque) for torque in torques for v in velocities]
    pairs = [cells[i : i + 2] for i in range(0, len(cells), 2)]
    jobs = [
        partial(_ramp_part, robot, fixed, joint, pairs[i : i + 8], protocol)
        for i in range(0, len(pairs), 8)
    ]
    parts = run_all(jobs, workers, progress)
    return np.concatenate(parts).reshape(len(torques), len(velocities))


def _ramp_part(
    robot: RobotConfig,
    plant: PlantConfig,
    joint: str,
    pairs: list[list[tuple[float, float]]],
    protocol: RampProtocol,
) -> FloatArray:
    """Mean errors [rad] of some pairs of cells, one after the other on one simulation, each from the start."""
    simulation = Simulation(robot, plant)
    simulation.model.mj.opt.gravity[:] = 0.0
    sides = [robot.joint_index(joint), robot.joint_index(opposite(joint))]
    return np.concatenate([_ramp_pair(robot, plant, simulation, sides, p, protocol) for p in pairs])


def _ramp_pair(
    robot: RobotConfig,
    plant: PlantConfig,
    simulation: Simulation,
    sides: list[int],
    pair: list[tuple[float, float]],
    protocol: RampProtocol,
) -> FloatArray:
    """Mean errors [rad] of one or two cells, each on an arm of its own."""
    commands = [
        ramp_command(robot, index, velocity, protocol)
        for index, (velocity, _) in zip(sides, pair, strict=False)
    ]
    posture = robot.posture("Stand")
    for index, command in zip(sides, commands, strict=False):
        posture[index] = command[0]
    simulation.reset(posture)
    dofs = simulation.model.link_dof
    simulation.data.qfrc_applied[:] = 0.0
    for index, (_, torque) in zip(sides, pair, strict=False):
        simulation.data.qfrc_applied[dofs[index]] = -torque
    length = max(len(command) for command in commands)
    positions = np.empty((length, len(commands)))
    ones, still = np.ones(len(posture)), np.zeros(3)
    for tick in range(length):
        for index, command in zip(sides, commands, strict=False):
            posture[index] = command[min(tick, len(command) - 1)]
        simulation.cycle(posture.copy(), ones, still, still)
        positions[tick] = simulation.position[sides[: len(commands)]]
    # Command and sample are each late by whole ticks: all of it shows when the sample is read.
    late = plant.response_delay
    errors = []
    for column, command in enumerate(commands):
        ramp = _ramp_ticks(robot, sides[column], pair[column][0], protocol)
        ticks = np.arange(len(command) - ramp + int(protocol.skip * ramp), len(command))
        errors.append(float(np.mean(command[ticks] - positions[ticks - late, column])))
    return np.array(errors)


def ramp_command(
    robot: RobotConfig, index: int, velocity: float, protocol: RampProtocol
) -> FloatArray:
    """(ticks,) positions [rad] of one joint, tick by tick: arrival, wait, ramp."""
    lower, upper = robot.lower[index], robot.upper[index]
    ramp = _ramp_ticks(robot, index, velocity, protocol)
    start = (lower + upper) / 2 - velocity * ramp * robot.cycle / 2
    towards = np.sign(velocity) if protocol.onwards else -np.sign(velocity)
    origin = np.clip(start - towards * protocol.arrival, lower, upper)
    arrival = origin + (start - origin) * _ramp(round(protocol.arrival_time / robot.cycle))
    wait = np.full(round(protocol.wait / robot.cycle), start)
    return np.concatenate(
        [[origin], arrival, wait, start + velocity * robot.cycle * np.arange(1, ramp + 1)]
    )


def _ramp_ticks(robot: RobotConfig, index: int, velocity: float, protocol: RampProtocol) -> int:
    travel = min(protocol.travel, 0.9 * float(robot.upper[index] - robot.lower[index]))
    return round(min(protocol.time, travel / abs(velocity)) / robot.cycle)


def hold_errors(
    robot: RobotConfig,
    plant: PlantConfig,
    holds: Holds,
    seed: int,
    *,
    workers: Workers = -1,
    progress: Progress | None = None,
) -> HoldEnds:
    """Errors and currents of an arm at the end of holds.

    Several robots divide the goals among them, base fixed, gravity on. Each is activated in posture Stand, goes to
    random goals of all joints at once, in minimum-jerk moves straight to the boards, and waits at each. Error and
    current are what the sensors report.

    Args:
        robot: The robot.
        plant: Its parameters; the base is fixed for this.
        holds: Joints, number of goals, ranges and times.
        seed: Of goals and noise.
        workers: Processes, -1 for one per core; or a cluster.
        progress: Called after each part.
    """
    fixed = replace(plant, base="fixed")
    jobs = [
        partial(_hold_part, robot, fixed, part, (seed, first)) for first, part in divided(holds)
    ]
    error, current, load = (
        np.concatenate(p) for p in zip(*run_all(jobs, workers, progress), strict=True)
    )
    return HoldEnds(joints=holds.joints, error=error, current=current, load=load)


def divided(goals: G) -> list[tuple[int, G]]:
    """Divide goals among robots of GOALS_EACH at most; return the number of the first goal of each, and its goals."""
    firsts = range(0, goals.count, GOALS_EACH)
    return [(n, replace(goals, count=min(GOALS_EACH, goals.count - n))) for n in firsts]


def _hold_part(
    robot: RobotConfig, plant: PlantConfig, holds: Holds, seed: tuple[int, int]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Errors [rad], currents [A] and loads [N m], (count, joints) each, of one robot."""
    rng = np.random.default_rng(seed)
    ramp = _ramp(round(holds.move / robot.cycle))
    ramps = [ramp] * holds.count
    run = play_goals(robot, plant, holds.joints, ramps, rng, part=holds.range, hold=holds.hold)
    mean = max(1, round(CURRENT_TIME / robot.cycle))
    currents = [run.current[end - mean : end].mean(axis=0) for end in run.ends]
    columns = [robot.joint_index(name) for name in holds.joints]
    last = [end - 1 for end in run.ends]
    return (
        (run.command - run.position)[last][:, columns],
        np.array(currents)[:, columns],
        gravity_torque(robot, plant, run.command[last])[:, columns],
    )


@dataclass(frozen=True, kw_only=True)
class GoalRun:
    """One robot on its way from goal to goal, arrays (n, 17) by tick.

    Attributes:
        command: Position sent [rad].
        position: Measured in the same exchange [rad].
        current: The same, unsigned [A].
        age: (n,) of the sample beyond the usual transport [s].
        begins: (count,) first tick of each move.
        ends: (count,) tick after the end of each hold.
    """

    command: FloatArray
    position: FloatArray
    current: FloatArray
    age: FloatArray
    begins: tuple[int, ...]
    ends: tuple[int, ...]


def play_goals(
    robot: RobotConfig,
    plant: PlantConfig,
    joints: Sequence[str],
    ramps: Sequence[FloatArray],
    rng: np.random.Generator,
    *,
    part: float,
    hold: float,
) -> GoalRun:
    """Have one robot go to random goals of all joints at once, straight to the boards, and hold each.

    Args:
        robot: The robot.
        plant: Its parameters, with a fixed base.
        joints: Those that have goals; the others stay in posture Stand.
        ramps: For each goal, the fraction of the way that is done after each tick.
        rng: Of goals and noise.
        part: Of each joint's range, around its middle, where its goals lie.
        hold: How long each goal is held [s].
    """
    columns = np.array([robot.joint_index(name) for name in joints])
    lower, upper = robot.lower[columns], robot.upper[columns]
    reach = part * (upper - lower) / 2
    wait = max(1, round(hold / robot.cycle))
    ones, still = np.ones(len(robot.joint_names)), np.zeros(3)
    backend = MujocoBackend(robot, plant, seed=int(rng.integers(2**31)))
    backend.open()
    backend.activate()
    here = robot.posture("Stand")
    path: list[FloatArray] = []
    begins, ends = [], []
    for ramp in ramps:
        goal = here.copy()
        goal[columns] = (lower + upper) / 2 + rng.uniform(-reach, reach)
        begins.append(len(path))
        path += [here + fraction * (goal - here) for fraction in ramp] + [goal] * wait
        ends.append(len(path))
        here = goal
    measured = [
        backend.exchange(Command(position=position, stiffness=ones, wheel_speed=still))
        for position in path
    ]
    backend.close()
    return GoalRun(
        command=np.array(path),
        position=np.array([m.position for m in measured]),
        current=np.array([m.current for m in measured]),
        age=np.array([m.age for m in measured]),
        begins=tuple(begins),
        ends=tuple(ends),
    )


def gravity_torque(robot: RobotConfig, plant: PlantConfig, postures: FloatArray) -> FloatArray:
    """Return the (n, 17) torque that gravity asks of each joint in (n, 17) postures, at rest [N m]."""
    simulation = Simulation(robot, plant)
    loads = []
    for posture in postures:
        simulation.reset(posture)
        loads.append(simulation.data.qfrc_bias[simulation.model.link_dof].copy())
    return np.array(loads)


def real_time_factor(
    robot: RobotConfig, plant: PlantConfig, *, seconds: float = 2.0, repeats: int = 5
) -> float:
    """Measure how much faster than real time the plant runs on one core: median of some repeats.

    All 17 joints, all sensors, the base as the plant has it, one hand on the right forearm, no controller.
    """
    backend = MujocoBackend(robot, plant)
    backend.open()
    posture = backend.activate().position
    command = Command(position=posture, stiffness=np.ones(len(posture)), wheel_speed=np.zeros(3))
    ticks = round(seconds / robot.cycle)
    backend.grab(GRABBED, np.array(PULL), hold=(repeats + 1) * seconds)
    for _ in range(ticks // 2):
        backend.exchange(command)
    times = []
    for _ in range(repeats):
        begin = perf_counter()
        for _ in range(ticks):
            backend.exchange(command)
        times.append(perf_counter() - begin)
    backend.close()
    return ticks * robot.cycle / float(np.median(times))


def _ramp(ticks: int) -> FloatArray:
    """Return (ticks,) the fraction of a move that is done after each tick; at least one."""
    return minimum_jerk(np.arange(1, max(ticks, 1) + 1) / max(ticks, 1))


def opposite(joint: str) -> str:
    """Return the name of this joint on the other arm."""
    return {"L": "R", "R": "L"}[joint[0]] + joint[1:]


def run_all(
    jobs: Sequence[Callable[[], T]], workers: Workers, progress: Progress | None
) -> list[T]:
    """Results of all jobs, in order."""
    results = []
    for result in run_jobs(jobs, workers=workers):
        results.append(result)
        if progress is not None:
            progress(len(results), len(jobs))
    return results
