"""Parts of motions, as a user meets them: ways in a given time, runs up to an event."""

import numpy as np
import pytest

from pepper_driver.controller import BasePoseTask, TargetError
from support.experiments import YAW
from support.robots import make_pepper


def test_a_posture_can_be_set_with_a_duration() -> None:
    with make_pepper() as pepper:
        start = pepper.target[YAW]
        pepper.set_posture({"HeadYaw": 0.6}, duration=1.2)
        pepper.run(0.6)
        assert pepper.controller.position[YAW] == pytest.approx((start + 0.6) / 2, abs=0.01)
        pepper.run(0.6)
        assert pepper.controller.position[YAW] == pytest.approx(0.6, abs=0.01)
        assert pepper.controller.posture.error[YAW] == pytest.approx(0.0, abs=0.01)


def test_a_posture_set_again_ends_the_motion_to_it() -> None:
    """The same posture without a duration is a set-point from then on, with one it is a new way."""
    with make_pepper() as pepper:
        pepper.set_posture({"HeadYaw": 0.6}, duration=6.0)
        pepper.run(0.6)
        pepper.set_posture({"HeadYaw": 0.6})
        pepper.run(2.5)
        assert pepper.controller.position[YAW] == pytest.approx(0.6, abs=0.03)
        pepper.set_posture({"HeadYaw": 0.0}, duration=6.0)
        pepper.run(0.6)
        pepper.set_posture({"HeadYaw": 0.0}, duration=1.2)
        pepper.run(1.2)
        assert pepper.controller.position[YAW] == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("duration", [0.0, -1.0, float("nan"), float("inf"), 1e9])
def test_a_wrong_duration_changes_nothing(duration: float) -> None:
    with make_pepper() as pepper:
        before = pepper.target
        with pytest.raises(TargetError, match="duration"):
            pepper.set_posture({"HeadYaw": 0.5}, stiffness=9.0, duration=duration)
        np.testing.assert_array_equal(pepper.target, before)
        pepper.run(0.1)
        assert pepper.controller.posture.stiffness == 5.0


def test_a_run_can_end_with_an_event() -> None:
    with make_pepper() as pepper:
        task = BasePoseTask()
        pepper.controller.add(task)
        task.target = [0.1, 0.0, 0.0]
        assert pepper.run(10.0, until=lambda: task.reached(0.005))
        assert 0.5 < pepper.time < 6.0
        assert pepper.controller.base_pose[0] == pytest.approx(0.1, abs=0.005)
        assert not pepper.run(0.12, until=lambda: False)
        assert not pepper.run(0.12)
