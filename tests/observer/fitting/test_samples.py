"""Samples at a limit of speed or current are left out, until the joint has settled again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.observer.fitting.samples import (
    FALLING_TIME,
    SETTLING_TIME,
    WORKING_ERROR,
    clipped_current,
    fit_samples,
    in_working_range,
)
from pepper_driver.observer.recording import Recording
from support.fusion import ELBOW, PER_AMPERE, STICK_SLIP, drive, recording_of, swing
from support.observer import CYCLE, recording


def test_a_joint_that_falls_behind_is_left_out_until_it_has_settled() -> None:
    error = np.full(400, 0.05)
    error[200:230] = WORKING_ERROR + 0.1
    run = recording(np.zeros((400, 3)), error)
    within = in_working_range(run, 3)
    before, after = round(FALLING_TIME / CYCLE), round(SETTLING_TIME / CYCLE)
    expected = np.ones(400, dtype=bool)
    expected[200 - before : 230 + after] = False
    np.testing.assert_array_equal(within, expected)
    np.testing.assert_array_equal(fit_samples(run, 3), expected)
    assert run.usable(3).all()
    assert in_working_range(replace(run, position=run.sent_position), 3).all()


def test_a_sample_that_is_no_answer_is_no_evidence_that_a_joint_falls_behind() -> None:
    error, age = np.full(400, 0.05), np.zeros(400)
    error[200:203], age[200:203] = 1.0, 0.1
    run = replace(recording(np.zeros((400, 3)), error), age=age)
    assert in_working_range(run, 3).all()
    np.testing.assert_array_equal(fit_samples(run, 3), age == 0.0)


def swung(limit: float) -> Recording:
    """Swings under a load that takes most of the torque, with the noise of a current sensor."""
    motion = swing(12.0, size=0.8, rate=1.2, gravity=2.5)
    run = recording_of(motion, drive(motion, STICK_SLIP, limit=limit))
    noise = 0.004 * np.random.default_rng(1).standard_normal(run.current.shape)
    current = np.round(np.maximum(run.current + noise, 0.0) / 0.016) * 0.016
    return replace(run, current=current)


def test_a_current_at_its_limit_leaves_its_samples_out() -> None:
    free = swung(np.inf)
    assert clipped_current(free, ELBOW) is None
    assert in_working_range(free, ELBOW).all()
    limit = 0.75 * PER_AMPERE * float(free.current[:, ELBOW].max())
    run = swung(limit)
    clipped = clipped_current(run, ELBOW)
    assert clipped is not None
    assert clipped.limit == pytest.approx(limit / PER_AMPERE, abs=0.04)
    # The joint follows no longer where the board gives no more: there, and nowhere else, it differs from the free one.
    apart = np.abs(run.position[:, ELBOW] - free.position[:, ELBOW]) > 0.01
    assert apart.any()
    within = in_working_range(run, ELBOW)
    assert np.mean(within[apart]) < 0.1
    assert 0.3 < np.mean(within) < 1.0
