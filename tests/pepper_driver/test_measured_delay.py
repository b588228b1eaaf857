"""A robot over NAOqi is told the delay that was measured when its models were identified."""

from dataclasses import replace
from pathlib import Path

import pytest

from pepper_driver import Pepper
from pepper_driver.observer import ModelFileError, ModelSet
from pepper_driver.observer.models.measured_robot import MeasuredRobot
from pepper_driver.observer.models.model_file import shipped

MODELS = ModelSet.load(shipped("fusion")["nominal"])
MEASURED = MeasuredRobot(
    reported_delay=3,
    delay_error=4,
    delay_spread=(3.0, 5.0),
    late=0.02,
    lost=0.0,
    weight=None,
    joints={},
)


@pytest.fixture
def models(tmp_path: Path) -> Path:
    path = tmp_path / "models.json"
    replace(MODELS, measured=MEASURED).save(path)
    return path


@pytest.mark.parametrize(
    ("uri", "expected"),
    [
        ("naoqi://pepper.local", "naoqi://pepper.local?delay=7"),
        ("naoqi://pepper.local?delay=2", "naoqi://pepper.local?delay=2"),
        ("naoqi://pepper.local?mode=angles", "naoqi://pepper.local?mode=angles"),
        ("mujoco", "mujoco"),
    ],
)
def test_the_uri_comes_before_the_models_before_the_settings(
    uri: str, expected: str, models: Path
) -> None:
    assert Pepper(uri, models=models).backend.uri == expected


def test_models_that_say_nothing_leave_the_settings(tmp_path: Path) -> None:
    path = tmp_path / "models.json"
    MODELS.save(path)
    assert Pepper("naoqi://pepper.local", models=path).backend.uri == "naoqi://pepper.local"
    assert Pepper("naoqi://pepper.local", observer=None).backend.uri == "naoqi://pepper.local"


def test_a_damaged_file_is_refused_before_anything_connects(tmp_path: Path) -> None:
    path = tmp_path / "models.json"
    path.write_text("{")
    with pytest.raises(ModelFileError, match="damaged"):
        Pepper("naoqi://pepper.local", models=path)
