"""Whether anything draws here, and the log that is drawn."""

from __future__ import annotations

from pathlib import Path

import pytest

from pepper_driver import Pepper
from pepper_driver.config import PepperError
from pepper_driver.log import RunLog, read_log
from pepper_driver.rendering.gl import make_context


@pytest.fixture(scope="session")
def gl() -> None:
    """OpenGL without a display."""
    try:
        make_context(8, 8).free()
    except PepperError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def log_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated robot whose left arm is pushed for a while."""
    path = tmp_path_factory.mktemp("render") / "run.mcap"
    with Pepper("mujoco", log=path) as pepper:
        pepper.set_posture({"LShoulderRoll": 0.6})
        pepper.run(3.0)
        pepper.push("LBicep", [0, 20, 0], point=[0.16, 0, 0], duration=0.6)
        pepper.run(1.5)
        assert {contact.joint for contact in pepper.contact_history} == {"LShoulderRoll"}
    return path


@pytest.fixture(scope="session")
def log(log_file: Path) -> RunLog:
    return read_log(log_file)
