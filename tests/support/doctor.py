"""Robots for the doctor: well and sick ones without physics, and models that say they are theirs."""

from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends import Backend, DeviceError, Measurement
from pepper_driver.backends.mock import Fault, MockBackend
from pepper_driver.config import RobotConfig, load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.clock import SYSTEM_CLOCK, Clock
from pepper_driver.doctor import CheckResult, Examination, examine
from pepper_driver.observer import ModelSet
from pepper_driver.observer.models.model_file import shipped

ROBOT = load_robot()
TICKS = 3000


class Patient(MockBackend):
    """A robot that is sick all the time, or in one tick; ``errors`` is what its own diagnosis says."""

    def __init__(
        self,
        sickness: Fault | None = None,
        *,
        tick: int | None = None,
        errors: tuple[DeviceError, ...] | None = None,
        real_time: bool = False,
        opens: Callable[[], None] | None = None,
    ) -> None:
        sick = range(TICKS) if tick is None else (tick,)
        faults = None if sickness is None else dict.fromkeys(sick, sickness)
        super().__init__(ROBOT, faults=faults, real_time=real_time)
        self._errors, self._opens = errors, opens

    def open(self) -> Measurement:
        if self._opens is not None:
            self._opens()
        return super().open()

    def diagnosis(self) -> tuple[DeviceError, ...] | None:
        return self._errors

    @property
    def moved(self) -> bool:
        """True if it was made stiff, or got any command that could move it."""
        return "activate" in self.calls or any(
            command.stiffness.any() or command.wheel_speed.any() for command in self.commands
        )


def use(monkeypatch: pytest.MonkeyPatch, backend: Backend) -> None:
    """Whatever the URI says, this is the robot; no caller waits for the time."""

    def make(uri: str, robot: RobotConfig | None = None) -> Backend:
        return backend

    monkeypatch.setattr("pepper_driver.doctor.examination.make_backend", make)
    monkeypatch.setattr("pepper_driver.robot.make_backend", make)
    if backend.clock is SYSTEM_CLOCK:
        backend.clock = passing_clock()


def passing_clock(oversleep: float = 0.0) -> Clock:
    """Return a clock by which no one waits: time passes when a thread sleeps, and some more [s]."""
    passed = [0.0]

    def sleep(seconds: float) -> None:
        passed[0] += seconds + oversleep

    return Clock(now=lambda: round(1e9 * passed[0]), sleep=sleep)


def models_for(identity: str, folder: Path) -> Path:
    """The nominal plant's models, as if they had been identified on another robot."""
    path = folder / "models.json"
    replace(ModelSet.load(shipped("fusion")["nominal"]), identity=identity).save(path)
    return path


def examined(monkeypatch: pytest.MonkeyPatch, backend: Backend, models: Path) -> Examination:
    use(monkeypatch, backend)
    return examine("mock", models=models)


def named(examination: Examination, name: str) -> CheckResult:
    """The result of one check."""
    (result,) = (result for result in examination.results if result.name == name)
    return result


def field(name: str, value: Any) -> Fault:
    """The measurement has another value."""
    return lambda measurement: replace(measurement, **{name: value})


def shifted_clock(seconds: float) -> Fault:
    return lambda measurement: replace(measurement, time=measurement.time + seconds)


def lost(joint: int) -> Fault:
    def change(measurement: Measurement) -> Measurement:
        position = measurement.position.copy()
        position[joint] = np.nan
        return replace(measurement, position=position)

    return change


def held(joint: int, angle: float) -> Fault:
    def change(measurement: Measurement) -> Measurement:
        position = measurement.position.copy()
        position[joint] = angle
        return replace(measurement, position=position)

    return change


def inertial(**changes: FloatArray) -> Fault:
    return lambda measurement: replace(measurement, imu=replace(measurement.imu, **changes))


def only(models: ModelSet, joints: Collection[str]) -> ModelSet:
    """The models of some joints."""
    parts: dict[str, Any] = {
        name: {j: v for j, v in getattr(models, name).items() if j in joints}
        for name in ("models", "estimation_fit", "test_fit", "threshold")
    }
    return replace(models, **parts)
