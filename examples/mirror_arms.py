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

with Pepper(BACKEND, observer=None) as pepper:
    model = pepper.controller.model
    right = FrameTask("r_wrist", root="base_link", joints=RIGHT_ARM)
    right.stiffness = 100.0  # [1/s2]
    right.dim_weight = [1.0, 1.0, 1.0, 0.1, 0.1, 0.1]  # five joints: the place before the turn

    def mirror(tick: Tick, observation: Observation | None) -> None:
        """Inside every tick: where the left wrist is, reflected, is where the right one shall go, and as fast."""
        before = right.target
        left = model.link_pose("l_wrist", pepper.controller.position)
        right.target = MIRROR @ left @ MIRROR
        if np.isfinite(before).all():
            speed = (right.target - before)[:3, 3] / pepper.config.cycle
            right.reference_velocity = [*speed, 0.0, 0.0, 0.0]

    pepper.run(0.012, on_tick=mirror)
    pepper.controller.add(right)
    for number, posture in enumerate(POSTURES):
        pepper.set_posture(posture, duration=2.0)
        worst = 0.0

        def watch(tick: Tick, observation: Observation | None) -> None:
            """The wrists as the encoders see them."""
            global worst
            mirror(tick, observation)
            left, other = (
                model.link_pose(link, tick.measurement.position) for link in ("l_wrist", "r_wrist")
            )
            worst = max(worst, float(np.linalg.norm((MIRROR @ left - other)[:3, 3])))

        pepper.run(3.0, on_tick=watch)
        print(
            f"posture {number}: right wrist off its mirror image by"
            f" {1e3 * np.linalg.norm(right.error[:3]):.1f} mm, on the way by"
            f" {1e3 * worst:.0f} mm at most as measured"
        )
