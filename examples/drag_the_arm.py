"""A hand leads a simulated Pepper's arm, which complies. Run: python examples/drag_the_arm.py.

It writes drag.mcap; `pepper render drag.mcap --out drag.gif` makes a film of it.
"""

from math import cos, pi

import numpy as np

from pepper_driver import Comply, Contact, Pepper

POSTURE = {"LShoulderPitch": 0.9, "LShoulderRoll": 0.25, "LElbowRoll": -0.8}  # [rad]
WAY = np.array([0.05, 0.28, 0.22])  # [m] of the hand: forward, to the robot's left, up
RISE, HOLD = 2.0, 0.8  # [s]

pepper = Pepper("mujoco", reflexes=[Comply(gain=0.9)], log="drag.mcap")


@pepper.on_contact()
def touched(contact: Contact) -> None:
    """Print a contact that begins."""
    print(f"{contact.time:.2f} s: {contact.limb} is touched, at {contact.link}")


with pepper:
    pepper.set_posture(POSTURE, duration=1.5)
    pepper.run(3.0)
    hand = pepper.take_hand("LForeArm", [0.1, 0.0, 0.0], max_force=40.0)
    begin, start = pepper.time, hand.point
    while pepper.time < begin + RISE + HOLD:
        done = min(1.0, (pepper.time - begin) / RISE)
        hand.move(start + WAY * 0.5 * (1.0 - cos(pi * done)))  # again and again, or it lets go
        pepper.step()
    print(f"the arm was led {1000 * np.linalg.norm(hand.point - start):.0f} mm")
    hand.release()
    pepper.run(2.2)
