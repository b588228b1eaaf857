"""The conformance suite on each backend of this package."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from pepper_driver import Pepper
from pepper_driver.backends import Backend, make_backend
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.config import load_robot
from pepper_driver.testing.conformance import BackendConformance
from pepper_driver.testing.conformance.abilities import AbilityTests
from pepper_driver.testing.conformance.commands import CommandTests
from pepper_driver.testing.conformance.cycles import CycleTests
from pepper_driver.testing.conformance.measurements import MeasurementTests
from pepper_driver.testing.conformance.sequences import SequenceTests
from pepper_driver.testing.conformance.states import StateTests
from pepper_driver.testing.conformance.threads import ThreadTests
from support.stand_ins import patient_driver
from support.virtual_naoqi import VirtualNaoqi


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


class TestNaoqi(
    StateTests, CycleTests, CommandTests, MeasurementTests, AbilityTests, SequenceTests
):
    """A robot over NAOqi, in virtual time: at the driver's own bounds."""

    sequences = 8

    @pytest.fixture(autouse=True)
    def _awake(self, qi: object) -> Iterator[None]:
        with VirtualNaoqi("mujoco://?seed=7") as self.robot:
            self.robot.wake_up()
            yield

    def make_backend(self) -> Backend:
        return self.robot.backend()


@pytest.fixture(scope="module")
def awake(qi: Any, wake_up: Callable[[StandIn], None]) -> Iterator[StandIn]:
    """A stand-in robot that was woken up."""
    with StandIn("mujoco://?seed=7", consent=True) as stand_in, patient_driver():
        wake_up(stand_in)
        yield stand_in


@pytest.mark.realtime
class TestNaoqiThreads(ThreadTests):
    """A robot over the real protocol, whose library has threads of its own."""

    @pytest.fixture(autouse=True)
    def _connect(self, awake: StandIn) -> None:
        self.uri = f"naoqi://127.0.0.1:{awake.port}"

    def make_backend(self) -> Backend:
        return make_backend(self.uri)
