"""Plan of a first hour: what each step is, what a person does in it, and how long both take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pepper_driver.config import Experiment, RobotConfig, load_doctor_settings, load_experiment
from pepper_driver.config.files import content_hash
from pepper_driver.config.first_hour import FirstHourSettings
from pepper_driver.config.steps import Step
from pepper_driver.config.touch_prompts import TouchPrompts, load_touch_prompts
from pepper_driver.doctor.motion_test import RESPONSE_TIME
from pepper_driver.first_hour.state import STEPS, StepName
from pepper_driver.identification.dataset import experiment_hash
from pepper_driver.identification.measurements.friction import HeldWeight
from pepper_driver.identification.runs import (
    IdentificationRun,
    plan_measurements,
    plan_runs,
    sweeps_of,
)
from pepper_driver.recording.record import step_to_stand

BY_KEY = "key"
"""Source of labels that is the space bar, which then does not stop the robot; q does."""


@dataclass(frozen=True, kw_only=True)
class PlannedStep:
    """One step.

    Attributes:
        name: Of the step.
        title: In few words.
        robot: Time of the robot [s].
        hands: Time for which a person's hands are needed [s].
        do: What a person does before and meanwhile.
        stop: What a person holds, or has within reach, to stop the robot.
        normal: What is normal.
    """

    name: StepName
    title: str
    robot: float
    hands: float
    do: str
    stop: str
    normal: str

    @property
    def moves(self) -> bool:
        """True where the robot moves, or stands with stiffness."""
        return self.robot > 0.0


@dataclass(frozen=True, kw_only=True)
class HourPlan:
    """All that is decided about an hour before it begins.

    Attributes:
        settings: Names and times.
        experiment: Sweeps, from which models are identified.
        calibration: Free motion, on which thresholds are chosen.
        free: Free motion, in which false contacts are counted.
        prompts: Touches that are asked for.
        label: Source of their labels.
        weight: That a person hangs into a hand; None for none.
        runs: By step, those of the identification.
        steps: In their order.
    """

    settings: FirstHourSettings
    experiment: Experiment
    calibration: Experiment
    free: Experiment
    prompts: TouchPrompts
    label: str
    weight: HeldWeight | None
    runs: Mapping[StepName, tuple[IdentificationRun, ...]]
    steps: tuple[PlannedStep, ...]

    def step(self, name: StepName) -> PlannedStep:
        """Return one step."""
        return self.steps[STEPS.index(name)]

    @property
    def robot(self) -> float:
        """Time of the robot in all [s]."""
        return sum(step.robot for step in self.steps)

    @property
    def hands(self) -> float:
        """Time of a person's hands in all [s]."""
        return sum(step.hands for step in self.steps)

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that are identified."""
        return tuple(sweeps_of(self.experiment).joints)

    def hash(self) -> str:
        """Hash of what the robot does, wherever the files of its motions are; times of persons do not count."""
        motions = [experiment_hash(one) for one in (self.experiment, self.calibration, self.free)]
        return content_hash([self.settings.version, self.settings.rest, motions])


def standing(seconds: float) -> Experiment:
    """Return the experiment in which the robot stands for a time [s]."""
    return Experiment(schema=2, name="rest", steps=(step_to_stand(), Step(hold=seconds)))


def plan_hour(
    robot: RobotConfig,
    settings: FirstHourSettings,
    *,
    label: str,
    weight: HeldWeight | None = None,
    prompts: str | None = None,
) -> HourPlan:
    """Plan all steps, down to each run.

    Args:
        robot: Its description.
        settings: Names and times.
        label: Source of the labels of touches.
        weight: Known weight for a hand; None for none.
        prompts: Name or file of the touches; None for those of the settings.

    Raises:
        PepperError: An experiment or prompts do not exist, or are wrong.
    """
    experiment = load_experiment(settings.experiment, robot)
    calibration = load_experiment(settings.calibration, robot)
    free = load_experiment(settings.free, robot)
    asked = load_touch_prompts(robot, prompts or settings.prompts)
    joints = sweeps_of(experiment).joints
    measurements = plan_measurements(robot, experiment.seed, weight=weight)
    swept = plan_runs(robot, joints, experiment, calibration=calibration, seed=experiment.seed)
    runs: dict[StepName, tuple[IdentificationRun, ...]] = {
        "measure": measurements,
        "identify": swept,
    }
    doctor = load_doctor_settings()
    seconds: dict[StepName, float] = {
        "doctor": doctor.inspection_time + doctor.motion + RESPONSE_TIME + 2 * settings.session,
        **{name: _with_sessions(made, settings) for name, made in runs.items()},
        "rest": standing(settings.rest).max_length + settings.session,
        "free": free.max_length + settings.session,
        "touches": step_to_stand().max_duration + asked.seconds + settings.session,
        "pack": 0.0,
    }
    hands = {name: settings.confirmation if seconds[name] else 0.0 for name in STEPS}
    hands["measure"] += settings.confirmation  # before the fast arms
    if weight is not None:
        hands["measure"] += settings.weighing
    hands["touches"] += asked.seconds
    return HourPlan(
        settings=settings,
        experiment=experiment,
        calibration=calibration,
        free=free,
        prompts=asked,
        label=label,
        weight=weight,
        runs=runs,
        steps=tuple(
            PlannedStep(name=name, robot=seconds[name], hands=hands[name], **_words(name, label))
            for name in STEPS
        ),
    )


def _with_sessions(runs: tuple[IdentificationRun, ...], settings: FirstHourSettings) -> float:
    return sum(run.seconds + settings.session for run in runs)


STOP = "one hand at the emergency stop; space bar, q or chest button"

_WORDS: dict[StepName, dict[str, str]] = {
    "doctor": {
        "title": "look at the robot, then a small motion",
        "do": "level floor, two metres clear around, hands empty, charging flap closed; touch nothing",
        "normal": "no check FAILED; the delay is 2 to 8 ticks; arms and head move by 5 degrees, then step by 2",
    },
    "measure": {
        "title": "delay, friction and speed",
        "do": "stay away from the arms: they sweep slowly, then fast, out to the front; hang the weight when asked",
        "normal": "friction 0.05 to 2 N m; a torque/load of 1 to 3; arms reach 1.5 rad/s or more",
    },
    "identify": {
        "title": "free motion of arms and head, and the fit",
        "do": "take the weight out of the hand, if one hangs there; touch nothing; then the computer computes for some "
        "minutes, the robot rests meanwhile",
        "normal": "models explain 60 % and more; thresholds below 3 deg or 2 N m at shoulders and elbows",
    },
    "rest": {
        "title": "stand, observer on",
        "do": "touch nothing, do not walk near the arms",
        "normal": "no contact, or one",
    },
    "free": {
        "title": "free motion, observer on",
        "do": "touch nothing, stay out of reach",
        "normal": "no contact, or a few",
    },
    "touches": {
        "title": "touches that the robot asks for",
        "do": "touch where the robot says, as it says; let go before the next one",
        "normal": "firm touches are detected, half of the light ones are not",
    },
    "pack": {
        "title": "pack what can be sent",
        "do": "nothing",
        "normal": "an archive of 100 to 300 MB",
    },
}


def _words(name: StepName, label: str) -> dict[str, str]:
    stop = STOP
    if name == "pack":
        stop = "none: the robot does not move"
    elif name == "touches" and label == BY_KEY:
        stop = "one hand at the emergency stop; q or chest button: the space bar labels touches"
    return {**_WORDS[name], "stop": stop}
