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
    spread_of,
    swing,
    ticks_of,
)


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
