"""Mode ``fusion`` over ticks of a joint that another integrator simulates."""

from __future__ import annotations

import math
import warnings
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import Phase, given
from hypothesis import strategies as st

from pepper_driver.config.robot import TRUNK
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.constants import (
    CORRECTION_TIME,
    FRICTION_RATIO,
    HELD_FACTOR,
    MIN_SPREAD,
    PUSH_TICKS,
    REST_SPEED,
    SETTLING_TICKS,
    UNSURE_FACTOR,
)
from pepper_driver.observer.contact_observer import ContactObserver
from pepper_driver.observer.detection.threshold import BREAKAWAY, REST, SLIDING
from pepper_driver.observer.interface import (
    MIN_OBSERVED_STIFFNESS,
    Contact,
    JointState,
    Residuals,
)
from pepper_driver.observer.models.fusion_model import TAPS, MotorTorque
from pepper_driver.observer.residuals.fusion import FusionParts
from pepper_driver.observer.residuals.mobile_base import BaseGenerator
from pepper_driver.observer.residuals.prediction import MAX_LATE_TICKS
from support.examples import examples
from support.fusion import (
    BOUND,
    BY_MODEL,
    ELBOW,
    MODEL,
    NO_JOINT,
    STICK_SLIP,
    Driven,
    Motion,
    check_lives,
    drive,
    fusion_generator,
    fusion_model,
    fusion_observer,
    fusion_set,
    of_elbow,
    play,
    push_profile,
    spread_of,
    standing,
    still_base,
    swing,
    ticks_of,
)
from support.observer import CYCLE, JOINTS, ROBOT, SETTINGS, run, same, spoilt, tick

WINDOW = SETTINGS.fusion_window
STIFFNESS = STICK_SLIP.stiffness
HEAD = ROBOT.joint_index("HeadYaw")
QUIET = round((CORRECTION_TIME + 1.0) / CYCLE)


# -- free motion ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("size", "rate"), [(0.3, 2.0), (0.6, 3.0), (0.1, 0.7)])
def test_nothing_is_detected_in_free_motion(size: float, rate: float) -> None:
    motion = swing(8.0, size, rate, rest=1.0)
    observations, events = run(fusion_observer(), ticks_of(motion, drive(motion)))
    assert events == []
    residual = of_elbow(observations, "residual")
    error = (motion.position - drive(motion).position).std()
    assert residual.std() < 0.2 * error
    assert np.abs(residual).max() < 0.6 * BOUND


def test_expected_error_is_that_of_the_joint() -> None:
    motion = swing(5.0)
    driven = drive(motion)
    observations, _ = run(fusion_observer(), ticks_of(motion, driven))
    error = motion.position - driven.position
    expected = of_elbow(observations, "expected")
    assert np.sqrt(np.mean((expected - error) ** 2)) < 0.1 * error.std()


@pytest.mark.parametrize(
    "parts", [FusionParts(), FusionParts(model=False), FusionParts(current=False)]
)
def test_both_channels_alone_and_together_detect_a_push(parts: FusionParts) -> None:
    motion = swing(6.0)
    push = push_profile(len(motion), 2.0, 0.8, 4.5)
    made = ticks_of(motion, drive(motion, torque=push))
    _, events = run(fusion_observer(parts=parts), made)
    begins = [event for event in events if event.phase == "begin" and event.kind != "rebound"]
    assert [event.link for event in begins] == ["LForeArm"]
    assert 2.0 < begins[0].time < 2.2
    # At the begin this may still be a touch whose torque on the shoulder is larger, and hidden.
    strongest = max(events, key=lambda event: abs(event.torque or 0.0))
    assert (strongest.joint, strongest.direction) == ("LElbowRoll", 1)


# -- torque ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("torque", [4.0, -4.0, 6.0, -6.0])
def test_torque_of_a_push_on_a_joint_at_rest(torque: float) -> None:
    motion = standing(4.0, load=1.0)
    push = push_profile(len(motion), 1.0, 1.5, torque)
    observations, events = run(fusion_observer(), ticks_of(motion, drive(motion, torque=push)))
    assert events[0].direction == math.copysign(1, torque)
    held = slice(round(1.3 / CYCLE), round(2.3 / CYCLE))
    estimate = of_elbow(observations, "torque")[held]
    spread = of_elbow(observations, "torque_std")[held]
    assert (np.sign(estimate) == np.sign(torque)).all()
    # What is not known is on which side friction holds.
    assert np.abs(estimate - torque).max() < 3.0 * spread.min()
    assert spread.max() < 0.5 * abs(torque)
    event = next(e for e in events if e.phase == "update" and e.time > 1.3)
    assert event.torque is not None
    assert abs(event.torque - torque) < 3.0 * spread.min()


