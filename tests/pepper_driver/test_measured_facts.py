"""Facts that were measured when models were identified replace assumptions: delay and speeds."""

from dataclasses import replace
from pathlib import Path

import pytest

from pepper_driver import Pepper
from pepper_driver.backends import make_backend
from pepper_driver.config import load_robot
from pepper_driver.controller import Tick
from pepper_driver.observer import ModelFileError, ModelSet
from pepper_driver.observer.models.measured_robot import MeasuredJoint, MeasuredRobot
from pepper_driver.observer.models.model_file import shipped

MODELS = ModelSet.load(shipped("fusion")["nominal"])
MEASURED = MeasuredRobot(
    reported_delay=3,
    delay_error=4,
    delay_spread=(3.0, 5.0),
    late=0.02,
    lost=0.0,
    weight=None,
    joints={
        "LElbowRoll": MeasuredJoint(
            encoder_noise=0.0, current_noise=0.0, speed=1.0, speed_limited=True
        ),
        "RElbowRoll": MeasuredJoint(encoder_noise=0.0, current_noise=0.0, speed=2.6),
        "LElbowYaw": MeasuredJoint(encoder_noise=0.0, current_noise=0.0),
    },
)


@pytest.fixture
def models(tmp_path: Path) -> Path:
    path = tmp_path / "models.json"
    identity = make_backend("mujoco", load_robot()).info.identity
    replace(MODELS, measured=MEASURED, identity=identity).save(path)
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
    replace(MODELS, measured=None).save(path)
    assert Pepper("naoqi://pepper.local", models=path).backend.uri == "naoqi://pepper.local"
    assert Pepper("naoqi://pepper.local", observer=None).backend.uri == "naoqi://pepper.local"


def test_a_damaged_file_is_refused_before_anything_connects(tmp_path: Path) -> None:
    path = tmp_path / "models.json"
    path.write_text("{")
    with pytest.raises(ModelFileError, match="damaged"):
        Pepper("naoqi://pepper.local", models=path)


def peaks(pepper: Pepper) -> dict[str, float]:
    """Largest desired speed by joint of a move that asks for more than any limit [rad/s]."""
    found = dict.fromkeys(SPEEDS, 0.0)

    def watch(tick: Tick, _: object) -> None:
        for name in found:
            speed = abs(float(tick.reference.velocity[pepper.config.joint_index(name)]))
            found[name] = max(found[name], speed)

    with pepper:
        pepper.set_posture({"LElbowRoll": -0.2, "RElbowRoll": 0.2, "LElbowYaw": -1.8})
        pepper.run(3.0)
        pepper.set_posture(
            {"LElbowRoll": -1.4, "RElbowRoll": 1.4, "LElbowYaw": -0.2}, stiffness=400.0
        )
        pepper.run(3.0, on_tick=watch)
    return found


SPEEDS = {"LElbowRoll": 0.8, "RElbowRoll": 2.0, "LElbowYaw": 1.5}


def test_arms_are_slow_until_their_speed_is_measured(models: Path) -> None:
    assert peaks(Pepper("mujoco", models=models)) == pytest.approx(SPEEDS, rel=0.05)
    slow = dict.fromkeys(SPEEDS, 1.5)
    assert peaks(Pepper("mujoco", observer=None)) == pytest.approx(slow, rel=0.05)
