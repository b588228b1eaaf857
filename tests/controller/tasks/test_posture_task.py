"""Postures by name, motion as a reference, and what errors of targets and gains carry."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pepper_driver.config import PepperError, UnknownNameError
from pepper_driver.controller import BaseVelocityTask, GainError, PostureTask, TargetError
from support.controller import DT, JOINTS, MIDDLE, ROBOT, controller


def task() -> PostureTask:
    return PostureTask(stiffness=5.0, weight=1.0)


def test_joints_by_name_leave_the_others() -> None:
    posture = task()
    start = MIDDLE + 0.01
    posture.target = start
    posture.target = {"LElbowYaw": 0.3, "HeadYaw": -0.2}
    expected = start.copy()
    expected[ROBOT.joint_index("LElbowYaw")] = 0.3
    expected[ROBOT.joint_index("HeadYaw")] = -0.2
    assert np.array_equal(posture.target, expected)


@pytest.mark.parametrize(
    "wrong",
    [
        {"HeadYaw": 0.1, "LElbowYwa": 0.1},
        {"HeadYaw": 0.1, "HeadPitch": np.nan},
        {"HeadYaw": 0.1, "HeadPitch": 9.0},
        {"HeadYaw": 0.1, "HeadPitch": "up"},
        None,
        "StandInit",
        ["a"] * JOINTS,
        np.array(["a"] * JOINTS),
        [[0.0] * JOINTS, [0.0]],
    ],
)
def test_a_target_that_is_none_is_refused_as_a_whole(wrong: Any) -> None:
    posture = task()
    before = posture.target
    with pytest.raises(PepperError) as caught:
        posture.target = wrong
    assert isinstance(caught.value, ValueError | LookupError)
    assert np.array_equal(posture.target, before)


def test_errors_carry_what_was_wrong() -> None:
    posture = task()
    with pytest.raises(UnknownNameError, match="did you mean LElbowYaw"):
        posture.target = {"LElbowYwa": 0.1}
    joint = ROBOT.joints[ROBOT.joint_index("HeadPitch")]
    with pytest.raises(TargetError) as caught:
        posture.target = {"HeadPitch": 9.0}
    error = caught.value
    assert (error.joint, error.value) == ("HeadPitch", 9.0)
    assert (error.lower, error.upper) == (joint.lower, joint.upper)
    with pytest.raises(TargetError, match="HeadPitch") as caught:
        posture.target = {"HeadPitch": np.nan}
    assert caught.value.joint == "HeadPitch"
    with pytest.raises(GainError) as gain:
        posture.stiffness = -3.0
    assert (gain.value.name, gain.value.value) == ("stiffness", -3.0)


def test_a_moving_reference_is_followed_without_lag() -> None:
    """A sine with its velocity and acceleration as feed-forward; without them it lags by degrees."""
    amplitude, rate = 0.2, 3.0
    lags = {}
    for feed_forward in (True, False):
        control = controller()
        lag = 0.0
        for tick in range(600):
            t = tick * DT
            ramp = min(t / 2.0, 1.0)
            control.posture.target = MIDDLE + ramp * amplitude * np.sin(rate * t)
            if feed_forward and ramp == 1.0:
                control.posture.reference_velocity = np.full(
                    JOINTS, amplitude * rate * np.cos(rate * t)
                )
                control.posture.reference_acceleration = np.full(
                    JOINTS, -amplitude * rate**2 * np.sin(rate * t)
                )
            reference = control.step()
            if t > 5.0:
                expected = MIDDLE + amplitude * np.sin(rate * (t + DT))
                lag = max(lag, float(np.abs(reference.position - expected)[3:].max()))
        lags[feed_forward] = lag
    assert lags[True] < 0.01
    assert lags[False] > 0.05


@pytest.mark.parametrize("name", ["reference_velocity", "reference_acceleration"])
@pytest.mark.parametrize("wrong", [np.full(JOINTS, np.nan), np.zeros(JOINTS - 1), None, "fast"])
def test_a_reference_motion_that_is_none_is_refused(name: str, wrong: Any) -> None:
    posture = task()
    setattr(posture, name, np.full(JOINTS, 0.5))
    with pytest.raises(TargetError):
        setattr(posture, name, wrong)
    assert np.array_equal(getattr(posture, name), np.full(JOINTS, 0.5))
    getattr(posture, name)[:] = 7.0
    assert np.array_equal(getattr(posture, name), np.full(JOINTS, 0.5))


def test_reset_forgets_the_reference_motion() -> None:
    control = controller()
    control.posture.reference_velocity = np.full(JOINTS, 0.5)
    control.posture.reference_acceleration = np.full(JOINTS, 0.5)
    control.reset(MIDDLE)
    assert np.abs(control.step().velocity).max() < 1e-12


@pytest.mark.parametrize("wrong", [["a", 1, 2], None, "x", {"vx": 1.0}])
def test_a_twist_of_the_wrong_kind_is_refused(wrong: Any) -> None:
    base = BaseVelocityTask(stiffness=1.0, weight=1.0)
    with pytest.raises(TargetError):
        base.target = wrong
    assert base.target.tolist() == [0.0, 0.0, 0.0]