@pytest.mark.parametrize("torque", [4.0, -4.0])
def test_torque_of_a_push_on_a_joint_that_moves(torque: float) -> None:
    motion = swing(6.0, rate=1.0)
    push = push_profile(len(motion), 2.0, 1.2, torque)
    observations, _ = run(fusion_observer(), ticks_of(motion, drive(motion, torque=push)))
    held = slice(round(2.3 / CYCLE), round(3.0 / CYCLE))
    estimate = of_elbow(observations, "torque")[held]
    spread = of_elbow(observations, "torque_std")[held]
    assert (np.sign(estimate) == np.sign(torque)).all()
    assert np.sqrt(np.mean((estimate - torque) ** 2)) < 3.0 * spread.mean()


LIMIT = 0.05
"""[rad] Torque / K at which a board gives no more."""


@pytest.mark.parametrize("source", ["current", "voltage"])
@pytest.mark.parametrize("torque", [9.0, -9.0])
def test_torque_is_no_more_than_motor_friction_and_load_oppose(
    torque: float, source: MotorTorque
) -> None:
    """Its board gives 5 N m: a hand of 9 N m moves the joint far from its goal, where K e would be hundreds of N m."""
    motion = standing(4.0, load=1.0)
    push = push_profile(len(motion), 1.0, 1.5, torque)
    made = ticks_of(motion, drive(motion, torque=push, limit=LIMIT))
    momentum = replace(fusion_model().momentum, source=source)
    observations, events = run(fusion_observer(fusion_model(momentum=momentum)), made)
    if source == "voltage":  # else the residual is no larger than the current shows
        assert np.degrees(np.abs(of_elbow(observations, "residual")).max()) > 45.0
    motor = ROBOT.motors.of("LElbowRoll").stall_torque * ROBOT.motors.joints["LElbowRoll"].ratio
    if source == "current":
        motor = LIMIT * STIFFNESS
    friction = STICK_SLIP.breakaway * (STICK_SLIP.friction * STIFFNESS + STICK_SLIP.load_friction)
    bound = motor + friction + math.copysign(1.0, torque)
    # Once the contact has ended, the joint cannot be judged as long as its motor is at its limit.
    largest = np.nanmax(np.abs(of_elbow(observations, "torque")))
    # The current shows the motor at its limit, and not all of the friction that helps it.
    lowest = (0.85 if source == "current" else 0.98) * bound
    assert lowest <= largest <= 1.02 * bound
    reported = [e.torque for e in events if e.torque is not None]
    assert max(map(abs, reported)) <= 1.02 * bound
    assert math.copysign(1.0, torque) * sum(reported) > 0.0


def test_a_current_that_does_not_carry_the_load_is_no_hand() -> None:
    """A joint that rests without current, as real ones do at times."""
    motion = standing(3.0, load=3.0)
    made = ticks_of(motion, drive(motion, start=-0.03))
    for one in made:
        one.measurement.current[:] = 0.0
    for parts in (FusionParts(), FusionParts(current=False)):
        observations, events = run(fusion_observer(parts=parts), made)
        assert events == []
        assert np.abs(of_elbow(observations, "torque")[WINDOW:]).max() < 0.5


def chase(speed: float) -> tuple[Motion, Motion]:
    """A command faster than the board lets its target run [rad/s], and the target."""
    fast = swing(3.0, size=1.0, rate=3.0, rest=1.5)
    target = [0.0]
    for goal in fast.position[1:]:
        step = float(np.clip(goal - target[-1], -speed * CYCLE, speed * CYCLE))
        target.append(target[-1] + step)
    return fast, replace(fast, position=np.array(target))


LIMITED = fusion_model(replace(STICK_SLIP, target_speed=0.8))
"""Of a board that lets its target run no faster [rad/s]."""


