"""Samples: their contents, the time from one to the next, and that they stay as they were."""

from __future__ import annotations

import copy
from operator import attrgetter

import numpy as np
import pytest

from pepper_driver.backends import Backend, Measurement
from pepper_driver.backends.fields import fields_of
from pepper_driver.backends.interface import MAX_RESPONSE_DELAY
from pepper_driver.testing.conformance.driving import (
    LATEST,
    ROBOT,
    BackendSuite,
    bits,
    command,
    cycles,
    hold,
    run,
    until,
    watch,
)

ARRAYS = [
    f for f in (*fields_of("measurement"), *fields_of("measurement.imu")) if f.elements(ROBOT)
]


def check(measurement: Measurement) -> None:
    for field in ARRAYS:
        array = attrgetter(field.source.partition(".")[2])(measurement)
        if array is None and field.absent is not None:
            continue
        assert isinstance(array, np.ndarray), field.source
        assert array.shape == (len(field.elements(ROBOT) or ()),), field.source
        assert array.dtype == field.type, field.source
        assert np.isfinite(array).all() or field.absent is not None, field.source
    assert (measurement.position > ROBOT.lower - 0.1).all()
    assert (measurement.position < ROBOT.upper + 0.1).all()
    assert (measurement.current >= 0).all(), "the sensor loses the sign"
    for name in ("touch", "bumpers", "buttons"):
        assert set(getattr(measurement, name)) <= {0.0, 1.0}, name
    assert (measurement.temperature > -20).all()
    assert (measurement.temperature < 120).all()
    assert 0.0 <= measurement.battery <= 1.0
    assert measurement.charging_flap in (0.0, 1.0) or np.isnan(measurement.charging_flap)
    assert measurement.age >= 0.0
    assert isinstance(measurement.tick, int)
    assert measurement.response_delay is None or measurement.response_delay >= 0
    assert measurement.dropped_commands >= 0
    if measurement.stiffness is not None:
        known = measurement.stiffness[~np.isnan(measurement.stiffness)]
        assert ((known >= 0.0) & (known <= 1.0)).all()
    assert len(measurement.stale_reason.splitlines()) <= 1


Course = list[tuple[Measurement, Measurement]]


class MeasurementTests(BackendSuite):
    """Samples: their contents, the time from one to the next, and that they stay as they were."""

    @pytest.fixture
    def course(self) -> Course:
        """Return a short life of a robot: each sample, and a copy of it as it was then."""
        kept: Course = []

        def keep(*samples: Measurement) -> None:
            kept.extend((sample, copy.deepcopy(sample)) for sample in samples)

        with self.make_backend() as backend:
            keep(backend.open())
            for measurement in cycles(backend, hold(kept[0][0]), 10):
                keep(measurement)
            start = backend.activate()
            keep(start)
            target = hold(start).position
            target[ROBOT.joint_index("HeadYaw")] += 0.05
            for measurement in cycles(backend, command(target, wheel_speed=np.full(3, 0.5)), 30):
                keep(measurement)
            backend.deactivate()
            for measurement in cycles(backend, hold(kept[-1][0]), 10):
                keep(measurement)
        return kept

    def test_all_is_there_in_its_shape(self, course: Course) -> None:
        for measurement, _ in course:
            check(measurement)
        assert np.abs(course[0][0].imu.acceleration - [0, 0, 9.81]).max() < 1.0, "it stands"
        delays = {m.response_delay for m, _ in course[-20:-10]}
        assert delays == {None} or all(d is not None and d < MAX_RESPONSE_DELAY for d in delays)

    def test_ticks_and_time_only_go_on(self, course: Course) -> None:
        ticks = np.array([m.tick for m, _ in course])
        times = np.array([m.time for m, _ in course])
        assert (np.diff(ticks) >= 0).all()
        np.testing.assert_allclose(np.diff(times), np.diff(ticks) * ROBOT.cycle, atol=1e-9)
        dropped_commands = [m.dropped_commands for m, _ in course[:-10]]
        assert dropped_commands == sorted(dropped_commands)

    def test_a_measurement_is_never_changed_afterwards(self, course: Course) -> None:
        """The log and callbacks read it on threads of their own, later."""
        assert not np.array_equal(course[-11][0].position, course[5][0].position)
        for later, then in course:
            assert bits(later) == bits(then)

    def test_each_read_is_a_cycle_or_returns_at_once(self, backend: Backend) -> None:
        """A simulation lets a cycle pass in each read; a robot does not wait for its caller."""
        first = backend.open()
        if not backend.real_time:
            ticks = [m.tick for m in [first, *run(backend, hold(first), 0.3)]]
            assert (np.diff(ticks) == 1).all()
            return
        took, samples = [], []
        held = hold(backend.activate())
        for _ in range(50):
            before = backend.clock.seconds()
            samples += list(cycles(backend, held, 1))
            took.append(backend.clock.seconds() - before)
        calls = []
        for _ in range(50):  # without a pause: samples repeat
            before = backend.clock.seconds()
            samples.append(backend.exchange(held))
            calls.append(backend.clock.seconds() - before)
        assert np.median(calls) < 0.5 * backend.info.cycle, "it waits for nothing"
        passed = samples[49].tick - samples[0].tick
        assert 25 < passed < 50 * (np.mean(took) / backend.info.cycle + 0.5), (
            "it keeps its own time"
        )
        assert samples[-1].tick - samples[49].tick < 25 + sum(calls) / backend.info.cycle

    def test_a_robot_waited_for_goes_on(self, backend: Backend) -> None:
        """A loop may miss many ticks; the first sample after that is old or new, but the calls work."""
        first = backend.open()
        held = hold(backend.activate())
        before = run(backend, held, 0.1)[-1]
        backend.clock.sleep(0.3)
        after = until(backend, held, lambda sample: sample.tick > before.tick and sample.age < 0.2)
        assert after.tick > before.tick > first.tick
        assert after.age < 0.2
        check(after)

    def test_arrays_of_a_command_are_the_callers(self, backend: Backend) -> None:
        """A program may fill the same arrays again for each cycle."""
        backend.open()
        measurement = backend.activate()
        held = hold(measurement)
        for _ in range(10):
            backend.write(held)
            position = held.position.copy()
            for array in (held.position, held.stiffness, held.wheel_speed):
                array[:] = np.nan
            (last,) = watch(backend, backend.info.cycle)
            held.position[:], held.stiffness[:], held.wheel_speed[:] = position, 1.0, 0.0
        check(last)
        backend.deactivate()
        check(run(backend, hold(last), 0.1)[-1])
        assert last.age < LATEST
