"""Experiments to be played, and robots without physics to play them: joints that are where they are sent."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from pepper_driver import Pepper
from pepper_driver.backends.mock import MockBackend
from pepper_driver.callbacks.events import CueEvent, StepEvent
from pepper_driver.config import Experiment, load_experiment, load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.loading import parse
from pepper_driver.controller import Tick
from pepper_driver.experiments.experiment import ExperimentRun
from pepper_driver.experiments.reports import ExperimentReport
from pepper_driver.observer import Contact, Observation
from pepper_driver.reflexes import Reflex
from support import ROOT
from support.events import Scripted
from support.events import make_pepper as make_scripted

ROBOT = load_robot()
CYCLE = ROBOT.cycle
YAW = ROBOT.joint_index("HeadYaw")
PITCH = ROBOT.joint_index("HeadPitch")
ARM = ["LShoulderPitch", "LShoulderRoll", "LElbowYaw", "LElbowRoll", "LWristYaw"]
PLACE = [0.25, 0.2, 0.85]
REACH = {"link": "l_wrist", "root": "base_link", "target": PLACE, "joints": ARM}
EXAMPLES = sorted((ROOT / "examples" / "experiments").glob("*.yaml"))
STAND: dict[str, Any] = {"name": "stand", "posture": "Stand", "duration": 0.1}
TURN: dict[str, Any] = {"name": "turn", "joints": {"HeadYaw": 0.2}, "duration": 0.5}

Script = Mapping[int, tuple[Contact, ...]]
"""Contacts by tick, counted from 1; an experiment begins with the first."""


def make_experiment(*steps: dict[str, Any], **more: Any) -> Experiment:
    return parse(Experiment, {"schema": 2, "name": "mine", "steps": list(steps), **more}, "mine")


def with_played(experiment: Experiment, **played: Experiment) -> Experiment:
    """An experiment whose reactions play others, by name."""
    reactions = tuple(
        replace(reaction, steps=played[reaction.play].steps) if reaction.play else reaction
        for reaction in experiment.reactions
    )
    return replace(experiment, reactions=reactions)


def listen(name: str = "listen", timeout: float = 0.6, **more: Any) -> dict[str, Any]:
    return {"name": name, "wait": {"timeout": timeout, **more}}


def write(folder: Path, *steps: dict[str, Any], file: str = "mine", **more: Any) -> Path:
    path = folder / f"{file}.yaml"
    content = {"schema": 2, "name": file, **more, "steps": list(steps)}
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


# -- robots ---------------------------------------------------------------------------------------------------------


def fake(
    monkeypatch: pytest.MonkeyPatch, backend: MockBackend | None = None
) -> tuple[MockBackend, Scripted]:
    """A robot without physics, and the contacts it detects, in place of all others."""
    backend, observer = backend or MockBackend(), Scripted()
    monkeypatch.setattr("pepper_driver.robot.make_backend", lambda *_: backend)
    monkeypatch.setattr("pepper_driver.robot.make_observer", lambda *_: observer)
    return backend, observer


def make_run(
    monkeypatch: pytest.MonkeyPatch,
    folder: Path,
    *steps: dict[str, Any],
    at: Script | None = None,
    backend: MockBackend | None = None,
    **more: Any,
) -> ExperimentRun:
    """An experiment in a file, whose robot detects what a test requests."""
    _, observer = fake(monkeypatch, backend)
    observer.at = dict(at or {})
    return ExperimentRun(load_experiment(write(folder, *steps, **more), ROBOT))


class Played:
    """An experiment that was played by a robot that detects what a test requests, in the robot's time.

    Attributes:
        report: What came of it; None where an error broke it off.
        error: The error.
        steps: Names of the steps, each with the tick in which it began.
        cues: Texts of words, each with its tick.
        position: (n, 17) the controller's own, after each tick [rad].
        twist: (n, 3) that of the base which was asked for.
        tasks: Names of the tasks in each tick.
        pepper: The robot, stopped.
        before, after: What the controller had before and after.
    """

    def __init__(
        self,
        experiment: Experiment,
        at: Script | None = None,
        *,
        reflexes: tuple[Reflex, ...] = (),
        on_tick: Callable[[Pepper, int], object] = lambda pepper, tick: None,
        rest: float = 0.0,
    ) -> None:
        self.pepper = pepper = make_scripted(dict(at or {}), reflexes=reflexes)
        steps: list[StepEvent] = []
        cues: list[CueEvent] = []
        pepper.on_step()(steps.append)
        pepper.on_cue()(cues.append)
        positions: list[FloatArray] = []
        twists: list[FloatArray] = []
        self.tasks: list[set[str]] = []
        self.report: ExperimentReport | None = None
        self.error: BaseException | None = None

        def note(tick: Tick, observation: Observation | None) -> None:
            positions.append(pepper.controller.position)
            twists.append(pepper.controller.base_velocity.target.copy())
            self.tasks.append({task.name for task in pepper.controller.tasks})
            on_tick(pepper, tick.measurement.tick)

        try:
            with pepper:
                self.before = snapshot(pepper)
                try:
                    self.report = pepper.play(experiment, on_tick=note)
                finally:
                    self.after = snapshot(pepper)
                if rest:
                    pepper.run(rest, on_tick=note)
        except (Exception, KeyboardInterrupt) as error:
            self.error = error
        self.position, self.twist = np.array(positions), np.array(twists)
        self.steps = [(event.step, round(event.time / CYCLE)) for event in steps]
        self.cues = [(str(event), round(event.time / CYCLE)) for event in cues]

    @property
    def done(self) -> ExperimentReport:
        """The report of an experiment that came to its end."""
        if self.error is not None:
            raise self.error
        assert self.report is not None
        return self.report

    @property
    def words(self) -> list[str]:
        return [text for text, _ in self.cues]

    @property
    def names(self) -> list[str]:
        return [name for name, _ in self.steps]

    @property
    def velocity(self) -> FloatArray:
        """(n - 1, 17) between ticks [rad/s]."""
        velocity: FloatArray = np.diff(self.position, axis=0) / CYCLE
        return velocity


# -- looks at robots ------------------------------------------------------------------------------------------------


def wrist(pepper: Pepper, link: str = "l_wrist") -> FloatArray:
    """(3,) in base_link, from the joints alone."""
    return pepper.controller.model.link_pose(link, pepper.controller.position)[:3, 3]


class Trace:
    """One number after each tick."""

    def __init__(self, value: Callable[[], float]) -> None:
        self.values: list[float] = []
        self._value = value

    def __call__(self, tick: Tick, observation: Observation | None) -> None:
        self.values.append(self._value())


def snapshot(pepper: Pepper) -> tuple[object, ...]:
    """All that an experiment must leave as it was."""
    own = pepper.controller.base_velocity
    return (
        pepper.controller.tasks,
        own.weight,
        own.target.tolist(),
        pepper.controller.posture.weight,
        pepper._loop.arbiter.posture_stiffness,
        pepper._loop.arbiter.attentive,
    )