@pytest.mark.parametrize("speed", [0.8, 1.2])
@pytest.mark.parametrize("torque", [0.0, 5.0])
def test_a_joint_is_blind_while_its_board_holds_its_target_behind_the_command(
    speed: float, torque: float
) -> None:
    """Also where the target then runs faster than it was measured to, as recorded robots do at times."""
    command, target = chase(speed)
    assert np.abs(command.velocity).max() > 1.2
    behind = np.abs(command.position - chase(0.8)[1].position) > MIN_SPREAD
    caught_up = int(np.flatnonzero(behind)[-1]) + 1
    push = push_profile(len(target), (caught_up + SETTLING_TICKS + 10) * CYCLE, 0.5, torque)
    made = ticks_of(target, drive(target, torque=push))
    for one, position in zip(made, command.position, strict=True):
        one.sent.position[ELBOW] = one.reference.position[ELBOW] = position
    observations, events = run(fusion_observer(LIMITED), made)
    state = np.array([one.state[ELBOW] for one in observations])
    assert (state[behind] == JointState.BLIND).all()
    assert (state[caught_up + WINDOW : caught_up + SETTLING_TICKS] == JointState.FREE).all()
    assert bool(events) == bool(torque)
    # Where the limit is not known, the position alone would show a touch.
    assert run(fusion_observer(parts=FusionParts(current=False)), made)[1]


def fall_behind(joint: str) -> list[Tick]:
    """A standing robot one of whose joints is to be 0.4 rad further off in tick 60."""
    made = [tick(k) for k in range(160)]
    for one in made[60:]:
        one.sent.position[ROBOT.joint_index(joint)] += 0.4
        one.reference.position[ROBOT.joint_index(joint)] += 0.4
        one.measurement.position[ROBOT.joint_index(joint)] += 0.4
    return made


@pytest.mark.parametrize(
    ("joint", "blind"),
    [
        ("LElbowYaw", {"left_arm", TRUNK}),
        ("HeadYaw", {"head", TRUNK}),
        ("HipPitch", {"left_arm", "right_arm", "head", TRUNK}),
    ],
)
def test_joints_that_carry_a_joint_that_falls_behind_are_blind_as_well(
    joint: str, blind: set[str]
) -> None:
    """Their desired load is that of a motion that is not made; a limb on its own is not concerned."""
    seen = run(fusion_observer(LIMITED), fall_behind(joint))[0]
    for limb, names in ROBOT.limbs.items():
        for name in names:
            state = np.array([one.state[ROBOT.joint_index(name)] for one in seen])
            expected = JointState.BLIND if limb in blind else JointState.FREE
            assert set(state[60:70].tolist()) == {expected}, name
            assert set(state[120:].tolist()) == {JointState.FREE}, name


def test_a_base_that_carries_a_joint_that_falls_behind_is_not_judged() -> None:
    base = BaseGenerator(
        still_base(0.1), ROBOT, WINDOW, false_contacts=SETTINGS.false_contacts, adapt=False
    )
    seen = play(fusion_generator(LIMITED, base=base), fall_behind("LElbowYaw"))
    judged = np.isfinite([one.base_residual for one in seen])
    assert judged[50:60].all()
    assert not judged[60 : 60 + TAPS].any()
    assert judged[-10:].all()


def test_a_joint_that_was_blind_needs_more_until_it_is_known_to_rest_in_its_place() -> None:
    motion = standing(4.0)
    made = ticks_of(motion, drive(motion))
    made[100].measurement.position[ELBOW] = np.nan
    observations, events = run(fusion_observer(parts=FusionParts(limbs=False)), made)
    factor = of_elbow(observations, "threshold") / observations[0].threshold[ELBOW]
    begin = 100 + WINDOW
    assert np.isnan(factor[100:begin]).all()
    np.testing.assert_allclose(factor[begin : begin + SETTLING_TICKS], UNSURE_FACTOR)
    np.testing.assert_allclose(factor[begin + SETTLING_TICKS :], 1.0)
    assert events == []


def test_a_joint_that_was_blind_still_knows_that_its_current_has_not_reversed() -> None:
    """It rests off its place, and its motor holds its load only: no touch, though its board would answer as much."""
    motion = standing(4.0, load=-3.0)
    made = ticks_of(motion, drive(motion))
    for one in made[100:]:
        one.measurement.position[ELBOW] -= 0.06
    assert run(fusion_observer(), made)[1] == []
    made[200].sent.stiffness[ELBOW] = 0.5
    assert run(fusion_observer(), made)[1] == []


