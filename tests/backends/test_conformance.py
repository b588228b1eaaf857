"""The conformance suite on each backend of this package."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from pepper_driver import Pepper
from pepper_driver.backends import Backend, make_backend
from pepper_driver.backends.naoqi.qi_library import NoQiError, load_qi
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.config import load_robot
from pepper_driver.testing.conformance import BackendConformance
from support.stand_ins import patient_driver


class TestMock(BackendConformance):
    """The robot without physics: no ability beyond the interface."""

    def make_backend(self) -> Backend:
        return make_backend("mock://?delay=2")


class TestMujoco(BackendConformance):
    """The simulated robot."""

    def make_backend(self) -> Backend:
        return make_backend("mujoco://?seed=7")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of it, long enough for every test."""
    path = tmp_path_factory.mktemp("robot") / "run.mcap"
    with Pepper("mujoco://?seed=7", observer=None, log=path) as pepper:
        pepper.set_posture({"LShoulderRoll": 0.6})
        pepper.run(1500 * load_robot().cycle)
    return path


class TestReplay(BackendConformance):
    """The one robot that need not follow commands."""

    follows = drives = starts_at_zero = False

    @pytest.fixture(autouse=True)
    def _record(self, recording: Path) -> None:
        self.uri = f"replay://{recording}"

    def make_backend(self) -> Backend:
        return make_backend(self.uri)


@pytest.fixture(scope="module")
def awake() -> Iterator[StandIn]:
    """A stand-in robot that was woken up."""
    try:
        qi = load_qi()
    except NoQiError as error:
        pytest.skip(str(error))
    with StandIn("mujoco://?seed=7", consent=True) as stand_in, patient_driver():
        session = qi.Session()
        session.connect(stand_in.url, _async=True).value(10_000)
        session.service("ALMotion").wakeUp(_async=True).value(20_000)
        session.close()
        yield stand_in


class TestNaoqi(BackendConformance):
    """A robot over the real protocol."""

    sequences = 2

    @pytest.fixture(autouse=True)
    def _connect(self, awake: StandIn) -> None:
        self.uri = f"naoqi://127.0.0.1:{awake.port}"

    def make_backend(self) -> Backend:
        return make_backend(self.uri)
