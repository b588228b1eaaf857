"""Steps as they are played: in time, to the target, and without a trace in the controller."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver import FaultError, Pepper
from pepper_driver.config import ConfigError, UnknownNameError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.task_specs import AnyTask
from pepper_driver.controller import PositionTask, TargetError, Tick, WholeBodyController
from pepper_driver.experiments import goals
from pepper_driver.observer import Observation
from support.experiments import (
    PITCH,
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
from support.scripted import Holder


def test_a_posture_is_reached_in_its_time_along_a_spline() -> None:
    experiment = make_experiment({"duration": 1.2, "joints": {"HeadYaw": 0.6}, "hold": 0.6})
    with make_pepper() as pepper:
        start = pepper.target[YAW]
        trace = Trace(lambda: pepper.controller.position[YAW])
        report = pepper.play(experiment, on_tick=trace)
    assert len(trace.values) == 150
    fraction = (np.array(trace.values) - start) / (0.6 - start)
    # Of minimum jerk: half the way at half the time.
    assert fraction[49] == pytest.approx(0.5, abs=0.02)
    assert fraction[24] == pytest.approx(0.1035, abs=0.02)
    np.testing.assert_allclose(fraction[100:], 1.0, atol=0.01)
    (step,) = report.steps
    assert step.duration == pytest.approx(1.8)
    assert step.reached is None
    (goal,) = step.goals
    assert goal.name == "posture"
    assert goal.commanded.radians == pytest.approx(0.0, abs=1e-3)
    assert goal.commanded.metres is None


def test_joints_and_hands_win_over_the_posture_and_the_rest_stays() -> None:
    first = {"duration": 1.0, "posture": "Crouch", "joints": {"HeadYaw": 0.3, "HeadPitch": 0.4}}
    second = {"duration": 1.0, "hands": {"LHand": 0.9}}
    with make_pepper() as pepper:
        pepper.play(make_experiment(first, second))
        expected = ROBOT.posture("Crouch")
        expected[[YAW, PITCH, ROBOT.joint_index("LHand")]] = 0.3, 0.4, 0.9
        np.testing.assert_array_equal(pepper.target, expected)
        pepper.run(5.0)
        np.testing.assert_allclose(pepper.controller.position, expected, atol=0.01)


def test_a_step_that_cannot_be_reached_gives_up_and_the_next_one_comes() -> None:
    far = REACH | {"target": [2.0, 0.0, 1.0]}
    with make_pepper() as pepper:
        report = pepper.play(
            make_experiment(
                {"until": "reached", "timeout": 1.5, "hold": 0.3, "position": far},
                {"duration": 3.0, "posture": "Stand", "until": "reached", "timeout": 6.0},
            )
        )
    assert [step.reached for step in report.steps] == [False, True]
    assert not report.reached
    assert report.steps[0].duration == pytest.approx(1.8)
    assert report.steps[0].goals[0].commanded.metres == pytest.approx(1.6, abs=0.2)


def test_a_step_that_is_there_does_not_wait_for_its_timeout() -> None:
    step = {"until": "reached", "timeout": 60.0, "joints": {"HeadYaw": 0.3}, "stiffness": 50.0}
    with make_pepper() as pepper:
        report = pepper.play(make_experiment(step))
        assert pepper.controller.position[YAW] == pytest.approx(0.3, abs=0.011)
    assert report.steps[0].duration < 2.0


def test_a_block_that_repeats_plays_all_its_steps_again() -> None:
    experiment = make_experiment(
        {
            "repeat": {
                "times": 3,
                "steps": [
                    {"duration": 0.6, "joints": {"HeadYaw": 0.3}},
                    {"duration": 0.6, "joints": {"HeadYaw": -0.3}},
                ],
            }
        }
    )
    with make_pepper() as pepper:
        trace = Trace(lambda: pepper.controller.position[YAW])
        report = pepper.play(experiment, on_tick=trace)
    assert [step.number for step in report.steps] == [0, 1] * 3
    np.testing.assert_allclose(trace.values[49::50], [0.3, -0.3] * 3, atol=0.02)


def test_an_experiment_that_is_broken_off_leaves_the_robot_where_it_is() -> None:
    with make_pepper() as pepper:
        before = snapshot(pepper)
        ticks = 0

        def interrupt(tick: Tick, observation: Observation | None) -> None:
            nonlocal ticks
            ticks += 1
            if ticks == 90:
                raise KeyboardInterrupt

        down = {"posture": "Crouch", "joints": {"HeadPitch": 0.4}}
        experiment = make_experiment(
            {"duration": 2.0, "position": REACH, "base": {"x": 0.3}, **down},
        )
        with pytest.raises(KeyboardInterrupt):
            pepper.play(experiment, on_tick=interrupt)
        assert snapshot(pepper) == before
        here, base = pepper.controller.position, pepper.controller.base_pose
        speed = pepper.controller.velocity
        assert np.abs(speed).max() > 0.2
        pepper.run(6.0)
        way = pepper.controller.position - here
        # On with what is left of the speed, v / sqrt(5), and neither back nor to the posture that was asked for.
        left = np.delete(way - speed / np.sqrt(5.0), PITCH)  # the head meets a limit on its way
        np.testing.assert_allclose(left, 0.0, atol=0.03)
        assert 0.0 < pepper.controller.base_pose[0] - base[0] < 0.2


def test_a_fault_takes_its_tasks_out_of_the_controller() -> None:
    with make_pepper() as pepper:
        before = snapshot(pepper)
        with pytest.raises(FaultError, match="emergency stop"):
            pepper.play(
                make_experiment({"duration": 1.0, "position": REACH, "base": {"x": 0.1}}),
                on_tick=lambda tick, _: (
                    pepper.emergency_stop() if tick.measurement.tick > 20 else None
                ),
            )
        assert snapshot(pepper) == before


def test_a_target_that_a_task_refuses_leaves_nothing_behind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The experiment is broken off where a task refuses its target; those before it are taken back."""
    other = REACH | {"link": "r_wrist", "joints": ["right_arm"]}
    honest = goals._target

    def target(spec: AnyTask, controller: WholeBodyController) -> FloatArray:
        expected = honest(spec, controller)
        return expected * np.nan if spec.label == "position r_wrist" else expected

    monkeypatch.setattr(goals, "_target", target)
    for experiment in (
        make_experiment({"duration": 0.3, "position": [REACH, other]}),
        make_experiment({"duration": 0.3}, {"hold": 0.3, "position": [REACH, other]}),
    ):
        with make_pepper() as pepper:
            before = snapshot(pepper)
            with pytest.raises(TargetError):
                pepper.play(experiment)
            assert snapshot(pepper) == before
            pepper.run(0.1)


