"""Random targets, half of them out of reach: does the robot stay off itself, on its wheels and within its limits?

New targets every 0.5 to 3 s: both wrists anywhere around and inside the body (half of them out of reach), postures near
and far, base poses, some in jumps and some on trajectories, soft and stiff. Distances are coal's on the integrated
posture; the zero moment point is that of Pinocchio's inverse dynamics with a free base, at start and end of each cycle.
Run: python benchmarks/wander.py --minutes 10 --seed 0 --json wander.json
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from rich.console import Console
from rich.table import Table

from pepper_driver.config import RobotConfig, load_robot, load_self_collision
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import RobotModel, WholeBodyController
from pepper_driver.controller.collision import CapsuleDistances
from pepper_driver.controller.constraints import (
    Balance,
    Constraint,
    CoupledLimits,
    SelfCollision,
    WheelSpeedLimit,
)
from pepper_driver.controller.tasks import BasePoseTask, FrameTask, PositionTask

PALM = (0.05, 0.0, 0.0)  # [m] in the wrist link
NEAR = np.array([[-0.4, -0.45, 0.2], [0.6, 0.45, 1.3]])  # [m] around base_link, inside the body too
FAR = np.array([[-2.0, -2.0, -0.5], [2.0, 2.0, 2.5]])
BASE = np.array([1.0, 1.0, 3.0])  # [m], [m], [rad]
TICKS = (40, 250)  # between two sets of targets


class Judge:
    """Distances, centre of mass and zero moment point of a posture, from other code than the constraints'."""

    def __init__(self, robot: RobotConfig) -> None:
        self._model = RobotModel(robot)
        self._capsules = CapsuleDistances(self._model, load_self_collision(robot))
        full = pin.buildModelFromUrdf(str(robot.urdf), pin.JointModelFreeFlyer())
        wheels = [full.getJointId(name) for name in robot.wheels.names]
        self._free = pin.buildReducedModel(full, wheels, pin.neutral(full))
        self._data = self._free.createData()
        corners = np.array(robot.wheels.positions)[:, :2]
        self._corners = corners[np.argsort(np.arctan2(corners[:, 1], corners[:, 0]))]

    def distance(self, q: FloatArray) -> float:
        """Minimum distance of any pair [m]."""
        self._capsules.place(q)
        return float(self._capsules.distances().min())

    def centre_of_mass(self, q: FloatArray) -> float:
        """Return its distance inside the triangle of the wheels [m]."""
        com = pin.centerOfMass(self._free, self._data, self._posture(q))
        return self._inside(com[:2])

    def zero_moment_point(self, q: FloatArray, v: FloatArray, a: FloatArray) -> float:
        """Return its distance inside the triangle of the wheels [m]."""
        velocity, acceleration = (np.r_[x[:2], 0.0, 0.0, 0.0, x[2:]] for x in (v, a))
        push = pin.rnea(self._free, self._data, self._posture(q), velocity, acceleration)[:6]
        return self._inside(np.array([-push[4], push[3]]) / push[2])

    @staticmethod
    def _posture(q: FloatArray) -> FloatArray:
        posture: FloatArray = np.r_[np.zeros(6), 1.0, q[4:]]  # where the base is does not matter
        return posture

    def _inside(self, point: FloatArray) -> float:
        along = np.roll(self._corners, -1, axis=0) - self._corners
        to = point - self._corners
        cross = along[:, 0] * to[:, 1] - along[:, 1] * to[:, 0]
        return float((cross / np.linalg.norm(along, axis=1)).min())


class Wanderer:
    """A controller with all its limits, and ever new targets for it."""

    def __init__(
        self, robot: RobotConfig, seed: int, constraints: tuple[Constraint, ...] | None = None
    ) -> None:
        self._rng = np.random.default_rng(seed)
        self._robot = robot
        self.controller = control = WholeBodyController(robot)
        if constraints is None:
            constraints = (
                SelfCollision(robot),
                Balance(robot),
                CoupledLimits(robot),
                WheelSpeedLimit(robot),
            )
        for given in control.constraints:
            control.remove(given)
        for constraint in constraints:
            control.add(constraint)
        control.reset(robot.posture("StandInit"))
        control.remove(control.base_velocity)
        self._base = BasePoseTask()
        self._wrists = [
            PositionTask("l_wrist", PALM, base=True, robot=robot),
            FrameTask("r_wrist", PALM, robot=robot),
        ]
        for task in (self._base, *self._wrists):
            control.add(task)

    def retarget(self) -> None:
        """New targets, weights and stiffnesses."""
        rng, robot, control = self._rng, self._robot, self.controller
        posture = rng.uniform(robot.lower, robot.upper)
        if rng.random() < 0.5:
            near = control.position + rng.normal(0.0, 0.2, len(posture))
            posture = np.clip(near, robot.lower, robot.upper)
        control.posture.stiffness, control.posture.weight = rng.choice([5.0, 50.0]), _decade(rng)
        if rng.random() < 0.5:
            control.posture.target = posture
        else:
            control.posture.move_to(posture, float(rng.uniform(0.5, 3.0)))
        pose = control.base_pose
        self._base.target = pose + rng.uniform(-BASE, BASE)
        self._base.stiffness = rng.choice([3.0, 30.0])
        for task in self._wrists:
            low, high = FAR if rng.random() < 0.5 else NEAR
            place = rng.uniform(low, high)
            turn = pin.Quaternion(*_unit(rng, 4)).matrix()
            heading = pin.utils.rotate("z", pose[2])
            place = np.r_[pose[:2], 0.0] + heading @ place
            task.stiffness, task.weight = rng.choice([5.0, 50.0]), _decade(rng)
            if isinstance(task, FrameTask):
                target = np.eye(4)
                target[:3, :3], target[:3, 3] = turn, place
                task.target = target
            elif rng.random() < 0.5:
                task.target = place
            else:
                task.move_to(place, float(rng.uniform(0.5, 3.0)))

    def pause(self) -> int:
        """Ticks to the next targets."""
        return int(self._rng.integers(*TICKS))


