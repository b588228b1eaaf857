"""The oscillation of an attentive robot: its waves, the controller that follows it, limits; off, it changes nothing."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config import UnknownNameError, load_self_collision
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.settings import AttentiveSettings, Wave
from pepper_driver.controller import Reference, WholeBodyController
from pepper_driver.controller.collision import CapsuleDistances
from pepper_driver.controller.dither import CENTRE_RATE, Dither
from pepper_driver.controller.qp import QuadraticProgram
from pepper_driver.controller.tasks import PositionTask
from support.controller import DT, ROBOT, STANDARD

SETTINGS = STANDARD.attentive
AMPLITUDE = np.radians(SETTINGS.amplitude_deg)
SWINGING = [ROBOT.joint_index(name) for name in SETTINGS.joints]
STILL = [j for j in range(len(ROBOT.joint_names)) if j not in SWINGING]
FADE = round(SETTINGS.fade_time / DT)
ROLL = ROBOT.joint_index("LShoulderRoll")
ELBOW = ROBOT.joint_index("LElbowRoll")
STAND = ROBOT.posture("Stand")
BENT = STAND.copy()  # all arm joints far from their limits
BENT[[ROBOT.joint_index(n) for n in ("LShoulderPitch", "RShoulderPitch")]] = 0.9
BENT[[ROLL, ROBOT.joint_index("RShoulderRoll")]] = 0.4, -0.4
FRICTION = dict.fromkeys(SETTINGS.joints, 0.8)  # [deg]
WAVES: tuple[Wave, ...] = ("sine", "triangle", "glide")


def with_friction(wave: Wave = SETTINGS.wave, **changes: object) -> AttentiveSettings:
    return replace(SETTINGS, wave=wave, friction_deg=FRICTION, **changes)  # type: ignore[arg-type]


def make_dither(settings: AttentiveSettings = SETTINGS) -> Dither:
    return Dither(ROBOT, settings, DT)


def make_controller(posture: FloatArray = BENT, *, stiffness: float = 5.0) -> WholeBodyController:
    control = WholeBodyController(ROBOT, STANDARD)
    control.reset(posture)
    control.posture.stiffness = stiffness
    return control


def steps(control: WholeBodyController, seconds: float) -> FloatArray:
    """(ticks, 17) positions."""
    return np.array([control.step().position for _ in range(round(seconds / DT))])


def traced(dither: Dither, cycles: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(cycles, 17) positions and velocities after each cycle, and accelerations of it."""
    position, velocity, acceleration = np.empty((3, cycles, len(ROBOT.joint_names)))
    for cycle in range(cycles):
        acceleration[cycle] = dither.step(BENT).acceleration
        position[cycle], velocity[cycle] = dither.position, dither.velocity
    return position, velocity, acceleration


# -- waves ----------------------------------------------------------------------------------------------------------


def test_a_sine_is_one_of_its_own_phase_once_it_has_faded_in() -> None:
    dither = make_dither(replace(SETTINGS, wave="sine"))
    dither.enabled = True
    positions, _, _ = traced(dither, FADE + 1000)
    cycles = np.arange(1, len(positions) + 1)[FADE:]
    turns = 2.0 * np.pi * DT * cycles / SETTINGS.period
    for joint in SWINGING:
        basis = np.stack([np.sin(turns), np.cos(turns)], axis=1)
        (sine, cosine), residue, *_ = np.linalg.lstsq(basis, positions[FADE:, joint], rcond=None)
        assert np.hypot(sine, cosine) == pytest.approx(AMPLITUDE, rel=1e-5)
        assert residue < 1e-12
    assert (positions[:, STILL] == 0.0).all()


@pytest.mark.parametrize("wave", WAVES)
def test_each_joint_swings_by_its_friction_and_the_slide(wave: Wave) -> None:
    friction = FRICTION | {"LElbowRoll": 0.3, "LShoulderPitch": 4.0}
    settings = replace(SETTINGS, wave=wave, friction_deg=friction)
    dither = make_dither(settings)
    dither.enabled = True
    positions, _, _ = traced(dither, FADE + round(2 * SETTINGS.period / DT))
    late = positions[FADE:]
    for name, joint in zip(SETTINGS.joints, SWINGING, strict=True):
        size = min(friction[name] + SETTINGS.slide_deg, SETTINGS.max_amplitude_deg)
        assert np.degrees(late[:, joint].max()) == pytest.approx(size, rel=2e-3)
        assert np.degrees(late[:, joint].min()) == pytest.approx(-size, rel=2e-3)
    np.testing.assert_array_equal(np.degrees(dither.amplitude[STILL]), 0.0)


