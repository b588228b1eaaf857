"""An attentive robot: what its users see of it, with motions, reflexes, a pause and a fault."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver import Comply, FaultError, FollowHand, Hold, Pepper, Retract, RobotState
from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import load_controller_settings, load_observer_settings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Tick
from pepper_driver.controller.dither import Dither
from pepper_driver.log import read_log
from pepper_driver.observer import ContactObserver, Observation
from pepper_driver.observers import friction_errors
from pepper_driver.replay import compare, load_run, replay
from support.experiments import make_experiment
from support.fusion import STICK_SLIP, fusion_model, fusion_set
from support.reflexes import ARM, ROBOT, ROLL, Stage, touch
from support.robots import make_pepper

AMPLITUDE = np.radians(2.0)
BENT = {
    "LShoulderPitch": 0.9,
    "LShoulderRoll": 0.4,
    "RShoulderPitch": 0.9,
    "RShoulderRoll": -0.4,
}
SWINGING = [j for j in ARM if ROBOT.joint_names[j] not in ("LWristYaw", "LHand")]
HEAD = [ROBOT.joint_index(name) for name in ("HeadYaw", "HeadPitch")]
RIGHT = ROBOT.joint_index("RShoulderRoll")


def trace(
    pepper: Pepper, seconds: float, value: Callable[[], FloatArray] | None = None
) -> FloatArray:
    """(ticks, 17) commanded positions, or another value, after each tick."""
    rows: list[FloatArray] = []
    take = value or (lambda: pepper.controller.position)

    def note(tick: Tick, observation: Observation | None) -> None:
        rows.append(take())

    pepper.run(seconds, on_tick=note)
    return np.array(rows)


def swing(rows: FloatArray, joint: int) -> float:
    """Half of the way between the extremes [rad]."""
    return float(np.ptp(rows[:, joint]) / 2.0)


# -- facade ---------------------------------------------------------------------------------------------------------


def test_a_robot_is_attentive_when_enabled_and_not_before() -> None:
    with make_pepper() as pepper:
        pepper.set_posture(BENT, duration=1.0)
        assert not pepper.attentive
        assert swing(trace(pepper, 3.0)[100:], ROLL) < 1e-3
        pepper.attentive = True
        assert pepper.attentive
        trace(pepper, 2.0)
        rows = trace(pepper, 5.0)
        for joint in SWINGING + HEAD:
            assert swing(rows, joint) == pytest.approx(AMPLITUDE, rel=0.01)
        others = [*ROBOT.chains["legs"], "LWristYaw", "LHand", "RWristYaw", "RHand"]
        for name in others:
            assert swing(rows, ROBOT.joint_index(name)) < 1e-6
        # What the user asked for has not moved, and by FFT the largest part of it is at 0.4 Hz.
        assert pepper.target["LShoulderRoll"] == 0.4
        spectrum = np.abs(np.fft.rfft(rows[:, ROLL] - rows[:, ROLL].mean()))
        frequency = np.fft.rfftfreq(len(rows), ROBOT.cycle)[int(np.argmax(spectrum))]
        assert frequency == pytest.approx(0.4, abs=0.01)


def test_it_fades_out_to_the_target() -> None:
    with make_pepper() as pepper:
        pepper.set_posture(BENT)
        pepper.attentive = True
        pepper.run(7.3)
        pepper.attentive = False
        rows = trace(pepper, 2.1)
        assert swing(rows[:80], ROLL) > 0.2 * AMPLITUDE  # not at once
        pepper.run(2.0)
        np.testing.assert_allclose(pepper.controller.position, pepper.target, atol=1e-3)


def test_before_the_start_it_counts_from_the_first_tick_and_for_the_next_run_too() -> None:
    pepper = make_pepper()
    pepper.attentive = True
    for _ in range(2):
        with pepper:
            pepper.run(3.0)
            assert swing(trace(pepper, 2.5), ROLL) > 0.9 * AMPLITUDE
    pepper.attentive = False
    with pepper:
        assert swing(trace(pepper, 3.0), ROLL) == 0.0


@pytest.mark.parametrize("value", [1, 0, "yes", None, 2.0, np.True_])
def test_what_is_no_truth_value_is_refused(value: Any) -> None:
    pepper = make_pepper()
    with pytest.raises(ValueError, match="attentive is True or False, got"):
        pepper.attentive = value
    assert not pepper.attentive


def test_off_the_ticks_are_bit_for_bit_those_of_a_robot_that_never_was(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def never(*_: object) -> None:
        raise AssertionError("computes")

    monkeypatch.setattr(Dither, "step", never)
    rows = []
    for enabled in (False, True):
        with Pepper("mujoco://?seed=3", observer=None) as pepper:
            if enabled:
                pepper.attentive = False
            pepper.set_posture(BENT, duration=0.5)
            rows.append(trace(pepper, 1.0, lambda: pepper.measurement.position).tobytes())
    assert rows[0] == rows[1]


def test_the_log_says_when_it_was_and_replays_bit_for_bit(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with Pepper("mujoco://?plant=integral&seed=3", log=path) as pepper:
        pepper.set_posture(BENT, duration=1.0)
        pepper.run(1.2)
        pepper.attentive = True
        pepper.attentive = True  # nothing new
        pepper.run(3.0)
        pepper.attentive = False
        pepper.run(1.0)
    log = read_log(path)
    events = [event for event in log.events if event.kind == "attentive"]
    assert [event.phase for event in events] == ["begin", "end"]
    assert events[1].time - events[0].time == pytest.approx(3.0, abs=0.02)
    assert log.metadata["attentive"] == "false"
    reference = log["reference_position"]
    assert np.ptp(reference[-150:, ROLL]) > AMPLITUDE
    assert not log["limited"].any()  # the gate has nothing to say
    run = load_run(path)
    assert compare(run, replay(run, run.observer())).identical


def test_each_joint_swings_by_what_its_models_say() -> None:
    """Friction of 8 mrad, 1.3 times that at rest: half of a swing loses 9.2 mrad."""
    observer = ContactObserver(ROBOT, fusion_set(), load_observer_settings())
    settings = load_controller_settings(ROBOT)
    with Pepper("mock", observer=observer) as pepper:
        expected = 0.0092 + np.radians(settings.attentive.slide_deg)
        assert pepper.controller.dither.amplitude[ROLL] == pytest.approx(expected)
    # A user's own values come first.
    own = settings.with_friction({"LShoulderRoll": 0.001})
    with Pepper("mock", observer=observer, controller=own) as pepper:
        expected = 0.001 + np.radians(settings.attentive.slide_deg)
        assert pepper.controller.dither.amplitude[ROLL] == pytest.approx(expected)
        assert pepper.controller.dither.amplitude[RIGHT] == pytest.approx(AMPLITUDE)


def test_friction_of_models_is_that_of_a_swing_from_motion_to_rest(tmp_path: Path) -> None:
    sluggish = replace(STICK_SLIP, friction=0.01, breakaway=1.5, dead_band=0.002)
    models = fusion_set({"LElbowRoll": fusion_model(sluggish)})
    models.save(tmp_path / "own.json")
    for known in (models, tmp_path / "own.json"):
        assert friction_errors(known) == {"LElbowRoll": pytest.approx(0.0145)}
    assert friction_errors(None) == {}


def test_a_base_that_drives_leaves_the_oscillation_as_it_is() -> None:
    rows = []
    for speed in (0.0, 0.15):
        with make_pepper() as pepper:
            pepper.attentive = True
            pepper.run(3.0)
            pepper.drive(speed, 0.0, 2.0 * speed, hold=True)
            rows.append(trace(pepper, 3.0))
            assert (np.linalg.norm(pepper.controller.base_pose[:2]) > 0.2) == (speed > 0.0)
    # Limits that arms and base share, and balance, change it by little at most.
    np.testing.assert_allclose(rows[1][:, SWINGING + HEAD], rows[0][:, SWINGING + HEAD], atol=1e-3)


# -- motions --------------------------------------------------------------------------------------------------------


def test_a_motion_goes_its_way_and_ends_where_it_would() -> None:
    motion = make_experiment(
        {"joints": BENT, "duration": 1.5, "until": "reached", "tolerance": 0.005, "timeout": 4.0},
        {"joints": {"LElbowRoll": -1.0}, "duration": 1.0, "hold": 0.5},
    )
    ways = []
    for attentive in (False, True):
        with make_pepper() as pepper:
            pepper.attentive = attentive
            pepper.run(2.5)
            rows: list[FloatArray] = []
            report = pepper.play(
                motion,
                on_tick=lambda *_, p=pepper, r=rows: r.append(
                    p.controller.position - p.controller.dither.position
                ),
            )
            assert report.reached
            deviation = report.steps[0].goals[0].commanded.radians
            assert deviation is not None
            assert deviation < 0.005
            ways.append(np.array(rows))
            np.testing.assert_array_equal(
                [pepper.target[name] for name in BENT], list(BENT.values())
            )
    count = min(map(len, ways))
    np.testing.assert_allclose(ways[1][:count], ways[0][:count], atol=0.005)


def test_a_motion_that_is_broken_off_leaves_the_target_without_the_oscillation() -> None:
    with make_pepper() as pepper:
        pepper.attentive = True
        pepper.set_posture(BENT)
        pepper.run(6.1)
        before = pepper.target
        motion = make_experiment({"joints": {"HeadYaw": 0.5}, "duration": 3.0})

        def stop(*_: object) -> None:
            if pepper.time > 7.0:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            pepper.play(motion, on_tick=stop)
        moved = np.abs(pepper.target - before)
        moved[ROBOT.joint_index("HeadYaw")] = 0.0
        assert moved.max() < 0.003


# -- reflexes -------------------------------------------------------------------------------------------------------


def attentive_stage(*reflexes: Any) -> Stage:
    stage = Stage(*reflexes)
    stage.arbiter.attentive = True
    stage.run(4.2)
    return stage


def test_held_the_robot_stands_still_and_is_attentive_again_afterwards() -> None:
    stage = attentive_stage(Hold(release_delay=0.1))
    stage.step(touch())
    rows = stage.run(3.0)
    # It brakes within a few ticks, with no more way than the speed it had, and stands.
    assert np.abs(np.diff(rows[30:], axis=0)).max() < 1e-5
    assert np.abs(rows[-1] - rows[0]).max() < 0.01
    stage.step(touch(phase="end"))
    stage.run(0.2)
    fading = stage.run(3.0)
    late = stage.run(2.5)
    assert swing(late, ROLL) == pytest.approx(AMPLITUDE, rel=0.02)
    assert np.abs(np.diff(fading, axis=0)).max() / ROBOT.cycle < 0.3
    np.testing.assert_allclose(
        (late.max(axis=0) + late.min(axis=0))[SWINGING] / 2.0,
        stage.arbiter.target[SWINGING],
        atol=0.004,
    )


@pytest.mark.parametrize("reflex", [Comply, FollowHand, Retract])
def test_joints_that_a_reflex_has_do_not_oscillate_and_the_others_go_on(reflex: type) -> None:
    stage = attentive_stage(reflex(release_delay=0.1))
    stage.step(touch(joint="LElbowRoll", link="LForeArm"))
    stage.run(0.5)
    rows = stage.run(2.5)
    assert swing(rows, RIGHT) == pytest.approx(AMPLITUDE, rel=0.02)
    for joint in SWINGING:
        assert stage.controller.dither.position[joint] == 0.0
        assert swing(rows[50:], joint) < 1e-3
    stage.step(touch(phase="end"))
    stage.run(4.0)
    late = stage.run(2.5)
    for joint in SWINGING:
        assert swing(late, joint) == pytest.approx(AMPLITUDE, rel=0.02)
    np.testing.assert_allclose(
        (late.max(axis=0) + late.min(axis=0))[SWINGING] / 2.0,
        stage.arbiter.target[SWINGING],
        atol=0.004,
    )


def test_what_stays_where_it_was_led_oscillates_there() -> None:
    stage = attentive_stage(Comply(gain=1.0, release_delay=0.1, then="stay"))
    stage.step(touch(), torque={"LShoulderRoll": 3.0})
    stage.run(0.6, torque={"LShoulderRoll": 3.0})
    stage.step(touch(phase="end"))
    stage.run(4.0)
    target = stage.arbiter.target.copy()
    assert target[ROLL] > ROBOT.posture("Stand")[ROLL] + 0.1
    late = stage.run(2.5)
    assert (late[:, ROLL].max() + late[:, ROLL].min()) / 2 == pytest.approx(target[ROLL], abs=0.004)
    assert swing(late, ROLL) == pytest.approx(AMPLITUDE, rel=0.02)


def test_a_pause_of_the_program_brings_it_to_rest() -> None:
    stage = attentive_stage()
    stage.arbiter.paused = True
    rows = stage.run(2.0)
    assert np.abs(np.diff(rows[30:], axis=0)).max() < 1e-5
    stage.arbiter.paused = False
    stage.run(3.0)
    assert swing(stage.run(2.5), ROLL) == pytest.approx(AMPLITUDE, rel=0.02)


def test_a_fault_ends_it_and_setting_it_then_raises_the_fault() -> None:
    pepper = make_pepper()
    pepper.attentive = True
    pepper.start()
    try:
        pepper.run(5.0)
        pepper.emergency_stop("enough")
        for call in (lambda: pepper.run(1.0), lambda: setattr(pepper, "attentive", False)):
            with pytest.raises(FaultError, match="enough"):
                call()
        assert pepper.state is RobotState.FAULT
        assert isinstance(pepper.backend, MockBackend)
        last, held = (command.position for command in pepper.backend.commands[-2:])
        assert np.abs(held - last).max() < 0.002
    finally:
        pepper.stop()