def test_without_a_push_there_is_little_torque() -> None:
    motion = swing(6.0)
    observations, _ = run(fusion_observer(), ticks_of(motion, drive(motion)))
    assert np.abs(of_elbow(observations, "torque")).max() < 0.6 * BOUND * STIFFNESS


# -- after a push ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("torque", [4.0, -4.0])
def test_a_joint_that_friction_holds_away_from_its_target_is_released(torque: float) -> None:
    """A hand pushes it away and goes; it stays where friction holds it, further off than the threshold."""
    rough = replace(STICK_SLIP, friction=0.025, breakaway=1.2)
    motion = standing(8.0)
    push = push_profile(len(motion), 1.0, 1.0, 2.0 * torque)
    driven = drive(motion, rough, torque=push)
    bound = 0.015
    model = fusion_model(rough, spread=spread_of(bound))
    assert abs(driven.position[-1]) / bound > 1.1
    observations, events = run(fusion_observer(model), ticks_of(motion, driven))
    first = [event for event in events if event.id == 1]
    assert first[-1].phase == "end"
    assert first[-1].time == pytest.approx(2.1, abs=0.3)
    # From then on it is free, where it is.
    after = round(4.0 / CYCLE)
    assert {int(one.state[ELBOW]) for one in observations[after:]} == {JointState.FREE}
    assert np.abs(of_elbow(observations, "residual")[after:]).max() < 0.3 * BOUND
    # Another push is detected as well as the first.
    again = drive(motion, rough, torque=push, start=driven.position[-1])
    more = ticks_of(motion, again)
    shifted = [
        replace(one, measurement=replace(one.measurement, time=one.measurement.time + 8.0))
        for one in more
    ]
    target = fusion_observer(model)
    _, events = run(target, [*ticks_of(motion, driven), *shifted])
    pushes = [e.time for e in events if e.phase == "begin" and e.kind in ("contact", "collision")]
    assert any(9.0 < time < 9.3 for time in pushes)


def test_a_model_is_put_where_its_joint_rests_once_it_does() -> None:
    """A hand lets go; the joint moves for 0.12 s, and stays where friction holds it."""
    motion = standing(2.5)
    position = np.interp(np.arange(len(motion)), [60, 70, 100, 110], [0.0, 0.13, 0.13, 0.05])
    made = ticks_of(motion, Driven(position=position, motor=-position))
    rough = fusion_model(replace(STICK_SLIP, friction=0.06, breakaway=1.2))
    signal, expected = fusion_generator(rough, parts=BY_MODEL), []
    for k, one in enumerate(made):
        seen = signal.step(one)
        expected.append(float(seen.expected[ELBOW]))
        settled = NO_JOINT.copy()
        settled[ELBOW] = k == 103
        signal.learn(NO_JOINT, settled, False)
    np.testing.assert_allclose(expected[:111], 0.0, atol=1e-3)
    np.testing.assert_allclose(expected[103 + SETTLING_TICKS :], -0.05, atol=1e-3)


@pytest.mark.parametrize("torque", [4.0, -4.0])
def test_letting_go_is_no_contact_of_its_own(torque: float) -> None:
    rough = replace(STICK_SLIP, friction=0.03, breakaway=1.2)
    motion = standing(8.0)
    driven = drive(motion, rough, torque=push_profile(len(motion), 1.0, 1.0, 2.5 * torque))
    model = fusion_model(rough, spread=spread_of(0.01))
    _, events = run(fusion_observer(model), ticks_of(motion, driven))
    assert {event.id for event in events} == {1}


def test_a_joint_released_in_motion_is_detected_again() -> None:
    motion = swing(12.0)
    push = sum(
        (
            push_profile(len(motion), at, 0.6, side * 5.0)
            for at, side in ((2.0, 1), (5.0, -1), (8.0, 1))
        ),
        np.zeros(len(motion)),
    )
    observations, events = run(fusion_observer(), ticks_of(motion, drive(motion, torque=push)))
    check_lives(events)
    begins = [event for event in events if event.phase == "begin" and event.kind != "rebound"]
    assert [event.direction for event in begins] == [1, -1, 1]
    np.testing.assert_allclose([event.time for event in begins], [2.1, 5.1, 8.1], atol=0.12)
    ends = [e.time for e in events if e.phase == "end" and e.kind != "rebound"]
    np.testing.assert_allclose(ends, [2.6, 5.6, 8.6], atol=0.25)
    assert np.abs(of_elbow(observations, "residual")[-100:]).max() < 0.5 * BOUND


