"""Joints held by a reflex: nothing else moves them, neither tasks of the user's, nor motions, nor the base."""

import numpy as np
import pytest

from pepper_driver import Hold, Pepper
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import PositionTask, Tick
from pepper_driver.observer import Observation
from support.experiments import ARM, PLACE, REACH, ROBOT, YAW, Trace, make_experiment, wrist
from support.scripted import Holder, contact, make_pepper

STILL = 0.005
"""[rad/s], [m/s]: at rest. The base may brake by 0.3 m/s2: from 0.1 m/s it is there within half a second."""


class Speeds:
    """The largest joint speed [rad/s] and base speed [m/s, rad/s] after each tick, with its time [s]."""

    def __init__(self, pepper: Pepper) -> None:
        self._pepper = pepper
        self._rows: list[tuple[float, float, float]] = []

    def __call__(self, tick: Tick, observation: Observation | None) -> None:
        model, sent = self._pepper.controller.model, self._pepper.controller.velocity
        base = np.abs(model.v[:3]).max()
        self._rows.append((tick.measurement.time, float(np.abs(sent).max()), float(base)))

    def between(self, begin: float, end: float) -> FloatArray:
        """(2,) largest of the joints and of the base from one time to another [s]."""
        rows = np.array(self._rows)
        inside = (rows[:, 0] >= begin) & (rows[:, 0] < end)
        largest: FloatArray = rows[inside, 1:].max(axis=0)
        return largest


def test_hold_stops_the_users_tasks_and_the_base_and_lets_them_go_on() -> None:
    touch = {2.0: contact(1, "begin"), 4.0: contact(1, "end")}  # let go after the pause, at 4.5 s
    with make_pepper(Hold(release_delay=0.5), touch) as pepper:
        task = PositionTask("l_wrist", root="base_link", joints=ARM)
        task.move_to(PLACE, 4.0)
        pepper.controller.add(task)
        pepper.controller.base_velocity.target = [0.1, 0.0, 0.3]
        speeds = Speeds(pepper)
        pepper.run(2.5, on_tick=speeds)
        here, base = wrist(pepper), pepper.controller.base_pose
        pepper.run(2.0, on_tick=speeds)
        np.testing.assert_allclose(wrist(pepper), here, atol=1e-3)
        np.testing.assert_allclose(pepper.controller.base_pose, base, atol=2e-3)
        assert np.linalg.norm(here - PLACE) > 0.05, "it was stopped on its way"
        assert not task.reached(0.005)
        pepper.run(5.0, on_tick=speeds)
        np.testing.assert_allclose(wrist(pepper), PLACE, atol=0.002)
        assert task.reached(0.005)
        np.testing.assert_allclose(pepper.controller.model.v[:3], [0.1, 0.0, 0.3], atol=5e-3)
    before = speeds.between(1.5, 2.0)
    assert (before > [0.2, 0.15]).all()
    assert (speeds.between(2.5, 4.49) < STILL).all()
    # What it goes on with is behind by what braking took, and no more.
    assert speeds.between(4.5, 6.0)[0] < 2.5 * before[0]


def test_a_held_motion_stops_the_base_too() -> None:
    step = {"duration": 3.0, "base_velocity": {"vx": 0.1}, "position": REACH}
    with make_pepper(Holder(1.5, 3.5)) as pepper:
        speeds = Speeds(pepper)
        report = pepper.play(make_experiment(step), on_tick=speeds)
        np.testing.assert_allclose(wrist(pepper), PLACE, atol=0.005)
        assert pepper.controller.model.v[0] > 0.08, "it rolls on"
    assert speeds.between(1.3, 1.5)[1] > 0.08
    assert (speeds.between(2.0, 3.49) < STILL).all()
    assert report.steps[0].duration == pytest.approx(5.0, abs=0.03), "3 s and 2 s of waiting"


def away(position: FloatArray) -> FloatArray:
    """The head turned aside."""
    position[YAW] -= 0.4
    return position


