"""Short motions for tests of identification, and a robot in real time."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from pepper_driver.backends import Backend, BackendInfo, Measurement
from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import Experiment, RobotConfig, load_experiment, load_robot
from pepper_driver.config.loading import package_file, read_yaml
from pepper_driver.identification import IdentificationDataset, record_joints
from support.once import made_once

ROBOT = load_robot()
FULL = load_experiment("identify", ROBOT)
BODY = load_experiment("calibration_motion", ROBOT)

_SHORT = {"estimation_stiffness": [2.0, 4.0], "sweeps": 1, "setpoints": 2, "dwell": [0.35, 0.7]}

SHORT = FULL.with_goals(
    settle=0.6, estimation_stiffness=(2.0, 4.0), sweeps=1, setpoints=2, dwell=(0.6, 1.2)
)


def short_body() -> Experiment:
    return BODY.with_goals(settle=0.6, count=1)


def short_files(folder: Path) -> list[str]:
    """Options of ``pepper identify`` for short motions, with their files in ``folder``."""
    options = ["--no-measure"]
    changes: dict[str, tuple[str, str, dict[str, Any]]] = {
        "experiment": ("identify", "sweeps", _SHORT),
        "calibration": ("calibration_motion", "setpoints", {"count": 3}),
    }
    for option, (name, kind, goals) in changes.items():
        data = read_yaml(package_file("experiments", f"{name}.yaml"))
        data["steps"][0][kind] |= goals | {"settle": 0.6}
        path = folder / f"{name}.yaml"
        path.write_text(yaml.safe_dump(data))
        options += [f"--{option}", str(path)]
    return options


def record_elbows(folder: Path, workers: int) -> IdentificationDataset:
    """Record both elbow rolls, and a test run of a head joint with a motor of the same type."""
    # Half a run is enough to fit a model to.
    longer = SHORT.with_goals(dwell=(1.5, 2.0))
    joints = ["LElbowRoll", "RElbowRoll"]
    return record_joints("mujoco", joints, longer, folder, tested=["HeadPitch"], workers=workers)


def recorded_elbows(request: pytest.FixtureRequest) -> Path:
    """Their recordings, made by two processes."""
    return made_once(request, "elbows", lambda folder: record_elbows(folder, workers=2))


class SlowRobot(MockBackend):
    """Claims to be a real robot; its joints are where they were commanded three cycles ago."""

    identity = "body 1"

    def __init__(self) -> None:
        super().__init__(ROBOT, delay=3, real_time=True)

    @property
    def info(self) -> BackendInfo:
        return replace(super().info, response_delay=0, identity=self.identity)


class InterruptedRobot(SlowRobot):
    """The same; a person presses Ctrl-C in the middle of a run."""

    def read(self) -> Measurement:
        if len(self.commands) == 250:
            raise KeyboardInterrupt
        return super().read()


def use_backends(monkeypatch: pytest.MonkeyPatch, *kinds: type[MockBackend]) -> list[MockBackend]:
    """Whatever the URI says, robots are of these kinds: the first for what is known, then one for each run.

    Those that run let time pass only with their ticks, so that no test waits.

    Returns:
        The robots that were made, in order.
    """
    made: list[MockBackend] = []

    def make(uri: str, robot: RobotConfig | None = None) -> Backend:
        made.append(kinds[min(len(made), len(kinds) - 1)]())
        return made[-1]

    def make_running(uri: str, robot: RobotConfig | None = None) -> Backend:
        backend = make(uri, robot)
        backend.real_time = False
        return backend

    monkeypatch.setattr("pepper_driver.identification.identify.make_backend", make)
    monkeypatch.setattr("pepper_driver.robot.make_backend", make_running)
    monkeypatch.setattr("pepper_driver.identification.identify.check_dry_run", lambda run: None)
    return made
