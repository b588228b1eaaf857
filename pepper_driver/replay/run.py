"""Runs the loop over a recording: the same calls in the same order, on the recorded measurements."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pepper_driver.backends.fields import Column, fields_of
from pepper_driver.backends.replay import CommandDifferences, EndOfLogError
from pepper_driver.config.arguments import as_path, checked_arguments
from pepper_driver.controller import Tick
from pepper_driver.log import LogEvent, LogWriter, run_metadata
from pepper_driver.log.schema import unobserved
from pepper_driver.loop import Loop, TickRecord
from pepper_driver.observer import Contact, Observation, Observer
from pepper_driver.reflexes import Arbiter, Reflex, prepare_reflexes
from pepper_driver.reflexes.declared import declare
from pepper_driver.replay.logged_run import LoggedRun, ReplayError
from pepper_driver.replay.playback import PlaybackController
from pepper_driver.safety import Fault, FaultError, SafetyGate


@dataclass(frozen=True, kw_only=True)
class Replayed:
    """Outputs of observer and reflexes over a recording.

    Attributes:
        ticks: How many were replayed.
        observer: In one line; None without.
        reflexes: Their names, in the order in which they were asked.
        contacts: Events with the row in which each was raised.
        events: Begin and end of reflexes, the same.
        values: (n, 17) by name, as in the log; empty without an observer.
        commands: How the commands differ from those recorded.
        fault: Why the safety gate stopped the replay; None if it did not.
    """

    ticks: int
    observer: str | None
    reflexes: tuple[str, ...]
    contacts: list[tuple[int, Contact]] = field(repr=False)
    events: list[tuple[int, LogEvent]] = field(repr=False)
    values: dict[str, Column] = field(repr=False)
    commands: CommandDifferences
    fault: Fault | None


@checked_arguments
def replay(
    run: LoggedRun,
    observer: Observer | None,
    reflexes: Sequence[Reflex] = (),
    *,
    out: Path | str | None = None,
) -> Replayed:
    """Step observer and reflexes through a recording.

    The observer sees the recorded ticks, bit for bit. The controller plays the recorded references, whatever
    reflexes request of it, and passes the safety gate; the commands that come out are compared with those recorded.

    Args:
        run: The recording.
        observer: Or None.
        reflexes: New ones: a replay changes them.
        out: A log of the replay, with the recorded ticks and what was made of them now.

    Raises:
        PepperError: The recording lacks something, a reflex is not for this robot, or ``out`` cannot be written.
    """
    out = None if out is None else as_path("out", out)
    if out is not None and out.exists() and out.samefile(run.path):
        raise ReplayError(f"{out}: is the recording itself; give another file")
    robot, backend = run.robot, run.backend
    prepared = prepare_reflexes(reflexes, robot)
    controller = PlaybackController(robot, run.controller_settings, run.references)
    gate = SafetyGate(robot, run.safety_settings, run.controller_settings)
    seen = _TakenOver(run)
    with ExitStack() as stack:
        if out is not None:
            seen.log = LogWriter(out, robot, _metadata(run, observer, prepared), lossless=True)
            stack.callback(seen.log.close)
        first = backend.open()
        stack.callback(backend.close)
        first = backend.activate()
        hold = np.clip(first.position, robot.lower, robot.upper)
        controller.reset(hold)
        gate.activate(hold)
        loop = Loop(
            backend,
            robot,
            Arbiter(controller, robot, prepared),
            gate,
            first=first,
            observer=None if observer is None else _OnRecordedTicks(observer, run.ticks),
            publish=seen.take,
        )
        fault: Fault | None = None
        try:
            while True:
                loop.tick()
        except EndOfLogError:
            pass
        except FaultError as error:
            fault = error.fault
    return Replayed(
        ticks=seen.ticks,
        observer=None if observer is None else observer.describe(),
        reflexes=tuple(reflex.full_name for reflex in prepared),
        contacts=seen.contacts,
        events=seen.events,
        values={} if observer is None else seen.values(),
        commands=backend.differences,
        fault=fault,
    )


class _OnRecordedTicks(Observer):
    """Shows an observer the ticks of a recording: gate and controller of today have no part in what it sees."""

    def __init__(self, observer: Observer, ticks: Sequence[Tick]) -> None:
        self._observer = observer
        self._ticks = iter(ticks)

    def step(self, tick: Tick) -> Observation:
        return self._observer.step(next(self._ticks))

    def reset(self) -> None:
        self._observer.reset()

    def describe(self) -> str:
        return self._observer.describe()


class _TakenOver:
    """Listener that keeps the records of the loop."""

    def __init__(self, run: LoggedRun) -> None:
        self.log: LogWriter | None = None
        self.contacts: list[tuple[int, Contact]] = []
        self.events: list[tuple[int, LogEvent]] = []
        self._run = run
        self._blind = unobserved(run.robot)
        self._observations: list[Observation] = []

    @property
    def ticks(self) -> int:
        """Number of ticks so far."""
        return len(self._observations)

    def take(self, record: TickRecord) -> None:
        """Take in one tick."""
        row, observation = self.ticks, record.observation
        self._observations.append(self._blind if observation is None else observation)
        if observation is not None:
            self.contacts += [(row, contact) for contact in observation.contacts]
        logged = [LogEvent.of(event) for event in record.events]
        self.events += [(row, event) for event in logged if event.kind == "reflex"]
        if self.log is not None:
            unmatched = self._run.passed_over[row]
            self.log.append(replace(record, tick=self._run.ticks[row], unmatched=unmatched))

    def values(self) -> dict[str, Column]:
        """All that the observer said."""
        return {
            f.name: np.array(
                [getattr(observation, f.attribute) for observation in self._observations]
            )
            for f in fields_of("observation")
        }


def _metadata(
    run: LoggedRun, observer: Observer | None, reflexes: Sequence[Reflex]
) -> dict[str, str]:
    """Return the metadata of the log of a replay: the robot is the recorded one."""
    then = run.log.metadata
    now = run_metadata(
        run.backend,
        observer,
        run.robot,
        run.controller_settings,
        run.safety_settings,
        reflexes=[declare(reflex) for reflex in reflexes],
    )
    kept: dict[str, str] = {key: then[key] for key in ("start", "backend", "seed") if key in then}
    return {**now, **kept, "replay_of": run.path.name}
