"""One world of parity.py: plays an example or an experiment, as its file stands, and records what came of it.

The file is not changed. Another class takes the place of `pepper_driver.Pepper`: it forces the robot and the pace of
its world, has the run logged, and records calls of callbacks and results of the facade.

The argument is the job as JSON: `program`, a path; `world`: sim, paced or stand-in; `out`, the JSON file to write.
"""

from __future__ import annotations

import json
import runpy
import sys
from collections import Counter
from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any, NamedTuple, Unpack
from unittest.mock import patch

import pepper_driver.experiments.experiment
import pepper_driver.robot
from pepper_driver import (
    Contact,
    CueEvent,
    ExperimentRun,
    FaultError,
    FaultEvent,
    Observation,
    Pepper,
    PushEvent,
    ReflexEvent,
    SensorEvent,
    StepEvent,
    TickEvent,
)
from pepper_driver.backends.naoqi.timing import SlowLinkError
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.callbacks.filters import ContactArguments, contact_filter
from pepper_driver.config import Experiment, RobotConfig, SafetySettings
from pepper_driver.controller import Tick
from pepper_driver.experiments.plan import Plan
from pepper_driver.experiments.player import OnStep
from pepper_driver.experiments.reports import ExperimentReport, StepReport
from pepper_driver.log import LogEvent, RunLog, read_log
from pepper_driver.session import OnTick

MAX_STARTS = 10
"""Attempts to start in a program: on a busy machine the driver refuses the stand-in now and then, as too slow."""

DECORATORS = {  # name of the events in the log, selector of their names, default of the selector of their phase
    "on_touch": ("sensor", "sensor", True),
    "on_bumper": ("sensor", "bumper", True),
    "on_button": ("sensor", "button", True),
    "on_reflex": ("reflex", "name", "begin"),
    "on_fault": ("fault", "", None),
    "on_step": ("step", "", None),
    "on_cue": ("cue", "kind", None),
    "on_push": ("push", "", None),
    "on_contact": ("contact", "", None),
    "on_tick": ("tick", "", None),
}
PHASES = {True: "begin", False: "end"}  # of a press

Event = (
    Contact | TickEvent | FaultEvent | ReflexEvent | SensorEvent | StepEvent | CueEvent | PushEvent
)
Key = tuple[object, ...]
"""Identity of an event within its run; the first element is its kind, the third its phase."""


class Mark(NamedTuple):
    """A push, a grab or a step, from which onsets count: ``asked`` for and ``begin``, by the robot's clock [s]."""

    name: str
    asked: float
    begin: float


@dataclass(kw_only=True)
class ContactRecord:
    """One contact, as it was last reported.

    Attributes:
        limb: That of the contact.
        link: Where it was.
        onset: Since the mark [s].
        mark: Number of the last push or grab before its detection, of the last step where there was none; -1 for the
            begin of the run.
    """

    limb: str
    link: str
    onset: float
    mark: int


@dataclass(kw_only=True)
class RunRecord:
    """One run of the robot, from start to stop: what happened, in its order.

    Attributes:
        marks: Pushes, grabs and steps.
        contacts: Without rebounds, which are no touch.
        rebounds: Their number.
        reflexes: Names and phases.
        sensors: Names and phases.
        faults: Their reasons.
        cues: What was to be said or shown.
        begin: Clock of the robot at the first tick [s].
        ticks: Number of ticks in the log.
        missed: Number of missed ticks.
        max_age: Age of the oldest sample [s].
        truth: True where the log holds ground truth.
    """

    marks: list[str]
    contacts: list[ContactRecord]
    rebounds: int
    reflexes: list[str]
    sensors: list[str]
    faults: list[str]
    cues: list[str]
    begin: float
    ticks: int
    missed: int
    max_age: float
    truth: bool


