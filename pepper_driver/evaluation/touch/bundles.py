"""Bundles of a first hour as the judge sees them: the robot's own models on its own logs, without a truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version

from pepper_driver.config import ConfigError, load_robot
from pepper_driver.config.touch_suites import load_touch_suites
from pepper_driver.config.workers import Workers, run_jobs
from pepper_driver.evaluation.evaluate import episode_of
from pepper_driver.evaluation.touch.logs import LogFailure, reason_of, take_of
from pepper_driver.evaluation.touch.observers import (
    FUSION,
    MATCHED,
    MOMENTUM_ADAPTIVE,
    ModelFiles,
    make,
)
from pepper_driver.evaluation.touch.records import RobotRecord, Take
from pepper_driver.first_hour.bundle import Bundle, Part
from pepper_driver.first_hour.state import ResultValue
from pepper_driver.log import read_log
from pepper_driver.observer import ModelSet
from pepper_driver.recording.labels import pushes_of

BUNDLE_OBSERVERS = (
    FUSION,
    "momentum",
    f"momentum{MATCHED}",
    "error",
    f"error{MATCHED}",
    MOMENTUM_ADAPTIVE,
)
"""Observers that need no other models than a bundle has; the trees of the paper have none there."""

JUDGED: tuple[Part, ...] = ("models", "rest", "free", "touches")
"""Parts of a bundle that are judged."""

FREE_MOTION = "free motion"
"""State of the robot while it moves and no one touches it."""

_STATES: dict[Part, str] = {"rest": "standing", "free": FREE_MOTION, "touches": "standing"}
"""State of the suites, or FREE_MOTION, of each log."""


@dataclass(frozen=True, kw_only=True)
class JudgedBundle:
    """One bundle.

    Attributes:
        record: The robot: its touches, and what each observer reports.
        simulated: Whether it is a simulated robot.
        version: Of the package that recorded it.
        asked: Touches that a person was asked for.
        label: Source of the labels.
        begun: Date and time of the touches, UTC, ISO 8601; empty where it is not known.
        pressed: By name of a log without touches, sensors that were pressed in it, and how often.
        earlier: By name of a log, what the robot found in each attempt before it; nothing where that ended early.
    """

    record: RobotRecord
    simulated: bool
    version: str
    asked: int
    label: str
    begun: str
    pressed: dict[str, dict[str, int]]
    earlier: dict[str, tuple[Mapping[str, ResultValue], ...]]

    @property
    def lines(self) -> tuple[str, ...]:
        """Human-readable statements: what it is, how much there is, and what is not known."""
        name, touches = self.record.robot, self.record.takes[-1].touches
        kind = "a SIMULATED robot, a rehearsal" if self.simulated else "a REAL robot"
        known = sum(touch.force is not None for touch in touches)
        forces = (
            f"of {known} of them the force is known, by a spring scale: an N90 of few touches is a rough one"
            if known
            else "of none of them the force is known, so there are fractions and no N90"
        )
        lines = [
            f"{name}: {kind}{f', {self.begun[:10]}' if self.begun else ''}. {len(touches)} labelled touches of "
            f"{self.asked} asked for, marked by `{self.label}`; {forces}. There is no ground truth: onset and release "
            "are those of the label, as quick as who marked them; joint, direction, torque and delay are not scored."
        ]
        if self.version != (here := version("pepper-driver")):
            lines.append(f"{name}: recorded with version {self.version}, judged with {here}.")
        lines += [
            f"{name}: while the log `{log}` was recorded, {sensor} was pressed {count} times: someone may have touched "
            "the robot, and contacts there count as false all the same."
            for log, sensors in self.pressed.items()
            for sensor, count in sensors.items()
        ]
        lines += [
            f"{name}: the log `{log}` that is judged is attempt {len(earlier) + 1}; {_attempts(earlier)}."
            for log, earlier in self.earlier.items()
        ]
        return tuple(lines)


def _attempts(earlier: Sequence[Mapping[str, ResultValue]]) -> str:
    """Return in words what became of attempts that are not judged: else one could repeat until no contact is false."""
    whole = [results for results in earlier if results]
    found = [str(results["false_contacts"]) for results in whole if "false_contacts" in results]
    parts = [f"{len(earlier) - len(whole)} before ended early"] if len(whole) < len(earlier) else []
    if whole:
        parts.append(f"{len(whole)} before made again")
    if found:
        parts[-1] += f" (false contacts: {', '.join(found)})"
    return ", ".join(parts)


def judge_bundles(
    bundles: Sequence[Bundle],
    observers: Sequence[str] = BUNDLE_OBSERVERS,
    *,
    workers: Workers = -1,
) -> tuple[tuple[JudgedBundle, ...], tuple[LogFailure, ...]]:
    """Return what observers report on the logs of bundles, and the bundles that could not be judged.

    Args:
        bundles: With the parts JUDGED.
        observers: Names, of :data:`pepper_driver.evaluation.touch.observers.OBSERVERS`.
        workers: Processes, -1 for one per core; or a cluster.

    Raises:
        ConfigError: A bundle is given twice.
    """
    names = _names(bundles)
    jobs = [
        partial(_take, bundle, part, number, tuple(observers))
        for bundle in bundles
        for number, part in enumerate(_STATES)
    ]
    done = list(run_jobs(jobs, workers=workers))
    judged, failures = [], []
    for number, (bundle, name) in enumerate(zip(bundles, names, strict=True)):
        results = done[number * len(_STATES) : (number + 1) * len(_STATES)]
        wrong = [result for result in results if isinstance(result, LogFailure)]
        takes = [result for result in results if not isinstance(result, LogFailure)]
        if wrong:
            failures.append(wrong[0])
        else:
            judged.append(_judged(bundle, name, takes))
    return tuple(judged), tuple(failures)


def _names(bundles: Sequence[Bundle]) -> list[str]:
    """Return a name of each bundle: that of its file, or its whole path where two are called alike."""
    paths = Counter(bundle.source.resolve() for bundle in bundles)
    twice = next((path for path, count in paths.items() if count > 1), None)
    if twice is not None:
        raise ConfigError(f"{twice}: this bundle is given twice")
    names = Counter(bundle.source.name for bundle in bundles)
    return [b.source.name if names[b.source.name] == 1 else str(b.source) for b in bundles]


_Result = tuple[Take, dict[str, int]]


def _judged(bundle: Bundle, name: str, results: Sequence[_Result]) -> JudgedBundle:
    state = bundle.state
    models = ModelSet.load(bundle.models, load_robot())
    return JudgedBundle(
        record=RobotRecord(
            robot=name,
            draw=None,
            law=None,
            identity=state.identity,
            fit=dict(models.test_fit),
            takes=tuple(take for take, _ in results),
        ),
        simulated=state.simulated,
        version=state.version,
        asked=len(state.prompts.touches),
        label=state.label,
        begun=state.step("touches").begin or "",
        pressed={
            part: pressed
            for part, (_, pressed) in zip(_STATES, results, strict=True)
            if pressed and part != "touches"
        },
        earlier={
            step.name: step.earlier for step in state.steps if step.name in _STATES and step.earlier
        },
    )


def _take(
    bundle: Bundle, part: Part, number: int, observers: Sequence[str]
) -> _Result | LogFailure:
    """Return one log as a take, and by name how often sensors were pressed in it."""
    try:
        robot = load_robot()
        path = bundle.place_of(part)
        log = read_log(path)
        if part == "touches":
            pushes_of(log)  # raises without labels: the truth of a rehearsal does not count
        episode = episode_of(log, path, labels_only=True)
        files = ModelFiles(fusion=bundle.models)
        take = take_of(
            episode,
            {name: partial(make, name, robot, files) for name in observers},
            robot,
            load_touch_suites(robot),
            state=_STATES[part],
            suite="touch" if part == "touches" else "free",
        )
        pressed = Counter(
            event.name for event in log.events if event.kind == "sensor" and event.phase == "begin"
        )
    except Exception as error:  # one bundle that fails must not cost the others
        return LogFailure(path=bundle.source, reason=f"{part}: {reason_of(error)}")
    return replace(take, number=number), dict(pressed)
