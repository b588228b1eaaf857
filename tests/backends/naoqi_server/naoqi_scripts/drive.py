#! /usr/bin/env python
"""Pepper drives: to a pose, by a joystick's values, and stops."""

import argparse
import math
import time

import qi


def rounded(pose):
    return [round(value, 1) + 0.0 for value in pose]


def main(session):
    life = session.service("ALAutonomousLife")
    if life.getState() != "disabled":
        life.setState("disabled")
    motion = session.service("ALMotion")
    motion.wakeUp()

    start = motion.getRobotPosition(True)
    print("there", motion.moveTo(0.3, 0.0, math.pi / 4))
    end = motion.getRobotPosition(True)
    print("moved", rounded([end[0] - start[0], end[1] - start[1]]))

    motion.moveToward(0.5, 0.0, 0.0, [["MaxVelXY", 0.4]])
    while motion.getRobotVelocity()[0] < 0.19:
        time.sleep(0.1)
    velocity = motion.getRobotVelocity()
    print("forward", rounded(velocity), motion.moveIsActive())
    motion.move(0.0, 0.0, -0.5)
    while motion.getRobotVelocity()[2] > -0.3:
        time.sleep(0.1)
    print("turning", motion.moveIsActive())
    print("stopped", motion.stopMove(), motion.moveIsActive())

    # Start a long way, and think better of it.
    future = motion.moveTo(20.0, 0.0, 0.0, _async=True)
    while not motion.moveIsActive():
        time.sleep(0.1)
    print("on its way", future.isRunning())
    motion.stopMove()
    print("interrupted", future.value())


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--ip", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=9559)
    args = parser.parse_args()
    session = qi.Session()
    session.connect("tcp://{}:{}".format(args.ip, args.port))
    main(session)
