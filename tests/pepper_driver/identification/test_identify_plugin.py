"""Identification of a simulated robot of another package, which has truth but a motor model of its own."""

import json
from pathlib import Path

import pytest

from pepper_driver import Pepper
from pepper_driver.backends import make_backend
from pepper_driver.cli.app import run
from pepper_driver.identification import CLOSED_FORM, load_recordings
from pepper_driver.observer import ModelSet
from support.identification import ROBOT, short_files

pytestmark = pytest.mark.usefixtures("example_plugins")


def test_a_plug_in_that_has_truth_is_identified_and_then_observed(tmp_path: Path) -> None:
    models, figures = tmp_path / "models.json", tmp_path / "figures.json"
    robot = ["--backend", "pinocchio://?seed=3", "--joints", "LElbowRoll", "--workers", "1"]
    motion = [*short_files(tmp_path)[:3], "--calibration", "none", "--model-type", "affine"]
    assert run(["identify", "--out", str(models), "--json", str(figures), *robot, *motion]) == 0
    fit = json.loads(figures.read_text())["fit"]
    assert CLOSED_FORM not in fit, "its motors are not those of Eq. 11"
    assert fit["affine"]["LElbowRoll"]["test"] > 50.0
    made = ModelSet.load(models)
    assert made.identity == make_backend("pinocchio").info.identity
    assert set(made.models) == {"LElbowRoll", "RElbowRoll"}

    (entry,) = load_recordings(tmp_path / "models-recordings", ROBOT).sweeps
    still = [ROBOT.joint_index(name) for name in ROBOT.chains["right_arm"][:2]]
    noise = [record.position[:40, still].tobytes() for record in entry.runs]
    assert len(set(noise)) == len(noise) == 3, "each run has noise of its own"

    with Pepper("pinocchio://?seed=4", observer="paper", models=models) as pepper:
        pepper.set_posture({"LElbowRoll": -0.8}, duration=1.0)
        pepper.run(1.5)
        assert not pepper.contact_history, "nothing touches it"
        pepper.push("LForeArm", [0, 32, 0], [0.15, 0, 0], 0.8, frame="link")
        pepper.run(1.0)
        assert {contact.joint for contact in pepper.contact_history} == {"LElbowRoll"}