def _decade(rng: np.random.Generator) -> float:
    return float(10 ** rng.uniform(0, 5))


def _unit(rng: np.random.Generator, size: int) -> FloatArray:
    vector: FloatArray = rng.normal(size=size)
    return vector / np.linalg.norm(vector)


def wander(
    robot: RobotConfig,
    ticks: int,
    seed: int,
    constraints: tuple[Constraint, ...] | None = None,
) -> dict[str, Any]:
    """Wander for some cycles; lengths in [mm], times in [us]."""
    wanderer, judge = Wanderer(robot, seed, constraints), Judge(robot)
    control, model = wanderer.controller, wanderer.controller.model
    outcomes: Counter[str] = Counter()
    violated: Counter[str] = Counter()
    minimum = dict.fromkeys(("distance", "centre of mass", "zero moment point"), np.inf)
    overshoot, nans, errors, change = -np.inf, 0, 0, 0
    times = np.zeros(ticks)
    for tick in range(ticks):
        if tick == change:
            wanderer.retarget()
            change += wanderer.pause()
        q, v = model.q, model.v
        start = time.perf_counter()
        try:
            reference = control.step()
        except Exception:  # counted, whatever it is
            errors += 1
            continue
        times[tick] = time.perf_counter() - start
        status = control.status
        outcomes[status.solver] += 1
        violated.update({name.split(",")[0] for name in status.violated})
        vectors = (model.q, model.v, reference.acceleration, reference.load_torque)
        nans += not all(np.isfinite(vector).all() for vector in vectors)
        a = (model.v - v) / robot.cycle
        outside = np.maximum(robot.lower - control.position, control.position - robot.upper)
        overshoot = max(overshoot, float(outside.max()))
        for key, value in (
            ("distance", judge.distance(model.q)),
            ("centre of mass", judge.centre_of_mass(model.q)),
            ("zero moment point", judge.zero_moment_point(q, v, a)),
            ("zero moment point", judge.zero_moment_point(model.q, model.v, a)),
        ):
            minimum[key] = min(minimum[key], value)
    return {
        "seed": seed,
        "ticks": ticks,
        "least_distance_mm": 1e3 * minimum["distance"],
        "worst_penetration_mm": max(0.0, -1e3 * minimum["distance"]),
        "least_margin_mm": {
            "zero_moment_point": 1e3 * minimum["zero moment point"],
            "centre_of_mass": 1e3 * minimum["centre of mass"],
        },
        "position_overshoot_mrad": max(0.0, 1e3 * overshoot),
        "not_a_number": nans,
        "exceptions": errors,
        "outcomes": {
            name: outcomes[name] for name in ("solved", "relaxed", "infeasible", "failed")
        },
        "violated": dict(violated.most_common()),
        "tick_us": {
            "median": 1e6 * float(np.median(times)),
            "p99": 1e6 * float(np.percentile(times, 99)),
        },
    }


def main() -> None:
    """Wander and print."""
    parser = argparse.ArgumentParser(description="Random targets: collisions, balance, limits.")
    parser.add_argument("--minutes", type=float, default=10.0, help="of the controller's time")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="write the results to this file")
    given = parser.parse_args()
    robot = load_robot()
    results = wander(robot, round(given.minutes * 60 / robot.cycle), given.seed)
    table = Table(title=f"{given.minutes:g} min of random targets", show_header=False)
    for key, value in results.items():
        parts = value.items() if isinstance(value, dict) else [("", value)]
        for part, number in parts:
            shown = f"{number:.2f}" if isinstance(number, float) else str(number)
            table.add_row(f"{key} {part}".replace("_", " ").strip(), shown)
    Console().print(table)
    if given.json is not None:
        given.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
