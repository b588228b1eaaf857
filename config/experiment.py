"""Experiments: what the robot does, how it reacts to touch, and what touches it; checked before anything moves."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.errors import ConfigError, suggestion
from pepper_driver.config.experiment_steps import (
    AnyPush,
    AnyStep,
    ContactWait,
    PlayedStep,
    WaitStep,
    count,
    flatten,
    is_open,
    longest,
    motion_of,
)
from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import STRICT, by_kind, parse, read_yaml
from pepper_driver.config.motion import Motion, MotionStep, check_step
from pepper_driver.config.motion_tasks import Label
from pepper_driver.config.robot import RobotConfig

USUAL_LONGEST = 3600.0
"""[s] An experiment may take, unless it says more."""

DAY = 24 * 3600.0
"""[s] No experiment takes longer."""

MOST_STEPS = 20_000
"""Played in one experiment, with all repetitions."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ObserverChoice:
    """Name of an observer, and its model file, beside the experiment's; None for the one shipped for the robot."""

    mode: Label = "fusion"
    models: str | None = None


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Experiment:
    """Steps one after the other, with reflexes and pushes.

    Attributes:
        schema: Of this form of file.
        name: As it is called.
        description: What it is for, for people.
        observer: What feels the touches; None for nobody.
        reflexes: As the file has them; ``pepper_driver`` knows which there are.
        pushes: What a simulated backend does to the robot. Others skip them.
        steps: With repetitions.
        longest: It is refused if it may take longer [s].
        source: The file it came from, for messages.
    """

    schema: Literal[1]
    name: Label
    description: str = ""
    observer: ObserverChoice | None = ObserverChoice()
    reflexes: Annotated[tuple[dict[str, Any], ...], Field(max_length=100)] = ()
    pushes: Annotated[tuple[Annotated[AnyPush, by_kind(AnyPush)], ...], Field(max_length=1000)] = ()
    steps: Annotated[tuple[AnyStep, ...], Field(min_length=1)]
    longest: Annotated[float, Field(gt=0, le=DAY)] = USUAL_LONGEST
    source: str = ""

    @property
    def length(self) -> float:
        """It is over after this time at the latest [s], unless a reflex holds the robot."""
        return longest(self.steps)

    @cached_property
    def played(self) -> tuple[tuple[str, PlayedStep], ...]:
        """The steps as they are played, each with the key where the file has it."""
        return tuple(flatten(self.steps))

    @cached_property
    def starts(self) -> tuple[float, ...]:
        """When each of them begins if each takes its longest, from the beginning [s]."""
        ends = accumulate((motion_of(step).longest for _, step in self.played), initial=0.0)
        return tuple(ends)[:-1]

    @cached_property
    def written(self) -> dict[str, PlayedStep]:
        """The steps by the key where the file has them, each once."""
        return dict(self.played)

    @cached_property
    def order(self) -> tuple[int, ...]:
        """Which of the written steps are played one after the other."""
        number = {key: number for number, key in enumerate(self.written)}
        return tuple(number[key] for key, _ in self.played)

    @cached_property
    def motion(self) -> Motion:
        """What the robot does in the written steps."""
        steps = tuple(motion_of(step) for step in self.written.values())
        return Motion(schema=1, name=self.name, steps=steps, source=self.source)

    def error(self, key: str, problem: str) -> ConfigError:
        """That a value is wrong."""
        return ConfigError(f"{self.source or self.name}: key '{key}': {problem}")

    def step_of(self, push: AnyPush) -> int | None:
        """Number, as played, of the first step that a push is in; None where there is none."""
        if push.step is not None:
            names = (number for number, (_, s) in enumerate(self.played) if s.name == push.step)
            return next(names, None)
        begun = [number for number, start in enumerate(self.starts) if start <= push.start]
        return begun[-1] if push.start + push.duration <= self.length else None


@with_lines
def load_experiment(path: str | Path, robot: RobotConfig) -> Experiment:
    """Load an experiment from a path.

    Raises:
        ConfigError: The file is wrong; the message names file, line, key and cure.
    """
    source = str(path)
    experiment = parse(Experiment, {**read_yaml(Path(path)), "source": source}, source)
    check_experiment(experiment, robot)
    return experiment