# -- blindness ------------------------------------------------------------------------------------------------------


BAD = [
    ("measurement", "position", math.nan),
    ("measurement", "position", math.inf),
    ("measurement", "current", math.nan),
    ("sent", "position", math.nan),
    ("sent", "stiffness", MIN_OBSERVED_STIFFNESS - 0.01),
    ("sent", "stiffness", math.nan),
    ("reference", "velocity", math.nan),
    ("reference", "velocity", math.inf),
    ("reference", "acceleration", -math.inf),
    ("reference", "load_torque", math.nan),
    ("reference", "load_torque", math.inf),
]


@pytest.mark.parametrize(
    ("part", "name", "value"),
    BAD,
)
def test_a_bad_tick_makes_its_joint_blind_for_a_window(part: str, name: str, value: float) -> None:
    motion = swing(4.0)
    made = ticks_of(motion, drive(motion))
    bad = 150
    made[bad] = spoilt(made[bad], part, name, value, ELBOW)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        observations, events = run(fusion_observer(), made)
    assert events == []
    for k, one in enumerate(observations):
        blind = bad <= k < bad + WINDOW
        assert (one.state[ELBOW] == JointState.BLIND) == blind
        for values in (one.expected, one.residual, one.threshold, one.torque, one.torque_std):
            assert np.isnan(values[ELBOW]) == blind
            assert np.isfinite(values[HEAD])
        assert one.state[HEAD] == JointState.FREE
    # The model continues from where the joint is.
    after = of_elbow(observations, "residual")[bad + WINDOW :]
    assert np.abs(after).max() < 0.6 * BOUND


@pytest.mark.parametrize("age", [(MAX_LATE_TICKS + 1) * CYCLE, 5.0, math.nan, math.inf])
def test_a_lost_sample_makes_all_joints_blind_for_a_window(age: float) -> None:
    motion = swing(4.0)
    made = ticks_of(motion, drive(motion))
    made[150] = replace(made[150], measurement=replace(made[150].measurement, age=age))
    observations, events = run(fusion_observer(), made)
    assert events == []
    for k, one in enumerate(observations):
        blind = 150 <= k < 150 + WINDOW
        assert (one.state == (JointState.BLIND if blind else JointState.FREE)).all()


@pytest.mark.parametrize("late", range(1, MAX_LATE_TICKS + 1))
def test_late_samples_are_compared_with_what_was_expected_for_their_time(late: int) -> None:
    motion = swing(6.0, 0.5, 3.0)
    driven = drive(motion)
    delays = [late if 100 <= k < 400 and k % 7 < 2 * late else 0 for k in range(len(motion))]
    on_time, _ = run(fusion_observer(), ticks_of(motion, driven))
    observations, events = run(fusion_observer(), ticks_of(motion, driven, late=delays))
    assert events == []
    assert all(one.state[ELBOW] == JointState.FREE for one in observations)
    difference = of_elbow(observations, "residual") - of_elbow(on_time, "residual")
    # Compared with the wrong time, the distance that it moves in between would be the difference.
    assert np.abs(difference).max() < 0.25 * late * CYCLE * np.abs(motion.velocity).max()


def test_a_frozen_link_is_no_contact() -> None:
    """Samples become older, then they are lost, then they come again."""
    motion = swing(6.0, 0.5, 3.0)
    delays = [max(0, min(k - 200, 30)) if k < 230 else 0 for k in range(len(motion))]
    observations, events = run(fusion_observer(), ticks_of(motion, drive(motion), late=delays))
    assert events == []
    states = [JointState(int(one.state[ELBOW])) for one in observations]
    assert set(states[: 200 + MAX_LATE_TICKS + 1]) == {JointState.FREE}
    assert set(states[200 + MAX_LATE_TICKS + 1 : 229 + WINDOW]) == {JointState.BLIND}
    assert set(states[230 + WINDOW :]) == {JointState.FREE}


