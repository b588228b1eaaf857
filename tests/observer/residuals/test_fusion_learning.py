"""Bias, spreads and models follow the robot of today in free motion, and never a touch."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.constants import (
    BIAS_TIME,
    CORRECTION_TIME,
    HELD_FACTOR,
    MIN_SPREAD,
    UNSURE_FACTOR,
)
from pepper_driver.observer.interface import Residuals
from pepper_driver.observer.residuals.fusion import FusionParts
from support.fusion import (
    ALL_JOINTS,
    BOUND,
    BY_CURRENT,
    BY_MODEL,
    ELBOW,
    NO_JOINT,
    STICK_SLIP,
    Driven,
    drive,
    fusion_generator,
    fusion_model,
    fusion_observer,
    of_elbow,
    play,
    push_profile,
    spread_of,
    standing,
    swing,
    ticks_of,
    touched,
)
from support.observer import CYCLE, ROBOT, SETTINGS, run

HEAD = ROBOT.joint_index("HeadYaw")

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
    joints = ALL_JOINTS.copy()
    joints[ELBOW] = free
    found = []
    for one in made:
        seen = signal.step(one)
        found.append(float(seen.residual[ELBOW]))
        signal.learn(joints, NO_JOINT, untouched)
    return np.array(found)


CHANNELS = pytest.mark.parametrize(
    "parts", [FusionParts(), BY_MODEL, BY_CURRENT], ids=["both", "model", "current"]
)


@CHANNELS
def test_bias_follows_a_load_that_was_not_identified_while_nothing_touches(
    parts: FusionParts,
) -> None:
    made = biased(12.0)
    last = slice(round(8.0 / CYCLE), None)
    fixed = learnt(made, replace(parts, bias=False))[last].mean()
    assert fixed > 0.5 * HEAVIER.offset
    assert learnt(made, parts)[last].mean() < 0.7 * fixed
    for kept in (
        learnt(made, parts, adapt=False),
        learnt(made, parts, untouched=False),
        learnt(made, parts, free=False),
    ):
        assert kept[last].mean() == pytest.approx(fixed, rel=0.05)


@CHANNELS
def test_bias_has_its_time_constant_in_both_channels(parts: FusionParts) -> None:
    made = biased(33.0)
    followed, fixed = (learnt(made, replace(parts, bias=bias)) for bias in (True, False))
    for at in (15.0, 30.0):
        around = slice(round((at - 2.0) / CYCLE), round((at + 2.0) / CYCLE))
        left = followed[around].mean() / fixed[around].mean()
        assert left == pytest.approx(math.exp(-at / BIAS_TIME), abs=0.12)


# -- spreads ----------------------------------------------------------------------------------------------------------


def test_a_joint_with_larger_residuals_today_gets_a_wider_threshold() -> None:
    motion = swing(30.0, rate=1.5)
    model = fusion_model(spread=spread_of(0.01))
    model = replace(model, momentum=replace(model.momentum, source="voltage"))
    driven = drive(motion)
    noise = 0.006 * np.random.default_rng(2).standard_normal(len(motion))
    rough = replace(driven, position=driven.position + noise)
    signals = play(fusion_generator(model, adapt=True), ticks_of(motion, rough))
    threshold = np.array([one.threshold for one in signals])
    assert threshold[:, ELBOW].max() > 1.5 * HELD_FACTOR * 0.01
    assert threshold[:, HEAD].max() == pytest.approx(0.01)
    fixed = play(fusion_generator(model), ticks_of(motion, rough))
    found = {round(float(one.threshold[ELBOW]), 9) for one in fixed}
    assert found == {0.01, round(0.01 * HELD_FACTOR, 9)}


def test_thresholds_learn_nothing_while_something_touches_the_robot() -> None:
    """Even those of joints that do not detect it."""
    motion = swing(10.0)
    rough = drive(motion, replace(STICK_SLIP, friction=0.03), steps=20)
    signal = fusion_generator(fusion_model(spread=spread_of(0.01)), adapt=True)
    free = ALL_JOINTS.copy()
    free[HEAD] = False
    shaken = 1.0
    for one in ticks_of(motion, rough):
        made = signal.step(one)
        found = round(float(made.threshold[ELBOW]) / shaken, 9)
        assert found in (0.01, round(0.01 * HELD_FACTOR, 9))
        assert made.threshold[HEAD] == pytest.approx(0.01)
        np.testing.assert_allclose(np.delete(made.threshold, [ELBOW, HEAD]), 0.01 * shaken)
        signal.learn(free, NO_JOINT, False)
        shaken = HELD_FACTOR


def test_no_spread_falls_below_a_step_of_the_encoder() -> None:
    """It was identified just above it, and there is no residual at all for a minute."""
    model = fusion_model(spread=(1.05 * MIN_SPREAD,) * 3)
    seen = play(fusion_generator(model, adapt=True), [touched(0)] * 5000)
    identified = seen[0].threshold[ELBOW]
    assert seen[-1].threshold[ELBOW] == pytest.approx(identified / 1.05, rel=1e-9)


# -- models at rest ---------------------------------------------------------------------------------------------------


def resting(
    ratio: float, seconds: float, *, limited: bool = False, parts: FusionParts | None = None
) -> list[Residuals]:
    """A joint that rests off its place by so much of its threshold, both channels show it, and nothing touches it."""
    before, after = touched(0), touched(0, LElbowRoll=ratio)
    for one in (before, after):
        one.limited[ELBOW] = limited
    generator = fusion_generator(adapt=parts is None, parts=parts or FusionParts())
    made = [before] * 30 + [after] * round(seconds / CYCLE)
    return play(generator, made)[30 + SETTINGS.fusion_window // 2 :]


def test_a_model_at_rest_follows_with_the_time_of_correction() -> None:
    residual = np.array([one.residual[ELBOW] for one in resting(0.45, 4.0, parts=BY_MODEL)])
    assert residual[0] == pytest.approx(0.45 * BOUND, rel=0.02)
    time = np.arange(len(residual)) * CYCLE
    np.testing.assert_allclose(
        residual, residual[0] * np.exp(-time / CORRECTION_TIME), atol=0.02 * residual[0]
    )


@pytest.mark.parametrize(
    ("ratio", "limited", "learns"),
    [(0.45, False, True), (0.55, False, False), (0.45, True, False)],
    ids=["less than half", "more than half", "altered by the gate"],
)
def test_models_learn_from_small_residuals_of_commands_that_were_sent(
    ratio: float, limited: bool, learns: bool
) -> None:
    """More than half of a threshold may be a hand; an altered command is not what the model knows."""
    seen = resting(ratio, 3.0, limited=limited)
    left = seen[-1].residual[ELBOW] / (ratio * BOUND)
    assert left < 0.2 if learns else left == pytest.approx(1.0, rel=1e-9)
    if limited:  # nor do spreads
        assert seen[-1].threshold[ELBOW] == pytest.approx(UNSURE_FACTOR * BOUND, rel=1e-12)


# -- touches ----------------------------------------------------------------------------------------------------------


def test_a_push_is_not_learned() -> None:
    """A hand that holds on for long must not become the load of the joint."""
    motion = standing(40.0)
    push = push_profile(len(motion), 10.0, 25.0, 9.0)
    made = ticks_of(motion, drive(motion, torque=push))
    observations, events = run(fusion_observer(adapt=True), made)
    begins = [event for event in events if event.phase == "begin"]
    assert [event.direction for event in begins] == [1]
    [end] = [event for event in events if event.phase == "end"]
    assert end.time == pytest.approx(35.0, abs=0.3)
    estimate = of_elbow(observations, "torque")
    assert estimate[round(33.0 / CYCLE)] == pytest.approx(9.0, abs=1.5)
    fixed, _ = run(fusion_observer(), made)
    assert estimate[round(33.0 / CYCLE)] == pytest.approx(
        of_elbow(fixed, "torque")[round(33.0 / CYCLE)], abs=0.1
    )


def test_the_model_of_a_joint_at_rest_moves_to_where_it_rests() -> None:
    """A target does not determine on which side of it friction holds the joint; the motor works against that."""
    motion = standing(8.0)
    crept = np.where(np.arange(len(motion)) < 100, 0.0, 0.007)
    driven = Driven(position=crept, motor=-crept)
    made = ticks_of(motion, driven)
    residual = np.array([one.residual[ELBOW] for one in play(fusion_generator(), made)])
    assert np.abs(residual).max() > 0.006
    assert np.abs(residual[-1]) < 0.001
    # A joint that is touched is not one of them.
    touched = fusion_generator()
    free = ALL_JOINTS.copy()
    free[ELBOW] = False
    for one in made:
        last = touched.step(one)
        touched.learn(free, NO_JOINT, False)
    assert abs(last.residual[ELBOW]) > 0.006
