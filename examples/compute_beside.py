"""Heavy computing in a worker process: the ticks stay punctual. Run: python examples/compute_beside.py."""

import logging
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

from pepper_driver import Pepper
from pepper_driver.config import load_robot
from pepper_driver.controller import RobotModel

BACKEND = "mujoco://?plant=integral"
PLACES = ([0.25, 0.20, 0.95], [0.25, 0.25, 1.05])  # [m] in base_link
ARM = ("LShoulderPitch", "LShoulderRoll", "LElbowYaw", "LElbowRoll")
TRIES = 6_000


def search(place: list[float]) -> dict[str, float]:
    """In the worker: of many random postures of the arm, the one that brings the hand nearest to a place [m]."""
    robot = load_robot()
    model, rng = RobotModel(robot), np.random.default_rng(0)
    indices = [robot.joint_index(name) for name in ARM]
    joints, best, nearest = robot.posture("Stand"), {}, np.inf
    for _ in range(TRIES):
        joints[indices] = rng.uniform(robot.lower[indices], robot.upper[indices])
        hand = model.link_pose("l_gripper", joints)[:3, 3]
        distance = float(np.linalg.norm(hand - place))
        if distance < nearest:
            best, nearest = dict(zip(ARM, joints[indices].tolist(), strict=True)), distance
    return best


def main() -> None:
    """Wait for a touch, have a posture computed, go there: twice."""
    logging.basicConfig(stream=sys.stdout)  # warnings about missed ticks too
    pepper = Pepper(BACKEND, real_time=True)
    # spawn: the worker begins with nothing of this process, neither its threads nor its connections.
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as worker:
        worker.submit(load_robot).result()  # it has imported everything before the robot is active
        with pepper:  # from here on a thread ticks, whatever this one does
            pepper.run(0.5)
            for place in PLACES:
                pepper.push("LBicep", [0, 20, 0], point=[0.16, 0, 0], duration=0.5)
                contact = pepper.wait_for_contact(timeout=2.0)
                print("touched at", "nothing" if contact is None else contact.link)
                ticks = pepper.statistics.ticks
                posture = worker.submit(search, place).result()
                print(f"{pepper.statistics.ticks - ticks} ticks while the worker computed")
                pepper.set_posture(posture, duration=1.5)
                pepper.run(2.0)
                hand = pepper.link_pose("l_gripper")[:3, 3]
                print(f"hand {1e3 * np.linalg.norm(hand - place):.0f} mm from {place}")
        print(pepper.statistics.summary)


if __name__ == "__main__":  # the worker imports this file, and must not run it
    main()
