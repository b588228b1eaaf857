"""The oscillation of an attentive robot: its curve, the controller that follows it, limits; off, it changes nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config import UnknownNameError, load_self_collision
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import PostureTask, Reference, WholeBodyController
from pepper_driver.controller.collision import CapsuleDistances
from pepper_driver.controller.dither import Dither
from support.controller import DT, ROBOT, STANDARD

SETTINGS = STANDARD.attentive
AMPLITUDE = np.radians(SETTINGS.amplitude_deg)
RATE = 2.0 * np.pi * SETTINGS.frequency
SWINGING = [ROBOT.joint_index(name) for name in SETTINGS.joints]
STILL = [j for j in range(len(ROBOT.joint_names)) if j not in SWINGING]
FADE = round(SETTINGS.fade_time / DT)
ROLL = ROBOT.joint_index("LShoulderRoll")
ELBOW = ROBOT.joint_index("LElbowRoll")
STAND = ROBOT.posture("Stand")
BENT = STAND.copy()  # all arm joints far from their limits
BENT[[ROBOT.joint_index(n) for n in ("LShoulderPitch", "RShoulderPitch")]] = 0.9
BENT[[ROLL, ROBOT.joint_index("RShoulderRoll")]] = 0.4, -0.4


def make_dither() -> Dither:
    return Dither(ROBOT, SETTINGS, DT)


def make_controller(posture: FloatArray = BENT, *, stiffness: float = 5.0) -> WholeBodyController:
    control = WholeBodyController(ROBOT, STANDARD)
    control.reset(posture)
    control.posture.stiffness = stiffness
    return control


def steps(control: WholeBodyController, seconds: float) -> FloatArray:
    """(ticks, 17) positions."""
    return np.array([control.step().position for _ in range(round(seconds / DT))])


# -- curve ----------------------------------------------------------------------------------------------------------


def test_each_joint_is_a_sine_of_its_own_phase_once_it_has_faded_in() -> None:
    dither = make_dither()
    dither.enabled = True
    positions = np.array([(dither.step(), dither.position)[1] for _ in range(FADE + 1000)])
    cycles = np.arange(1, len(positions) + 1)[FADE:]
    for number, joint in enumerate(SWINGING):
        phase = 2.0 * np.pi * number / len(SWINGING)
        expected = AMPLITUDE * np.sin(RATE * DT * cycles + phase)
        np.testing.assert_allclose(positions[FADE:, joint], expected, atol=1e-12)
    assert (positions[:, STILL] == 0.0).all()
    # No two joints of an arm stand still at a time: half a period is shared evenly among their turning points.
    half = [(2.0 * np.pi * n / len(SWINGING)) % np.pi for n in range(4)]
    np.testing.assert_allclose(np.diff(sorted(half)), np.pi / 4)


def test_shipped_values_are_those_of_the_probe_range() -> None:
    assert 1.5 <= SETTINGS.amplitude_deg <= 2.0
    assert SETTINGS.frequency == 0.4
    assert SETTINGS.fade_time == 2.0
    arms = {*ROBOT.chains["left_arm"], *ROBOT.chains["right_arm"]}
    assert set(SETTINGS.joints) < arms


def test_it_fades_in_and_out_within_the_fade_time() -> None:
    dither = make_dither()
    assert not dither.active
    dither.enabled = True
    rising = np.array([(dither.step(), dither.position)[1] for _ in range(FADE)])
    size = np.abs(rising[:, SWINGING]).max(axis=1)
    assert size[: FADE // 8].max() < 0.02 * AMPLITUDE
    assert size[-20:].max() > 0.9 * AMPLITUDE
    dither.enabled = False
    for _ in range(FADE - 1):
        dither.step()
        assert dither.active
    dither.step()
    dither.step()
    assert not dither.active
    assert (dither.position == 0.0).all()
    assert (dither.velocity == 0.0).all()


def test_velocity_and_acceleration_are_those_of_the_position() -> None:
    dither = make_dither()
    dither.enabled = True
    motions = []
    for cycle in range(2 * FADE + 300):
        if cycle == FADE + 150:
            dither.enabled = False
        motions.append(dither.step())
    position = np.array([m.position for m in motions])
    velocity = np.array([m.velocity for m in motions])
    acceleration = np.array([m.acceleration for m in motions])
    central = (position[2:] - position[:-2]) / (2.0 * DT)
    # A third derivative of A w^3 and of the fading is left out.
    np.testing.assert_allclose(velocity[1:-1], central, atol=2e-4)
    np.testing.assert_allclose(np.diff(velocity, axis=0) / DT, acceleration[:-1], atol=1e-12)
    assert np.abs(acceleration).max() < 0.6


def test_joints_that_are_suspended_stand_still_at_once_and_fade_in_again() -> None:
    dither = make_dither()
    dither.enabled = True
    for _ in range(FADE + 50):
        dither.step()
    mask = np.zeros(len(ROBOT.joint_names), dtype=np.bool_)
    mask[ROLL] = True
    dither.suspend(mask)
    assert (dither.position[ROLL], dither.velocity[ROLL]) == (0.0, 0.0)
    assert dither.position[ELBOW] != 0.0
    motion = dither.step()
    assert motion.position[ROLL] == motion.velocity[ROLL] == motion.acceleration[ROLL] == 0.0
    again = np.array([(dither.step(), dither.position)[1][ROLL] for _ in range(FADE + 250)])
    assert np.abs(again[: FADE // 8]).max() < 0.02 * AMPLITUDE
    assert np.abs(again[FADE:]).max() == pytest.approx(AMPLITUDE, rel=1e-3)


def test_a_joint_that_does_not_exist_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="LElbowRoll"):
        Dither(ROBOT, replace(SETTINGS, joints=["LElbowRol"]), DT)


# -- controller -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("stiffness", [1.0, 5.0, 60.0])
def test_the_controller_follows_it_whatever_its_stiffness(stiffness: float) -> None:
    control = make_controller(stiffness=stiffness)
    control.dither.enabled = True
    for _ in range(FADE + 500):
        reference = control.step()
        np.testing.assert_allclose(
            reference.position - control.dither.position, BENT, atol=np.radians(0.005)
        )
    # What the observer predicts from is the motion with the oscillation, not without.
    np.testing.assert_allclose(reference.velocity, control.dither.velocity, atol=1e-4)
    assert np.abs(reference.velocity[SWINGING]).max() > 0.5 * AMPLITUDE * RATE
    np.testing.assert_array_equal(control.posture.target, BENT)


def test_it_ends_where_it_began_and_changes_nothing_afterwards() -> None:
    control = make_controller()
    control.dither.enabled = True
    steps(control, 7.0)
    control.dither.enabled = False
    steps(control, 4.0)
    assert not control.dither.active
    assert not control.posture.has_reference
    np.testing.assert_allclose(control.position, BENT, atol=1e-4)
    np.testing.assert_allclose(control.velocity, 0.0, atol=1e-4)


def rows_of(reference: Reference) -> list[bytes]:
    return [
        array.tobytes()
        for array in (
            reference.position,
            reference.velocity,
            reference.acceleration,
            reference.load_torque,
        )
    ]


def test_off_it_leaves_every_bit_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: object) -> None:
        raise AssertionError("nothing is computed for an oscillation that is off")

    plain, watched = make_controller(), make_controller()
    with monkeypatch.context() as patch:
        rows = []
        for control in (plain, watched):
            if control is watched:
                patch.setattr(Dither, "step", forbidden)
                patch.setattr(PostureTask, "superpose", forbidden)
            made = []
            for tick in range(200):
                if tick == 20:
                    control.posture.move_to(STAND, 1.0)
                made += rows_of(control.step())
            rows.append(made)
    assert rows[0] == rows[1]


def test_the_same_cycles_give_the_same_bits() -> None:
    made = []
    for _ in range(2):
        control = make_controller()
        control.dither.enabled = True
        made.append(steps(control, 3.0).tobytes())
    assert made[0] == made[1]


def test_a_motion_under_way_is_the_same_with_it_on_top() -> None:
    positions = []
    for enabled in (False, True):
        control = make_controller()
        control.dither.enabled = enabled
        steps(control, 5.0)
        control.posture.move_to({"LShoulderRoll": 0.9, "LElbowYaw": -0.6}, 1.5)
        rows = []
        for _ in range(round(2.5 / DT)):
            control.step()
            rows.append(control.position - control.dither.position)
        positions.append(np.array(rows))
    np.testing.assert_allclose(positions[1], positions[0], atol=np.radians(0.02))


def test_a_posture_is_reached_in_spite_of_it() -> None:
    control = make_controller(stiffness=20.0)
    control.dither.enabled = True
    steps(control, 3.0)
    control.posture.target = STAND
    assert not control.posture.reached(0.002)
    for _ in range(round(4.0 / DT)):
        control.step()
        if control.posture.reached(0.002):
            break
    else:
        pytest.fail("not reached")
    assert np.abs(control.position - control.dither.position - STAND).max() < 0.004


def test_rest_without_it_is_the_place_about_which_the_joints_oscillate() -> None:
    control = make_controller()
    control.dither.enabled = True
    steps(control, 5.3)
    assert np.abs(control.stopping_position(5.0) - BENT).max() > 0.5 * AMPLITUDE
    np.testing.assert_allclose(
        control.stopping_position(5.0, dither=False), BENT, atol=np.radians(0.01)
    )


# -- limits ---------------------------------------------------------------------------------------------------------


def test_at_a_joint_limit_it_stays_inside() -> None:
    posture = BENT.copy()
    posture[ELBOW] = ROBOT.upper[ELBOW]
    posture[ROLL] = ROBOT.lower[ROLL] + 0.01
    control = make_controller(posture)
    control.dither.enabled = True
    rows = steps(control, 8.0)
    margin = STANDARD.position_margin
    assert rows[100:, ELBOW].max() <= ROBOT.upper[ELBOW] - margin + 1e-9
    assert rows[100:, ROLL].min() >= ROBOT.lower[ROLL] + margin - 1e-9
    # The half of the period that leads inside is left.
    assert ROBOT.upper[ELBOW] - rows[200:, ELBOW].min() > 0.9 * AMPLITUDE
    assert control.status.solver == "solved"


def test_speed_and_acceleration_limits_hold_with_the_largest_settings() -> None:
    settings = replace(
        STANDARD,
        attentive=replace(SETTINGS, amplitude_deg=5.0, frequency=2.0, fade_time=0.5),
        velocity_limit=dict.fromkeys(STANDARD.velocity_limit, 0.4),
        acceleration_limit=dict.fromkeys(STANDARD.acceleration_limit, 3.0),
    )
    control = WholeBodyController(ROBOT, settings)
    control.reset(BENT)
    control.dither.enabled = True
    for _ in range(400):
        reference = control.step()
        assert np.abs(reference.velocity).max() <= 0.4 + 1e-9
        assert np.abs(reference.acceleration).max() <= 3.0 + 1e-9
    assert np.abs(reference.velocity).max() > 0.2


def test_it_keeps_the_distance_from_the_robot_itself() -> None:
    """Both arms are led into each other in front of the chest, as far as the constraint lets them."""
    posture = STAND.copy()
    for name, angle in {
        "ShoulderPitch": 0.8,
        "ShoulderRoll": 0.01,
        "ElbowYaw": -0.1,
        "ElbowRoll": -1.4,
    }.items():
        posture[ROBOT.joint_index("L" + name)] = angle
        posture[ROBOT.joint_index("R" + name)] = angle if name == "ShoulderPitch" else -angle
    parts, nearest = load_self_collision(ROBOT), []
    for enabled in (False, True):
        control = make_controller(STAND, stiffness=20.0)
        control.posture.target = posture
        steps(control, 4.0)
        control.dither.enabled = enabled
        capsules = CapsuleDistances(control.model, parts)
        distances = []
        for _ in range(round(6.0 / DT)):
            control.step()
            capsules.place(control.model.q)
            distances.append(float(capsules.distances().min()))
        nearest.append(min(distances))
    assert nearest[0] < 0.012, "the constraint holds nothing back here"
    assert nearest[1] > nearest[0] - 0.001
