"""A robot whose models do not have its response delay: this is said before anything connects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from pepper_driver import Pepper
from pepper_driver.observer.models.measured_robot import MeasuredRobot
from support.fusion import fusion_set

AT_ONCE = MeasuredRobot(
    reported_delay=3,
    delay_error=-3,
    delay_spread=(-3.0, -3.0),
    late=0.0,
    lost=0.0,
    weight=None,
    joints={},
)
WARNING = "without the response delay of the robot"


@pytest.mark.parametrize(
    ("uri", "measured", "used", "said"),
    [
        ("naoqi://pepper.local", None, "naoqi://pepper.local", True),
        ("naoqi://pepper.local?delay=4", None, "naoqi://pepper.local?delay=4", False),
        # A robot that answers at once is no robot without a delay.
        ("naoqi://pepper.local", AT_ONCE, "naoqi://pepper.local?delay=0", False),
        ("naoqi://pepper.local?mode=angles", None, "naoqi://pepper.local?mode=angles", False),
    ],
    ids=["absent", "in the address", "zero", "known to the robot"],
)
def test_a_delay_that_is_only_assumed_is_said(
    uri: str,
    measured: MeasuredRobot | None,
    used: str,
    said: bool,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    path = tmp_path / "models.json"
    replace(fusion_set(), measured=measured).save(path)
    assert Pepper(uri, models=path).backend.uri == used
    assert (WARNING in caplog.text) == said


def test_without_models_there_is_nothing_to_compare(caplog: pytest.LogCaptureFixture) -> None:
    assert Pepper("naoqi://pepper.local", observer=None).backend.uri == "naoqi://pepper.local"
    assert caplog.text == ""
