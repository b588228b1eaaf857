from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from pepper_driver.controller.model import RobotModel
from pepper_driver.observer.recording import Recording, RecordingBuilder, RecordingError
from support.observer import JOINTS, ROBOT, random_ticks

LEFT = ROBOT.joint_index("LShoulderRoll")
RIGHT = ROBOT.joint_index("RShoulderRoll")


def random_run(seed: int = 0) -> Recording:
    builder = RecordingBuilder(ROBOT)
    for one in random_ticks(6, seed):
        builder.append(one)
    return builder.finish()


def test_left_and_right_change_places() -> None:
    run = random_run()
    seen = run.mirrored(ROBOT)
    signed = (
        "sent_position",
        "position",
        "reference_position",
        "velocity",
        "acceleration",
        "load_torque",
    )
    for name in signed:
        before, after = getattr(run, name), getattr(seen, name)
        np.testing.assert_array_equal(after[:, LEFT], -before[:, RIGHT])
        np.testing.assert_array_equal(after[:, RIGHT], -before[:, LEFT])
    for name in ("current", "stiffness", "limited"):
        np.testing.assert_array_equal(getattr(seen, name)[:, LEFT], getattr(run, name)[:, RIGHT])
    assert seen.limited.dtype == np.bool_
    for joint, sign in (("HeadYaw", -1), ("HeadPitch", 1), ("HipRoll", -1), ("KneePitch", 1)):
        k = ROBOT.joint_index(joint)
        np.testing.assert_array_equal(seen.position[:, k], sign * run.position[:, k])
        np.testing.assert_array_equal(seen.current[:, k], run.current[:, k])
    hands = [ROBOT.joint_index(name) for name in ("LHand", "RHand")]
    np.testing.assert_array_equal(seen.position[:, hands], run.position[:, hands[::-1]])
    np.testing.assert_array_equal(seen.time, run.time)
    np.testing.assert_array_equal(seen.age, run.age)


def test_the_base_and_its_inertial_unit_are_mirrored() -> None:
    run = random_run()
    seen = run.mirrored(ROBOT)
    np.testing.assert_array_equal(seen.base_twist, run.base_twist * [1, -1, -1])
    np.testing.assert_array_equal(seen.linear_acceleration, run.linear_acceleration * [1, -1, 1])
    np.testing.assert_array_equal(seen.angular_velocity, run.angular_velocity * [-1, 1, -1])
    np.testing.assert_array_equal(seen.attitude, run.attitude * [-1, 1, -1])
    for name in ("wheel_speed", "sent_wheel_speed"):
        twist = getattr(run, name) @ ROBOT.wheels.inverse.T
        mirrored = getattr(seen, name) @ ROBOT.wheels.inverse.T
        np.testing.assert_allclose(mirrored, twist * [1, -1, -1], atol=1e-12)


def test_the_mirror_of_the_mirror_is_the_run() -> None:
    run = random_run()
    again = run.mirrored(ROBOT).mirrored(ROBOT)
    for field in fields(run):
        if field.name != "joint_names":
            np.testing.assert_allclose(
                getattr(again, field.name), getattr(run, field.name), atol=1e-12
            )


def test_load_torque_of_the_mirrored_posture_is_the_mirrored_load_torque() -> None:
    """The signs hold for torques as the model computes them, up to its small asymmetries and the hands' aperture."""
    model = RobotModel(ROBOT)
    rng = np.random.default_rng(3)
    index = [k for k, _ in ROBOT.mirror]
    sign = np.array([s for _, s in ROBOT.mirror])
    for _ in range(3):
        posture = rng.uniform(ROBOT.lower, ROBOT.upper)
        here = model.gravity_torque(posture)
        there = model.gravity_torque(sign * posture[index])
        joints = [k for k, name in enumerate(ROBOT.joint_names) if name not in ROBOT.hands.joints]
        np.testing.assert_allclose(there[joints], (sign * here[index])[joints], atol=0.1)
        assert np.abs(here[joints]).max() > 1.0


def test_another_robot_is_refused() -> None:
    run = random_run()
    other = replace(run, joint_names=tuple(f"Joint{k}" for k in range(JOINTS)))
    with pytest.raises(RecordingError, match="other joints"):
        other.mirrored(ROBOT)
