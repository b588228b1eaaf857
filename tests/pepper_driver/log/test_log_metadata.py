"""Metadata of a log: facts of its run, and what it keeps to itself."""

from __future__ import annotations

import hashlib
import json
import platform
from dataclasses import asdict, replace
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver import Pepper
from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import (
    ControllerSettings,
    load_controller_settings,
    load_observer_settings,
    load_robot,
    load_safety_settings,
)
from pepper_driver.config.passwords import without_secrets
from pepper_driver.log import read_log, run_metadata
from pepper_driver.observer import shipped

ROBOT = load_robot()
CONTROLLER = load_controller_settings(ROBOT)


def test_a_run_can_be_reconstructed_from_its_log(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    controller = replace(CONTROLLER, feedback="joints")
    with Pepper("mujoco://?seed=7&plant=integral", log=path, controller=controller) as pepper:
        pepper.run(0.05)
        identity = pepper.backend.info.identity
    run = read_log(path).metadata
    assert run["backend"] == "mujoco://?seed=7&plant=integral"
    assert (run["seed"], run["identity"], run["robot"]) == ("7", identity, ROBOT.name)
    settings, given = json.loads(run["controller_settings"]), asdict(controller)
    # Of the models: how far an attentive robot oscillates.
    friction = settings["attentive"].pop("friction_deg")
    assert set(given["attentive"]["joints"]) <= friction.keys()
    assert given["attentive"].pop("friction_deg") == {}
    assert settings == given
    assert json.loads(run["safety_settings"]) == asdict(load_safety_settings())
    assert json.loads(run["observer_settings"]) == asdict(load_observer_settings())
    models = shipped("fusion")["integral"]
    assert run["observer_mode"] == "fusion"
    assert run["observer_models_sha256"] == hashlib.sha256(models.read_bytes()).hexdigest()
    for name in ("numpy", "mujoco", "pin", "mcap"):
        assert run[name] == version(name)
    assert run["pepper_driver"] == version("pepper-driver")
    age = datetime.now(UTC) - datetime.fromisoformat(run["start"])
    assert timedelta(seconds=-1) < age < timedelta(minutes=10)
    assert platform.node() not in " ".join(run.values())


def metadata(controller: ControllerSettings) -> dict[str, str]:
    return run_metadata(MockBackend(ROBOT), None, ROBOT, controller, load_safety_settings())


def test_settings_that_differ_have_another_hash() -> None:
    one, other = metadata(CONTROLLER), metadata(replace(CONTROLLER, feedback_time=0.3))
    assert one["controller_settings_sha256"] != other["controller_settings_sha256"]
    assert one["safety_settings_sha256"] == other["safety_settings_sha256"]
    assert "seed" not in one
    assert one["observer"] == "none"


@pytest.mark.parametrize(
    ("uri", "shown"),
    [
        ("mujoco", "mujoco"),
        ("mujoco?seed=3", "mujoco?seed=3"),
        ("mujoco://?plant=worn&seed=3", "mujoco://?plant=worn&seed=3"),
        ("naoqi://pepper.local:9559", "naoqi://pepper.local:9559"),
        ("naoqis://nao:s3cr3t@pepper.local", "naoqis://pepper.local"),
        ("naoqis://nao:s3/cr@3t@pepper.local?late=1", "naoqis://pepper.local?late=1"),
        ("naoqis://pepper?password=s3cr3t&late=1", "naoqis://pepper?password=...&late=1"),
        ("naoqis://pepper?late=1&API_Key=s3cr3t", "naoqis://pepper?late=1&API_Key=..."),
    ],
)
def test_the_uri_is_logged_without_secrets(uri: str, shown: str) -> None:
    assert without_secrets(uri) == shown


@given(user=st.text(st.characters(codec="ascii", exclude_characters="?#")), host=st.just("pepper"))
def test_no_user_or_password_stays(user: str, host: str) -> None:
    assert without_secrets(f"naoqis://{user}@{host}") == f"naoqis://{host}"
