"""Steps of an experiment: those of motions, and waits, repetitions, speech and lights. Times in [s]."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, WrapValidator
from pydantic.dataclasses import dataclass, rebuild_dataclass

from pepper_driver.config.loading import STRICT
from pepper_driver.config.motion import Duration, MotionStep
from pepper_driver.config.motion_tasks import Label
from pepper_driver.config.scenario_contacts import Grab, JointPush, Push

AT_ONCE = 1e-6
"""[s] For what takes no time: one tick."""

MOST_TIMES = 1000
"""A block may be repeated."""

Share = Annotated[float, Field(ge=0, le=1)]
Degrees = Annotated[float, Field(ge=0, le=180)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Wait:
    """For a time."""

    seconds: Duration


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ContactWait:
    """Until a contact begins, or has grown to what is asked for.

    Attributes:
        event: Key ``for``.
        link, joint, kind, min_intensity: Which contact, as for callbacks.
        timeout: Longest wait.
        otherwise: What to do when none came: ``continue``, or ``stop`` the experiment.
    """

    event: Annotated[Literal["contact"], Field(alias="for")]
    link: str | None = None
    joint: str | None = None
    kind: Literal["contact", "collision"] | None = None
    min_intensity: Degrees = 0.0
    timeout: Duration
    otherwise: Literal["continue", "stop"] = "continue"


def _wait(value: object, _: object) -> object:
    if not isinstance(value, dict):
        if isinstance(value, Wait | ContactWait):
            return value
        raise ValueError("a wait says {seconds: ...} or {for: contact, timeout: ...}")
    kind = ContactWait if "for" in value else Wait
    # Through JSON, as in the loader: there strict mode takes lists for tuples.
    return TypeAdapter[Any](kind).validate_json(json.dumps(value), strict=True)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class WaitStep:
    """The robot stays where it is."""

    name: Label | None = None
    wait: Annotated[Wait | ContactWait, WrapValidator(_wait)]

    @property
    def motion(self) -> MotionStep:
        """What the robot does meanwhile."""
        wait = self.wait
        return MotionStep(
            name=self.name or "wait", hold=wait.seconds if isinstance(wait, Wait) else wait.timeout
        )


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SayStep:
    """A text for whoever can speak. Takes no time."""

    name: Label | None = None
    say: Annotated[str, Field(min_length=1, max_length=500, pattern=r"^\P{Cc}+$")]

    @property
    def motion(self) -> MotionStep:
        """What the robot does meanwhile."""
        return MotionStep(name=self.name or "say", hold=AT_ONCE)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Leds:
    """A ``group`` of lights, by NAOqi's name for it, fades to a ``colour`` (r, g, b), each 0..1, in ``duration``."""

    group: Label = "FaceLeds"
    colour: tuple[Share, Share, Share]
    duration: Annotated[float, Field(ge=0, le=60)] = 0.2


@dataclass(frozen=True, kw_only=True, config=STRICT)
class LedsStep:
    """A colour for whoever has lights. Takes no time: what follows goes on while they fade."""

    name: Label | None = None
    leds: Leds

    @property
    def motion(self) -> MotionStep:
        """What the robot does meanwhile."""
        return MotionStep(name=self.name or "leds", hold=AT_ONCE)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Repeat:
    """A block of steps, several times."""

    times: Annotated[int, Field(ge=1, le=MOST_TIMES)]
    steps: Annotated[tuple[AnyStep, ...], Field(min_length=1)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RepeatStep:
    """A block of steps, several times."""

    name: Label | None = None
    repeat: Repeat


_BY_KEY: dict[str, Any] = {
    "wait": WaitStep,
    "say": SayStep,
    "leds": LedsStep,
    "repeat": RepeatStep,
}


def _by_key(value: object, _: object) -> object:
    """A mapping becomes the kind of step that one of its keys names, or else a step of a motion."""
    if not isinstance(value, dict):
        if isinstance(value, MotionStep | WaitStep | SayStep | LedsStep | RepeatStep):
            return value
        raise ValueError("a step is a mapping of keys to values")
    kind = next((cls for key, cls in _BY_KEY.items() if key in value), MotionStep)
    # Through JSON, as in the loader: there strict mode takes lists for tuples.
    return TypeAdapter(kind).validate_json(json.dumps(value), strict=True)


PlayedStep = MotionStep | WaitStep | SayStep | LedsStep
AnyStep = Annotated[PlayedStep | RepeatStep, WrapValidator(_by_key)]
rebuild_dataclass(Repeat)  # type: ignore[arg-type]
rebuild_dataclass(RepeatStep)  # type: ignore[arg-type]


def motion_of(step: PlayedStep) -> MotionStep:
    """What the robot does in a step."""
    return step if isinstance(step, MotionStep) else step.motion


def is_open(step: PlayedStep) -> bool:
    """Whether it may end before its longest time."""
    if isinstance(step, MotionStep):
        return step.until is not None
    return isinstance(step, WaitStep) and isinstance(step.wait, ContactWait)


def longest(steps: tuple[AnyStep, ...]) -> float:
    """They are over after this time at the latest [s], unless a reflex holds the robot."""
    return sum(
        step.repeat.times * longest(step.repeat.steps)
        if isinstance(step, RepeatStep)
        else motion_of(step).longest
        for step in steps
    )


def count(steps: tuple[AnyStep, ...]) -> int:
    """How many steps are played, with all repetitions."""
    return sum(
        step.repeat.times * count(step.repeat.steps) if isinstance(step, RepeatStep) else 1
        for step in steps
    )


def flatten(steps: tuple[AnyStep, ...], key: str = "steps") -> Iterator[tuple[str, PlayedStep]]:
    """The steps as they are played, each with the key where the file has it."""
    for number, step in enumerate(steps):
        here = f"{key}.{number}"
        if isinstance(step, RepeatStep):
            for _ in range(step.repeat.times):
                yield from flatten(step.repeat.steps, f"{here}.repeat.steps")
        else:
            yield here, step


@dataclass(frozen=True, kw_only=True, config=STRICT)
class InStep:
    """Of a push: ``step`` with whose beginning its ``start`` counts, each time; None for the experiment's."""

    step: Label | None = None


@dataclass(frozen=True, kw_only=True, config=STRICT)
class PushInStep(InStep, Push):
    """A force."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class JointPushInStep(InStep, JointPush):
    """A force by the degrees it puts on a joint."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class GrabInStep(InStep, Grab):
    """A hand that pulls."""


AnyPush = PushInStep | JointPushInStep | GrabInStep