@pytest.mark.parametrize("wave", WAVES)
def test_speed_acceleration_and_jerk_are_bounded(wave: Wave) -> None:
    """By closed forms: of a sine, and of minimum-jerk turns between slides of a constant speed."""
    settings = with_friction(wave)
    dither = make_dither(settings)
    dither.enabled = True
    _, velocities, accelerations = (part[FADE + 2 :, ROLL] for part in traced(dither, 3 * FADE))
    jerk = np.diff(accelerations) / DT
    amplitude, turn = dither.amplitude[ROLL], settings.turn_time
    if wave == "sine":
        rate = 2.0 * np.pi / settings.period
        bounds = amplitude * rate ** np.array([1.0, 2.0, 3.0])
    else:
        # Largest slope, curvature and third derivative of minimum jerk: 1.875, 10 / sqrt(3), 60.
        crossed = 2.0 * amplitude * settings.turning("LShoulderRoll")
        slide = (2.0 * amplitude - crossed) / (settings.period / 2.0 - turn)
        bend = 10.0 / np.sqrt(3.0)
        bounds = np.array(
            [
                slide + 1.875 * crossed / turn,
                2.0 * slide * 1.875 / turn + bend * crossed / turn**2,
                2.0 * slide * bend / turn**2 + 60.0 * crossed / turn**3,
            ]
        )
    largest = [np.abs(values).max() for values in (velocities, accelerations, jerk)]
    assert (largest <= bounds * 1.001).all()
    assert (largest >= bounds * 0.6).all()


def stuck_fraction(command: FloatArray, friction: float) -> float:
    """Fraction of time in which a joint that lags by its friction alone (a play operator) stands still."""
    place, still = 0.0, 0
    for target in command.tolist():
        moved = min(max(place, target - friction), target + friction)
        still += moved == place
        place = moved
    return still / len(command)


def test_waves_slide_for_longer_in_their_order() -> None:
    stuck = []
    for wave in WAVES:
        dither = make_dither(with_friction(wave))
        dither.enabled = True
        positions, _, _ = traced(dither, FADE + round(8 * SETTINGS.period / DT))
        stuck.append(stuck_fraction(np.degrees(positions[FADE:, ROLL]), FRICTION["LShoulderRoll"]))
    # Of a sine: arccos(1 - friction / half the swing) / pi, Coulomb friction alone.
    amplitude = FRICTION["LShoulderRoll"] + SETTINGS.slide_deg
    closed_form = np.arccos(1.0 - 2.0 * FRICTION["LShoulderRoll"] / amplitude) / np.pi
    assert stuck[0] == pytest.approx(closed_form, abs=0.02)
    assert stuck[2] < 0.5 * stuck[1] < 0.5 * stuck[0] + 0.02
    # A glide stands still in its turns at most.
    assert stuck[2] < 2.0 * SETTINGS.turn_time / SETTINGS.period


def test_a_glide_of_unknown_friction_is_a_triangle() -> None:
    """Crossing too much in a turn would move the joint in a jump."""
    traces = []
    for wave in ("triangle", "glide"):
        dither = make_dither(replace(SETTINGS, wave=wave))
        dither.enabled = True
        traces.append(traced(dither, 500)[0])
    np.testing.assert_array_equal(traces[0], traces[1])


@pytest.mark.parametrize("wave", WAVES)
def test_joints_of_a_limb_never_turn_together(wave: Wave) -> None:
    dither = make_dither(with_friction(wave))
    dither.enabled = True
    _, velocities, _ = traced(dither, FADE + round(SETTINGS.period / DT))
    turns = {
        joint: np.flatnonzero(np.diff(np.sign(velocities[FADE:, joint]))) * DT for joint in SWINGING
    }
    for limb in ROBOT.limbs.values():
        moving = [j for j in SWINGING if ROBOT.joint_names[j] in limb]
        for one, other in combinations(moving, 2):
            apart = np.abs(turns[one][:, None] - turns[other]).min()
            assert apart > 0.9 * SETTINGS.period / 2.0 / len(moving)


