"""State of a first hour: the file ``first_hour.json``, from which the same command goes on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, field, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.backends import BackendInfo
from pepper_driver.config import ConfigError, PepperError, RobotConfig
from pepper_driver.config.errors import first_difference, reason, short_reason
from pepper_driver.config.files import write_json
from pepper_driver.config.loading import STRICT, parse
from pepper_driver.config.parts import Positive
from pepper_driver.config.touch_prompts import TouchPrompts
from pepper_driver.identification.measurements.friction import HeldWeight

FORMAT: Literal[1] = 1
STATE = "first_hour.json"

StepName = Literal["doctor", "measure", "identify", "rest", "free", "touches", "pack"]
STEPS: tuple[StepName, ...] = get_args(StepName)
"""In their order."""

StepProgress = Literal["open", "begun", "done"]

ResultValue = bool | int | float | str | tuple[str, ...] | None

ANOTHER_FOLDER = "give another folder to --out"


class FirstHourError(PepperError, ValueError):
    """A first hour cannot go on in this folder."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class StepRecord:
    """State and result of one step.

    Attributes:
        name: Of the step.
        progress: ``begun`` is one that was ended early: what it recorded is kept.
        begin, end: Date and time, UTC, ISO 8601; None where it has not begun or ended.
        figures: What it found, by name.
        earlier: What it found in each attempt before this one, oldest first; nothing where that ended early.
    """

    name: StepName
    progress: StepProgress = "open"
    begin: str | None = None
    end: str | None = None
    figures: Mapping[str, ResultValue] = field(default_factory=dict)
    earlier: tuple[Mapping[str, ResultValue], ...] = ()

    def reopened(self) -> StepRecord:
        """Return the state of a step that is to be made again."""
        if self.progress != "done":
            return self
        return StepRecord(name=self.name, earlier=(*self.earlier, self.figures))


@dataclass(frozen=True, kw_only=True, config=STRICT)
class FirstHour:
    """A first hour: of which robot, by which settings, how far it is.

    Attributes:
        format: Of the file.
        version: Of the package.
        robot, joint_names: Of the robot's description.
        identity: Of the robot; in an archive its hash.
        cycle: Period of its ticks [s].
        simulated: Whether it is a simulated one.
        plan: Hash of the settings of the hour.
        weight: Known weight that is held; None for none.
        label: Source of the labels of touches.
        prompts: Touches that are asked for.
        steps: In their order, all of them.
    """

    format: Literal[1]
    version: str
    robot: str
    joint_names: tuple[str, ...]
    identity: str
    cycle: Positive
    simulated: bool
    plan: str
    weight: HeldWeight | None
    label: str
    prompts: TouchPrompts
    steps: Annotated[tuple[StepRecord, ...], Field(min_length=len(STEPS), max_length=len(STEPS))]

    def __post_init__(self) -> None:
        """Check the order of the steps."""
        if tuple(step.name for step in self.steps) != STEPS:
            raise ValueError(f"its steps are not {', '.join(STEPS)}")

    @property
    def next_step(self) -> StepName | None:
        """The first step that is not done; None where all are."""
        return next((step.name for step in self.steps if step.progress != "done"), None)

    def step(self, name: StepName) -> StepRecord:
        """Return what became of a step."""
        return self.steps[STEPS.index(name)]

    def begun(self, name: StepName) -> FirstHour:
        """Return the state with a step that begins now."""
        step = self.step(name)
        earlier = (*step.earlier, step.figures) if step.progress == "begun" else step.earlier
        return self._with(StepRecord(name=name, progress="begun", begin=now(), earlier=earlier))

    def done(self, name: StepName, figures: Mapping[str, ResultValue]) -> FirstHour:
        """Return the state with a step that ends now."""
        step = self.step(name)
        return self._with(replace(step, progress="done", end=now(), figures=dict(figures)))

    def reopened(self, name: StepName) -> FirstHour:
        """Return the state with a step to be made again, and those that build on it: all later ones need the models."""
        again = STEPS[STEPS.index(name) :] if name in ("measure", "identify") else (name, "pack")
        return replace(
            self, steps=tuple(s.reopened() if s.name in again else s for s in self.steps)
        )

    def _with(self, record: StepRecord) -> FirstHour:
        return replace(
            self, steps=tuple(record if s.name == record.name else s for s in self.steps)
        )


def now() -> str:
    """Return date and time, UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def new_hour(
    robot: RobotConfig,
    info: BackendInfo,
    *,
    plan: str,
    prompts: TouchPrompts,
    label: str,
    weight: HeldWeight | None,
) -> FirstHour:
    """Return the state before the first step; see :class:`FirstHour`."""
    return FirstHour(
        format=FORMAT,
        version=version("pepper-driver"),
        robot=robot.name,
        joint_names=robot.joint_names,
        identity=info.identity,
        cycle=info.cycle,
        simulated=info.simulated,
        plan=plan,
        weight=weight,
        label=label,
        prompts=prompts,
        steps=tuple(StepRecord(name=name) for name in STEPS),
    )


_COMPARED = {
    "version": "with version",
    "robot": "of the robot description",
    "joint_names": "of a robot with the joints",
    "identity": "of the robot",
    "cycle": "of a robot whose clock has a cycle [s] of",
    "simulated": "of a simulated robot:",
    "plan": "by the plan with the hash",
    "weight": "with the weight",
    "label": "with the label",
    "prompts": "with prompts that ask for",
}
"""What must not change within an hour, and the words before its value."""


def check_same_hour(there: FirstHour, asked: FirstHour, path: Path) -> None:
    """Refuse to go on with another robot, version, clock or plan than the hour was begun with.

    Raises:
        FirstHourError: It names what differs, and how to go on.
    """
    if difference := first_difference(there, asked, _COMPARED):
        raise FirstHourError(
            f"{path}: this hour was begun {difference}; go on as it was begun, or {ANOTHER_FOLDER}"
        )


def save_state(path: Path, hour: FirstHour) -> None:
    """Write the file; at no time is there half a file.

    Raises:
        OutputError: It cannot be written.
    """
    write_json(path, asdict(hour))


def load_state(path: Path) -> FirstHour:
    """Read the file.

    Raises:
        FirstHourError: It is missing, damaged, or of another version of the format.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FirstHourError(
            f"{path.parent}: holds no first hour (no {STATE}); 'pepper first-hour' makes one"
        ) from None
    except (OSError, ValueError, RecursionError) as error:
        raise FirstHourError(
            f"{path}: cannot be read ({reason(error)}); {ANOTHER_FOLDER}"
        ) from error
    if not isinstance(data, dict) or "format" not in data:
        raise FirstHourError(f"{path}: is not the state of a first hour; {ANOTHER_FOLDER}")
    if data["format"] != FORMAT:
        raise FirstHourError(
            f"{path}: format {json.dumps(data['format'])[:20]} is not the format {FORMAT} of this version; use the "
            f"version of the package that wrote it, or {ANOTHER_FOLDER}"
        )
    try:
        return parse(FirstHour, data, str(path))
    except ConfigError as error:
        raise FirstHourError(f"damaged: {short_reason(error)}; {ANOTHER_FOLDER}") from error
