"""Records a run with labels: when the robot was really touched, as a key, a touch sensor or a bumper told it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from pepper_driver.config import Motion, Scenario, load_robot
from pepper_driver.controller import Tick
from pepper_driver.keys import SpaceBar
from pepper_driver.labeller import make_labeller
from pepper_driver.labelling import LabelError
from pepper_driver.log import Label
from pepper_driver.observer import Observation
from pepper_driver.robot import Pepper
from pepper_driver.staging import Stage, scenario_uri


@dataclass(frozen=True, kw_only=True)
class LabelledRun:
    """What was recorded.

    Attributes:
        seconds: Length [s].
        touches: Number of onsets.
        released: Whether the last touch was over at the end.
        interrupt: What ended it early, Ctrl-C or a signal; None where nothing did.
        missing: Ticks that did not get into the log.
    """

    seconds: float
    touches: int
    released: bool
    interrupt: KeyboardInterrupt | None
    missing: int


def record_labelled(
    uri: str,
    out: Path,
    source: str,
    *,
    motion: Motion | None = None,
    scenario: Scenario | None = None,
    seconds: float | None = None,
    seed: int | None = None,
    link: str | None = None,
    joint: str | None = None,
    on_label: Callable[[Label], None] | None = None,
    on_start: Callable[[Pepper], None] | None = None,
) -> LabelledRun:
    """Run the robot, log every tick, and label touches in the log. Ctrl-C or a signal ends it; what was recorded stays.

    Args:
        uri: The robot. A simulated one runs in real time where the labels come from a key.
        out: The log; an existing file is replaced once the robot is there.
        source: Where the labels come from, see :func:`pepper_driver.labeller.make_labeller`.
        motion: What the robot plays, again and again until ``seconds`` are over, or once.
        scenario: Or what it performs, once.
        seconds: How long it holds its posture, or plays the motion at least [s].
        seed: Of a scenario; None is its own.
        link: What is touched; in place of the link of the sensor.
        joint: The last joint that moves it.
        on_label: Told each label, inside the tick: must be quick.
        on_start: Given the robot when it is ready: to push a simulated one, for example.

    Raises:
        LabelError: No terminal for keys, a time that is none, or nothing that tells how long.
        PepperError: The robot or the log cannot be opened, or the robot stopped.
    """
    if seconds is not None and not 0 < seconds < float("inf"):
        raise LabelError(f"seconds must be a time above 0, got {seconds!r}")
    if scenario is not None and (motion is not None or seconds is not None):
        raise LabelError("a scenario has a motion and a length of its own: give it alone")
    if scenario is None and motion is None and seconds is None:
        raise LabelError("give seconds to hold the posture for, a motion or a scenario")
    length = 0.0 if seconds is None else seconds
    robot = load_robot()
    space_bar, by_key = SpaceBar(), source == "key"
    labeller = make_labeller(source, robot, space_bar, link=link, joint=joint)
    if scenario is not None:
        uri = scenario_uri(uri, scenario)
    pepper = Pepper(uri, observer=None, robot=robot, real_time=by_key)
    stage = (
        None
        if scenario is None
        else Stage(pepper, scenario, scenario.seed if seed is None else seed)
    )
    ticks = touches = 0
    interrupt: KeyboardInterrupt | None = None

    def on_tick(tick: Tick, observation: Observation | None) -> None:
        nonlocal ticks, touches
        ticks += 1
        for label in labeller.latest:
            touches += label.phase == "onset"
            if on_label is not None:
                on_label(label)

    with space_bar if by_key else nullcontext(), pepper:
        space_bar.forget()  # what was pressed while the robot started
        log = pepper.start_log(out, labeller.step)
        if on_start is not None:
            on_start(pepper)
        try:
            if stage is not None:
                stage.perform(on_tick=on_tick, settling=True)
            elif motion is None:
                pepper.run(length, on_tick=on_tick)
            else:
                end = pepper.time + length
                pepper.play(motion, on_tick=on_tick)
                while pepper.time < end:
                    pepper.play(motion, on_tick=on_tick)
        except KeyboardInterrupt as error:
            error.add_note(f"log: {out}")
            interrupt = error
    return LabelledRun(
        seconds=ticks * robot.cycle,
        touches=touches,
        released=not labeller.touched,
        interrupt=interrupt,
        missing=log.dropped,
    )
