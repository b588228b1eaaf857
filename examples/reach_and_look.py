"""Pepper reaches with its left hand and looks at the hand meanwhile. Run: python examples/reach_and_look.py."""

import numpy as np

from pepper_driver import Pepper
from pepper_driver.controller import LookAtTask, PositionTask

BACKEND = "mujoco"
PLACES = ([0.25, 0.20, 0.85], [0.25, 0.05, 0.95], [0.15, 0.40, 0.90])  # [m] in base_link
ARM = ("LShoulderPitch", "LShoulderRoll", "LElbowYaw", "LElbowRoll", "LWristYaw")

reach = PositionTask("l_gripper", root="base_link", joints=ARM)
look = LookAtTask(  # the head follows the hand wherever it goes
    target_link="l_gripper", joints=("HeadYaw", "HeadPitch"), stiffness=40.0
)

with Pepper(BACKEND, observer=None) as pepper:
    pepper.add(reach)
    pepper.add(look)
    for place in PLACES:
        reach.move_to(place, duration=2.0)  # [s] along a spline
        arrived = pepper.run(5.0, until=lambda: reach.reached(0.005) and look.reached(0.02))
        hand = pepper.link_pose("l_gripper")[:3, 3]
        print(
            f"{place}: {'reached' if arrived else 'NOT reached'}, reference off by"
            f" {1e3 * np.linalg.norm(reach.error):.1f} mm, measured hand by"
            f" {1e3 * np.linalg.norm(hand - place):.1f} mm, line of sight by"
            f" {np.degrees(np.linalg.norm(look.error)):.1f} deg"
        )
