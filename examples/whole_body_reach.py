"""A place out of the arm's reach: the base drives, the arm does the rest. Run: python examples/whole_body_reach.py."""

import numpy as np

from pepper_driver import Pepper
from pepper_driver.controller import PositionTask

BACKEND = "mujoco"
PLACE = [1.0, 0.35, 0.85]  # [m] in the world, which is where the base started
MOVING = ("LShoulderPitch", "LShoulderRoll", "LElbowYaw", "LElbowRoll", "LWristYaw")

with Pepper(BACKEND, observer=None) as pepper:
    controller = pepper.controller
    # The arm alone first: it stretches out and stops short.
    alone = PositionTask("l_gripper", joints=MOVING)
    alone.target = PLACE
    controller.add(alone)
    pepper.run(3.0)
    print(f"arm alone: {1e3 * np.linalg.norm(alone.error):.0f} mm short")
    controller.remove(alone)

    # A reach that may use the base: the controller holds the base no longer, until this task is removed.
    reach = PositionTask("l_gripper", joints=MOVING, base=True)
    controller.add(reach)
    reach.move_to(PLACE, duration=5.0)
    arrived = pepper.run(10.0, until=lambda: reach.reached(0.005))
    x, y, heading = controller.base_pose
    rolled = controller.odometry.pose
    print(
        f"with the base: {'reached' if arrived else 'NOT reached'}, off by"
        f" {1e3 * np.linalg.norm(reach.error):.1f} mm; the base went to x {x:.2f} m, y {y:.2f} m,"
        f" heading {np.degrees(heading):.0f} deg (by its wheels {rolled[0]:.2f}, {rolled[1]:.2f})"
    )

    # Stay there: the posture becomes what the arm has, the base is held again.
    pepper.set_posture(controller.position)
    controller.remove(reach)
    pepper.run(1.0)
    print(f"it stands: base at {np.linalg.norm(controller.model.v[:2]):.3f} m/s")
