"""Two channels that must agree: the smaller residual counts, and none where they contradict each other."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.constants import BIAS_TIME, SETTLING_TICKS, UNSURE_FACTOR
from pepper_driver.observer.contact_observer import ContactObserver
from pepper_driver.observer.interface import Contact, JointState
from pepper_driver.observer.models.fusion_model import MomentumParameters
from pepper_driver.observer.residuals.fusion import FusionGenerator, FusionParts
from support.examples import examples
from support.fusion import (
    BOUND,
    ELBOW,
    MODEL,
    PER_AMPERE,
    STICK_SLIP,
    Motion,
    drive,
    fusion_generator,
    fusion_model,
    fusion_observer,
    fusion_set,
    guided,
    push_profile,
    standing,
    swing,
    ticks_of,
)
from support.observer import CYCLE, JOINTS, ROBOT, SETTINGS, tick

VOLTAGE = MomentumParameters(
    source="voltage", torque_per_ampere=0.0, inertia=STICK_SLIP.inertia, lag=0.02, offset=0.0
)
BY_MODEL, BY_CURRENT = FusionParts(current=False), FusionParts(model=False)
FREE, NONE = np.ones(JOINTS, dtype=np.bool_), np.zeros(JOINTS, dtype=np.bool_)


def residuals(signal: FusionGenerator, ticks: list[Tick]) -> FloatArray:
    """(n, joints), of models that nothing corrects."""
    return np.array([signal.step(one).residual for one in ticks])


def strayed(motion: Motion, offset: FloatArray | float) -> list[Tick]:
    """Ticks of a joint whose board follows another target than the command, off by (n,) [rad]."""
    other = replace(motion, position=motion.position + offset)
    ticks = ticks_of(other, drive(other, start=float(other.position[0])))
    for one, position in zip(ticks, motion.position, strict=True):
        one.sent.position[ELBOW] = one.reference.position[ELBOW] = position
    return ticks


PART = st.tuples(
    st.integers(1, 12),
    st.floats(-0.1, 0.1),
    st.floats(0.0, 2.0),
    st.sampled_from([0.0, 0.3, -1.0]),
    st.sampled_from([0.0, 1.0, -3.0]),
)


@examples(60)
@given(st.lists(PART, min_size=1, max_size=8))
def test_it_is_the_smaller_of_both_and_nothing_where_their_signs_differ(
    parts: list[tuple[int, float, float, float, float]],
) -> None:
    ticks: list[Tick] = []
    for count, error, current, velocity, load in parts:
        for _ in range(count):
            one = tick(len(ticks), error, features=(velocity, 0.0, load))
            one.measurement.current[:] = current * np.linspace(0.1, 1.0, JOINTS)
            ticks.append(one)
    both, model, shown = (
        residuals(fusion_generator(fusion_model(spread=(9.0, 9.0, 9.0)), parts=part), ticks)
        for part in (FusionParts(), BY_MODEL, BY_CURRENT)
    )
    smaller = np.minimum(np.abs(model), np.abs(shown))
    # The product of the smallest numbers is 0.
    expected = np.where(model * shown > 0.0, smaller, 0.0)
    np.testing.assert_allclose(np.abs(both), expected, rtol=0.0, atol=1e-100)
    agree = np.abs(both) > 1e-100
    np.testing.assert_array_equal(np.sign(both[agree]), np.sign(model[agree]))


def test_while_a_hand_holds_the_current_alone_shows_it() -> None:
    """A board that sums errors up takes the joint nearer to its goal under the hand; then the hand lets go."""
    error, ticks = 3.0 * BOUND, []
    for k in range(120):
        one = tick(k, 0.0 if k < 20 else error * max(1.0 - (k - 20) / 40, 0.3))
        one.measurement.current[:] = error / PER_AMPERE if 20 <= k < 90 else 0.0
        ticks.append(one)
    seen = np.abs(residuals(fusion_generator(), ticks)[:, ELBOW])
    assert (seen[25:88] > 1.5 * BOUND).all()
    assert (seen[:20] < 0.1 * BOUND).all()
    assert (seen[95:] < 0.1 * BOUND).all()


def test_the_model_alone_counts_where_the_current_shows_nothing() -> None:
    motion = swing(4.0)
    made = ticks_of(motion, drive(motion, torque=push_profile(len(motion), 1.0, 1.0, 5.0)))
    voltage = fusion_model(momentum=VOLTAGE)
    alone = residuals(fusion_generator(parts=BY_MODEL), made)
    np.testing.assert_array_equal(residuals(fusion_generator(voltage), made), alone)
    for one in made:
        one.measurement.current[:] = 1.7
    np.testing.assert_array_equal(residuals(fusion_generator(voltage), made), alone)
    assert np.abs(alone[:, ELBOW]).max() > BOUND


@pytest.mark.parametrize("torque", [5.0, -5.0])
def test_both_channels_show_what_a_hand_does(torque: float) -> None:
    motion = standing(3.0, load=1.0)
    made = ticks_of(
        motion, drive(motion, torque=push_profile(len(motion), 1.0, 1.5, torque), start=-0.01)
    )
    held = slice(round(1.5 / CYCLE), round(2.3 / CYCLE))
    # Friction holds a part of it; the rest moves the joint against its stiffness.
    most = abs(torque) * STICK_SLIP.load_gain
    least = most - 2.0 * STICK_SLIP.breakaway * STICK_SLIP.friction
    for part in (FusionParts(), BY_MODEL, BY_CURRENT):
        seen = residuals(fusion_generator(parts=part), made)[held, ELBOW]
        assert (np.sign(seen) == -math.copysign(1.0, torque)).all()
        assert least < np.abs(seen).min() <= np.abs(seen).max() < 1.05 * most


@pytest.mark.parametrize("offset", [0.05, -0.05])
def test_a_target_of_the_board_that_is_not_the_command_is_no_touch(offset: float) -> None:
    """The position shows it alone: the motor needs no more torque for it."""
    motion = swing(8.0, rest=1.0)
    time = np.arange(len(motion)) * CYCLE
    made = strayed(motion, np.where((time > 2.0) & (time < 6.0), offset, 0.0))
    strays = (time > 2.5) & (time < 5.9)
    model = residuals(fusion_generator(parts=BY_MODEL), made)[:, ELBOW]
    assert np.abs(model[strays]).min() > 0.6 * abs(offset)
    seen = residuals(fusion_generator(), made)[:, ELBOW]
    assert np.abs(seen[strays]).max() < 0.3 * abs(offset)


def test_a_current_that_nothing_moves_by_is_no_touch() -> None:
    """A board may give some without effect, as warm ones do: the position does not show it."""
    motion = standing(3.0)
    made = ticks_of(motion, drive(motion))
    for one in made[80:160]:
        one.measurement.current[ELBOW] = 0.05 / PER_AMPERE
    assert np.abs(residuals(fusion_generator(parts=BY_CURRENT), made)[:, ELBOW]).max() > 0.03
    assert np.abs(residuals(fusion_generator(), made)[:, ELBOW]).max() < 0.1 * BOUND


# -- bias -------------------------------------------------------------------------------------------------------------

HEAVIER = replace(STICK_SLIP, offset=0.006)


def biased(seconds: float) -> list[Tick]:
    motion = swing(seconds, 0.5, 1.7, gravity=2.5)
    return ticks_of(motion, drive(motion, HEAVIER, steps=20))


def learnt(
    made: list[Tick],
    parts: FusionParts | None = None,
    *,
    adapt: bool = True,
    free: bool = True,
    untouched: bool = True,
) -> FloatArray:
    """Residuals of the elbow."""
    signal = fusion_generator(adapt=adapt, parts=parts or FusionParts())
    joints = FREE.copy()
    joints[ELBOW] = free
    found = []
    for one in made:
        seen = signal.step(one)
        found.append(float(seen.residual[ELBOW]))
        signal.learn(seen, joints, NONE, untouched)
    return np.array(found)


def test_bias_follows_a_load_that_was_not_identified_while_nothing_touches() -> None:
    made = biased(12.0)
    last = slice(round(8.0 / CYCLE), None)
    fixed = learnt(made, FusionParts(bias=False))[last].mean()
    assert fixed > 0.5 * HEAVIER.offset
    assert learnt(made)[last].mean() < 0.7 * fixed
    for kept in (
        learnt(made, adapt=False),
        learnt(made, untouched=False),
        learnt(made, free=False),
    ):
        assert kept[last].mean() == pytest.approx(fixed, rel=0.05)


def test_bias_has_its_time_constant() -> None:
    made = biased(33.0)
    followed, fixed = (
        learnt(made, FusionParts(current=False, bias=bias)) for bias in (True, False)
    )
    for at in (15.0, 30.0):
        around = slice(round((at - 2.0) / CYCLE), round((at + 2.0) / CYCLE))
        left = followed[around].mean() / fixed[around].mean()
        assert left == pytest.approx(math.exp(-at / BIAS_TIME), abs=0.12)


# -- doubt ------------------------------------------------------------------------------------------------------------


def states(target: ContactObserver, ticks: list[Tick]) -> tuple[list[JointState], list[Contact]]:
    """State of the elbow in each tick, and the events."""
    observations = [target.step(one) for one in ticks]
    events = [event for one in observations for event in one.contacts]
    return [JointState(int(one.state[ELBOW])) for one in observations], events


@pytest.mark.parametrize("offset", [0.053, -0.035, 0.03])
def test_a_joint_that_rests_off_its_command_without_current_is_in_doubt(
    offset: float, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    motion = standing(6.0)
    made = ticks_of(motion, drive(motion))
    for one in made[100:]:
        one.measurement.position[ELBOW] -= offset
    seen, events = states(fusion_observer(), made)
    begin = 100 + SETTINGS.fusion_window // 2 + SETTLING_TICKS - 1
    assert set(seen[:begin]) == {JointState.FREE}
    assert set(seen[begin:]) == {JointState.DOUBTFUL}
    assert events == []
    assert caplog.text.count("LElbowRoll is doubtful") == 1


def test_a_joint_in_doubt_is_free_again_when_its_error_is_gone() -> None:
    motion = standing(3.0)
    made = ticks_of(motion, drive(motion))
    for one in made[100:150]:
        one.measurement.position[ELBOW] -= 0.04
    seen, events = states(fusion_observer(), made)
    assert set(seen[130:150]) == {JointState.DOUBTFUL}
    assert set(seen[155:]) == {JointState.FREE}
    assert events == []


def test_a_joint_in_doubt_needs_more_until_its_error_is_gone() -> None:
    """Its friction may have any sign, also when it moves on."""
    first, second = swing(3.0, rest=2.0), swing(4.0, rest=1.0)
    motion = Motion(
        **{
            name: np.concatenate([getattr(first, name), getattr(second, name)])
            for name in ("position", "velocity", "acceleration", "load")
        }
    )
    made, plain = ticks_of(motion, drive(motion)), ticks_of(motion, drive(motion))
    rests, moves = round(3.0 / CYCLE) + 50, len(first) + 50
    for one in made[rests : moves + 100]:
        one.measurement.position[ELBOW] -= 0.04
    target = fusion_observer(parts=FusionParts(limbs=False))
    seen = [target.step(one) for one in made]
    assert all(one.contacts == () for one in seen)
    other = fusion_observer(parts=FusionParts(limbs=False))
    ordinary = np.array([other.step(one).threshold[ELBOW] for one in plain])
    factor = np.array([one.threshold[ELBOW] for one in seen]) / ordinary
    begin = rests + SETTINGS.fusion_window // 2 + SETTLING_TICKS
    np.testing.assert_allclose(factor[:begin], 1.0)
    assert np.abs(motion.velocity[moves : moves + 100]).max() > 0.3
    np.testing.assert_allclose(factor[begin : moves + 100], UNSURE_FACTOR)
    np.testing.assert_allclose(factor[moves + 110 :], 1.0)


def test_nothing_is_learned_from_a_joint_in_doubt() -> None:
    """Its model stays where the joint belongs."""
    motion = standing(8.0)
    made = ticks_of(motion, drive(motion))
    for one in made[100:-50]:
        one.measurement.position[ELBOW] -= 0.04
    target = fusion_observer(adapt=True)
    seen = [target.step(one) for one in made]
    assert {int(one.state[ELBOW]) for one in seen[130:-50]} == {JointState.DOUBTFUL}
    assert abs(seen[-1].expected[ELBOW]) < 0.002


@pytest.mark.parametrize("torque", [5.0, -5.0, 25.0])
@pytest.mark.parametrize("seconds", [0.2, 2.0])
def test_a_joint_that_a_hand_pushes_is_not_in_doubt(torque: float, seconds: float) -> None:
    """Neither at the begin, while the current does not show it yet, nor when the hand lets go."""
    motion = standing(5.0, load=1.0)
    driven = drive(motion, torque=push_profile(len(motion), 1.0, seconds, torque))
    seen, events = states(fusion_observer(), ticks_of(motion, driven))
    assert JointState.DOUBTFUL not in seen
    assert [event.direction for event in events][:1] == [math.copysign(1.0, torque)]


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(("speed", "far"), [(0.3, 0.2), (1.0, 0.6), (3.0, 0.2), (3.0, 0.6)])
def test_a_hand_that_is_stronger_than_the_board_is_found_until_it_has_gone(
    side: float, speed: float, far: float
) -> None:
    """With and against the load: the board gives its 6 N m, far less than its law asks for."""
    motion = standing(6.0, load=1.0)
    driven = guided(motion, side=side, speed=speed, far=far, begin=1.0, seconds=2.0, limit=0.06)
    seen, events = states(fusion_observer(), ticks_of(motion, driven))
    assert JointState.DOUBTFUL not in seen
    lives = [event for event in events if event.phase != "update"]
    assert [event.phase for event in lives] == ["begin", "end"]
    assert lives[0].direction == side
    assert 1.0 < lives[0].time < 1.0 + BOUND / speed + 0.1
    assert lives[1].time == pytest.approx(3.0 + far / speed, abs=0.1)


def test_a_joint_that_moves_is_not_in_doubt() -> None:
    motion = swing(4.0)
    time = np.arange(len(motion)) * CYCLE
    made = strayed(motion, np.where((time > 1.0) & (time < 2.0), 0.05, 0.0))
    assert JointState.DOUBTFUL not in states(fusion_observer(), made)[0][:200]


def test_where_currents_show_nothing_no_joint_is_in_doubt() -> None:
    motion = standing(3.0)
    made = ticks_of(motion, drive(motion))
    for one in made[100:]:
        one.measurement.position[ELBOW] -= 0.053
    seen, events = states(fusion_observer(fusion_model(momentum=VOLTAGE)), made)
    assert JointState.DOUBTFUL not in seen
    assert events


@pytest.mark.parametrize(("spread_deg", "numb"), [(2.9, False), (5.0, True)])
def test_a_joint_whose_threshold_no_touch_reaches_is_always_doubtful(
    spread_deg: float, numb: bool, caplog: pytest.LogCaptureFixture
) -> None:
    wrist = ROBOT.joint_index("LWristYaw")
    loose = fusion_model(spread=(0.001, 0.001, math.radians(spread_deg)))
    models = dict.fromkeys(ROBOT.joint_names, MODEL) | {"LWristYaw": loose}
    target = ContactObserver(ROBOT, fusion_set(models), replace(SETTINGS, adapt=False))
    assert ("LWristYaw detects nothing" in caplog.text) == numb
    events: list[Contact] = []
    for k in range(120):
        errors = np.zeros(JOINTS)
        errors[wrist] = 0.4 if k > 60 else 0.0
        one = tick(k, errors)
        one.measurement.current[:] = np.abs(errors) / PER_AMPERE
        observation = target.step(one)
        events += observation.contacts
        assert (observation.state[wrist] == JointState.DOUBTFUL) == numb
        assert np.isnan(observation.residual[wrist]) == numb
        assert (np.delete(observation.state, wrist) == JointState.FREE).all()
    assert (events == []) == numb


def test_models_of_which_no_joint_shows_a_touch_leave_the_robot_blind() -> None:
    loose = fusion_model(spread=(math.radians(5.0),) * 3)
    target = ContactObserver(ROBOT, fusion_set({"LWristYaw": loose}), SETTINGS)
    assert "blind" in target.describe()
    assert target.step(tick(0)).contacts == ()
