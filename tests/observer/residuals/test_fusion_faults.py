"""Mode ``fusion`` under values that no robot has, long touches and slow pushes: it goes blind, and comes back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.constants import HELD_FACTOR
from pepper_driver.observer.interface import JointState
from support.fusion import (
    ALL_JOINTS,
    BOUND,
    ELBOW,
    MATRIX,
    NO_JOINT,
    STICK_SLIP,
    drive,
    fusion_generator,
    fusion_model,
    fusion_observer,
    standing,
    still_base,
    swing,
    ticks_of,
)
from support.observer import CYCLE, ROBOT, run

SPREAD = 0.015
STILL_BASE = still_base(SPREAD)


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
    assert abs(seen.residual[ELBOW]) < 0.3 * BOUND


def test_a_board_keeps_what_it_has_summed_up_while_its_joint_cannot_be_judged() -> None:
    model = fusion_model(replace(STICK_SLIP, integral_rate=2.0))
    motion = standing(8.0, load=4.0)
    made = ticks_of(motion, drive(motion, model.twin, start=0.0))
    signal = fusion_generator(model, adapt=True)
    after = []
    for k, one in enumerate(made):
        lost = 3.0 <= k * CYCLE < 5.0
        measurement = replace(one.measurement, age=1.0) if lost else one.measurement
        seen = signal.step(replace(one, measurement=measurement))
        signal.learn(ALL_JOINTS, NO_JOINT, True)
        if k * CYCLE > 5.2:
            after.append(abs(float(seen.residual[ELBOW])))
    # A model that starts again does not know on which side friction holds: 0.3 deg. A sum of 0 would be off by 2.8 deg.
    assert max(after) < 0.25 * BOUND


@pytest.mark.parametrize("field", ["position", "current"])
def test_a_first_sample_that_is_not_valid_starts_no_board_with_a_sum_that_it_has_not(
    field: str,
) -> None:
    """At 1.2 rad, a joint that is taken to be at 0 would have a sum of 1.2 rad."""
    model = fusion_model(replace(STICK_SLIP, integral_rate=0.3))
    motion = standing(3.0, load=1.0)
    motion = replace(motion, position=motion.position + 1.2)
    made = ticks_of(motion, drive(motion, model.twin))
    getattr(made[0].measurement, field)[ELBOW] = np.nan
    target = fusion_observer(model)
    for one in made:
        seen = target.step(one)
        assert not seen.contacts
    error = made[-1].sent.position[ELBOW] - made[-1].measurement.position[ELBOW]
    assert abs(seen.expected[ELBOW] - error) < 0.5 * BOUND
    assert seen.state[ELBOW] == JointState.FREE


def test_two_values_that_no_robot_has_do_not_hide_each_other() -> None:
    made = ticks_of(standing(2.0), drive(standing(2.0)))
    for one in made[100:]:
        one.sent.position[ELBOW], one.measurement.position[ELBOW] = 1e6, -1e6
    target = fusion_observer()
    for one in made:
        seen = target.step(one)
        assert not seen.contacts
    assert seen.state[ELBOW] == JointState.BLIND


@pytest.mark.parametrize("adapt", [True, False])
def test_a_long_push_on_the_base_does_not_make_it_deaf(adapt: bool) -> None:
    """The elbow swings; the base is pushed for ten seconds, and again for one."""
    motion = swing(28.0, rate=1.5)
    made = ticks_of(motion, drive(motion, steps=20))
    for k, one in enumerate(made):
        if 10.0 <= k * CYCLE < 20.0 or 25.0 <= k * CYCLE < 26.0:
            one.measurement.wheel_speed[:] = MATRIX @ np.array(
                [6.0 * HELD_FACTOR * SPREAD, 0.0, 0.0]
            )
    _, contacts = run(fusion_observer(adapt=adapt, base=STILL_BASE), made)
    reported = [(c.phase, round(c.time)) for c in contacts if c.phase != "update"]
    assert reported == [("begin", 10), ("end", 20), ("begin", 25), ("end", 26)]
    assert {c.link for c in contacts} == {"base_link"}


def test_samples_that_come_late_do_not_break_up_a_push_on_the_base() -> None:
    """Recorded robots have 8 % of them."""
    motion = swing(6.0, rate=1.5)
    late = np.random.default_rng(1).random(len(motion)) < 0.08
    made = ticks_of(motion, drive(motion, steps=20), late=late.astype(int).tolist())
    for k, one in enumerate(made):
        if 2.0 <= k * CYCLE < 4.0:
            one.measurement.wheel_speed[:] = MATRIX @ np.array(
                [6.0 * HELD_FACTOR * SPREAD, 0.0, 0.0]
            )
    assert late[round(2.0 / CYCLE) : round(4.0 / CYCLE)].sum() > 5
    _, contacts = run(fusion_observer(base=STILL_BASE), made)
    reported = [(c.phase, round(c.time, 1)) for c in contacts if c.phase != "update"]
    assert reported == [("begin", 2.1), ("end", 4.0)]


def test_a_push_that_grows_for_long_is_detected_in_the_end() -> None:
    """Neither bias nor spread follow it beyond their limits."""
    motion = swing(30.0, rate=1.5)
    growth: FloatArray = np.power(1.25, np.arange(len(motion)) * CYCLE)  # 25 % a second
    made = ticks_of(motion, drive(motion, torque=-0.05 * growth, steps=20))
    _, contacts = run(fusion_observer(adapt=True), made)
    assert contacts
    assert contacts[0].joint == ROBOT.joint_names[ELBOW]
    assert contacts[0].direction == -1
    # From spreads at UNSURE_FACTOR, and a bias of half a threshold.
    assert contacts[0].intensity_deg < 3.5 * np.degrees(BOUND)