def check_experiment(experiment: Experiment, robot: RobotConfig) -> None:
    """Refuse what is wrong with steps and pushes, as far as the description of the robot tells.

    Raises:
        ConfigError: The message names the key.
    """
    if experiment.length > experiment.longest:
        raise experiment.error(
            "longest" if experiment.longest != USUAL_LONGEST else "steps",
            f"may take {experiment.length:.0f} s, with all repetitions and timeouts, which is more than"
            f" {experiment.longest:g} s; set 'longest' to allow more, up to {DAY:g} s",
        )
    if (steps := count(experiment.steps)) > MOST_STEPS:
        raise experiment.error("steps", f"{steps} with all repetitions; at most {MOST_STEPS}")
    for key, step in experiment.written.items():
        if isinstance(step, MotionStep):
            check_step(step, robot, f"{experiment.source or experiment.name}: key '{key}")
        elif isinstance(step, WaitStep):
            _check_wait(experiment, key, step, robot)
    if experiment.observer is None and experiment.reflexes:
        raise experiment.error("reflexes", "nobody feels what they answer to: there is no observer")
    for number, push in enumerate(experiment.pushes):
        _check_push(experiment, f"pushes.{number}", push, robot)
    _check_hands(experiment)


def _check_wait(experiment: Experiment, key: str, step: WaitStep, robot: RobotConfig) -> None:
    wait = step.wait
    if not isinstance(wait, ContactWait):
        return
    if experiment.observer is None:
        raise experiment.error(
            f"{key}.wait.for", "nobody feels contacts: the experiment has no observer"
        )
    _check_names(
        experiment,
        (
            (f"{key}.wait.link", "link", wait.link, robot.links),
            (f"{key}.wait.joint", "joint", wait.joint, robot.joint_names),
        ),
    )


def _check_push(experiment: Experiment, key: str, push: AnyPush, robot: RobotConfig) -> None:
    names = {step.name for _, step in experiment.played if step.name is not None}
    _check_names(
        experiment,
        (
            (f"{key}.link", "link", push.link, robot.links),
            (f"{key}.joint", "joint", push.joint, robot.joint_names),
            (f"{key}.step", "step", push.step, sorted(names)),
        ),
    )
    number = experiment.step_of(push)
    if number is None:
        raise experiment.error(
            key, f"ends after the experiment, which is over at {experiment.length:g} s"
        )
    if push.step is None:
        for before, step in experiment.played[:number]:
            if is_open(step):
                raise experiment.error(
                    key,
                    f"nobody knows what the robot does at {push.start:g} s: '{before}' lasts as long as it takes;"
                    " give 'step', with whose beginning 'start' counts",
                )
    else:
        where = {where for where, step in experiment.played if step.name == push.step}
        if len(where) > 1:
            raise experiment.error(
                f"{key}.step",
                f"{len(where)} steps are called '{push.step}'; give them different names",
            )
        length = motion_of(experiment.played[number][1]).longest
        if push.start + push.duration > length:
            raise experiment.error(
                key,
                f"ends at {push.start + push.duration:g} s, after step '{push.step}', which is over at {length:g} s",
            )
    moving = (motion_of(step) for _, step in experiment.played[: number + 1])
    if not any(step.posture is not None for step in moving):
        raise experiment.error(
            key,
            "pushes are planned for a known posture, and no step up to it has a 'posture'; begin with one",
        )


def _check_hands(experiment: Experiment) -> None:
    """No two hands on one link at a time."""
    pushes = list(enumerate(experiment.pushes))
    for number, push in pushes:
        for other, earlier in pushes[:number]:
            if (push.step, push.link) == (earlier.step, earlier.link) and (
                push.start < earlier.start + earlier.duration
                and earlier.start < push.start + push.duration
            ):
                raise experiment.error(
                    f"pushes.{number}",
                    f"a hand on {push.link} at {push.start:g} s, where that of 'pushes.{other}' is still",
                )


def _check_names(
    experiment: Experiment, names: Iterable[tuple[str, str, str | None, Iterable[str]]]
) -> None:
    for key, kind, name, known in names:
        if name is not None and name not in known:
            raise experiment.error(key, f"unknown {kind} '{name}'{suggestion(name, known)}")
