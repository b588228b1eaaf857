"""The left arm moves slowly. Touched, it says so and follows the hand; pushed harder, it retracts.

The same as experiments/touch_the_arm.yaml. Run: python examples/touch_the_arm.py [URI]
"""

import sys

from pepper_driver import FollowHand, Pepper, Retract

FORWARD = {"LShoulderPitch": 0.8, "LShoulderRoll": 0.15, "LElbowRoll": -0.6}
ASIDE = {"LShoulderPitch": 1.0, "LShoulderRoll": 0.7, "LElbowRoll": -0.4}
DOWN = {"LShoulderPitch": 1.4, "LShoulderRoll": 0.3, "LElbowRoll": -0.5}
FOLLOW = FollowHand(limb="left_arm", follow_with="arm", priority=20)
RETRACT = Retract(limb="left_arm", min_force=18.0, distance=0.3, priority=50)

if __name__ == "__main__":
    uri = sys.argv[1] if len(sys.argv) > 1 else "mujoco"
    with Pepper(uri, reflexes=[FOLLOW, RETRACT], log="touch.mcap") as pepper:
        pepper.on_contact(limb="left_arm")(
            lambda _: pepper.services.say("You are touching my arm.")
        )
        for posture in ("Stand", FORWARD, ASIDE, DOWN, "Stand"):
            pepper.set_posture(posture, duration=4.0)
            pepper.run(4.0)
        print(f"{len(pepper.contact_history)} events of contacts; log: touch.mcap")
