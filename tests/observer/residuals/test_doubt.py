"""Joints that rest off their command with no current are in doubt; joints that a hand pushes are not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.contact_observer import ContactObserver
from pepper_driver.observer.interface import Contact, JointState
from pepper_driver.observer.models.fusion_model import FusionModel, MomentumParameters
from pepper_driver.observer.models.stick_slip import StickSlipParameters
from pepper_driver.observer.residuals.doubt import LINGER_TICKS
from support.examples import examples
from support.fusion import (
    ELBOW,
    MODEL,
    PER_AMPERE,
    STICK_SLIP,
    Motion,
    constant_tree,
    drive,
    fusion_model,
    fusion_observer,
    fusion_set,
    push_profile,
    standing,
    swing,
    ticks_of,
)
from support.observer import CYCLE, JOINTS, ROBOT, SETTINGS, tick

VOLTAGE = MomentumParameters(
    source="voltage", torque_per_ampere=0.0, inertia=STICK_SLIP.inertia, lag=0.02, offset=0.0
)


def states(target: ContactObserver, ticks: list[Tick]) -> tuple[list[JointState], list[Contact]]:
    """State of the elbow in each tick, and the events."""
    observations = [target.step(one) for one in ticks]
    events = [event for one in observations for event in one.contacts]
    return [JointState(int(one.state[ELBOW])) for one in observations], events


def strayed(motion: Motion, offset: FloatArray, per_ampere: float = PER_AMPERE) -> list[Tick]:
    """Ticks of a joint whose board follows another target than the command, off by (n,) [rad]."""
    other = replace(motion, position=motion.position + offset)
    ticks = ticks_of(other, drive(other, start=float(other.position[0])))
    for one, position in zip(ticks, motion.position, strict=True):
        one.sent.position[ELBOW] = one.reference.position[ELBOW] = position
    return ticks


@pytest.mark.parametrize("offset", [0.053, -0.035, 0.03])
def test_a_joint_that_rests_off_its_command_without_current_is_in_doubt(
    offset: float, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    motion = standing(6.0)
    seen, events = states(fusion_observer(), strayed(motion, np.full(len(motion), offset)))
    assert set(seen[10:]) == {JointState.DOUBTFUL}
    assert events == []
    assert caplog.text.count("LElbowRoll is doubtful") == 1


@pytest.mark.parametrize("load", [2.5, -2.5])
def test_neither_is_a_current_of_the_load_with_no_error_to_answer(load: float) -> None:
    motion = standing(6.0, load=load)
    # The droop under the load, taken back by a target that is off.
    offset = np.where(np.arange(len(motion)) > 200, STICK_SLIP.load_gain * load * 1.3, 0.0)
    start = -STICK_SLIP.load_gain * load
    other = replace(motion, position=motion.position + offset)
    ticks = ticks_of(other, drive(other, start=start))
    for one in ticks:
        one.sent.position[ELBOW] = one.reference.position[ELBOW] = 0.0
    seen, events = states(fusion_observer(), ticks)
    assert set(seen[:200]) == {JointState.FREE}
    assert set(seen[230:]) == {JointState.DOUBTFUL}
    assert events == []


def test_doubt_ends_shortly_after_the_joint_moves_on() -> None:
    motion = swing(6.0, rest=3.0)
    k = np.arange(len(motion))
    rests = k >= round(6.0 / CYCLE) + 20
    twice = Motion(
        position=np.concatenate((motion.position, motion.position)),
        velocity=np.concatenate((motion.velocity, motion.velocity)),
        acceleration=np.concatenate((motion.acceleration, motion.acceleration)),
        load=np.concatenate((motion.load, motion.load)),
    )
    offset = np.concatenate((0.04 * rests, np.zeros(len(motion))))
    seen, _ = states(fusion_observer(), strayed(twice, offset))
    begin = round(6.0 / CYCLE) + 40
    assert set(seen[begin : len(motion)]) == {JointState.DOUBTFUL}
    moves = len(motion) + int(np.argmax(np.abs(motion.velocity) > 0.05))
    assert set(seen[moves + LINGER_TICKS + 1 :]) <= {JointState.FREE}


def test_a_current_that_answers_half_of_the_error_is_no_doubt() -> None:
    motion = standing(3.0)
    offset = np.full(len(motion), 0.03)
    ticks = strayed(motion, offset)
    for one in ticks:
        one.measurement.current[ELBOW] = 0.55 * 0.03 / PER_AMPERE
    seen, events = states(fusion_observer(), ticks)
    assert JointState.DOUBTFUL not in seen
    assert events


@pytest.mark.parametrize("torque", [2.5, -2.5, 5.0, -12.0, 25.0])
@pytest.mark.parametrize("limit", [math.inf, 0.06])
@pytest.mark.parametrize("seconds", [0.2, 2.0])
def test_a_joint_that_a_hand_pushes_is_not_in_doubt(
    torque: float, limit: float, seconds: float
) -> None:
    """Neither when it is so strong that the board reaches its limit, nor when it lets go."""
    motion = standing(6.0, load=1.0)
    push = push_profile(len(motion), 1.0, seconds, torque)
    driven = drive(motion, torque=push, limit=limit)
    seen, events = states(fusion_observer(), ticks_of(motion, driven))
    assert JointState.DOUBTFUL not in seen
    if abs(torque) > 3.0:
        assert events


@pytest.mark.parametrize("rate", [0.3, 1.5])
@pytest.mark.parametrize("torque", [4.0, -8.0])
def test_nor_is_one_whose_board_has_summed_up_the_push(rate: float, torque: float) -> None:
    """When the hand has left, the integral balances the error for a while, without current."""
    summing = replace(STICK_SLIP, integral_rate=rate)
    motion = standing(12.0)
    push = push_profile(len(motion), 1.0, 4.0, torque)
    driven = drive(motion, summing, torque=push)
    seen, events = states(fusion_observer(fusion_model(summing)), ticks_of(motion, driven))
    assert JointState.DOUBTFUL not in seen
    assert events


def test_where_currents_show_nothing_no_joint_is_in_doubt() -> None:
    model = fusion_model(momentum=VOLTAGE)
    motion = standing(3.0)
    seen, _ = states(fusion_observer(model), strayed(motion, np.full(len(motion), 0.053)))
    assert JointState.DOUBTFUL not in seen


def test_a_dead_band_takes_no_current() -> None:
    banded = replace(STICK_SLIP, dead_band=0.02)
    motion = standing(3.0)
    ticks = [tick(k) for k in range(len(motion))]
    for one in ticks:
        one.measurement.current[:] = 0.0
        one.measurement.position[ELBOW] -= 0.025
    seen, _ = states(fusion_observer(fusion_model(banded)), ticks)
    assert JointState.DOUBTFUL not in seen


@examples(60)
@given(
    st.lists(st.tuples(st.integers(1, 40), st.floats(-0.15, 0.15)), min_size=1, max_size=12),
    st.floats(0.0, 0.02),
)
def test_no_error_that_the_current_answers_is_doubted(
    parts: list[tuple[int, float]], dead_band: float
) -> None:
    parameters: StickSlipParameters = replace(STICK_SLIP, dead_band=dead_band)
    target = fusion_observer(fusion_model(parameters))
    k = 0
    for ticks, error in parts:
        for _ in range(ticks):
            errors = np.zeros(JOINTS)
            errors[ELBOW] = error
            one = tick(k, errors)
            answered = max(abs(error) - dead_band, 0.0) / PER_AMPERE
            one.measurement.current[:] = 0.0
            one.measurement.current[ELBOW] = min(answered, 1.5)
            assert target.step(one).state[ELBOW] != JointState.DOUBTFUL
            k += 1


@pytest.mark.parametrize(("bound_deg", "numb"), [(9.0, False), (17.0, True)])
def test_a_joint_whose_threshold_no_touch_reaches_is_always_doubtful(
    bound_deg: float, numb: bool, caplog: pytest.LogCaptureFixture
) -> None:
    wrist = ROBOT.joint_index("LWristYaw")
    loose: FusionModel = fusion_model(bound=constant_tree(math.radians(bound_deg)))
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
