from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pepper_driver.config import PepperError
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.recording import (
    Recording,
    RecordingBuilder,
    RecordingError,
)
from support.observer import CYCLE, JOINTS, ROBOT, free_run, random_ticks, tick


def built(n: int, capacity: int = 8192) -> Recording:
    builder = RecordingBuilder(ROBOT, capacity)
    for k in range(n):
        error = np.arange(float(JOINTS)) * 0.001 + k
        builder.append(
            tick(k, error, features=(k + 0.1, k + 0.2, k + 0.3), limited=(k % JOINTS,), age=k / 1e3)
        )
    assert len(builder) == n
    return builder.finish()


@pytest.mark.parametrize("capacity", [1, 3, 100])
def test_builder_keeps_every_tick_in_its_row(capacity: int) -> None:
    run = built(20, capacity)
    assert len(run) == 20
    assert run.joint_names == ROBOT.joint_names
    rows = np.arange(20)
    np.testing.assert_allclose(run.time, rows * CYCLE)
    np.testing.assert_allclose(run.age, rows / 1e3)
    for joint in (0, 7, 16):
        np.testing.assert_allclose(run.features(joint), rows[:, None] + np.array([0.1, 0.2, 0.3]))
        np.testing.assert_allclose(run.tracking_error(joint), rows + joint * 0.001)
        np.testing.assert_array_equal(run.limited[:, joint], rows % JOINTS == joint)
    np.testing.assert_allclose(run.current, 0.2)


def test_a_tick_that_repeats_a_cycle_is_left_out() -> None:
    """A robot's clock is not this computer's: now and then its next cycle is still to come."""
    builder = RecordingBuilder(ROBOT)
    for k in (0, 1, 1, 2, 2, 2, 3):
        builder.append(tick(k))
    np.testing.assert_allclose(builder.finish().time, np.arange(4) * CYCLE)


def test_tracking_error_is_what_was_sent_minus_what_was_measured() -> None:
    sample = tick(1)
    late = replace(sample, measurement=replace(sample.measurement, time=1.0))
    builder = RecordingBuilder(ROBOT)
    for one in (sample, late):
        one = replace(one, sent=replace(one.sent, position=np.full(JOINTS, 0.5)))
        position = np.full(JOINTS, 0.2)
        # The reference is not what was sent: the gate may have altered it.
        builder.append(replace(one, measurement=replace(one.measurement, position=position)))
    np.testing.assert_allclose(builder.finish().tracking_error(3), 0.3)


def test_builder_copies_what_it_is_given() -> None:
    builder = RecordingBuilder(ROBOT)
    first = tick(0, 0.5)
    builder.append(first)
    first.measurement.position[:] = 99.0
    builder.append(tick(1))
    run = builder.finish()
    assert run.tracking_error(0)[0] == pytest.approx(0.5)
    builder.append(tick(2))
    assert len(run) == 2
    with pytest.raises(ValueError, match="read-only"):
        run.position[0, 0] = 1.0


def test_usable_leaves_out_altered_and_stale_samples() -> None:
    run = built(60)
    for joint in (0, 5):
        rows = np.arange(60)
        np.testing.assert_array_equal(run.usable(joint), (rows % JOINTS != joint) & (rows <= 30))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("position", np.nan, "'position' of HeadYaw is not finite at sample 4"),
        ("load_torque", np.inf, "'load_torque' of HeadYaw is not finite at sample 4"),
    ],
)
def test_refuses_values_that_are_not_finite(name: str, value: float, message: str) -> None:
    run = built(6)
    broken = getattr(run, name).copy()
    broken[4, ROBOT.joint_index("HeadYaw")] = value
    changes: dict[str, Any] = {name: broken}
    with pytest.raises(RecordingError, match=message):
        replace(run, **changes)


def test_refuses_wrong_shapes_and_times_and_too_few_samples() -> None:
    run = built(6)
    with pytest.raises(RecordingError, match=r"'velocity' has shape \(6, 3\)"):
        replace(run, velocity=np.zeros((6, 3)))
    with pytest.raises(RecordingError, match="time does not increase at sample 3"):
        replace(run, time=np.array([0.0, 1.0, 2.0, 2.0, 3.0, 4.0]))
    with pytest.raises(RecordingError, match="'time' is not finite at sample 1"):
        replace(run, time=np.array([0.0, np.nan, 2.0, 3.0, 4.0, 5.0]))
    for n in (0, 1):
        with pytest.raises(RecordingError, match=f"two samples or more, got {n}"):
            built(n)
    assert issubclass(RecordingError, PepperError)
    assert issubclass(RecordingError, ValueError)


def test_making_a_recording_leaves_the_arrays_of_the_caller_writable() -> None:
    run = free_run(3.0, 0, seconds=1.0)
    time = run.time.copy()
    replace(run, time=time)
    time[0] = -1.0


def test_a_recording_gives_its_ticks_back() -> None:
    made = random_ticks(7, seed=1)
    builder = RecordingBuilder(ROBOT)
    for one in made:
        builder.append(one)
    again = list(builder.finish().ticks())
    assert len(again) == 7
    for number, (before, after) in enumerate(zip(made, again, strict=True)):
        check_same(before, after)
        neutral = after.measurement
        assert (neutral.tick, neutral.battery) == (number, 1.0)
        assert np.isfinite(neutral.temperature).all()
        for name in ("touch", "bumpers", "buttons"):
            expected = np.zeros_like(getattr(before.measurement, name))
            np.testing.assert_array_equal(getattr(neutral, name), expected)
        with pytest.raises(ValueError, match="read-only"):
            after.sent.position[0] = 1.0


def check_same(before: Tick, after: Tick) -> None:
    """All that a recording keeps is equal to the last bit."""
    np.testing.assert_array_equal(before.limited, after.limited)
    for field in ("position", "velocity", "acceleration", "load_torque", "base_twist"):
        np.testing.assert_array_equal(
            getattr(before.reference, field), getattr(after.reference, field)
        )
    for field in ("position", "stiffness", "wheel_speed"):
        np.testing.assert_array_equal(getattr(before.sent, field), getattr(after.sent, field))
    for field in ("time", "age", "position", "current", "wheel_speed"):
        np.testing.assert_array_equal(
            getattr(before.measurement, field), getattr(after.measurement, field)
        )
    for field in ("acceleration", "angular_velocity", "attitude"):
        np.testing.assert_array_equal(
            getattr(before.measurement.imu, field), getattr(after.measurement.imu, field)
        )
