"""The left arm goes from place to place, the right arm is its mirror image. Run: python examples/mirror_arms.py."""

import numpy as np

from pepper_driver import Observation, Pepper
from pepper_driver.controller import FrameTask, Tick

BACKEND = "mujoco"
POSTURES = (  # [rad]
    {"LShoulderPitch": 0.6, "LShoulderRoll": 0.5, "LElbowYaw": -1.0, "LElbowRoll": -0.8},
    {"LShoulderPitch": 0.2, "LShoulderRoll": 0.2, "LElbowYaw": -0.4, "LElbowRoll": -1.2},
    {"LShoulderPitch": 1.0, "LShoulderRoll": 0.9, "LElbowYaw": -1.4, "LElbowRoll": -0.4},
)
RIGHT_ARM = ("RShoulderPitch", "RShoulderRoll", "RElbowYaw", "RElbowRoll", "RWristYaw")
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])  # across the plane y = 0 of base_link

pepper = Pepper(BACKEND, observer=None)
right = FrameTask("r_wrist", root="base_link", joints=RIGHT_ARM, stiffness=100.0)  # [1/s2]
right.dim_weight = [1.0, 1.0, 1.0, 0.1, 0.1, 0.1]  # five joints: the place before the turn
pepper.add(right)


def mirror(tick: Tick, observation: Observation | None) -> None:
    """Inside every tick: where the left wrist is, reflected, is where the right one shall go, and as fast."""
    before = right.target
    right.target = MIRROR @ pepper.link_pose("l_wrist", of="commanded") @ MIRROR
    speed = (right.target - before)[:3, 3] / pepper.config.cycle
    right.reference_velocity = [*np.nan_to_num(speed), 0.0, 0.0, 0.0]


with pepper:
    for number, posture in enumerate(POSTURES):
        pepper.set_posture(posture, duration=2.0)
        pepper.run(3.0, on_tick=mirror)
        left, other = (pepper.link_pose(link) for link in ("l_wrist", "r_wrist"))
        print(
            f"posture {number}: right wrist off its mirror image by"
            f" {1e3 * np.linalg.norm(right.error[:3]):.1f} mm,"
            f" {1e3 * np.linalg.norm((MIRROR @ left - other)[:3, 3]):.0f} mm as measured"
        )