def test_a_motion_let_go_near_its_end_does_not_hurry() -> None:
    """The reflex turned the head away with a twentieth of a second to go."""
    step = {"duration": 2.0, "joints": {"HeadYaw": 0.5}}
    with make_pepper(Holder(1.95, 3.0, away)) as pepper:
        speeds = Speeds(pepper)
        report = pepper.play(make_experiment(step), on_tick=speeds)
        assert pepper.controller.position[YAW] == pytest.approx(0.5, abs=0.01)
    # Of minimum jerk within a second: 15/8 of the mean speed.
    assert speeds.between(3.0, 9.0)[0] == pytest.approx(0.4 * 15 / 8, rel=0.1)
    assert report.steps[0].duration == pytest.approx(4.0, abs=0.03), "until 3 s, and 1 s again"


def test_the_clock_of_a_held_motion_stands() -> None:
    step = {"duration": 2.0, "joints": {"HeadYaw": 0.5}}
    with make_pepper(Holder(0.5, 6.0)) as pepper:
        yaw = Trace(lambda: pepper.controller.position[YAW])
        report = pepper.play(make_experiment(step, {"duration": 0.6}), on_tick=yaw)
    assert [goal.name for goal in report.steps[0].goals] == ["posture"]
    assert report.steps[0].duration == pytest.approx(7.5, abs=0.03)
    assert report.steps[1].duration == pytest.approx(0.6)
    held = yaw.values[round(1.0 / ROBOT.cycle) : round(5.9 / ROBOT.cycle)]
    assert np.ptp(held) < 1e-3
    assert held[0] < 0.2


def test_a_pause_goes_on_where_it_was() -> None:
    with make_pepper(Holder(0.5, 1.5)) as pepper:
        report = pepper.play(make_experiment({"hold": 1.0, "joints": {"HeadYaw": 0.2}}))
    assert report.steps[0].duration == pytest.approx(2.0, abs=0.03)


def test_a_hold_after_a_way_goes_on_once_the_robot_is_there_again() -> None:
    """It is held for half a second, two seconds into a hold of three, and gets back within one."""
    step = {"duration": 1.0, "hold": 3.0, "joints": {"HeadYaw": 0.2}}
    with make_pepper(Holder(3.0, 3.5, away)) as pepper:
        report = pepper.play(make_experiment(step))
        assert pepper.controller.position[YAW] == pytest.approx(0.2, abs=0.01)
    assert report.steps[0].duration == pytest.approx(1.0 + 3.0 + 0.5 + 1.0, abs=0.03)


def test_what_was_reached_and_led_away_again_is_to_be_reached_again() -> None:
    """It is there after 1.5 s, led away at 2 s, let go at 3 s; there again 1.5 s later, where it is to stay 1.5 s."""
    step = {"until": "reached", "timeout": 8.0, "hold": 1.5, "joints": {"HeadYaw": 0.5}}
    with make_pepper(Holder(2.0, 3.0, away)) as pepper:
        report = pepper.play(make_experiment(step | {"stiffness": 20.0}))
        assert pepper.controller.position[YAW] == pytest.approx(0.5, abs=0.01)
    assert report.reached
    assert report.steps[0].duration == pytest.approx(6.0, abs=0.4)


def test_a_base_that_was_held_keeps_what_the_motion_left_open() -> None:
    """A twist that came to rest off the path: the base is to return to the line it began on."""

    def shove(position: FloatArray) -> FloatArray:
        pepper.controller.override_state(position, [0.0, 0.1, 0.0])
        return position

    step = {"duration": 2.0, "until": "reached", "timeout": 6.0, "base": {"x": 0.3}}
    with make_pepper(Holder(1.0, 2.0, shove)) as pepper:
        aside = Trace(lambda: pepper.controller.base_pose[1])
        assert pepper.play(make_experiment(step)).reached
        assert pepper.controller.base_pose[1] == pytest.approx(0.0, abs=0.011)
        del aside
