#! /usr/bin/env python
"""Pepper wakes up, waves, nods, opens a hand and goes to rest."""

import argparse
import sys
import time

import qi

WAVE_TIMES = [0.6, 0.9, 1.2, 1.5]
WAVE = [
    [-0.6, [3, -0.2, 0.0], [3, 0.1, 0.0]],
    [-0.3, [3, -0.1, 0.0], [3, 0.1, 0.0]],
    [-0.7, [3, -0.1, 0.0], [3, 0.1, 0.0]],
    [-0.4, [3, -0.1, 0.0], [3, 0.0, 0.0]],
]


def main(session):
    motion = session.service("ALMotion")
    posture = session.service("ALRobotPosture")

    motion.wakeUp()
    print("awake", motion.robotIsWakeUp())
    print("posture", posture.goToPosture("StandInit", 0.8), posture.getPosture())

    # Raise the right arm, then wave with the shoulder as a timeline exported it.
    motion.angleInterpolation(
        ["RShoulderPitch", "RElbowRoll"], [[-0.2], [1.0]], [[0.8], [0.8]], True
    )
    motion.angleInterpolationBezier(["RShoulderRoll"], [WAVE_TIMES], [WAVE])
    print("arm", [round(a, 1) for a in motion.getAngles(["RShoulderPitch", "RElbowRoll"], True)])

    # Nod twice, relative to where the head is.
    motion.angleInterpolation("HeadPitch", [0.2, 0.0, 0.2, 0.0], [0.3, 0.6, 0.9, 1.2], False)

    # Look around without waiting.
    motion.setAngles("HeadYaw", 0.6, 0.2)
    while abs(motion.getAngles("HeadYaw", True)[0] - 0.6) > 0.04:
        time.sleep(0.1)
    print("yaw", round(motion.getAngles("HeadYaw", True)[0], 1))
    motion.changeAngles("HeadYaw", -0.6, 0.1)
    motion.angleInterpolationWithSpeed(["HeadPitch"], [-0.2], 0.2)

    motion.openHand("RHand")
    print("hand", round(motion.getAngles("RHand", True)[0], 1))
    motion.setStiffnesses("RArm", 0.6)
    print("stiffness", sorted(set(motion.getStiffnesses("RArm"))))

    motion.rest()
    print("awake", motion.robotIsWakeUp())


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--ip", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=9559)
    args = parser.parse_args()
    session = qi.Session()
    try:
        session.connect("tcp://%s:%d" % (args.ip, args.port))
    except RuntimeError:
        print("Can't connect to Naoqi at %s:%d" % (args.ip, args.port))
        sys.exit(1)
    main(session)
