"""An inertial unit that is absent, or frozen, is reported, and the wheels go on without it."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.backends.fields import Imu
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.contact_observer import UNIT_PERIOD
from pepper_driver.observer.interface import Contact
from pepper_driver.observer.models.fusion_model import TAPS, UNSEEN_SPREAD, BaseModel
from support.fusion import fusion_observer
from support.observer import CYCLE, ROBOT, tick

MATRIX = np.asarray(ROBOT.wheels.matrix)
SPREADS = (0.01, 0.01, 0.01, 0.01, 0.1, 0.1)
BASE = BaseModel(
    coefficients=((0.0,) * 6,) * (6 * TAPS),
    still=SPREADS,
    moving=SPREADS,
    shaking=SPREADS,
    driving=SPREADS,
)
WITHOUT = (0.01, 0.01, 0.01, *(UNSEEN_SPREAD,) * 3)
COUNT = 3 * UNIT_PERIOD


def unit(value: float) -> Imu:
    return Imu(
        acceleration=np.full(3, value),
        angular_velocity=np.full(3, value),
        attitude=np.full(3, value),
    )


def pushed(units: Sequence[Imu]) -> list[Tick]:
    """A robot that stands, with these units; its base is pushed from 7 to 8 s."""
    made = []
    for k, one in enumerate(units):
        now = tick(k)
        now = replace(now, measurement=replace(now.measurement, imu=one))
        if 7.0 <= k * CYCLE < 8.0:
            now.measurement.wheel_speed[:] = MATRIX @ np.array([0.2, 0.0, 0.0])
        made.append(now)
    return made


def units(broken: float | None, first: int) -> list[Imu]:
    """Values with noise, from a tick on others: that value, or None for those of the tick before."""
    rng = np.random.default_rng(4)
    shown = [
        Imu(
            acceleration=0.01 * rng.standard_normal(3),
            angular_velocity=0.001 * rng.standard_normal(3),
            attitude=np.zeros(3),
        )
        for _ in range(COUNT)
    ]
    last = shown[max(first - 1, 0)] if broken is None else unit(broken)
    return shown[:first] + [last] * (COUNT - first)


@pytest.mark.parametrize(
    ("broken", "first"),
    [(np.nan, 0), (np.inf, 0), (0.0, 0), (np.nan, 200), (None, 200)],
    ids=["absent", "infinite", "zero", "falls out", "freezes"],
)
def test_a_unit_without_values_is_reported_once_and_the_wheels_detect_alone(
    broken: float | None, first: int, caplog: pytest.LogCaptureFixture
) -> None:
    observer = fusion_observer(base=BASE)
    assert observer.describe().endswith("deg")
    events: list[Contact] = []
    with caplog.at_level(logging.INFO):
        for one in pushed(units(broken, first)):
            events += observer.step(one).contacts
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    assert "the inertial unit gives no values" in caplog.text
    assert [(c.phase, round(c.time)) for c in events if c.phase != "update"] == [
        ("begin", 7),
        ("end", 8),
    ]
    assert {c.limb for c in events} == {"trunk"}


@pytest.mark.parametrize(
    ("model", "broken"),
    [
        (BASE, False),
        (replace(BASE, still=WITHOUT, moving=WITHOUT, shaking=WITHOUT, driving=WITHOUT), True),
    ],
)
def test_a_unit_that_works_or_that_no_model_knows_is_not_reported(
    model: BaseModel, broken: bool, caplog: pytest.LogCaptureFixture
) -> None:
    observer = fusion_observer(base=model)
    for one in pushed(units(np.nan, 0 if broken else COUNT)):
        observer.step(one)
    assert caplog.text == ""
    assert ("base without inertial unit" in observer.describe()) == broken


def test_models_without_the_base_are_described_so() -> None:
    assert "base not known" in fusion_observer().describe()
