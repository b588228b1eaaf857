"""Steps of a first hour on a robot: each opens it, and lets it go at its end."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import Protocol

from pepper_driver.backends import BackendInfo, Measurement, make_backend
from pepper_driver.backends.readiness import (
    CheckResult,
    CheckStatus,
    check_battery,
    check_temperatures,
    refuse_failed,
)
from pepper_driver.config import Experiment, RobotConfig, load_safety_settings
from pepper_driver.config.files import set_aside
from pepper_driver.config.workers import Workers
from pepper_driver.controller import Tick
from pepper_driver.doctor import examine, try_motion
from pepper_driver.doctor.bundle import write_bundle
from pepper_driver.doctor.motion_test import MotionTest, make_pepper
from pepper_driver.experiments.plan import plan_experiment
from pepper_driver.first_hour.bundle import PLACES
from pepper_driver.first_hour.operator import Operator
from pepper_driver.first_hour.plan import HourPlan, standing
from pepper_driver.first_hour.state import FirstHourError, ResultValue, StepName
from pepper_driver.identification import (
    Identification,
    fit_folder,
    read_manifest,
    record_joints,
)
from pepper_driver.identification import Progress as RecordingProgress
from pepper_driver.identification.dataset import load_measurement, recording_path
from pepper_driver.identification.measurements.program import WEIGHT, measure_robot
from pepper_driver.identification.runs import run_name
from pepper_driver.observer import Observation
from pepper_driver.observer.models.measured_robot import MeasuredRobot
from pepper_driver.recording.record import label_text, prompt_text, record_labelled
from pepper_driver.recording.terminal_keys import StopKey
from pepper_driver.robot import Pepper

OBSERVER = "fusion"


class Display(Protocol):
    """Display of what steps do and find."""

    def line(self, text: str) -> None:
        """Show a line."""

    def checks(self, results: Sequence[CheckResult]) -> None:
        """Show checks of the doctor."""

    def measured(self, robot: MeasuredRobot) -> None:
        """Show facts about a robot."""

    def identification(self, result: Identification) -> None:
        """Show models: how they fit, and what touch they notice."""

    def bar(self, what: str) -> AbstractContextManager[Callable[[float], None]]:
        """Show a bar while the block is open; what it yields takes the fraction that is done, 0..1."""

    def runs(
        self, operator: Operator
    ) -> AbstractContextManager[tuple[RecordingProgress, Operator]]:
        """Show the progress of runs; the second part asks the operator, and makes room for the question."""


def read_robot(uri: str, robot: RobotConfig) -> tuple[BackendInfo, Measurement]:
    """Connect to a robot, read it once, and let it go: nothing is sent to it.

    Raises:
        PepperError: It cannot be reached.
    """
    backend = make_backend(uri, robot)
    try:
        measurement = backend.open()
        return backend.info, measurement
    finally:
        backend.close()


def check_readiness(uri: str, robot: RobotConfig, identity: str) -> None:
    """Check that a robot is still the one that began, charged and cool, before it moves again.

    Raises:
        FirstHourError: It is not; the message has the remedy.
        PepperError: It cannot be reached.
    """
    info, measurement = read_robot(uri, robot)
    if info.identity != identity:
        raise FirstHourError(
            f"this is another robot than the one that began this hour ({info.identity}, not {identity}); connect to "
            "that one, or give another folder to --out"
        )
    safety = load_safety_settings()
    results = (
        check_battery(measurement.battery, safety),
        check_temperatures(measurement.temperature, robot, safety),
    )
    # Motors without a reading are a warning as well, but waiting does not help there.
    too_warm = (measurement.temperature >= safety.temperature_warning).any()
    for result in results:
        bad = result.status in (CheckStatus.WARNING, CheckStatus.FAILED)
        if bad and (result.name == "battery" or too_warm):
            raise FirstHourError(f"{result}; then go on")


@dataclass(frozen=True, kw_only=True)
class RobotSteps:
    """The steps, on one robot.

    Attributes:
        uri: Of the robot.
        info: Of its backend.
        robot: Its description.
        plan: What the steps are.
        folder: For what they record.
        archive: That is packed at the end.
        operator: Asked where a step needs a person.
        display: Where they show what they find.
        workers: Processes for the fit, -1 for one per core.
    """

    uri: str
    info: BackendInfo
    robot: RobotConfig
    plan: HourPlan
    folder: Path
    archive: Path
    operator: Operator
    display: Display
    workers: Workers = -1

    def actions(self) -> dict[StepName, Callable[[], Mapping[str, ResultValue]]]:
        """Return all steps by name."""
        return {
            "doctor": self.doctor,
            "measure": self.measure,
            "identify": self.identify,
            "rest": partial(self.watch, "rest", standing(self.plan.settings.rest)),
            "free": partial(self.watch, "free", self.plan.free),
            "touches": self.touches,
            "pack": self.pack,
        }

    # -- before models ------------------------------------------------------------------------------------------------

    def doctor(self) -> Mapping[str, ResultValue]:
        """Examine the robot at rest and in a small motion; what was seen is kept also where a check fails."""
        with self.display.bar("looking") as advance:
            seen = examine(self.uri, unidentified=True, robot=self.robot, on_progress=advance)
        self.display.checks(seen.results)
        moved = MotionTest(results=(), fits=())
        if seen.passed:
            pepper = make_pepper(self.uri, None, self.robot)
            with (
                StopKey(pepper.emergency_stop),
                self.display.bar("moving arms and head by a few degrees") as advance,
            ):
                moved = try_motion(pepper, None, on_progress=advance)
            self.display.checks(moved.results)
        report = self.folder / PLACES["doctor"]
        set_aside(report)
        write_bundle(report, self.uri, seen, moved)
        results = (*seen.results, *moved.results)
        refuse_failed("doctor", results)
        return {
            "checks": len(results),
            "warnings": tuple(
                result.name for result in results if result.status is CheckStatus.WARNING
            ),
        }

    def measure(self) -> Mapping[str, ResultValue]:
        """Measure the robot: delay, noise, friction, speed, and the scale of torques by a weight."""
        while True:
            self._record(measure_only=True)
            measured = measure_robot(
                load_measurement(self._recordings, self.robot),
                read_manifest(self._recordings).response_delay,
                self.robot,
                self.plan.weight,
            )
            doubt = measured.weight_doubt
            if doubt is None or not self._repeat([run_name(WEIGHT, 1)], doubt):
                break
        self.display.measured(measured)
        return {
            "delay_ticks": measured.response_delay,
            "reported_delay_ticks": measured.reported_delay,
            "late": measured.late,
            "lost": measured.lost,
            "limited": tuple(k for k, one in measured.joints.items() if one.speed_limited),
        }

    def identify(self) -> Mapping[str, ResultValue]:
        """Record free motion, fit models; runs that look touched may be recorded again, each once."""
        offered: set[str] = set()
        while True:
            self._record()
            with self.display.bar("fitting models: the robot rests meanwhile"):
                result = fit_folder(self._recordings, "fusion", compare=False, workers=self.workers)
            self.display.identification(result)
            touched = sorted(
                {one.run for one in result.findings if one.kind == "contact" and one.run}
            )
            again = offered.intersection(touched)
            if again:
                self.display.line(
                    f"{', '.join(sorted(again))}: looks touched again, and is kept; if nothing touched the robot, it "
                    "moves so by itself"
                )
            fresh = [run for run in touched if run not in offered]
            offered.update(fresh)
            look = "looks" if len(fresh) == 1 else "look"
            doubt = f"{', '.join(fresh)} {look} as if a person touched the robot"
            if not (fresh and self._repeat(fresh, doubt)):
                break
        models = self.folder / PLACES["models"]
        set_aside(models)
        result.models.save(models)
        return {
            "fit": _median([fit.test for fit in result.fits["fusion"].values()]),
            "threshold_deg": _median(
                [math.degrees(one.threshold) for one in result.sensitivities.values()]
            ),
            "blind": tuple(one.joint for one in result.blind if one.joint is not None),
            "touched": tuple(touched),
        }

    @property
    def _recordings(self) -> Path:
        return self.folder / PLACES["identification"]

    def _record(self, *, measure_only: bool = False) -> None:
        with self.display.runs(self.operator) as (progress, operator):
            record_joints(
                self.uri,
                self.plan.joints,
                self.plan.experiment,
                self._recordings,
                calibration=self.plan.calibration,
                measure=True,
                measure_only=measure_only,
                weight=self.plan.weight,
                seed=self.plan.experiment.seed,
                workers=self.workers,
                confirm=lambda run: operator.confirm(
                    f"Next, for {run.seconds:.0f} s: {run.watched}. Ready?"
                ),
                on_touch=lambda run, sensor: self.display.line(
                    f"{sensor} is pressed in run {run.name}: does a person touch the robot?"
                ),
                repeat=lambda run, sensors: operator.offer(
                    f"{', '.join(sensors)} pressed in run {run.name}. Record it again?"
                ),
                progress=progress,
            )

    def _repeat(self, runs: Sequence[str], doubt: str) -> bool:
        """Offer to record runs again; what was recorded is then set aside."""
        self.display.line(f"warning: {doubt}")
        if not self.operator.offer(
            "Record this again?" if len(runs) == 1 else "Record these again?"
        ):
            return False
        for run in runs:
            set_aside(recording_path(self._recordings, run))
        return True

    # -- with models --------------------------------------------------------------------------------------------------

    def watch(self, name: StepName, experiment: Experiment) -> Mapping[str, ResultValue]:
        """Play an experiment without a touch: all contacts are false."""
        log = self.folder / f"{name}.mcap"
        set_aside(log)
        links: list[str] = []
        pepper = Pepper(
            self.uri,
            observer=OBSERVER,
            models=self.folder / PLACES["models"],
            robot=self.robot,
        )
        plan = plan_experiment(experiment, self.robot, pepper.backend)

        def on_tick(tick: Tick, observation: Observation | None) -> None:
            for contact in () if observation is None else observation.contacts:
                if contact.phase == "begin":
                    links.append(contact.link)
                    self.display.line(f"{contact.time:8.2f} s  false contact at {contact.link}")

        with (
            self.display.bar(self.plan.step(name).title) as advance,
            StopKey(pepper.emergency_stop),
            pepper,
        ):
            pepper.start_log(log)
            pepper.play(plan, on_tick=on_tick, on_progress=advance)
        if links:
            self.display.line(
                f"if a person touched the robot, the same command with '--again {name}' makes this step again"
            )
        return {
            "false_contacts": len(links),
            "links": tuple(dict.fromkeys(links)),
            "seconds": experiment.max_length,
        }

    def touches(self) -> Mapping[str, ResultValue]:
        """Ask for touches, and label them."""
        log = self.folder / PLACES["touches"]
        set_aside(log)
        done = record_labelled(
            self.uri,
            log,
            self.plan.label,
            prompts=self.plan.prompts,
            observer=OBSERVER,
            models=self.folder / PLACES["models"],
            on_prompt=lambda number, prompt: self.display.line(prompt_text(number, prompt)),
            on_label=lambda label: self.display.line(label_text(label)),
        )
        if done.interrupt is not None:
            raise done.interrupt
        asked = len(self.plan.prompts.touches)
        if done.touches < asked:
            self.display.line(f"warning: {done.touches} of {asked} touches were labelled")
        return {"asked": asked, "touches": done.touches, "contacts": done.contacts}

    def pack(self) -> Mapping[str, ResultValue]:
        """Pack what can be sent."""
        from pepper_driver.first_hour.pack import pack_bundle

        pack_bundle(self.folder, self.archive, self.uri, self.info)
        size = self.archive.stat().st_size / 1e6
        self.display.line(
            f"archive: {self.archive}, {size:.0f} MB; look through it before you send it"
        )
        return {"megabytes": size}


def _median(values: Sequence[float]) -> float | None:
    return median(values) if values else None