@dataclass(kw_only=True)
class CallbackRecord:
    """Calls of one function in all runs.

    Attributes:
        name: Of the function.
        calls: Number of calls.
        once: Number of calls for other events than ticks and updates of contacts, whose number noise and pace decide.
        missing: Events that it was not called for.
        surplus: Calls that no event explains, or a second one for an event.
    """

    name: str
    calls: int
    once: int
    missing: list[str]
    surplus: list[str]


@dataclass(kw_only=True)
class Played:
    """Result of a program in one world.

    Attributes:
        world: Name of the world.
        uri: Robot that the program asks for.
        runs: Of the robot.
        callbacks: In the order of their registration.
        outcomes: Results of calls of the facade.
        starts: Number of attempts to start the robot.
        error: What ended the program; empty if it went through.
    """

    world: str
    uri: str = ""
    runs: list[RunRecord] = field(default_factory=list)
    callbacks: list[CallbackRecord] = field(default_factory=list)
    outcomes: list[str] = field(default_factory=list)
    starts: int = 0
    error: str = ""


def play(program: Path, world: str, *, safety: SafetySettings | None = None) -> Played:
    """Play an example or an experiment in one world; what it raises is part of the result.

    Args:
        program: A Python file, or an experiment in YAML.
        world: ``sim``, ``paced`` or ``stand-in``.
        safety: Limits of the safety gate, where the program gives none.
    """
    played, recorders = Played(world=world), list[CallRecorder]()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))

        class PepperOfWorld(RecordingPepper):
            def __init__(self, uri: str = "mujoco", **options: object) -> None:
                played.uri = uri
                if world == "stand-in":
                    robot = stack.enter_context(StandIn(uri, consent=True))
                    uri = f"naoqi://127.0.0.1:{robot.port}?wake=1"
                options |= {
                    "log": options.get("log") or folder / "run.mcap",
                    "real_time": world == "paced",
                    "safety": options.get("safety") or safety,
                }
                super().__init__(played, recorders, uri, **options)

        for module in (pepper_driver.robot, pepper_driver.experiments.experiment):
            stack.enter_context(patch.object(module, "Pepper", PepperOfWorld))
        try:
            if program.suffix == ".yaml":
                report = ExperimentRun(program).perform()
                detected = [(wait.step, wait.detected) for wait in report.waits]
                played.outcomes.append(f"completed: {report.completed}; contacts came: {detected}")
            else:
                runpy.run_path(str(program), run_name="__main__")
        except (Exception, SystemExit) as error:
            played.error = f"{type(error).__name__}: {error}"
    played.callbacks = [recorder.result() for recorder in recorders]
    return played


class RecordingPepper(Pepper):
    """A Pepper that records what goes through its facade."""

    def __init__(
        self,
        played: Played,
        recorders: list[CallRecorder],
        uri: str,
        **options: Any,  # noqa: ANN401
    ) -> None:
        super().__init__(uri, **options)
        self.recording = recording = Recording(self, played, recorders, Path(options["log"]))
        for name in DECORATORS:
            setattr(self, name, recording.registering(name, getattr(self, name)))
        for name in ("push", "grab"):  # experiments have the backend do it
            marking = recording.marking(name, getattr(self.backend, name))
            setattr(self.backend, name, marking)
            setattr(self, name, marking)

    def start(self) -> None:
        self.recording.begin(super().start)

    def _end(self, error: BaseException | None) -> None:
        super()._end(error)
        self.recording.end()

    def run(
        self,
        seconds: float,
        *,
        on_tick: OnTick | None = None,
        until: Callable[[], bool] | None = None,
    ) -> bool:
        ticks = None if until is not None else round(seconds / self.config.cycle)
        outcomes = self.recording.played.outcomes
        try:
            counted = self.recording.counting(on_tick, ticks)
            stopped = super().run(seconds, on_tick=counted, until=until)
        except FaultError as error:
            outcomes.append(f"run: fault {error.fault.reason.value}")
            raise
        if until is not None:
            outcomes.append(f"run: {'' if stopped else 'not '}ended by until")
        return stopped

    def play(
        self,
        experiment: Plan | Experiment | str | Path,
        *,
        on_step: OnStep | None = None,
        on_tick: OnTick | None = None,
        on_progress: Callable[[float], None] | None = None,
        skip_settling: bool = False,
    ) -> ExperimentReport:
        reported: list[StepReport] = []
        report = super().play(
            experiment,
            on_step=None if on_step is None else both(reported.append, on_step),
            on_tick=self.recording.counting(on_tick, None),
            on_progress=on_progress,
            skip_settling=skip_settling,
        )
        steps = [(step.name or str(step.number), step.reached) for step in report.steps]
        self.recording.played.outcomes.append(f"play {report.name}: {steps}")
        if on_step is not None:
            self.recording.compare_steps(on_step, report.steps, reported)
        return report

    def wait_for_contact(
        self, *, timeout: float | None = None, **selector: Unpack[ContactArguments]
    ) -> Contact | None:
        contact = super().wait_for_contact(timeout=timeout, **selector)
        limb = "nothing" if contact is None else contact.limb
        self.recording.played.outcomes.append(f"wait_for_contact: {limb}")
        return contact

    def contacts(self, **selector: Unpack[ContactArguments]) -> AsyncGenerator[Contact, None]:
        return self.recording.streaming(selector, super().contacts(**selector))