def test_it_fades_in_and_out_within_the_fade_time() -> None:
    dither = make_dither()
    assert not dither.active
    dither.enabled = True
    rising, _, _ = traced(dither, FADE)
    size = np.abs(rising[:, SWINGING]).max(axis=1)
    assert size[: FADE // 8].max() < 0.02 * AMPLITUDE
    assert size[-20:].max() > 0.9 * AMPLITUDE
    assert dither.full[SWINGING].all()
    dither.enabled = False
    for _ in range(FADE - 1):
        dither.step(BENT)
        assert dither.active
    dither.step(BENT)
    dither.step(BENT)
    assert not dither.active
    assert (dither.position == 0.0).all()
    assert (dither.velocity == 0.0).all()


@pytest.mark.parametrize("wave", WAVES)
def test_velocity_and_acceleration_are_those_of_the_position(wave: Wave) -> None:
    dither = make_dither(with_friction(wave))
    dither.enabled = True
    motions = []
    for cycle in range(2 * FADE + 300):
        if cycle == FADE + 150:
            dither.enabled = False
        motions.append(dither.step(BENT))
    position = np.array([m.position for m in motions])
    velocity = np.array([m.velocity for m in motions])
    acceleration = np.array([m.acceleration for m in motions])
    central = (position[2:] - position[:-2]) / (2.0 * DT)
    jerk = np.abs(np.diff(acceleration, axis=0)).max() / DT
    # The third derivative is left out, and what it changes within a cycle.
    np.testing.assert_allclose(velocity[1:-1], central, atol=jerk * DT**2 / 3.0 + 1e-6)
    np.testing.assert_allclose(np.diff(velocity, axis=0) / DT, acceleration[:-1], atol=1e-12)


def test_joints_that_are_suspended_stand_still_at_once_and_fade_in_again() -> None:
    dither = make_dither()
    dither.enabled = True
    traced(dither, FADE + 50)
    mask = np.zeros(len(ROBOT.joint_names), dtype=np.bool_)
    mask[ROLL] = True
    dither.suspend(mask)
    assert (dither.position[ROLL], dither.velocity[ROLL]) == (0.0, 0.0)
    assert dither.position[ELBOW] != 0.0
    motion = dither.step(BENT)
    assert motion.position[ROLL] == motion.velocity[ROLL] == motion.acceleration[ROLL] == 0.0
    again = traced(dither, FADE + 250)[0][:, ROLL]
    assert np.abs(again[: FADE // 8]).max() < 0.02 * AMPLITUDE
    assert np.abs(again[FADE:]).max() == pytest.approx(AMPLITUDE, rel=2e-3)


def test_joints_that_are_withheld_fade_out_without_a_step_and_in_again() -> None:
    dither = make_dither()
    dither.enabled = True
    traced(dither, FADE + 50)
    mask = np.zeros(len(ROBOT.joint_names), dtype=np.bool_)
    mask[ROLL] = True
    dither.withheld = mask
    fading, _, accelerations = traced(dither, FADE + 10)
    assert np.abs(accelerations[:, ROLL]).max() < 1.0
    assert (fading[-5:, ROLL] == 0.0).all()
    assert not dither.full[ROLL]
    assert np.abs(fading[:, ELBOW]).max() > 0.9 * AMPLITUDE
    dither.withheld = np.zeros_like(mask)
    assert np.abs(traced(dither, FADE + 250)[0][FADE:, ROLL]).max() > 0.99 * AMPLITUDE


def test_a_joint_that_does_not_exist_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="LElbowRoll"):
        Dither(ROBOT, replace(SETTINGS, joints=["LElbowRol"]), DT)


def test_turns_that_do_not_fit_into_the_period_are_refused() -> None:
    with pytest.raises(ValueError, match="turn_time"):
        replace(SETTINGS, period=0.6, turn_time=0.3)


@given(
    wave=st.sampled_from(WAVES),
    place=st.floats(-0.2, 0.2),
    upper=st.booleans(),
    friction=st.floats(0.0, 3.0),
)
def test_the_whole_swing_stays_within_the_limits_of_the_joint(
    wave: Wave, place: float, upper: bool, friction: float
) -> None:
    """The centre moves inside, whatever the motion does beyond its swing."""
    margin = 0.005
    dither = Dither(
        ROBOT,
        replace(SETTINGS, wave=wave, friction_deg={"LShoulderRoll": friction}),
        DT,
        margin=margin,
    )
    dither.enabled = True
    motion = BENT.copy()
    limit = ROBOT.upper[ROLL] - margin if upper else ROBOT.lower[ROLL] + margin
    motion[ROLL] = np.clip(limit + place, ROBOT.lower[ROLL] + margin, ROBOT.upper[ROLL] - margin)
    totals = []
    for _ in range(FADE + round((6.0 / CENTRE_RATE + SETTINGS.period) / DT)):
        dither.step(motion)
        totals.append(motion[ROLL] + dither.position[ROLL])
    late = np.array(totals[FADE + round(6.0 / CENTRE_RATE / DT) :])
    rounding = 0.02 * dither.amplitude[ROLL]  # of a centre that is still on its way
    assert late.min() > ROBOT.lower[ROLL] + margin - rounding
    assert late.max() < ROBOT.upper[ROLL] - margin + rounding
    assert np.ptp(late) == pytest.approx(2.0 * dither.amplitude[ROLL], rel=0.02)
    inside = np.clip(
        motion[ROLL],
        ROBOT.lower[ROLL] + margin + dither.amplitude[ROLL],
        ROBOT.upper[ROLL] - margin - dither.amplitude[ROLL],
    )
    assert dither.centre[ROLL] == pytest.approx(inside - motion[ROLL], abs=rounding)


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
    assert np.abs(reference.velocity[SWINGING]).max() > 3.0 * AMPLITUDE / SETTINGS.period
    np.testing.assert_array_equal(control.posture.target, BENT)


def test_it_ends_where_it_began_and_changes_nothing_afterwards() -> None:
    control = make_controller()
    control.dither.enabled = True
    steps(control, 7.0)
    control.dither.enabled = False
    steps(control, 4.0)
    assert not control.dither.active
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
                patch.setattr(QuadraticProgram, "superpose", forbidden)
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


def test_it_rides_on_a_task_that_moves_the_arm() -> None:
    """Joints swing by the whole amplitude about the motion of the task; without it, the hand is where it is to be."""
    ways = []
    for enabled in (False, True):
        control = make_controller()
        hand = PositionTask("l_wrist", root="torso", robot=ROBOT)
        control.add(hand)
        steps(control, 1.0)
        control.dither.enabled = enabled
        steps(control, 3.0)
        hand.move_to(hand.target + np.array([0.03, 0.04, 0.05]), 1.5)
        rows = []
        for _ in range(round(4.0 / DT)):
            control.step()
            rows.append(control.position - control.dither.position)
        ways.append(np.array(rows))
        assert hand.reached(0.002)
    np.testing.assert_allclose(ways[1], ways[0], atol=np.radians(0.1))
    swing = steps(control, SETTINGS.period)
    np.testing.assert_allclose(np.ptp(swing[:, SWINGING], axis=0), 2.0 * AMPLITUDE, rtol=0.01)


# -- limits ---------------------------------------------------------------------------------------------------------


def test_at_a_joint_limit_the_whole_swing_is_inside() -> None:
    posture = BENT.copy()
    posture[ELBOW] = ROBOT.upper[ELBOW]
    posture[ROLL] = ROBOT.lower[ROLL] + 0.01
    control = make_controller(posture)
    control.dither.enabled = True
    rows = steps(control, 10.0)
    margin = STANDARD.position_margin
    assert rows[100:, ELBOW].max() <= ROBOT.upper[ELBOW] - margin + 1e-9
    assert rows[100:, ROLL].min() >= ROBOT.lower[ROLL] + margin - 1e-9
    late = rows[-round(SETTINGS.period / DT) :]
    for joint in (ELBOW, ROLL):
        assert np.ptp(late[:, joint]) == pytest.approx(2.0 * AMPLITUDE, rel=0.03)
    assert ROBOT.upper[ELBOW] - late[:, ELBOW].max() < margin + 0.1 * AMPLITUDE
    assert control.status.solver == "solved"
    np.testing.assert_array_equal(control.posture.target, posture)


def test_speed_and_acceleration_limits_hold_with_the_largest_settings() -> None:
    settings = replace(
        STANDARD,
        attentive=replace(
            SETTINGS, wave="sine", amplitude_deg=5.0, period=0.5, turn_time=0.1, fade_time=0.5
        ),
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
