"""Mistakes of users: refused in one line, by an error of this project, before anything is built."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf, nan
from typing import Any

import numpy as np
import pytest

from pepper_driver.config import ConfigError, PepperError, UnknownNameError
from pepper_driver.controller import (
    ComplianceTask,
    FrameTask,
    LimitError,
    LookAtTask,
    OrientationTask,
    PositionTask,
    PostureTask,
    RobotModel,
    TargetError,
)
from pepper_driver.controller.constraints import (
    AccelerationBox,
    Balance,
    CoupledLimits,
    TorqueLimit,
)
from pepper_driver.controller.tasks.targets import checked_joints
from support.controller import DT, ROBOT, SETTINGS

FRAMES: list[Any] = [PositionTask, OrientationTask, FrameTask]


def test_joints_come_out_as_names() -> None:
    assert checked_joints(ROBOT, None) is None
    assert checked_joints(ROBOT, ["HeadYaw", "LHand"]) == ("HeadYaw", "LHand")
    names: Any = np.array(["HeadYaw"])
    assert checked_joints(ROBOT, names) == ("HeadYaw",)


def of_the_robot(joints: Any) -> object:
    return checked_joints(ROBOT, joints)


@pytest.mark.parametrize("wrong", [[3], 5, [], (), "HeadYaw", [None], ["HeadYaw", 1], True])
@pytest.mark.parametrize("use", [of_the_robot, PostureTask, ComplianceTask])
def test_what_is_no_list_of_joints_is_refused(use: Callable[..., Any], wrong: Any) -> None:
    with pytest.raises(TargetError, match="list of names of joints, one at least") as caught:
        use(wrong)
    assert repr(wrong) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("use", [of_the_robot, PostureTask, ComplianceTask])
def test_an_unknown_joint_is_named(use: Callable[..., Any]) -> None:
    with pytest.raises(UnknownNameError, match=r"HeadYow.*did you mean HeadYaw"):
        use(["LHand", "HeadYow"])


def test_a_compliance_task_is_called_by_its_joints_unless_it_has_a_name() -> None:
    assert ComplianceTask().name == "compliance"
    assert ComplianceTask(["HeadYaw", "LHand"]).name == "compliance HeadYaw, LHand"
    assert ComplianceTask(["HeadYaw"], name="soft").name == "soft"


@pytest.mark.parametrize("task", FRAMES)
def test_a_link_is_not_its_own_root(task: Any) -> None:
    with pytest.raises(TargetError, match="l_wrist cannot be the root of its own target"):
        task("l_wrist", root="l_wrist")
    task("l_wrist", root="r_wrist")


@pytest.mark.parametrize("task", [*FRAMES, LookAtTask, PostureTask, ComplianceTask])
def test_a_robot_in_place_of_a_name_is_refused_in_one_line(task: Any) -> None:
    with pytest.raises(TargetError, match=r"got a RobotConfig$"):
        task(ROBOT)


@pytest.mark.parametrize(("task", "shape"), list(zip(FRAMES, [(3,), (3, 3), (4, 4)], strict=True)))
def test_a_target_that_was_not_set_is_nan_of_its_own_shape(task: Any, shape: Any) -> None:
    target = task("l_wrist").target
    assert target.shape == shape
    assert np.isnan(target).all()


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: TorqueLimit(ROBOT, fraction=-1), "fraction must be .* got -1"),
        (lambda: TorqueLimit(ROBOT, fraction=0), "fraction must be .* got 0"),
        (lambda: TorqueLimit(ROBOT, fraction=nan), "fraction must be .* got nan"),
        (lambda: TorqueLimit(ROBOT, fraction=inf), "fraction must be .* got inf"),
        (lambda: TorqueLimit(ROBOT, fraction=bad("half")), "fraction must be .* got 'half'"),
        (lambda: TorqueLimit(ROBOT, of=bad("foo")), "of must be 'stall' or 'nominal', got 'foo'"),
        (lambda: CoupledLimits(ROBOT, nan), "margin must be .* got nan"),
        (lambda: CoupledLimits(ROBOT, -1), "margin must be .* got -1"),
        (lambda: CoupledLimits(ROBOT, inf), "margin must be .* got inf"),
        (lambda: CoupledLimits(ROBOT, bad(None)), "margin must be .* got None"),
        (lambda: Balance(ROBOT, -1), "margin must be .* got -1"),
        (lambda: Balance(ROBOT, nan), "margin must be .* got nan"),
        (lambda: Balance(ROBOT, bad("wide")), "margin must be .* got 'wide'"),
        (lambda: Balance(ROBOT, 0.1), "margin must be from 0 to 0.0.*got 0.1"),
        (lambda: Balance(ROBOT, 0.03, nan), "moving_margin must be .* got nan"),
        (lambda: Balance(ROBOT, 0.03, bad("x")), "moving_margin must be .* got 'x'"),
    ],
)
def test_a_limit_that_limits_nothing_is_refused(build: Callable[[], object], words: str) -> None:
    with pytest.raises(LimitError, match=words) as caught:
        build()
    assert isinstance(caught.value, PepperError)
    assert isinstance(caught.value, ValueError)


def bad(value: Any) -> Any:
    return value


@pytest.mark.parametrize("key", ["velocity_limit", "acceleration_limit", "jerk_limit"])
def test_a_table_without_a_joint_is_refused_by_name_when_the_box_is_built(key: str) -> None:
    """Tables from files are checked as they are read; these were made in Python."""
    whole = dict.fromkeys(ROBOT.joint_names, 10.0)
    model = RobotModel(ROBOT)
    table: dict[str, Any] = {key: whole}
    AccelerationBox(ROBOT, replace(SETTINGS, **table), model, DT)
    del whole["RElbowYaw"]
    with pytest.raises(ConfigError, match=f"'{key}': no entry for joint RElbowYaw"):
        AccelerationBox(ROBOT, replace(SETTINGS, **table), model, DT)