class CallRecorder:
    """Events that one function is to be called for, and those it is called for, each with the number of its run."""

    def __init__(self, name: str, function: Callable[..., object]) -> None:
        self.name, self.function = name, function
        self.selectors: list[tuple[str, dict[str, Any]]] = []
        self.run: int | None = None  # the only one that it listens to
        self.events: list[tuple[int, Key]] = []
        self.calls: list[tuple[int, Key]] = []

    def result(self) -> CallbackRecord:
        """Compare both."""
        events, calls = Counter(self.events), Counter(self.calls)
        once = [key for _, key in self.calls if key[0] != "tick" and "update" not in key]
        return CallbackRecord(
            name=self.name,
            calls=len(self.calls),
            once=len(once),
            missing=[str(key) for key in (events - calls).elements()],
            surplus=[str(key) for key in (calls - events).elements()],
        )


class Recording:
    """Record of the runs of one Pepper.

    Args:
        pepper: The robot.
        played: Gets the results.
        recorders: Gets a recorder of each function that is called back.
        log: File of the log; each run replaces it.
    """

    def __init__(
        self, pepper: Pepper, played: Played, recorders: list[CallRecorder], log: Path
    ) -> None:
        self.played = played
        self._pepper, self._recorders, self._log = pepper, recorders, log
        self._marks: list[Mark] = []
        self._wrappers: dict[int, Callable[[Any], object]] = {}
        self._waits = count()
        self._running = False

    @property
    def _run(self) -> int:
        """Number of the run."""
        return len(self.played.runs)

    # -- runs -------------------------------------------------------------------------------------------------------

    def begin(self, start: Callable[[], None]) -> None:
        """Start a run, again where the way to a stand-in is refused as too slow."""
        self._marks.clear()
        while not self._running:
            self.played.starts += 1
            try:
                start()
                self._running = True
            except SlowLinkError:
                if self.played.starts >= MAX_STARTS:
                    raise

    def end(self) -> None:
        """Record the run that is over, if there was one."""
        if not self._running:
            return
        self._running, pepper = False, self._pepper
        log, run, contacts = read_log(self._log), self._run, pepper.contact_history
        for recorder in self._recorders:
            if recorder.run in (None, run):
                for name, selector in recorder.selectors:
                    picked = picked_events(log, contacts, name, selector, pepper.config)
                    recorder.events += [(run, key) for key in picked]
        self.played.runs.append(run_record(log, contacts, self._marks, pepper.config))

    def marking(self, name: str, order: Callable[..., None]) -> Callable[..., None]:
        """Wrap what has the robot pushed or grabbed, ``delay`` after it took the order.

        The clock of a real-time robot goes on during the call, which a busy machine draws out.
        """

        def marked(link: str, *arguments: object, delay: float = 0.0, **options: object) -> None:
            time, begin = self._pepper.time, perf_counter()
            order(link, *arguments, delay=delay, **options)
            taken = perf_counter() - begin if self._pepper.backend.real_time else 0.0
            self._marks.append(Mark(f"{name} {link}", time, time + taken + delay))

        return marked

    # -- functions that are called back -----------------------------------------------------------------------------

    def registering(self, name: str, register: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap a decorator such as ``on_contact``: the calls of what it registers are recorded."""

        def registering(**selector: object) -> Callable[[Any], Any]:
            registered = register(**selector)

            def decorated(callback: Callable[[Any], object]) -> Callable[[Any], object]:
                recorder = self._recorder(callback.__qualname__, callback)
                recorder.selectors.append((name, selector))
                registered(self._wrapper(recorder))
                return callback

            return decorated

        return registering

    def _recorder(self, name: str, function: Callable[..., object]) -> CallRecorder:
        """Return the recorder of a function, the same for all its registrations."""
        for recorder in self._recorders:
            if recorder.name == name and recorder.function == function:
                return recorder
        self._recorders.append(CallRecorder(name, function))
        return self._recorders[-1]

    def _wrapper(self, recorder: CallRecorder) -> Callable[[Any], object]:
        """Return the wrapper of a function for registration: always the same, as its registrations share a thread."""

        def wrapper(event: Event) -> None:
            recorder.calls.append((self._run, event_key(event)))
            recorder.function(event)

        wrapper.__qualname__ = recorder.name
        return self._wrappers.setdefault(id(recorder), wrapper)

    async def streaming(
        self, selector: Mapping[str, Any], contacts: AsyncGenerator[Contact, None]
    ) -> AsyncGenerator[Contact, None]:
        """Record a stream of contacts; it belongs to the run in which it begins."""
        recorder = CallRecorder("async for contacts()", self.streaming)
        recorder.selectors.append(("on_contact", dict(selector)))
        recorder.run = run = self._run
        self._recorders.append(recorder)
        async for contact in contacts:
            recorder.calls.append((run, event_key(contact)))
            yield contact

    def counting(self, on_tick: OnTick | None, ticks: int | None) -> OnTick | None:
        """Wrap a function that is to be called inside so many ticks, once in each; None where the number is unknown."""
        if on_tick is None:
            return None
        recorder = self._recorder(f"{on_tick.__qualname__}, in ticks", on_tick)
        run, wait, number, last = self._run, next(self._waits), 0, None
        recorder.events += [(run, ("tick", wait, n)) for n in range(ticks or 0)]

        def counted(tick: Tick, observation: Observation | None) -> None:
            nonlocal number, last
            again, last = tick is last, tick
            recorder.calls.append((run, ("tick", wait, "again" if again else number)))
            if ticks is None:
                recorder.events.append((run, ("tick", wait, number)))
            number += 1
            on_tick(tick, observation)

        return counted

    def compare_steps(
        self,
        on_step: Callable[[StepReport], object],
        steps: Sequence[StepReport],
        reported: Sequence[StepReport],
    ) -> None:
        """Compare the steps of an experiment with those that were reported to its ``on_step``."""
        recorder = self._recorder("on_step of play()", on_step)
        for keys, reports in ((recorder.events, steps), (recorder.calls, reported)):
            keys += [(self._run, ("step", s.number, None, s.time)) for s in reports]


def run_record(
    log: RunLog,
    events: Sequence[Contact],
    pushes: Sequence[Mark],
    robot: RobotConfig,
) -> RunRecord:
    """Return the record of a run.

    Args:
        log: Its log.
        events: All events of contacts.
        pushes: In the order in which they were asked for.
        robot: Description of the robot.
    """
    steps = [Mark(f"step {e.name}", e.time, e.time) for e in log.events if e.kind == "step"]
    marks = sorted([*steps, *pushes], key=lambda mark: mark.asked)
    begin = float(log["time"][0]) if len(log) else 0.0
    last = {contact.id: contact for contact in events}
    contacts = [last[contact.id] for contact in events if contact.phase == "begin"]
    touches = [contact for contact in contacts if contact.kind != "rebound"]
    return RunRecord(
        marks=[mark.name for mark in marks],
        contacts=[contact_record(contact, marks, begin, robot) for contact in touches],
        rebounds=len(contacts) - len(touches),
        reflexes=[f"{e.name} {e.phase}" for e in log.events if e.kind == "reflex"],
        sensors=[f"{e.name} {e.phase}" for e in log.events if e.kind == "sensor"],
        faults=[e.name for e in log.events if e.kind == "fault"],
        cues=[e.text for e in log.events if e.kind == "cue"],
        begin=begin,
        ticks=len(log),
        missed=int(log["missed"].max(initial=0)),
        max_age=float(log["age"].max(initial=0.0)),
        truth=log.truth is not None,
    )


def contact_record(
    contact: Contact, marks: Sequence[Mark], begin: float, robot: RobotConfig
) -> ContactRecord:
    """Return the record of a contact; its onset counts from a mark, or from the ``begin`` of the run."""
    before = [n for n, mark in enumerate(marks) if mark.begin <= contact.detection_time]
    pushes = [n for n in before if not marks[n].name.startswith("step")]
    mark = (pushes or before or [-1])[-1]
    return ContactRecord(
        limb=contact.limb,
        link=contact.link,
        onset=contact.onset_time - (marks[mark].begin if mark >= 0 else begin),
        mark=mark,
    )


def picked_events(
    log: RunLog,
    contacts: Sequence[Contact],
    decorator: str,
    selector: Mapping[str, Any],
    robot: RobotConfig,
) -> list[Key]:
    """Return the events of a run that a callback is to get, by the log and not by what was published.

    Args:
        log: Of the run.
        contacts: All events of contacts.
        decorator: By which the callback is registered.
        selector: Arguments of the decorator.
        robot: Description of the robot.
    """
    kind, names, phase = DECORATORS[decorator]
    if kind == "contact":
        picks = contact_filter(robot, **selector)
        return [event_key(contact) for contact in contacts if picks(contact)]
    if kind == "tick":
        picked: list[int] = []
        for tick in log["tick"].tolist():
            if not picked or tick >= picked[-1] + selector.get("every", 1):
                picked.append(tick)
        return [("tick", tick) for tick in picked]
    sensors = robot.sensors
    groups = {
        "on_touch": sensors.touch,
        "on_bumper": sensors.bumpers,
        "on_button": sensors.buttons,
    }
    name, phase = selector.get(names), selector.get("pressed", selector.get("phase", phase))
    return [
        logged_key(event)
        for event in log.events
        if event.kind == kind
        and event.name in groups.get(decorator, [event.name])
        and name in (None, event.name)
        and PHASES.get(phase, phase) in (None, event.phase)
    ]


def both(
    first: Callable[[StepReport], object], second: Callable[[StepReport], object]
) -> Callable[[StepReport], None]:
    """Return a function that calls two, one after the other."""

    def call(report: StepReport) -> None:
        first(report)
        second(report)

    return call


def event_key(event: Event) -> Key:
    """Return the identity of an event, as callbacks get it."""
    if isinstance(event, Contact):
        return ("contact", event.id, event.phase, event.time)
    if isinstance(event, TickEvent):
        return ("tick", event.tick.measurement.tick)
    if isinstance(event, FaultEvent):
        return ("fault", event.fault.reason.value, None)
    return logged_key(LogEvent.of(event))


def logged_key(event: LogEvent) -> Key:
    """Return the identity of an event of the log; of faults there is one in a run."""
    if event.kind == "fault":
        return ("fault", event.name, None)
    return (event.kind, event.name, event.phase, event.time)


if __name__ == "__main__":
    job = json.loads(sys.argv[1])
    result = play(Path(job["program"]), job["world"])
    Path(job["out"]).write_text(json.dumps(asdict(result)), encoding="utf-8")
