"""Examination of a robot that does not move: an inspection of its measurements, then every check."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pepper_driver.backends import Backend, BackendInfo, make_backend
from pepper_driver.backends.readiness import (
    CheckResult,
    CheckStatus,
    check_battery,
    check_buttons,
    check_diagnosis,
    check_flap,
    check_limits,
    check_temperatures,
    failed,
    rated,
    unknown,
)
from pepper_driver.config import (
    DoctorSettings,
    PepperError,
    RobotConfig,
    SafetySettings,
    load_controller_settings,
    load_doctor_settings,
    load_robot,
    load_safety_settings,
)
from pepper_driver.doctor.checks import (
    Inspection,
    check_bumpers,
    check_clock,
    check_computer,
    check_imu,
    check_joints,
    check_models,
    check_samples,
    check_settings,
    check_touch,
    check_wheels,
)
from pepper_driver.observer import ModelFileError, ModelSet
from pepper_driver.observers import find_models
from pepper_driver.realtime import Pacer, RealTimePacer, realtime_process, realtime_thread


def inspect_robot(
    backend: Backend,
    robot: RobotConfig,
    seconds: float,
    on_progress: Callable[[float], None] | None = None,
) -> Inspection:
    """Open a robot and watch it; it is closed again, and was never active: nothing is sent to it.

    Args:
        backend: Closed.
        robot: Its description.
        seconds: How long [s].
        on_progress: Called with the fraction of the time that has passed, 0..1.

    Raises:
        PepperError: The robot refuses, or is lost.
    """
    pacer = Pacer()
    if backend.real_time:
        pacer = RealTimePacer(robot.cycle, backend, clock=backend.clock)
    report_progress = on_progress or (lambda fraction: None)
    ticks = round(seconds / robot.cycle)
    missed = 0
    try:
        samples = [backend.open()]
        diagnosis = backend.diagnosis()  # before the clock runs: it may take long
        with realtime_process(), realtime_thread():
            samples.append(backend.read())
            began = backend.clock.seconds()
            for tick in range(ticks):
                missed += pacer.wait()
                samples.append(backend.read())
                report_progress((tick + 1) / ticks)
            wall = backend.clock.seconds() - began
    finally:
        backend.close()
    return Inspection(
        samples=tuple(samples[1:]),  # the first may be from long before
        missed=missed,
        wall=wall if backend.real_time else None,
        diagnosis=diagnosis,
    )


@dataclass(frozen=True, kw_only=True)
class Examination:
    """Results of the checks of a robot that was not moved.

    Attributes:
        info: Of the backend.
        results: In the order of the checks.
        models: Of this robot; None without models.
        inspection: Measurements of the robot at rest; None where it did not answer.
    """

    info: BackendInfo
    results: tuple[CheckResult, ...]
    models: ModelSet | None
    inspection: Inspection | None

    @property
    def passed(self) -> bool:
        """True if no check failed: the robot may move."""
        return not failed(self.results)


def examine(
    uri: str = "mujoco",
    *,
    models: Path | None = None,
    unidentified: bool = False,
    robot: RobotConfig | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> Examination:
    """Inspection at a robot, at this computer and at the models. Nothing moves; what fails is in the results.

    Args:
        uri: The robot.
        models: Model file; None for the one shipped for this robot.
        unidentified: No models are looked for: this robot is about to be identified.
        robot: Its description, by default the shipped Pepper.
        on_progress: Called with the fraction of the time that has passed, 0..1.

    Raises:
        PepperError: The URI or a settings file is wrong, or a part of the package is missing.
    """
    robot = robot or load_robot()
    settings, safety = load_doctor_settings(), load_safety_settings()
    controller = load_controller_settings(robot)
    backend = make_backend(uri, robot)
    seen, results = _robot(backend, robot, settings, safety, on_progress)
    results += [check_settings(safety, controller), check_computer(backend)]
    found, result = None, unknown("models", "this robot is not identified yet")
    if not unidentified:
        found, result = _models(backend.info, models, robot)
    return Examination(info=backend.info, results=(*results, result), models=found, inspection=seen)


def _robot(
    backend: Backend,
    robot: RobotConfig,
    settings: DoctorSettings,
    safety: SafetySettings,
    on_progress: Callable[[float], None] | None,
) -> tuple[Inspection | None, list[CheckResult]]:
    """Return the measurements, and the checks of the connection and of what is measured over it."""
    info = backend.info
    if info.joint_names != robot.joint_names or info.cycle != robot.cycle:
        return None, [
            rated(
                "connection",
                "the robot has other joints, another order of them or another cycle than its description",
                failure=True,
                remedy="use the backend with the description of its robot",
            )
        ]
    try:
        seen = inspect_robot(backend, robot, settings.inspection_time, on_progress)
    except PepperError as error:
        return None, [
            rated(
                "connection",
                str(error),
                failure=True,
                remedy="switch the robot on, wait until it has started, and check address, network and password; "
                "no other program may move it",
            )
        ]
    connected = rated(
        "connection",
        f"'{info.identities[0].name}'; {len(info.joint_names)} joints every {info.cycle * 1e3:g} ms, "
        f"commands answered {info.response_delay} ticks later",
    )
    return seen, [connected, *_checks(seen, robot, settings, safety)]


def _checks(
    seen: Inspection, robot: RobotConfig, settings: DoctorSettings, safety: SafetySettings
) -> list[CheckResult]:
    return [
        check_clock(seen, robot, settings),
        check_samples(seen, robot, safety, settings),
        check_joints(seen, robot, settings),
        check_limits(seen.last.position, robot, safety),
        check_temperatures(seen.last.temperature, robot, safety),
        check_diagnosis(seen.diagnosis),
        check_battery(seen.last.battery, safety),
        check_flap(seen.last.charging_flap),
        check_wheels(seen, robot, settings),
        check_bumpers(seen, robot),
        check_buttons(seen.values("buttons"), robot, safety),
        check_touch(seen, robot),
        check_imu(seen, settings),
    ]


def _models(
    info: BackendInfo, path: Path | None, robot: RobotConfig
) -> tuple[ModelSet | None, CheckResult]:
    """Return the models of a robot, of any kind if they are in a file."""
    try:
        models = find_models(info.identities, path, "fusion", ("fusion", "affine", "cart"))
        models.check_robot(robot)
    except ModelFileError as error:
        found, _, remedy = str(error).rpartition("; ")
        return None, CheckResult(
            name="models", status=CheckStatus.FAILED, found=found or str(error), remedy=remedy
        )
    return models, check_models(models, info.identities, robot)