def test_a_soft_joint_is_blind_and_wakes_without_a_contact() -> None:
    motion = swing(9.0, 0.4, 1.5, gravity=4.0)
    n = len(motion)
    k = np.arange(n)
    stiffness = np.interp(k, [0, 150, 230, 400, 480, n], [1.0, 1.0, 0.2, 0.2, 1.0, 1.0])
    # Softer, it sags under its load and lags.
    driven = drive(motion)
    sag = (1.0 - stiffness) * (0.25 * motion.load + 0.2 * motion.velocity)
    soft = Driven(position=driven.position - sag, motor=driven.motor)
    observations, events = run(fusion_observer(), ticks_of(motion, soft, stiffness=stiffness))
    assert events == []
    states = of_elbow(observations, "state")
    stiff = stiffness >= MIN_OBSERVED_STIFFNESS
    assert (states[~stiff] == JointState.BLIND).all()
    wake = int(np.flatnonzero(~stiff)[-1]) + WINDOW
    assert (states[wake:] == JointState.FREE).all()
    assert np.abs(of_elbow(observations, "residual")[wake:]).max() < 0.6 * BOUND


def test_a_joint_that_was_soft_may_rest_elsewhere_when_it_wakes() -> None:
    """A person has moved it meanwhile, and its friction holds it where it was left."""
    rough = replace(STICK_SLIP, friction=0.03, breakaway=1.2)
    motion = standing(5.0)
    k = np.arange(len(motion))
    soft = (k >= 100) & (k < 200)
    position = np.where(soft, 0.3, np.where(k < 100, 0.0, 0.027))
    driven = Driven(position=position, motor=-position)
    made = ticks_of(motion, driven, stiffness=np.where(soft, 0.2, 1.0))
    observations, events = run(fusion_observer(fusion_model(rough)), made)
    assert events == []
    residual = of_elbow(observations, "residual")
    assert np.isnan(residual[100 : 200 + WINDOW - 1]).all()
    assert np.abs(residual[200 + WINDOW :]).max() < 0.3 * BOUND


def test_a_contact_ends_when_its_joint_goes_blind() -> None:
    motion = standing(5.0)
    made = ticks_of(motion, drive(motion, torque=push_profile(len(motion), 1.0, 3.0, 6.0)))
    made[200] = spoilt(made[200], "measurement", "position", math.nan, ELBOW)
    _, events = run(fusion_observer(), made)
    [end] = [event for event in events if event.id == 1 and event.phase == "end"]
    assert end.time == pytest.approx(200 * CYCLE)
    # The last torque that was known, as of its force.
    assert (end.joint, end.direction) == ("LElbowRoll", 1)
    assert end.torque == pytest.approx(6.0, abs=0.5)


