"""Friction and the scale of torques, found in slow sweeps."""

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config import load_experiment, load_plant
from pepper_driver.config.arrays import FloatArray
from pepper_driver.identification.measurements.friction import (
    GRAVITY,
    HeldWeight,
    measure_dead_band,
    measure_friction,
    measure_torque_scale,
)
from pepper_driver.identification.measurements.held_weight import falling_weight
from pepper_driver.observer import Recording, RecordingBuilder
from pepper_driver.observer.models.measured_robot import MeasuredJoint
from pepper_driver.robot import Pepper
from support.fusion import STICK_SLIP, drive, recording_of, standing, swing
from support.identification import ROBOT
from support.observer import CYCLE, JOINTS, recording

JOINT = "LShoulderRoll"
INDEX = ROBOT.joint_index(JOINT)
CONSTANT = ROBOT.motors.joint_torque_constant(JOINT)


def sweeps(
    friction: float, scale: float, constant: float, *, gravity: float = 2.0, speed: float = 0.15
) -> Recording:
    """A joint that sweeps over a radian twice, and the size of the current that this takes."""
    ticks = round(1.0 / speed / CYCLE)
    up = np.linspace(0.0, 1.0, ticks)
    position = np.concatenate((up, up[::-1], up, up[::-1]))
    velocity = np.gradient(position, CYCLE)
    load = gravity * np.sin(position - 0.3)
    run = recording(np.stack((velocity, np.zeros_like(load), load), axis=1), position)
    torque = friction * np.sign(velocity) + scale * load + constant
    noise = 0.01 * np.random.default_rng(5).standard_normal(len(torque))
    current = np.zeros((len(run), JOINTS))
    current[:, INDEX] = np.abs(np.abs(torque / CONSTANT) + noise)
    return replace(run, current=current)


@pytest.mark.parametrize("friction", [0.1, 0.5, 1.5])
@pytest.mark.parametrize("scale", [0.8, 1.6, 3.0])
@pytest.mark.parametrize("constant", [-0.15, 0.0, 0.3])
def test_friction_and_scale_are_found_though_currents_have_no_sign(
    friction: float, scale: float, constant: float
) -> None:
    found = measure_friction([sweeps(friction, scale, constant)], JOINT, ROBOT)
    assert found is not None
    assert found.friction == pytest.approx(friction, rel=0.1, abs=0.03)
    assert found.load_scale == pytest.approx(scale, rel=0.1)


@pytest.mark.parametrize("gravity", [0.0, 4.0])
@pytest.mark.parametrize("dead_band", [0.0, 0.005, 0.02])
def test_the_error_before_a_joint_moves_is_dead_band_and_friction_over_stiffness(
    dead_band: float, gravity: float
) -> None:
    board = replace(STICK_SLIP, dead_band=dead_band, load_friction=0.0)
    motion = swing(14.0, size=0.6, rate=0.35, gravity=gravity, shape=0.0)
    found = measure_dead_band([recording_of(motion, drive(motion, board))], "LElbowRoll", ROBOT)
    # Under a load the torque stays on one side of the dead band: then it does not show.
    shown = dead_band if gravity == 0.0 else 0.0
    # The joint crosses a wide dead band slowly.
    assert found == pytest.approx(shown + board.friction, rel=0.15)


def test_a_joint_that_stands_shows_no_dead_band() -> None:
    motion = standing(5.0)
    run = recording_of(motion, drive(motion))
    assert measure_dead_band([run], "LElbowRoll", ROBOT) is None


def test_a_load_that_hardly_changes_gives_no_scale() -> None:
    found = measure_friction([sweeps(0.5, 1.0, 0.0, gravity=0.1)], JOINT, ROBOT)
    assert found is not None
    assert found.load_scale is None
    assert found.friction == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("noise", [0.004, 0.012])
def test_a_friction_whose_current_is_less_than_a_step_of_its_sensor_is_found(noise: float) -> None:
    """More than half of the size of such a current is noise."""
    friction, scale, wrist = 0.006, 1.5, ROBOT.joint_index("LWristYaw")
    constant, step = ROBOT.motors.joint_torque_constant("LWristYaw"), ROBOT.sensors.current.step
    run = sweeps(0.0, 0.0, 0.0, gravity=0.004)
    torque = friction * np.sign(run.velocity[:, wrist]) + scale * run.load_torque[:, wrist]
    drawn = noise * np.random.default_rng(6).standard_normal(len(run))
    current = run.current.copy()
    current[:, wrist] = np.rint(np.abs(torque / constant + drawn) / step) * step
    found = measure_friction([replace(run, current=current)], "LWristYaw", ROBOT)
    assert found is not None
    assert found.friction == pytest.approx(friction, rel=0.25)
    assert found.load_scale is None


