"""Facts about a robot that identification has measured, as others ask for them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pepper_driver.observer.models.measured_robot import MeasuredJoint
from support.observer import measured

FACTS = measured(
    HeadYaw=MeasuredJoint(speed=2.0),
    LElbowRoll=MeasuredJoint(speed=1.5, speed_limited=True),
    LWristYaw=MeasuredJoint(friction=0.2),
)


def test_only_joints_whose_speed_was_measured_have_one() -> None:
    assert FACTS.speeds == {"HeadYaw": 2.0, "LElbowRoll": 1.5}


def test_only_a_board_that_limits_its_target_has_a_target_speed() -> None:
    assert FACTS.target_speeds == {"LElbowRoll": 1.5}


@pytest.mark.parametrize(("error", "delay"), [(0, 3), (2, 5), (-1, 2), (-4, 0)])
def test_a_response_is_later_than_reported_by_the_error_and_never_comes_before_its_command(
    error: int, delay: int
) -> None:
    assert replace(FACTS, delay_error=error).response_delay == delay