def test_joints_without_a_model_stay_blind() -> None:
    target = ContactObserver(
        ROBOT, fusion_set({"LElbowRoll": MODEL}), replace(SETTINGS, adapt=True)
    )
    motion = swing(3.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        observations, events = run(target, ticks_of(motion, drive(motion)))
    assert events == []
    for one in observations:
        assert np.isfinite(one.residual[ELBOW])
        assert np.isnan(np.delete(one.residual, ELBOW)).all()
        assert (np.delete(one.state, ELBOW) == JointState.BLIND).all()


# -- threshold ------------------------------------------------------------------------------------------------------


def test_a_command_that_the_gate_alters_widens_the_threshold_as_long_as_it_does() -> None:
    motion = swing(4.0)
    made = ticks_of(motion, drive(motion), limited=range(100, 110))
    observations, events = run(fusion_observer(parts=FusionParts(limbs=False)), made)
    assert events == []
    plain, _ = run(fusion_observer(parts=FusionParts(limbs=False)), ticks_of(motion, drive(motion)))
    factor = of_elbow(observations, "threshold") / of_elbow(plain, "threshold")
    np.testing.assert_allclose(factor[100:110], UNSURE_FACTOR)
    np.testing.assert_allclose(np.delete(factor, np.r_[100:110]), 1.0)
    assert all(one.state[ELBOW] == JointState.FREE for one in observations)
    np.testing.assert_allclose([one.threshold[HEAD] for one in observations], BOUND)


def test_the_threshold_is_that_of_the_phase_of_the_motion() -> None:
    spread = (spread_of(0.01)[0], spread_of(0.03)[1], spread_of(0.02)[2])
    motion = swing(4.0, rest=1.0)
    observations, _ = run(
        fusion_observer(fusion_model(spread=spread), parts=FusionParts(limbs=False)),
        ticks_of(motion, drive(motion)),
    )
    # Where it slides: friction holds it for a moment where it is to begin, and where it turns.
    speed = np.abs(np.gradient(drive(motion).position, CYCLE))
    memory = PUSH_TICKS
    recent = np.array([speed[max(0, k + 1 - memory) : k + 1].max() for k in range(len(motion))])
    stood = np.flatnonzero(np.r_[True, speed <= REST_SPEED])  # before, or in this tick
    since = np.array([k + 1 - stood[stood <= k + 1].max() for k in range(len(motion))])
    # It is to move until the end, and its friction may hold it.
    begun = np.maximum.accumulate(np.abs(motion.velocity) > REST_SPEED)
    held = np.where(begun, HELD_FACTOR, 1.0)
    resting, breaking_away = 0.01 * held, 0.03 * held
    expected = np.where(since <= SETTLING_TICKS, breaking_away, 0.02)
    expected = np.where(recent <= REST_SPEED, resting, expected)
    found = of_elbow(observations, "threshold")
    levels = [0.01, 0.01 * HELD_FACTOR, 0.02, 0.03 * HELD_FACTOR]
    np.testing.assert_allclose(np.unique(np.round(found, 12)), levels)
    assert np.mean(np.abs(found - expected) > 1e-9) < 0.04
    np.testing.assert_allclose([one.threshold[HEAD] for one in observations], 0.01)


def test_a_pushed_joint_keeps_its_threshold_while_it_turns() -> None:
    """It is touched while it slides, where its threshold is low; then it turns, and would have to break away."""
    spread = (*spread_of(0.05)[:2], spread_of(0.01)[2])
    model = fusion_model(spread=spread)
    motion = swing(6.0)
    push = push_profile(len(motion), 2.1, 1.3, 5.0)
    free, pushed = (
        run(
            fusion_observer(model, parts=FusionParts(limbs=False)),
            ticks_of(motion, drive(motion, torque=torque)),
        )[0]
        for torque in (0.0, push)
    )
    state = of_elbow(pushed, "state")
    touching = np.flatnonzero(state == JointState.CONTACT)
    within = slice(touching[0], touching[-1] + 1)
    assert (state[within] == JointState.CONTACT).all()
    assert (touching[-1] - touching[0]) * CYCLE > 1.0
    np.testing.assert_allclose(of_elbow(pushed, "threshold")[within], 0.01)
    assert of_elbow(free, "threshold")[within].max() > 0.04


def test_a_joint_with_much_friction_that_swings_slides_later_and_with_a_wider_threshold() -> None:
    """Settling time of 40 ticks, ln(20) 2 J / d; a friction beyond all other thresholds."""
    settling = 40
    lag = 2e-3 * math.log(20.0) / (settling * CYCLE)
    parameters = replace(STICK_SLIP, inertia=1e-3, lag=lag, friction=0.06, breakaway=1.0)
    motion = swing(4.0, size=0.5, rate=1.0)
    generator, phases, thresholds = fusion_generator(fusion_model(parameters)), [], []
    for one in ticks_of(motion, drive(motion, parameters)):
        thresholds.append(generator.step(one).threshold[ELBOW])
        phases.append(int(generator.phase[ELBOW]))
    slides = phases.index(SLIDING)
    assert phases[slides - settling - 1] == REST
    assert set(phases[slides - settling : slides]) == {BREAKAWAY}
    assert thresholds[slides] == pytest.approx(FRICTION_RATIO * parameters.friction)


# -- the whole ------------------------------------------------------------------------------------------------------


def test_after_a_reset_everything_is_as_at_first() -> None:
    motion = swing(5.0)
    push = push_profile(len(motion), 1.0, 0.6, 9.0) + push_profile(len(motion), 3.0, 0.6, -9.0)
    made = ticks_of(motion, drive(motion, torque=push), limited=(40, 300))
    made[200] = spoilt(made[200], "measurement", "position", math.nan, ELBOW)
    target = fusion_observer(adapt=True)
    first, events = run(target, made)
    assert events
    target.reset()
    again, _ = run(target, made)
    fresh, _ = run(fusion_observer(adapt=True), made)
    assert all(map(same, first, again))
    assert all(map(same, first, fresh))


def test_observations_are_not_written_to_later() -> None:
    motion = swing(2.0)
    made = ticks_of(motion, drive(motion, torque=push_profile(len(motion), 1.0, 0.5, 5.0)))
    target = fusion_observer(adapt=True)
    names = ("expected", "residual", "threshold", "torque", "torque_std", "state")
    first = target.step(made[0])
    kept = [getattr(first, name).copy() for name in names]
    run(target, made[1:])
    for name, copy in zip(names, kept, strict=True):
        np.testing.assert_array_equal(getattr(first, name), copy)


def test_residuals_are_not_written_to_later() -> None:
    """Records are written to in every tick, and what is handed out has copies of them."""
    motion = swing(2.0)
    made = ticks_of(motion, drive(motion, torque=push_profile(len(motion), 1.0, 0.5, 5.0)))
    made[20] = spoilt(made[20], "measurement", "position", math.nan, ELBOW)
    signal, kept = fusion_generator(adapt=True), []
    names = [field.name for field in fields(Residuals)]
    for one in made:
        found = signal.step(one)
        kept.append((found, [np.copy(getattr(found, name)) for name in names]))
        signal.learn(~found.blind, NO_JOINT, True)
    for found, copies in kept:
        for name, copy in zip(names, copies, strict=True):
            np.testing.assert_array_equal(getattr(found, name), copy)


def test_ticks_are_only_read() -> None:
    motion = swing(2.0)
    made = ticks_of(motion, drive(motion))
    for one in made:
        for part in (one.measurement, one.reference, one.sent):
            for name in part.__slots__:
                value = getattr(part, name)
                if isinstance(value, np.ndarray):
                    value.flags.writeable = False
        one.limited.flags.writeable = False
    run(fusion_observer(adapt=True), made)


def test_describe_names_mode_models_and_threshold_in_one_line() -> None:
    text = fusion_observer().describe()
    assert "\n" not in text
    # Of limbs and of the trunk, whose tail is long while sliding too.
    for part in ("fusion", "17 joints", "plant-0123", "median of 5", "1.15 to 2.19 deg"):
        assert part in text


# Each example takes a while.
NO_SHRINKING = (Phase.explicit, Phase.reuse, Phase.generate)
PART = st.tuples(
    st.integers(1, 30),
    st.sampled_from([0.0, 0.01, 0.03, -0.03, 0.2, -0.2, math.nan, math.inf]),
    st.sampled_from([0.0, -0.05, 0.3]),
    st.sampled_from([(), (), (ELBOW,), (ELBOW, 0)]),
    st.sampled_from([0.0, 0.0, CYCLE, 3 * CYCLE, 1.0, math.nan]),
    st.sampled_from([1.0, 1.0, 0.3, math.nan]),
    st.sampled_from([0.0, 0.5, -2.0]),
    st.sampled_from([0.0, 5.0]),
)


@examples(25, phases=NO_SHRINKING)
@given(st.lists(PART, max_size=12), st.booleans())
def test_events_make_sense_for_any_ticks(
    parts: list[tuple[int, float, float, tuple[int, ...], float, float, float, float]], adapt: bool
) -> None:
    target = fusion_observer(adapt=adapt)
    events: list[Contact] = []
    k = 0
    rest = (QUIET, 0.0, 0.0, (), 0.0, 1.0, 0.0, 0.0)
    for ticks, outer, trunk, limited, age, stiffness, velocity, current in (*parts, rest):
        error = np.zeros(JOINTS)
        error[ELBOW], error[0] = outer, trunk
        for _ in range(ticks):
            one = tick(k, error, limited=limited, age=age, features=(velocity, 0.0, 0.5))
            one.measurement.current[:] = current
            one.sent.stiffness[ELBOW] = stiffness
            observation = target.step(one)
            k += 1
            blind = observation.state == JointState.BLIND
            for name in ("residual", "threshold", "expected", "torque", "torque_std"):
                values = getattr(observation, name)
                np.testing.assert_array_equal(np.isnan(values), blind)
                assert not np.isinf(values).any()
            events += observation.contacts
    check_lives(events)


def test_motion_is_judged_by_its_own_reference() -> None:
    """Another joint's motion is nothing to the elbow."""
    motion = swing(3.0)
    driven = drive(motion)
    plain, _ = run(fusion_observer(), ticks_of(motion, driven))
    made = ticks_of(motion, driven)
    for k, one in enumerate(made):
        for values in (one.sent.position, one.measurement.position):
            values[HEAD] = 0.2 * math.sin(k / 40)
        one.reference.velocity[HEAD] = 0.2 / 40 / CYCLE * math.cos(k / 40)
    other, _ = run(fusion_observer(), made)
    np.testing.assert_array_equal(of_elbow(plain, "residual"), of_elbow(other, "residual"))
