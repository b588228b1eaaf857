"""The delay from a command to its current, found in small steps."""

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config import load_experiment
from pepper_driver.config.arrays import FloatArray
from pepper_driver.identification.measurements.response import (
    MAX_LEAD,
    MIN_STEPS,
    ResponseError,
    measure_response,
    step_begins,
)
from pepper_driver.observer import Recording, RecordingBuilder
from pepper_driver.robot import Pepper
from support.identification import ROBOT
from support.observer import CYCLE, JOINTS, recording

MOVING = ("LShoulderPitch", "LElbowYaw", "HeadYaw")
COUNT = 0.016
"""[A] Step of the sensor."""


def ramp(size: float, acceleration: float = 20.0) -> FloatArray:
    """A step as a controller makes it: it accelerates as much as it may, then brakes."""
    half = max(1, round(float(np.sqrt(size / acceleration)) / CYCLE))
    speed = np.concatenate((np.arange(1, half + 1), np.arange(half - 1, 0, -1))).astype(float)
    way: FloatArray = size * np.cumsum(speed) / speed.sum()
    return way


def stepping(lead: int, *, seed: int, pairs: int = 10, late: float = 0.0) -> Recording:
    """Joints that friction holds: only their currents answer, ``lead`` ticks after the sample of the command.

    A fraction ``late`` of the steps is answered three ticks later.
    """
    rng = np.random.default_rng(seed)
    one = np.concatenate((np.zeros(75), ramp(0.035), np.full(75, 0.035), 0.035 - ramp(0.035)))
    command = np.concatenate((np.zeros(60), np.tile(one, pairs), np.zeros(75)))
    n = len(command)
    lags, drawn = np.full(n, lead), rng.random(n)
    for k in step_begins(command):
        lags[k - 20 : k + 50] += 3 * int(drawn[k] < late)
    seen = command[np.clip(np.arange(n) - lags, 0, n - 1)]
    run = recording(np.zeros((n, 3)), command)
    current = np.zeros((n, JOINTS))
    for joint, gain in zip(MOVING, (38.0, 6.0, -12.0), strict=True):
        # The mean over a cycle in which the target moves, smoothed as sensors do, without its sign, in counts.
        mean = gain * (seen + np.roll(seen, 1)) / 2.0
        smooth = np.empty(n)
        level = 0.0
        for k in range(n):
            level += 0.45 * (mean[k] - level)
            smooth[k] = level
        noisy = np.abs(0.3 + smooth) + 0.008 * rng.standard_normal(n)
        current[:, ROBOT.joint_index(joint)] = COUNT * np.round(noisy / COUNT)
    return replace(run, current=current)


@pytest.mark.parametrize("lead", [-6, -3, -1, 0, 2, 5])
@pytest.mark.parametrize("seed", range(4))
def test_the_tick_in_which_currents_answer_is_found(lead: int, seed: int) -> None:
    found = measure_response(stepping(lead, seed=seed), MOVING, ROBOT)
    assert found.lead == lead
    assert found.steps == 20
    assert found.earliest <= lead + 1
    assert lead <= found.latest <= lead + 2


@pytest.mark.parametrize("seed", range(3))
def test_answers_that_come_late_now_and_then_widen_the_spread_and_not_the_delay(seed: int) -> None:
    quiet, late = (
        measure_response(stepping(1, seed=seed, pairs=20, late=late), MOVING, ROBOT)
        for late in (0.0, 0.25)
    )
    assert quiet.lead == late.lead == 1
    assert quiet.latest <= 2.0
    assert late.latest >= 3.5


def test_too_few_steps_are_refused() -> None:
    with pytest.raises(ResponseError, match="fewer than"):
        measure_response(stepping(0, seed=0, pairs=MIN_STEPS // 2), MOVING, ROBOT)


def test_currents_that_do_not_answer_are_refused() -> None:
    run = stepping(0, seed=0)
    noise = 0.3 + 0.008 * np.random.default_rng(3).standard_normal(run.current.shape)
    with pytest.raises(ResponseError, match="no current answers"):
        measure_response(replace(run, current=noise), MOVING, ROBOT)


def test_steps_begin_after_a_rest_alone() -> None:
    command = np.zeros(200)
    command[60:] = 0.03
    command[80:] = 0.06  # too soon
    command[150:] = 0.0
    assert step_begins(command) == [60, 150]
    assert step_begins(command[:160]) == [60]  # no room to see the answer


@pytest.mark.parametrize("plant", ["nominal", "recorded"])
def test_a_simulated_robot_answers_in_the_tick_in_which_its_board_has_the_command(
    plant: str,
) -> None:
    """That is the sample which a command is paired with."""
    experiment = load_experiment("measure_response", ROBOT)
    builder = RecordingBuilder(ROBOT)
    pepper = Pepper(f"mujoco://?plant={plant}", observer=None, robot=ROBOT)
    with pepper:
        pepper.play(experiment, on_tick=lambda tick, _: builder.append(tick))
    run = builder.finish()
    found = measure_response(run, MOVING, ROBOT)
    assert found.lead == 0
    assert found.steps == 40
    # As a robot would show it whose delay is reported wrongly.
    for wrong in (-2, 3):
        shifted = replace(run, sent_position=np.roll(run.sent_position, -wrong, axis=0))
        assert abs(wrong) < MAX_LEAD
        assert measure_response(shifted, MOVING, ROBOT).lead == found.lead + wrong