def test_tasks_of_the_user_stay(tmp_path: Path) -> None:
    with make_pepper() as pepper:
        own = PositionTask("r_wrist", root="base_link")
        pepper.controller.add(own)
        pepper.controller.base_velocity.weight = 123.0
        pepper.play(make_experiment({"duration": 0.3, "position": REACH, "base": {"x": 0.0}}))
        assert own in pepper.controller.tasks
        assert len(pepper.controller.tasks) == 3
        assert pepper.controller.base_velocity.weight == 123.0


def test_steps_wait_while_a_reflex_holds_the_robot() -> None:
    pepper = Pepper("mujoco", reflexes=[Holder(1.9, 3.9)])  # the stiffness takes the first second
    moving: list[float] = []
    step = {"duration": 2.0, "position": REACH, "base": {"x": 0.2}, "joints": {"HeadYaw": 0.5}}
    with pepper:

        def note(tick: Tick, observation: Observation | None) -> None:
            if 2.5 < tick.measurement.time < 3.8:
                moving.append(np.abs(pepper.controller.velocity).max())

        start = pepper.time
        report = pepper.play(make_experiment(step), on_tick=note)
        took = pepper.time - start
        np.testing.assert_allclose(wrist(pepper), PLACE, atol=0.005)
        assert pepper.controller.base_pose[0] == pytest.approx(0.2, abs=0.02)
        assert pepper.controller.position[YAW] == pytest.approx(0.5, abs=0.02)
        assert len(pepper.controller.tasks) == 2
    assert len(moving) > 80
    assert max(moving) < 0.05
    assert 3.9 < took < 4.6
    assert len(report.steps) == 1


def test_a_wrong_experiment_moves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(
        "schema: 2\nname: bad\nsteps:\n  - {duration: 1.0, joints: {HeadYaw: 0.5}}\n"
        "  - {duration: 1.0, position: {link: l_wris, target: [0, 0, 0]}}\n"
    )
    with make_pepper() as pepper:
        before = pepper.target
        wrong: list[tuple[Any, type[Exception], str]] = [
            (path, ConfigError, r"bad\.yaml line 5: key 'steps\.1\.position\.link'.*l_wrist"),
            (tmp_path / "gone.yaml", ConfigError, "cannot be read"),
            ("wav", UnknownNameError, "did you mean wave"),
            (make_experiment({"duration": 1.0, "posture": "Sit"}), ConfigError, "unknown posture"),
        ]
        for experiment, error, words in wrong:
            with pytest.raises(error, match=words):
                pepper.play(experiment)
            assert pepper.time == 0.0
            np.testing.assert_array_equal(pepper.target, before)
            assert len(pepper.controller.tasks) == 2


def test_the_report_can_be_read_and_written() -> None:
    with make_pepper() as pepper:
        lines: list[str] = []
        report = pepper.play("reach", on_step=lambda step: lines.append(str(step)))
    assert lines == [str(step) for step in report.steps]
    assert str(report) == f"reach: completed after {report.seconds:.1f} s, 3 steps"
    assert lines[0].startswith("step forward: ")
    assert "position l_gripper off by" in lines[0]
    assert " mm, measured " in lines[0]
    content = json.loads(json.dumps(report.as_json(), allow_nan=False))
    assert content["experiment"] == "reach"
    assert content["completed"] is True
    assert content["steps"][0]["goals"]["position l_gripper"]["commanded"]["m"] < 0.005
