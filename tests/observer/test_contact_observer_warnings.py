"""Warnings of the observer, once each: inertial unit, worn joints, contacts that last, joints that detect nothing."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.backends.fields import Imu
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.constants import HELD_FACTOR, PUSH_TICKS, RISE
from pepper_driver.observer.contact_observer import UNIT_PERIOD, WEAR_PERIOD, ContactObserver
from pepper_driver.observer.interface import Contact, JointState
from pepper_driver.observer.models.fusion_model import UNSEEN_SPREAD, BaseModel
from pepper_driver.observer.residuals.fusion import FusionParts
from support.fusion import (
    BOUND,
    ELBOW,
    MATRIX,
    MODEL,
    PER_AMPERE,
    STICK_SLIP,
    Motion,
    check_lives,
    drive,
    fusion_model,
    fusion_observer,
    fusion_set,
    spread_of,
    still_base,
    swing,
    ticks_of,
)
from support.observer import CYCLE, JOINTS, ROBOT, SETTINGS, imu, tick

# -- inertial unit -----------------------------------------------------------------------------------------------------

BASE = still_base((0.01, 0.01, 0.01, 0.01, 0.1, 0.1))
WITHOUT = still_base((0.01, 0.01, 0.01, *(UNSEEN_SPREAD,) * 3))
COUNT = 3 * UNIT_PERIOD


def pushed(units: Sequence[Imu]) -> list[Tick]:
    """A robot that stands, with these units; its base is pushed from 7 to 8 s."""
    made = []
    for k, one in enumerate(units):
        now = tick(k)
        now = replace(now, measurement=replace(now.measurement, imu=one))
        if 7.0 <= k * CYCLE < 8.0:
            now.measurement.wheel_speed[:] = MATRIX @ np.array([0.2, 0.0, 0.0])
        made.append(now)
    return made


def units(broken: float | None, first: int) -> list[Imu]:
    """Values with noise, from a tick on others: that value, or None for those of the tick before."""
    rng = np.random.default_rng(4)
    shown = [
        Imu(
            acceleration=0.01 * rng.standard_normal(3),
            angular_velocity=0.001 * rng.standard_normal(3),
            attitude=np.zeros(3),
        )
        for _ in range(COUNT)
    ]
    last = shown[max(first - 1, 0)] if broken is None else imu(broken)
    return shown[:first] + [last] * (COUNT - first)


@pytest.mark.parametrize(
    ("broken", "first"),
    [(np.nan, 0), (np.inf, 0), (0.0, 0), (np.nan, 200), (None, 200)],
    ids=["absent", "infinite", "zero", "falls out", "freezes"],
)
def test_a_unit_without_values_is_reported_once_and_the_wheels_detect_alone(
    broken: float | None, first: int, caplog: pytest.LogCaptureFixture
) -> None:
    observer = fusion_observer(base=BASE)
    assert observer.describe().endswith("deg")
    events: list[Contact] = []
    with caplog.at_level(logging.INFO):
        for one in pushed(units(broken, first)):
            events += observer.step(one).contacts
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    assert "the inertial unit gives no values" in caplog.text
    assert [(c.phase, round(c.time)) for c in events if c.phase != "update"] == [
        ("begin", 7),
        ("end", 8),
    ]
    assert {c.limb for c in events} == {"trunk"}


@pytest.mark.parametrize(
    ("model", "broken"),
    [
        (BASE, False),
        (WITHOUT, True),
    ],
)
def test_a_unit_that_works_or_that_no_model_knows_is_not_reported(
    model: BaseModel, broken: bool, caplog: pytest.LogCaptureFixture
) -> None:
    observer = fusion_observer(base=model)
    for one in pushed(units(np.nan, 0 if broken else COUNT)):
        observer.step(one)
    assert caplog.text == ""
    assert ("base without inertial unit" in observer.describe()) == broken


def test_models_without_the_base_are_described_so() -> None:
    assert "base not known" in fusion_observer().describe()


# -- worn joints -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("factor", "adapt", "worn"), [(1.0, True, ()), (2.0, True, ("LElbowRoll",)), (2.0, False, ())]
)
def test_a_joint_that_turns_harder_is_reported_once_by_one_that_adapts(
    factor: float, adapt: bool, worn: tuple[str, ...], caplog: pytest.LogCaptureFixture
) -> None:
    rough = replace(STICK_SLIP, friction=factor * STICK_SLIP.friction)
    motion = swing(65.0, 0.5, 2.0)
    made = ticks_of(motion, drive(motion, rough, steps=20))
    assert len(made) > 2 * WEAR_PERIOD
    observer = fusion_observer(fusion_model(spread=spread_of(0.0095)), adapt=adapt)
    with caplog.at_level(logging.WARNING):
        thresholds = [observer.step(tick).threshold[ELBOW] for tick in made]
    assert observer.worn == worn
    assert len([r for r in caplog.records if "has worn" in r.getMessage()]) == len(worn)
    assert (max(thresholds) > 1.9 * thresholds[0]) == bool(worn)
    observer.reset()
    assert observer.worn == ()


# -- contacts that last ------------------------------------------------------------------------------------------------

TOUCHED = 36.0
AFTER = 24.0
WARNING = "left_arm was in contact for most of half a minute"


def touched(torque: float, seconds: float, motion: Motion) -> list[Contact]:
    """Events of an observer with adaptation, of a joint that is touched from before the start."""
    time = np.arange(len(motion)) * CYCLE
    profile = torque * np.clip((seconds - time) / 0.1, 0.0, 1.0)
    start = STICK_SLIP.load_gain * (torque - motion.load[0]) - np.sign(torque) * STICK_SLIP.friction
    made = ticks_of(motion, drive(motion, torque=profile, start=start, steps=20))
    # Loads of the hands widen thresholds at first; this is about spreads.
    observer = fusion_observer(adapt=True, parts=FusionParts(loads=False))
    events: list[Contact] = []
    thresholds = []
    for one in made:
        seen = observer.step(one)
        events += seen.contacts
        if one.measurement.time < seconds:
            thresholds.append(seen.threshold[ELBOW])
    # It grows in a few ticks before the touch is detected, never afterwards.
    assert max(thresholds) < HELD_FACTOR * BOUND * (1.0 + RISE) ** PUSH_TICKS
    assert seen.state[ELBOW] == JointState.FREE
    assert abs(seen.residual[ELBOW]) < 0.5 * BOUND
    check_lives(events)
    return events


@pytest.mark.parametrize("torque", [6.0, -6.0])
def test_a_joint_that_a_hand_has_from_before_the_start_is_in_contact_until_it_leaves(
    torque: float, caplog: pytest.LogCaptureFixture
) -> None:
    motion = swing(TOUCHED + AFTER, rate=1.5)
    with caplog.at_level(logging.WARNING):
        events = touched(torque, TOUCHED, motion)
    real = [c for c in events if c.kind != "rebound"]
    begin, end = (c for c in real if c.phase != "update")
    assert (begin.phase, end.phase) == ("begin", "end")
    assert begin.time < 0.5
    assert end.time == pytest.approx(TOUCHED, abs=0.3)
    assert {c.direction for c in real} == {int(np.sign(torque))}
    # After half a minute it is said that this may be no hand, once.
    assert caplog.text.count(WARNING) == 1
    assert TOUCHED > WEAR_PERIOD * CYCLE


@pytest.mark.parametrize(("fraction", "warned"), [(0.4, False), (0.6, True)])
def test_a_contact_of_more_than_half_of_the_time_is_worth_a_warning(
    fraction: float, warned: bool, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        touched(6.0, fraction * WEAR_PERIOD * CYCLE, swing(WEAR_PERIOD * CYCLE + 2.0, rate=1.5))
    assert (WARNING in caplog.text) == warned


# -- joints that detect nothing ----------------------------------------------------------------------------------------


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
