"""A place out of the arm's reach: the base drives, the arm does the rest. Run: python examples/whole_body_reach.py."""

import numpy as np

from pepper_driver import Pepper
from pepper_driver.controller import PositionTask

BACKEND = "mujoco"
PLACE = [1.0, 0.35, 0.85]  # [m] in the world, which is where the base started
MOVING = ("LShoulderPitch", "LShoulderRoll", "LElbowYaw", "LElbowRoll", "LWristYaw")

alone = PositionTask("l_gripper", joints=MOVING)
reach = PositionTask("l_gripper", joints=MOVING, base=True)

with Pepper(BACKEND, observer=None) as pepper:
    # The arm alone first: it stretches out and stops short.
    alone.target = PLACE
    pepper.add(alone)
    pepper.run(3.0)
    print(f"arm alone: {1e3 * np.linalg.norm(alone.error):.0f} mm short")

    with pepper.changes():  # both between the same two ticks
        pepper.remove(alone)
        pepper.add(reach)
    reach.move_to(PLACE, duration=5.0)
    arrived = pepper.run(10.0, until=lambda: reach.reached(0.005))
    x, y, heading = pepper.base_pose
    print(
        f"with the base: {'reached' if arrived else 'NOT reached'}, off by"
        f" {1e3 * np.linalg.norm(reach.error):.1f} mm; by its wheels the base went to"
        f" x {x:.2f} m, y {y:.2f} m, heading {np.degrees(heading):.0f} deg"
    )

    with pepper.changes():  # stay there: the posture becomes what the arm has
        pepper.set_posture(pepper.controller.position)
        pepper.remove(reach)
    pepper.run(1.0)
    print(f"it stands: wheels at {np.abs(pepper.measurement.wheel_speed).max():.3f} rad/s")