def test_a_current_that_is_noise_alone_shows_no_friction() -> None:
    run, wrist = sweeps(0.0, 0.0, 0.0, gravity=0.004), ROBOT.joint_index("LWristYaw")
    step = ROBOT.sensors.current.step
    current = run.current.copy()
    drawn = 0.01 * np.random.default_rng(7).standard_normal(len(run))
    current[:, wrist] = np.rint(np.abs(drawn) / step) * step
    assert measure_friction([replace(run, current=current)], "LWristYaw", ROBOT) is None


@pytest.mark.parametrize("speed", [0.02, 0.8])
def test_a_motion_that_is_too_slow_or_too_fast_gives_no_result(speed: float) -> None:
    assert measure_friction([sweeps(0.5, 1.0, 0.0, speed=speed)], JOINT, ROBOT) is None


def test_samples_that_the_gate_altered_do_not_count() -> None:
    run = sweeps(0.5, 1.5, 0.0)
    spoiled = run.current.copy()
    spoiled[: len(run) // 4] = 9.0
    limited = np.zeros(run.limited.shape, dtype=np.bool_)
    limited[: len(run) // 4] = True
    found = measure_friction([replace(run, current=spoiled, limited=limited)], JOINT, ROBOT)
    assert found is not None
    assert found.friction == pytest.approx(0.5, rel=0.1)


def slow_sweeps(plant: str, weight: HeldWeight | None = None) -> Recording:
    """Have a simulated robot sweep slowly, with or without a weight that hangs from its hand."""
    builder = RecordingBuilder(ROBOT)
    pepper = Pepper(f"mujoco://?plant={plant}", observer=None, robot=ROBOT)
    with pepper:
        if weight is not None:
            force = (0.0, 0.0, -weight.mass * GRAVITY)
            pepper.backend.push(weight.link, force, weight.xyz, duration=100.0, rise=0.5)
        pepper.play(
            load_experiment("measure_friction", ROBOT),
            on_tick=lambda tick, _: builder.append(tick),
        )
    return builder.finish()


@pytest.mark.parametrize("plant", ["integral", "recorded"])
def test_a_simulated_robot_has_the_friction_and_the_gears_that_are_measured(plant: str) -> None:
    config = load_plant(plant, ROBOT)
    run = slow_sweeps(plant)
    assert not run.limited.any()
    for joint in ("HeadPitch", "LShoulderPitch", "RShoulderRoll", "LElbowYaw", "RElbowRoll"):
        drive = config.actuator(joint)
        true = drive.friction.contact.motor + drive.friction.contact.link
        found = measure_friction([run], joint, ROBOT)
        assert found is not None
        assert found.load_scale == pytest.approx(1.0 / drive.efficiency, rel=0.15)
        assert found.friction * drive.efficiency == pytest.approx(true, rel=0.3)
    weight = HeldWeight(mass=0.5, link="l_wrist", xyz=(0.07, 0.0, 0.0))
    loaded = slow_sweeps(plant, weight)
    for joint in ("LShoulderPitch", "LShoulderRoll", "LElbowYaw", "LElbowRoll"):
        scale = measure_torque_scale([run], [loaded], joint, weight, ROBOT)
        assert scale == pytest.approx(1.0 / config.actuator(joint).efficiency, rel=0.1)
    # The weight does not hang from the other arm, and hardly turns the wrist.
    for joint in ("RShoulderPitch", "LWristYaw"):
        assert measure_torque_scale([run], [loaded], joint, weight, ROBOT) is None


@pytest.mark.whole
def test_a_weight_that_falls_or_comes_late_is_noticed() -> None:
    weight = HeldWeight(mass=0.5, link="l_wrist", xyz=(0.07, 0.0, 0.0))
    empty, loaded = slow_sweeps("recorded"), slow_sweeps("recorded", weight)
    middle = len(loaded) // 2

    def judged(current: FloatArray) -> str | None:
        run, joints = replace(loaded, current=current), {}
        for joint in ("LShoulderPitch", "LShoulderRoll", "LElbowYaw", "LElbowRoll"):
            own = measure_friction([empty], joint, ROBOT)
            assert own is not None
            joints[joint] = MeasuredJoint(
                encoder_noise=0.0,
                current_noise=0.0,
                load_scale=own.load_scale,
                torque_scale=measure_torque_scale([empty], [run], joint, weight, ROBOT),
            )
        return falling_weight(joints, run, weight, ROBOT)

    assert judged(loaded.current) is None
    # Both runs are the same motion: from the fall on, the currents are those of an empty hand.
    n = min(len(empty), len(loaded))
    fell, late = loaded.current.copy(), loaded.current.copy()
    fell[middle:n] = empty.current[middle:n]
    late[:middle] = empty.current[:middle]
    assert "it fell meanwhile" in str(judged(fell))
    assert "hung in too late" in str(judged(late))
    assert "was not in the hand" in str(judged(empty.current[: len(loaded)]))
