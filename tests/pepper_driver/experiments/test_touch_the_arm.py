"""The shipped experiment of a moving arm: a light push on its hand is followed, a strong one makes it retract."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import pytest

from pepper_driver import Contact, CueEvent, ExperimentRun, Observation, ReflexEvent
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.config import Experiment, load_experiment, load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.steps import RepeatStep
from pepper_driver.controller import RobotModel, Tick
from support import ROOT
from support.stand_ins import PATIENT, patient_driver

ROBOT = load_robot()
MODEL = RobotModel(ROBOT)
SEED = 1
FILE = ROOT / "examples" / "experiments" / "touch_the_arm.yaml"
HAND, POINT = "l_wrist", np.array([0.07, 0.0, 0.0])  # [m] in the link
LIGHT, STRONG = 10.0, 25.0
"""[N] Without doubt in the tables of docs/results/touch_the_arm.md: light sideways, strong inwards. Else it depends."""
PUSH_TIME, GRACE = 1.0, 0.15  # [s]
MOVED = 0.01  # [m]
SENTENCE = "You are touching my arm."
INWARDS = np.array([0.0, -1.0, 0.0])
SIDEWAYS = {"outwards": -INWARDS, "inwards": INWARDS}


@dataclass
class Story:
    """Events of a run, and the measured posture tick by tick; times since the first tick [s]."""

    cues: list[CueEvent] = field(default_factory=list)
    reflexes: list[ReflexEvent] = field(default_factory=list)
    contacts: list[Contact] = field(default_factory=list)
    time: list[float] = field(default_factory=list)
    posture: list[FloatArray] = field(default_factory=list)

    def begun(self, kind: str, begin: float, end: float) -> bool:
        return any(
            e.kind == kind and e.phase == "begin" and begin < e.time < end for e in self.reflexes
        )

    def at(self, time: float) -> FloatArray:
        return self.posture[int(np.searchsorted(self.time, time))]


def short(times: int) -> Experiment:
    """The experiment with fewer rounds."""
    whole = load_experiment(FILE, ROBOT)
    steps = [
        replace(step, repeat=replace(step.repeat, times=times))
        if isinstance(step, RepeatStep)
        else step
        for step in whole.steps
    ]
    return replace(whole, steps=tuple(steps))


def played(run: ExperimentRun, pushes: dict[float, FloatArray]) -> Story:
    """The story of an experiment in which the hand is pushed, by time since its beginning [s]."""
    pepper, story = run.pepper, Story()
    pepper.on_cue(kind="say")(story.cues.append)
    pepper.on_reflex(phase=None)(story.reflexes.append)
    pepper.on_contact(phase=None)(story.contacts.append)
    left = sorted(pushes.items())
    first: list[float] = []

    def on_tick(tick: Tick, observation: Observation | None) -> None:
        now = tick.measurement.time
        first.append(now)
        story.time.append(now - first[0])
        story.posture.append(tick.measurement.position)
        if left and now - first[0] >= left[0][0]:
            pepper.backend.push(HAND, left.pop(0)[1], POINT, PUSH_TIME)

    report = run.perform(on_tick=on_tick)
    assert report.completed
    story.cues = [replace(e, time=e.time - first[0]) for e in story.cues]
    story.reflexes = [replace(e, time=e.time - first[0]) for e in story.reflexes]
    return story


@cache
def untouched(robot: str) -> Story:
    story = played(ExperimentRun(short(2), robot), {})
    assert [*story.cues, *story.reflexes, *story.contacts] == []
    return story


def moved(story: Story, robot: str, begin: float, way: FloatArray) -> float:
    """Way of the hand along a push, beyond that on which the untouched motion would have led it from there [m]."""
    end, free = begin + PUSH_TIME, untouched(robot)
    pushed, led = (
        MODEL.link_pose(HAND, q) @ np.append(POINT, 1.0)
        for q in (story.at(end), story.at(begin) + free.at(end) - free.at(begin))
    )
    return float((pushed - led)[:3] @ way)


def check(story: Story, robot: str, begin: float, way: FloatArray, *, strong: bool) -> None:
    """Sentence, following and retreat after one push that began at a time, along a direction."""
    over = begin + PUSH_TIME + GRACE
    assert {c.text for c in story.cues if begin < c.time < over} == {SENTENCE}
    assert story.begun("follow_hand", begin, over)
    assert story.begun("retract", begin, over) == strong
    assert moved(story, robot, begin, way) > MOVED


@pytest.mark.parametrize("plant", ["nominal", pytest.param("integral", marks=pytest.mark.whole)])
@pytest.mark.parametrize("direction", SIDEWAYS)
def test_in_simulation(plant: str, direction: str) -> None:
    """In the middle of a step each; the observer of ``nominal`` misses pushes in the first seconds of motion."""
    robot, way = f"mujoco://?plant={plant}&seed={SEED}", SIDEWAYS[direction]
    story = played(ExperimentRun(short(2), robot), {13.0: LIGHT * way, 21.0: STRONG * INWARDS})
    check(story, robot, 13.0, way, strong=False)
    check(story, robot, 21.0, INWARDS, strong=True)
    assert {c.limb for c in story.contacts if c.phase == "begin"} <= {"left_arm", "trunk"}


@pytest.mark.whole
@pytest.mark.parametrize("where", ["paced", "stand-in"])
def test_unchanged_in_real_time(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = f"mujoco://?plant=integral&seed={SEED}"
    untouched(robot)
    monkeypatch.setattr("pepper_driver.robot.load_safety_settings", lambda *_: PATIENT)
    pushes = {5.0: LIGHT * INWARDS, 13.0: STRONG * INWARDS}
    if where == "paced":
        story = played(ExperimentRun(short(1), robot, real_time=True), pushes)
    else:
        with patient_driver(), StandIn(robot, consent=True) as stand_in:
            uri = f"naoqi://127.0.0.1:{stand_in.port}?wake=1"
            story = played(ExperimentRun(short(1), uri), pushes)
    check(story, robot, 5.0, INWARDS, strong=False)
    check(story, robot, 13.0, INWARDS, strong=True)


def test_file_is_as_short_as_the_docs_say() -> None:
    lines = [line for line in FILE.read_text().splitlines() if line and not line.startswith("#")]
    assert len(lines) <= 20
