"""A joint that turns harder than when it was identified is reported once, and no other."""

from __future__ import annotations

import logging
from dataclasses import replace

import pytest

from pepper_driver.observer.contact_observer import WEAR_PERIOD
from support.fusion import (
    ELBOW,
    STICK_SLIP,
    drive,
    fusion_model,
    fusion_observer,
    standing,
    swing,
    ticks_of,
)
from support.observer import CYCLE


@pytest.mark.parametrize(("factor", "worn"), [(1.0, ()), (2.0, ("LElbowRoll",))])
def test_a_joint_that_turns_harder_is_reported_once(
    factor: float, worn: tuple[str, ...], caplog: pytest.LogCaptureFixture
) -> None:
    rough = replace(STICK_SLIP, friction=factor * STICK_SLIP.friction)
    motion = swing(65.0, 0.5, 1.2)
    made = ticks_of(motion, drive(motion, rough))
    assert len(made) > 2 * WEAR_PERIOD
    observer = fusion_observer(fusion_model(STICK_SLIP), adapt=True)
    with caplog.at_level(logging.WARNING):
        for tick in made:
            observer.step(tick)
    assert observer.worn == worn
    assert len([r for r in caplog.records if "has worn" in r.getMessage()]) == len(worn)
    observer.reset()
    assert observer.worn == ()


def test_a_robot_that_stands_is_not_worn(caplog: pytest.LogCaptureFixture) -> None:
    """Its board integrates and an unknown load pulls at it: it rests elsewhere than its model, within its friction."""
    board = replace(STICK_SLIP, integral_rate=0.3, load_gain=0.02, friction=0.014)
    motion = standing(WEAR_PERIOD * CYCLE + 0.5, load=-1.0)
    made = ticks_of(motion, drive(motion, replace(board, offset=0.01), start=-0.03, steps=20))
    observer = fusion_observer(fusion_model(board), adapt=True)
    residual = []
    with caplog.at_level(logging.WARNING):
        for tick in made:
            residual.append(observer.step(tick).residual[ELBOW])
    assert max(map(abs, residual[10:])) > 0.25 * board.friction
    assert observer.worn == ()
    assert "has worn" not in caplog.text
