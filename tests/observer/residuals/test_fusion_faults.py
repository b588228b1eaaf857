"""Mode ``fusion`` under values that no robot has, long touches and slow pushes: it goes blind, and comes back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.controller.tick import Tick
from pepper_driver.observer.contact_observer import ContactObserver
from pepper_driver.observer.interface import Contact, JointState
from pepper_driver.observer.models.fusion_model import TAPS, BaseModel
from support.fusion import (
    ELBOW,
    MODEL,
    STICK_SLIP,
    drive,
    fusion_generator,
    fusion_model,
    fusion_observer,
    standing,
    swing,
    ticks_of,
)
from support.observer import CYCLE, JOINTS, ROBOT

MATRIX = np.asarray(ROBOT.wheels.matrix)
STILL_BASE = BaseModel(
    coefficients=((0.0, 0.0, 0.0),) * (6 * TAPS), standing=(0.05,) * 3, driving=(0.05,) * 3
)


def detect(observer: ContactObserver, made: list[Tick]) -> list[Contact]:
    return [contact for one in made for contact in observer.step(one).contacts]


@pytest.mark.parametrize("value", [1e6, 1e100, 1e160, -1e160, 1e307, 1.7e308, np.nan, -np.inf])
@pytest.mark.parametrize(
    ("part", "field"),
    [
        ("reference", "load_torque"),
        ("reference", "velocity"),
        ("reference", "acceleration"),
        ("measurement", "position"),
        ("measurement", "current"),
        ("sent", "position"),
    ],
)
def test_an_absurd_value_blinds_its_joint_for_a_moment_and_teaches_nothing(
    part: str, field: str, value: float
) -> None:
    motion = swing(5.0, rate=1.5)
    made = ticks_of(motion, drive(motion, steps=20))
    observer = fusion_observer(adapt=True)
    # Two ticks in a row: one of them is a tick in which constants are learned.
    for k in (204, 205, 209, 210):
        getattr(getattr(made[k], part), field)[ELBOW] = value
    for k, one in enumerate(made):
        seen = observer.step(one)
        assert not seen.contacts
        blind = seen.state == JointState.BLIND
        assert np.isfinite(seen.residual[~blind]).all()
        assert np.isfinite(seen.threshold[~blind]).all()
        assert blind[ELBOW] or k not in (204, 205, 209, 210)
    assert not blind.any()
    assert abs(seen.residual[ELBOW]) < 0.3 * MODEL.max_bound
    assert all(abs(load.mass) < 0.1 for load in observer.hand_loads.values())


def test_a_board_keeps_what_it_has_summed_up_while_its_joint_cannot_be_judged() -> None:
    model = fusion_model(replace(STICK_SLIP, integral_rate=2.0))
    motion = standing(6.0, load=4.0)
    made = ticks_of(motion, drive(motion, model.twin, start=0.0))
    signal = fusion_generator(model, adapt=True)
    free, nothing = np.ones(JOINTS, dtype=np.bool_), np.zeros(JOINTS, dtype=np.bool_)
    after = []
    for k, one in enumerate(made):
        lost = 1.0 <= k * CYCLE < 3.0
        measurement = replace(one.measurement, age=1.0) if lost else one.measurement
        seen = signal.step(replace(one, measurement=measurement))
        signal.learn(seen, free, nothing, True)
        if k * CYCLE > 3.2:
            after.append(abs(float(seen.residual[ELBOW])))
    assert max(after) < 0.1 * model.max_bound


@pytest.mark.parametrize("integral_rate", [0.0, 2.0])
def test_boards_that_integrate_are_given_time_to_release(integral_rate: float) -> None:
    """They push against a touch for a while after it has ended; their thresholds fall in two seconds."""
    model = fusion_model(replace(STICK_SLIP, integral_rate=integral_rate))
    motion = standing(8.0)
    signal = fusion_generator(model, adapt=True)
    free, nothing = np.ones(JOINTS, dtype=np.bool_), np.zeros(JOINTS, dtype=np.bool_)
    thresholds = []
    for k, one in enumerate(ticks_of(motion, drive(motion, model.twin))):
        made = signal.step(one)
        thresholds.append(float(made.threshold[ELBOW]))
        signal.learn(made, free, nothing, not 3.0 <= k * CYCLE < 4.0)
    before, after = thresholds[round(3.9 / CYCLE)], thresholds[round(4.1 / CYCLE)]
    later = thresholds[round(6.5 / CYCLE)]
    if integral_rate:
        assert after > 1.4 * before
    else:
        assert after == pytest.approx(before, rel=1e-2)
    assert later == pytest.approx(before, rel=1e-2)


def pushed_base(adapt: bool, bounds: float) -> tuple[list[Contact], ContactObserver]:
    """The elbow swings; the base is pushed from 30 to 40 s and from 45 to 46 s."""
    motion = swing(48.0, rate=1.5)
    made = ticks_of(motion, drive(motion, steps=20))
    for k, one in enumerate(made):
        if 30.0 <= k * CYCLE < 40.0 or 45.0 <= k * CYCLE < 46.0:
            one.measurement.wheel_speed[:] = MATRIX @ np.array([bounds * 0.05, 0.0, 0.0])
    observer = fusion_observer(adapt=adapt, base=STILL_BASE)
    return detect(observer, made), observer


@pytest.mark.parametrize("adapt", [True, False])
def test_a_long_push_on_the_base_does_not_make_it_deaf(adapt: bool) -> None:
    contacts, _ = pushed_base(adapt, 1.6)
    reported = [(c.phase, round(c.time)) for c in contacts if c.phase != "update"]
    assert reported == [("begin", 30), ("end", 40), ("begin", 45), ("end", 46)]
    assert {c.link for c in contacts} == {"base_link"}


def test_a_push_that_grows_for_long_is_detected_in_the_end() -> None:
    """Even if it grows slowly: the envelope raises no threshold beyond MAX_ENVELOPE_FACTOR."""
    motion = swing(60.0, rate=1.5)
    growth = 1.2 ** (np.arange(len(motion)) * CYCLE)  # of torque, 20 % a second
    made = ticks_of(motion, drive(motion, steps=20))
    observer = fusion_observer(adapt=True)
    contacts: list[Contact] = []
    for k, one in enumerate(made):
        one.measurement.position[ELBOW] -= np.radians(0.05) * growth[k]
        contacts += observer.step(one).contacts
    assert contacts
    assert contacts[0].joint == ROBOT.joint_names[ELBOW]
    assert contacts[0].intensity_deg < 12.0 * np.degrees(MODEL.max_bound)
