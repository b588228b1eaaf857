"""Records a run with labels: when the robot was really touched, as a key, a touch sensor or a bumper reported it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from pepper_driver.backends import Measurement
from pepper_driver.config import Experiment, load_robot
from pepper_driver.config.arguments import as_path, checked_arguments, is_number
from pepper_driver.config.errors import shown
from pepper_driver.config.steps import Step
from pepper_driver.config.touch_prompts import TouchPrompt, TouchPrompts
from pepper_driver.controller import Tick
from pepper_driver.experiments.plan import experiment_uri, plan_experiment
from pepper_driver.log import Label
from pepper_driver.observer import Observation
from pepper_driver.recording.labels import (
    LabelError,
    Labeller,
    PromptedLabeller,
    make_labeller,
)
from pepper_driver.recording.terminal_keys import SpaceBar, StopKey
from pepper_driver.robot import Pepper


def step_to_stand() -> Step:
    """Return the step to the posture in which a robot asks for touches."""
    # Not a constant: pydantic would look up the types of its fields among the names of this module.
    return Step(posture="Stand", duration=3.0)


@dataclass(frozen=True, kw_only=True)
class LabelledRun:
    """Result of a labelled run.

    Attributes:
        seconds: Length [s].
        touches: Number of onsets.
        released: Whether the last touch was over at the end.
        interrupt: What ended it early, Ctrl-C or a signal; None where nothing did.
        missing: Ticks that did not get into the log.
        contacts: That an observer detected meanwhile; None without one.
    """

    seconds: float
    touches: int
    released: bool
    interrupt: KeyboardInterrupt | None
    missing: int
    contacts: int | None = None


def prompted_experiment(prompts: TouchPrompts) -> Experiment:
    """Return the experiment in which a robot that stands asks for touches."""
    pause = (Step(hold=prompts.rest),) if prompts.rest > 0.0 else ()
    asking = tuple(Step(say=touch.say, hold=prompts.time) for touch in prompts.touches)
    return Experiment(
        schema=2, name="prompted touches", observer=None, steps=(*pause, *asking, *pause)
    )


def prompt_text(number: int, prompt: TouchPrompt) -> str:
    """Return a line that asks for a touch; ``number`` is from 0 on."""
    force = "" if prompt.force is None else f" ({prompt.force:g} N)"
    return f"{number + 1:3d}. {prompt.say}{force}"


def label_text(label: Label) -> str:
    """Return a line that confirms a label."""
    return f"{label.time:8.2f} s  {label.phase}"


@checked_arguments
def record_labelled(
    uri: str,
    out: Path | str,
    source: str,
    *,
    experiment: Experiment | None = None,
    prompts: TouchPrompts | None = None,
    seconds: float | None = None,
    seed: int | None = None,
    link: str | None = None,
    joint: str | None = None,
    observer: str | None = None,
    models: Path | str | None = None,
    on_prompt: Callable[[int, TouchPrompt], None] | None = None,
    on_label: Callable[[Label], None] | None = None,
    on_start: Callable[[Pepper], None] | None = None,
) -> LabelledRun:
    """Run the robot, log every tick, and label touches in the log. Ctrl-C or a signal ends it; what was recorded stays.

    In a terminal the space bar and q stop the robot; where the space bar labels touches, q alone does.

    Args:
        uri: The robot. A simulated one runs in real time where the labels come from a key.
        out: The log; an existing file is replaced once the robot is there.
        source: Where the labels come from, see :func:`pepper_driver.recording.labels.make_labeller`.
        experiment: Played again and again until ``seconds`` are over, or once; its reactions are left out.
        prompts: Touches that the robot asks for, in place of an experiment; they name the links. The robot takes its
            posture before, which is not in the log.
        seconds: Time for which it holds its posture, or plays at least [s].
        seed: Of the experiment's random goals; None for its own.
        link: What is touched; in place of the link of the sensor.
        joint: The last joint that moves it.
        observer: Name of one that runs meanwhile; None for none.
        models: Its model file, by default the one shipped for this robot.
        on_prompt: Called with number and prompt when its time has come, inside the tick: must be quick.
        on_label: Called with each label, inside the tick: must be quick.
        on_start: Given the robot when it is ready: to push a simulated one, for example.

    Raises:
        LabelError: No terminal for keys, an invalid time, or no end of the recording.
        PepperError: The robot or the log cannot be opened, or the robot stopped.
    """
    out = as_path("out", out)
    if seconds is not None and not (is_number(seconds) and 0 < seconds < math.inf):
        raise LabelError(f"seconds must be a time above 0, got {shown(seconds)}")
    if prompts is not None:
        if any(given is not None for given in (experiment, seconds, seed, link, joint)):
            raise LabelError(
                "prompts have a motion, times and places of their own: leave those out"
            )
        experiment = prompted_experiment(prompts)
    if experiment is None and seed is not None:
        raise LabelError("a seed is for an experiment: leave it out")
    if experiment is None and seconds is None:
        raise LabelError("give seconds to hold the posture for, or an experiment")
    length = 0.0 if seconds is None else seconds
    robot = load_robot()
    by_key = source == "key"
    space_bar = SpaceBar(lambda what: pepper.emergency_stop(what))
    labeller: Labeller | PromptedLabeller
    if prompts is None:
        labeller = make_labeller(source, robot, space_bar, link=link, joint=joint)
    else:
        labeller = PromptedLabeller(source, prompts, robot, space_bar)
    if experiment is not None:
        uri = experiment_uri(uri, experiment)
    pepper = Pepper(uri, observer=observer, models=models, robot=robot, real_time=by_key)
    plan = None
    if experiment is not None:
        experiment = replace(experiment, reactions=())
        plan = plan_experiment(experiment, robot, pepper.backend, seed=seed)
    ticks = touches = contacts = 0
    made: deque[Label] = (
        deque()
    )  # also by the ticks between the start and the first call of on_tick
    interrupt: KeyboardInterrupt | None = None
    asked: int | None = None

    def on_tick(tick: Tick, observation: Observation | None) -> None:
        nonlocal ticks, touches, contacts, asked
        ticks += 1
        if observation is not None:
            contacts += sum(contact.phase == "begin" for contact in observation.contacts)
        if isinstance(labeller, PromptedLabeller) and prompts is not None:
            before, asked = asked, labeller.asked
            if asked is not None and asked != before and on_prompt is not None:
                on_prompt(asked, prompts.touches[asked])
        while made:
            label = made.popleft()
            touches += label.phase == "onset"
            if on_label is not None:
                on_label(label)

    def make_labels(measurement: Measurement) -> tuple[Label, ...]:
        labels = labeller.step(measurement)
        made.extend(labels)
        return labels

    with space_bar if by_key else StopKey(pepper.emergency_stop), pepper:
        if prompts is not None:
            pepper.play(Experiment(schema=2, name="stand", steps=(step_to_stand(),)))
        space_bar.forget()  # what was pressed while the robot started
        log = pepper.start_log(out, make_labels)
        if on_start is not None:
            on_start(pepper)
        try:
            if plan is None:
                pepper.run(length, on_tick=on_tick)
            else:
                end = pepper.time + length
                pepper.play(plan, on_tick=on_tick)
                while pepper.time < end:
                    pepper.play(plan, on_tick=on_tick)
        except KeyboardInterrupt as error:
            error.add_note(f"log: {out}")
            interrupt = error
    return LabelledRun(
        seconds=ticks * robot.cycle,
        touches=touches,
        released=not labeller.touched,
        interrupt=interrupt,
        missing=log.dropped,
        contacts=None if observer is None else contacts,
    )
