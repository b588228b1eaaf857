"""The reflex on the bench, declared in a file, and on a robot that is pushed."""

import numpy as np
import pytest
from lift_arm import LiftArm

from pepper_driver import Pepper
from pepper_driver.config import load_robot
from pepper_driver.reflexes import ReflexError
from pepper_driver.reflexes.declared import make_reflex
from pepper_driver.testing import ReflexBench, make_contact

ROBOT = load_robot()


@pytest.mark.parametrize(
    ("joint", "link", "roll", "goal"),
    [
        ("LElbowRoll", "LForeArm", "LShoulderRoll", 0.8),
        ("RShoulderRoll", "RBicep", "RShoulderRoll", -0.8),
    ],
)
def test_the_arm_that_is_touched_goes_up_and_back(
    joint: str, link: str, roll: str, goal: float
) -> None:
    bench = ReflexBench(LiftArm())
    start, index = bench.controller.position, ROBOT.joint_index(roll)
    bench.step(make_contact(joint=joint, link=link))
    bench.run(1.5)
    assert bench.controller.position[index] == pytest.approx(goal, abs=0.03)
    bench.step(make_contact(phase="end", joint=joint, link=link))
    bench.run(4.0)
    assert bench.controller.position == pytest.approx(start, abs=0.02)
    begin, end = bench.events
    assert (begin.reflex, begin.phase, end.phase) == ("lift_arm", "begin", "end")
    assert roll in begin.joints, "the event lists what it was given"


def test_a_contact_on_the_head_lifts_nothing() -> None:
    bench = ReflexBench(LiftArm())
    bench.step(make_contact(joint="HeadYaw", link="Neck"))
    assert np.ptp(bench.run(0.5), axis=0).max() == 0.0


def test_a_file_declares_it_by_name() -> None:
    reflex = make_reflex({"do": "lift_arm", "angle": 0.5}, ROBOT, "mine.yaml", "reflexes.0")
    assert isinstance(reflex, LiftArm)
    assert reflex.angle == 0.5
    with pytest.raises(ReflexError, match=r"angle is a number from 0\.1 to 1\.4"):
        LiftArm(angle=3.0)


def test_a_push_in_simulation_lifts_the_arm() -> None:
    highest = {"LShoulderRoll": 0.0, "RShoulderRoll": 0.0}
    with Pepper("mujoco://?plant=integral", reflexes=[LiftArm()]) as pepper:
        pepper.run(0.5)
        pepper.push("LBicep", [0, 25, 0], [0.16, 0, 0], 0.8, frame="link")
        for _ in range(150):
            pepper.step()
            for joint, angle in highest.items():
                highest[joint] = max(angle, abs(pepper.position[joint]))
    assert highest["LShoulderRoll"] > 0.6
    assert highest["RShoulderRoll"] < 0.2
