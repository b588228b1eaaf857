"""Accuracy of a hand at its target, on simulated robots: open and closed loop, plant by plant.

Random reachable targets 0.2 to 0.5 m away, alternating hands, task stiffness 10. When the task says that it has
reached its target, the true position of the hand is compared with it: in the world, with the base on its wheels, bent
hips and all. Run: python benchmarks/reach.py --json reach.json
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from pepper_driver import Pepper
from pepper_driver.config import PepperError, load_controller_settings, load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.workers import run_jobs
from pepper_driver.controller import PositionTask, RobotModel

PLANTS = ("nominal", "integral", "worn", "cold", "payload", "soft-hip")
HANDS = {"l_wrist": "L", "r_wrist": "R"}
ARM = ("ShoulderPitch", "ShoulderRoll", "ElbowYaw", "ElbowRoll", "WristYaw")
PALM = np.array([0.06, 0.0, 0.0])  # [m] in the wrist link
NEAREST, FARTHEST = 0.2, 0.5  # [m]
TOLERANCE = 0.002  # [m] asked of `reached`
PATIENCE = 8.0  # [s]
STIFFNESS = 10.0  # [1/s2]


def random_targets(
    model: RobotModel, start: FloatArray, link: str, rng: np.random.Generator
) -> FloatArray:
    """A place in front of the robot or next to it that the palm can be at, 0.2 to 0.5 m from where it is."""
    robot = model.robot
    here = model.link_pose(link, start) @ np.append(PALM, 1.0)
    joints = [robot.joint_index(HANDS[link] + joint) for joint in ARM]
    outwards = 1.0 if link == "l_wrist" else -1.0
    while True:
        posture = start.copy()
        span = robot.upper - robot.lower
        posture[joints] = (robot.lower + span * rng.uniform(0.1, 0.9, len(span)))[joints]
        there = model.link_pose(link, posture) @ np.append(PALM, 1.0)
        clear = there[0] > 0.15 or outwards * there[1] > 0.3
        if clear and NEAREST <= np.linalg.norm(there[:3] - here[:3]) <= FARTHEST:
            return there[:3]


def run(plant: str, feedback: str, count: int, seed: int) -> dict[str, Any]:
    """One robot: its true errors [m] when its tasks said they had reached, and how long they took [s]."""
    robot = load_robot()
    settings = replace(load_controller_settings(robot), feedback=feedback)
    model = RobotModel(robot)
    rng = np.random.default_rng(seed)  # the same targets for every plant and loop
    errors, durations, missed = [], [], 0
    with Pepper(
        f"mujoco://?plant={plant}&seed={seed}", observer=None, controller=settings
    ) as pepper:
        pepper.set_posture("Stand")
        pepper.run(3.0)
        posture = pepper.target
        for number in range(count):
            link = list(HANDS)[number % 2]
            task = PositionTask(link, PALM, stiffness=STIFFNESS, robot=robot)
            task.target = target = random_targets(model, posture, link, rng)
            controller = pepper.controller
            controller.add(task)
            began = pepper.time
            while not task.reached(TOLERANCE) and pepper.time - began < PATIENCE:
                pepper.run(robot.cycle)
            if task.reached(TOLERANCE):
                truth = pepper.backend.truth.link_pose(link) @ np.append(PALM, 1.0)
                errors.append(float(np.linalg.norm(truth[:3] - target)))
                durations.append(pepper.time - began)
            else:
                missed += 1
            controller.remove(task)
            pepper.run(2.0)  # back to the posture
        fallen = pepper.backend.truth.fallen
    return {"errors": errors, "durations": durations, "missed": missed, "fallen": fallen}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", nargs="+", default=PLANTS, metavar="PLANT")
    parser.add_argument("--count", type=int, default=40, help="targets for each plant and loop")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=-1)
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    if arguments.count < 1:
        parser.error("--count must be at least 1")
    pairs = [(plant, loop) for plant in arguments.plants for loop in ("none", "joints")]
    work = run_jobs(
        (partial(run, plant, loop, arguments.count, arguments.seed) for plant, loop in pairs),
        workers=arguments.workers,
    )
    try:
        results = list(track(work, "reaching", total=len(pairs), transient=True))
    except PepperError as error:
        parser.error(str(error))
    names = {"none": "open", "joints": "closed"}
    table = Table("plant", "loop", "reached", "median [mm]", "p90 [mm]", "time [s]")
    document: dict[str, Any] = {}
    for (plant, loop), result in zip(pairs, results, strict=True):
        errors = 1e3 * np.array(result["errors"] or [np.nan])
        median, p90 = np.percentile(errors, [50, 90])
        seconds = float(np.median(result["durations"] or [np.nan]))
        reached = len(result["errors"])
        table.add_row(
            plant,
            names[loop],
            f"{reached} of {arguments.count}",
            f"{median:.1f}",
            f"{p90:.1f}",
            f"{seconds:.1f}",
        )
        document.setdefault(plant, {})[names[loop]] = {
            "error_mm": {"median": float(median), "p90": float(p90)},
            "reached": reached,
            "missed": result["missed"],
            "seconds": {"median": seconds},
            "fallen": result["fallen"],
        }
    Console().print(table)
    if arguments.json is not None:
        settings = {"count": arguments.count, "seed": arguments.seed, "stiffness": STIFFNESS}
        arguments.json.write_text(json.dumps({**settings, "plants": document}, indent=2) + "\n")


if __name__ == "__main__":
    main()
