"""The tasks of steps: each gets the robot to its target, and ends when it shall."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pepper_driver import Pepper
from pepper_driver.backends import Measurement
from pepper_driver.backends.mock import MockBackend
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Tick
from pepper_driver.experiments.reports import StepReport
from pepper_driver.observer import Observation
from support.experiments import (
    ARM,
    PLACE,
    REACH,
    ROBOT,
    YAW,
    Trace,
    make_experiment,
    snapshot,
    wrist,
)
from support.robots import make_pepper


def test_a_hand_gets_where_it_shall_and_stays_there() -> None:
    with make_pepper() as pepper:
        before = snapshot(pepper)
        step = {"duration": 2.0, "until": "reached", "tolerance": 0.002, "timeout": 4.0}
        report = pepper.play(make_experiment(step | {"position": REACH, "stiffness": 20.0}))
        assert report.reached
        np.testing.assert_allclose(wrist(pepper), PLACE, atol=0.002)
        (goal,) = report.steps[0].goals
        assert goal.name == "position l_wrist"
        assert goal.commanded.metres == pytest.approx(
            np.linalg.norm(wrist(pepper) - PLACE), abs=1e-4
        )
        assert goal.measured.metres == pytest.approx(goal.commanded.metres, abs=1e-3)
        assert snapshot(pepper) == before
        pepper.run(2.0)
        assert pepper.controller.posture.stiffness == 5.0  # as before
        np.testing.assert_allclose(wrist(pepper), PLACE, atol=0.004)


def test_what_is_measured_is_of_the_robot_and_not_of_the_reference() -> None:
    step = {"duration": 2.0, "position": REACH, "joints": {"HeadYaw": 0.3, "HeadPitch": 0.0}}
    with make_pepper() as pepper:
        backend = pepper.backend
        assert isinstance(backend, MockBackend)
        shifted = ROBOT.joint_index("LShoulderRoll")

        def shift(measurement: Measurement) -> Measurement:
            measurement.position[[shifted, YAW]] += 0.05
            return measurement

        backend.faults = dict.fromkeys(range(1000), shift)
        posture, reach = pepper.play(make_experiment(step)).steps[0].goals
    assert posture.commanded.radians == pytest.approx(0.0, abs=1e-3)
    assert posture.measured.radians == pytest.approx(0.05, abs=2e-3)
    assert reach.commanded.metres == pytest.approx(0.0, abs=2e-3)
    assert reach.measured.metres is not None
    assert 0.005 < reach.measured.metres < 0.03  # 0.05 rad at an arm's length of 0.1 to 0.5 m


def test_tasks_end_with_their_step_unless_kept() -> None:
    """Compare the tasks in the controller while each step is played."""
    seen: list[list[str]] = []
    look = {"point": [1.0, 0.0, 1.0]}
    kept = REACH | {"keep": True}
    with make_pepper() as pepper:

        def note(report: StepReport) -> None:
            seen.append([goal.name for goal in report.goals])

        names: list[set[str]] = []

        def during(tick: Tick, observation: Observation | None) -> None:
            names.append({task.name for task in pepper.controller.tasks})

        experiment = make_experiment(
            {"duration": 0.24, "position": kept, "look_at": look},
            {"duration": 0.24},
            {"duration": 0.24, "position": REACH | {"target": [0.2, 0.3, 0.8]}},
            {"duration": 0.24},
        )
        pepper.play(experiment, on_step=note, on_tick=during)
    own = {"posture", "base velocity"}
    assert seen == [["position l_wrist", "look at"], ["position l_wrist"], ["position l_wrist"], []]
    both, one = own | {"position l_wrist", "look at"}, own | {"position l_wrist"}
    assert names == 20 * [both] + 40 * [one] + 20 * [own]


def test_a_later_task_of_a_name_takes_the_place_of_the_kept_one() -> None:
    there = [0.2, 0.3, 0.8]
    with make_pepper() as pepper:
        pepper.play(
            make_experiment(
                {"duration": 1.0, "position": REACH | {"keep": True}},
                {"duration": 1.5, "position": REACH | {"target": there}},
            )
        )
        np.testing.assert_allclose(wrist(pepper), there, atol=0.003)


def test_joints_that_no_task_moved_go_on_when_it_ends() -> None:
    with make_pepper() as pepper:
        pepper.play(make_experiment({"hold": 0.24, "position": REACH, "joints": {"HeadYaw": 0.6}}))
        assert pepper.controller.position[YAW] < 0.3
        pepper.run(5.0)
        assert pepper.controller.position[YAW] == pytest.approx(0.6, abs=0.01)


def test_a_task_has_the_gains_of_its_step() -> None:
    gains: dict[str, tuple[float, float]] = {}
    with make_pepper() as pepper:

        def during(tick: Tick, observation: Observation | None) -> None:
            gains.update({t.name: (t.stiffness, t.weight) for t in pepper.controller.tasks})

        other = REACH | {"link": "r_wrist", "name": "right", "joints": ["right_arm"]}
        pepper.play(
            make_experiment(
                {"hold": 0.06, "position": [REACH | {"stiffness": 7.0, "weight": 33.0}, other]}
            ),
            on_tick=during,
        )
    assert gains["position l_wrist"] == (7.0, 33.0)
    assert gains["right"] == (10.0, 1e4)  # the usual ones


def blocked(measurement: Measurement) -> Measurement:
    return replace(measurement, wheel_speed=np.zeros(3))


def test_the_base_goes_where_it_shall_and_is_held_again() -> None:
    with make_pepper() as pepper:
        assert isinstance(pepper.backend, MockBackend)
        pepper.backend.faults = dict.fromkeys(range(2000), blocked)
        before = snapshot(pepper)
        report = pepper.play(
            make_experiment(
                {"duration": 2.0, "until": "reached", "timeout": 5.0, "base": {"x": 0.2}},
                {"duration": 2.0, "until": "reached", "timeout": 5.0, "base": {"heading": 0.6}},
            )
        )
        assert report.reached
        np.testing.assert_allclose(pepper.controller.base_pose, [0.2, 0.0, 0.6], atol=0.011)
        assert snapshot(pepper) == before
        goal = report.steps[1].goals[0]
        assert goal.name == "base"
        assert goal.commanded.metres is not None
        assert goal.commanded.radians is not None
        # The wheels were blocked.
        assert goal.measured.radians == pytest.approx(0.6, abs=0.02)


def test_nothing_holds_the_base_back_on_its_way() -> None:
    with make_pepper() as pepper:
        trace = Trace(lambda: pepper.controller.base_pose[0])
        pepper.play(make_experiment({"duration": 2.4, "base": {"x": 0.2}}), on_tick=trace)
    assert trace.values[99] == pytest.approx(0.1, abs=0.005)
    assert trace.values[199] == pytest.approx(0.2, abs=0.002)


def test_a_base_velocity_lasts_as_long_as_its_step() -> None:
    speeds: list[FloatArray] = []
    with make_pepper() as pepper:

        def note(tick: Tick, observation: Observation | None) -> None:
            speeds.append(pepper.controller.model.v[:3].copy())

        pepper.play(
            make_experiment(
                {"duration": 4.0, "base_velocity": {"vx": 0.2, "wz": -0.3}}, {"hold": 4.0}
            ),
            on_tick=note,
        )
    np.testing.assert_allclose(speeds[332], [0.2, 0.0, -0.3], atol=5e-3)
    np.testing.assert_allclose(speeds[-1], 0.0, atol=5e-3)


def test_a_base_velocity_ends_a_kept_base() -> None:
    with make_pepper() as pepper:
        pepper.play(
            make_experiment(
                {"duration": 1.0, "base": {"x": 0.0, "keep": True}},
                {"duration": 4.0, "base_velocity": {"vx": 0.1}},
            )
        )
        assert pepper.controller.base_pose[0] > 0.25


def test_a_place_beyond_the_arm_is_reached_with_the_base() -> None:
    reach = {"link": "l_wrist", "target": [0.7, 0.2, 0.85], "joints": ARM}
    step = {"duration": 3.0, "until": "reached", "tolerance": 0.005, "timeout": 6.0}
    with make_pepper() as pepper:
        alone = pepper.play(make_experiment(step | {"position": reach}))
        together = pepper.play(make_experiment(step | {"position": reach | {"base": True}}))
        moved = pepper.controller.base_pose[0]
        pepper.run(1.0)
        assert pepper.controller.base_pose[0] == pytest.approx(moved, abs=0.01)
    assert not alone.reached
    assert together.reached
    assert moved > 0.2


def com(pepper: Pepper) -> FloatArray:
    """(3,) centre of mass in the world."""
    model = pepper.controller.model
    model.update_kinematics()
    return model.com()[0].copy()


def test_the_centre_of_mass_is_moved() -> None:
    with make_pepper() as pepper:
        pepper.play(
            make_experiment({"duration": 2.0, "posture": "Crouch", "joints": {"HeadPitch": 0.4}})
        )
        target = com(pepper) + np.array([0.02, 0.01, 0.01])
        step = {"duration": 2.0, "until": "reached", "timeout": 5.0, "tolerance": 0.002}
        task = {"target": target.tolist(), "root": "base_link"}
        report = pepper.play(make_experiment(step | {"com": task}))
        assert report.reached
        np.testing.assert_allclose(com(pepper), target, atol=0.003)
        assert report.steps[0].goals[0].measured.metres == pytest.approx(0.0, abs=0.005)


def test_poses_and_orientations_are_taken() -> None:
    half = np.sin(0.1), np.cos(0.1)
    legs = {"link": "torso", "joints": ["legs"]}
    with make_pepper() as pepper:

        def torso() -> FloatArray:
            return pepper.controller.model.link_pose("torso", pepper.controller.position)

        height = float(torso()[2, 3])
        tilted = {"quaternion": [0.0, float(half[0]), 0.0, float(half[1])]}
        step = {"duration": 2.5, "until": "reached", "timeout": 6.0, "tolerance": 0.005}
        (turn,) = pepper.play(make_experiment(step | {"orientation": legs | tilted})).steps
        assert turn.reached
        np.testing.assert_allclose(torso()[:3, 0], [np.cos(0.2), 0.0, -np.sin(0.2)], atol=0.01)
        assert turn.goals[0].commanded.metres is None
        upright = {"position": [0.0, 0.0, height], "quaternion": [0.0, 0.0, 0.0, 1.0]}
        (pose,) = pepper.play(make_experiment({"duration": 2.5, "pose": legs | upright})).steps
        np.testing.assert_allclose(torso()[:3, :3], np.eye(3), atol=0.03)
        assert torso()[2, 3] == pytest.approx(height, abs=0.005)
        assert pose.goals[0].commanded.metres is not None
        assert pose.goals[0].commanded.radians is not None


@pytest.mark.parametrize(
    "look", [{"point": [1.0, 0.6, 1.0]}, {"link": "l_wrist"}], ids=["point", "link"]
)
def test_the_head_looks_where_it_shall(look: dict[str, Any]) -> None:
    step = {"duration": 2.0, "until": "reached", "timeout": 8.0, "position": REACH, "look_at": look}
    with make_pepper() as pepper:
        assert pepper.play(make_experiment(step)).reached
        head = pepper.controller.model.link_pose("Head", pepper.controller.position)
        target = np.array(look["point"]) if "point" in look else wrist(pepper)
    way = (target - head[:3, 3]) / np.linalg.norm(target - head[:3, 3])
    assert np.arccos(np.clip(head[:3, 0] @ way, -1.0, 1.0)) < 0.02
