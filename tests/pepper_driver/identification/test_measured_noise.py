"""Noise at rest, and samples that are late or lost."""

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.identification.measurements.noise import (
    late_fraction,
    lost_fraction,
    measure_noise,
)
from pepper_driver.observer import Recording
from support.identification import ROBOT
from support.observer import CYCLE, JOINTS, recording

JOINT = "RElbowYaw"
INDEX = ROBOT.joint_index(JOINT)


def run_of(position: FloatArray, command: FloatArray | None = None) -> Recording:
    n = len(position)
    run = recording(np.zeros((n, 3)), np.zeros(n) if command is None else command)
    measured = np.zeros((n, JOINTS))
    measured[:, INDEX] = position
    return replace(run, position=measured)


def test_drift_and_motion_are_no_noise() -> None:
    rng = np.random.default_rng(2)
    n = 3000
    noise = 0.002 * rng.standard_normal(n)
    drift = 0.02 * np.sin(np.arange(n) * CYCLE * 0.5)
    # It moves in the second half.
    command = np.where(np.arange(n) < n // 2, 0.0, 0.2 * np.sin(np.arange(n) * CYCLE * 3.0))
    current = np.zeros((n, JOINTS))
    current[:, INDEX] = 0.5 + 0.01 * rng.standard_normal(n)
    run = replace(run_of(noise + drift + command, command), current=current)
    found = measure_noise(run, JOINT)
    assert found is not None
    assert found[0] == pytest.approx(0.002, rel=0.1)
    assert found[1] == pytest.approx(0.01, rel=0.1)


def test_a_joint_that_never_rests_shows_no_noise() -> None:
    command = 0.2 * np.sin(np.arange(1000) * CYCLE * 3.0)
    assert measure_noise(run_of(command, command), JOINT) is None


@pytest.mark.parametrize("fraction", [0.0, 0.02, 0.1])
def test_lost_samples_repeat_the_one_before_while_the_joint_moves(fraction: float) -> None:
    rng = np.random.default_rng(4)
    true = 0.02 * np.arange(4000.0)  # 1.7 rad/s
    lost = rng.random(len(true)) < fraction
    seen = true.copy()
    for k in np.flatnonzero(lost):
        seen[k] = seen[k - 1]
    found = lost_fraction([run_of(seen)], [JOINT], ROBOT)
    assert found == pytest.approx(fraction, abs=0.01)
    # A joint that stands repeats its samples all the same.
    assert lost_fraction([run_of(np.zeros(500))], [JOINT], ROBOT) is None


def test_late_samples_are_not_lost() -> None:
    true = 0.02 * np.arange(2000.0)
    late = np.random.default_rng(6).random(len(true)) < 0.1
    late[1:] &= ~late[:-1]
    seen: FloatArray = np.where(late, true - 0.02, true)
    run = replace(run_of(seen), age=np.where(late, CYCLE, 0.0))
    assert late_fraction([run]) == pytest.approx(late.mean())
    assert lost_fraction([run], [JOINT], ROBOT) == 0.0
