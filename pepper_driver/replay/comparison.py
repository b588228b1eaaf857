"""Comparison of a replay with its recording: bit for bit, and contact by contact."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from importlib.metadata import version
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends.replay import CommandDifferences
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import IntArray
from pepper_driver.log import LogEvent
from pepper_driver.log.summary import summarise
from pepper_driver.log.topics import CONTACTS, EVENTS, JsonTopic
from pepper_driver.observer import Contact
from pepper_driver.replay.logged_run import LoggedRun
from pepper_driver.replay.run import Replayed
from pepper_driver.safety import FaultReason

MATCH_WINDOW = 0.5
"""[s] Contacts and reflexes match when they are no further apart."""

ARITHMETIC = ("pepper_driver", "numpy", "pin")
"""Versions in the metadata that may change the last bits."""

UNMEASURED = frozenset(
    reason.value
    for reason in (FaultReason.EMERGENCY_STOP, FaultReason.FOREIGN_COMMAND, FaultReason.LOST)
)
"""Reasons of stops that no recorded measurement shows."""

T = TypeVar("T", Contact, LogEvent)


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One difference from the recording; ``time`` [s] on the clock of the robot, and a human-readable text."""

    time: float
    text: str


@dataclass(frozen=True, kw_only=True)
class MatchedPair(Generic[T]):
    """Matching items of the recording and the replay; None for an item that only the other has."""

    recorded: T | None
    found: T | None

    @property
    def later(self) -> float | None:
        """By how much it is later than in the recording [s]; None where it is in one only."""
        if self.recorded is None or self.found is None:
            return None
        return _time(self.found) - _time(self.recorded)


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A replay compared with its recording.

    Attributes:
        ticks: How many were replayed.
        contacts: Each contact as it was last seen, in the order of time.
        reflexes: Begin and end of each reflex, in the order of time.
        contact_events: How many begins, updates and ends were recorded.
        differences: What is not the same bit for bit: the first of each kind, the earliest first.
        commands: How the commands differ.
        notes: What may explain differences, and what was not compared.
    """

    ticks: int
    contacts: tuple[MatchedPair[Contact], ...]
    reflexes: tuple[MatchedPair[LogEvent], ...]
    contact_events: int
    differences: tuple[Difference, ...]
    commands: CommandDifferences
    notes: tuple[str, ...]

    @property
    def identical(self) -> bool:
        """True if everything compared is the same bit for bit."""
        return not self.differences

    def as_json(self) -> dict[str, Any]:
        """For programs; see ``docs/replay.md``."""
        commands = self.commands
        return {
            "identical": self.identical,
            "ticks": self.ticks,
            "differences": [asdict(difference) for difference in self.differences],
            "contacts": _counts(self.contacts) | {"events": self.contact_events},
            "reflexes": _counts(self.reflexes),
            "commands": {
                "compared": commands.compared,
                "differing": commands.differing,
                "largest": commands.largest,
            },
            "notes": list(self.notes),
        }


@checked_arguments
def compare(run: LoggedRun, found: Replayed) -> Comparison:
    """Hold a replay against its recording."""
    log = run.log
    reflexes = [event for event in log.events if event.kind == "reflex"]
    contacts_now = _comparable(run, found.contacts, len(log.contacts))
    reflexes_now = _comparable(run, found.events, len(reflexes))
    kinds = [_of_commands(run, found.commands), _of_fault(run, found)]
    if run.has_observer:
        kinds.append(_first_in_lists(CONTACTS, log.contacts, contacts_now))
        kinds.append(_first_in_lists(EVENTS, reflexes, reflexes_now))
        kinds.append(_first_in_values(run, found))
    present = [difference for difference in kinds if difference is not None]
    return Comparison(
        ticks=found.ticks,
        contacts=_pairs(_lasting(log.contacts), _lasting(contacts_now), _contact_distance),
        reflexes=_pairs(reflexes, reflexes_now, _reflex_distance),
        contact_events=len(log.contacts),
        differences=tuple(sorted(present, key=lambda difference: difference.time)),
        commands=found.commands,
        notes=tuple(_notes(run, found)),
    )


# -- bit for bit ----------------------------------------------------------------------------------------------------


def _comparable(run: LoggedRun, found: Sequence[tuple[int, T]], recorded: int) -> list[T]:
    """Return the findings without those of the last tick, which a log that is cut short may have lost."""
    before = sum(row < len(run.log) - 1 for row, _ in found)
    kept = len(found) if run.log.complete else max(before, recorded)
    return [item for _, item in found[:kept]]


def _first_in_lists(
    topic: JsonTopic[T], recorded: Sequence[T], found: Sequence[T]
) -> Difference | None:
    for then, now in zip(recorded, found, strict=False):
        if topic.encode(then) != topic.encode(now):  # floats with all their bits
            values = (
                f"{f.name} {getattr(now, f.name)!s} in place of {getattr(then, f.name)!s}"
                for f in fields(then)
                if getattr(now, f.name) != getattr(then, f.name)
            )
            text = f"{_named(then)}: {', '.join(values)}"
            return Difference(time=min(then.time, now.time), text=text)
    n = min(len(recorded), len(found))
    for rest, what in ((recorded[n:], "recorded only"), (found[n:], "found only")):
        if rest:
            return Difference(time=rest[0].time, text=f"{_named(rest[0])}: {what}")
    return None


def _first_in_values(run: LoggedRun, found: Replayed) -> Difference | None:
    first: Difference | None = None
    for name, now in found.values.items():
        then = run.log[name][: len(now)]
        differing = _bits(then) != _bits(now)
        if not differing.any():
            continue
        row, joint = np.argwhere(differing)[0]
        time = float(run.log["time"][row])
        if first is None or time < first.time:
            first = Difference(
                time=time,
                text=f"{name} of {run.robot.joint_names[joint]}: "
                f"{now[row, joint]!s} in place of {then[row, joint]!s}",
            )
    return first


def _bits(values: NDArray[Any]) -> IntArray:
    """Return the bits of floats, with one pattern for all NaN."""
    if values.dtype != np.float64:
        return values.astype(np.int64)
    return np.where(np.isnan(values), np.nan, values).view(np.int64)


def _of_commands(run: LoggedRun, commands: CommandDifferences) -> Difference | None:
    if commands.first is None or not run.from_start:
        return None
    time, text = commands.first
    return Difference(time=time, text=f"command: {text}")


def _of_fault(run: LoggedRun, found: Replayed) -> Difference | None:
    """Return a stop that the other run did not have; where no measurement shows why, the replay continues."""
    fault, log = found.fault, run.log
    then = next((event for event in log.events if event.kind == "fault"), None)
    # The recorded text ends with why no younger sample came, which is in no row.
    same = (
        then is not None
        and fault is not None
        and then.name == fault.reason.value
        and then.text.startswith(fault.text)
    )
    if then is not None and not same and then.name not in UNMEASURED:
        return Difference(time=then.time, text=f"stop of the robot: {then.text}: recorded only")
    lost = not log.complete and found.ticks == len(log)
    if fault is not None and then is None and not lost:
        time = float(log["time"][found.ticks - 1])
        return Difference(time=time, text=f"stop of the robot: {fault.text}: found only")
    return None


# -- one by one -----------------------------------------------------------------------------------------------------


def _lasting(contacts: Sequence[Contact]) -> list[Contact]:
    """Each contact as it was last seen."""
    return list({contact.id: contact for contact in contacts}.values())


def _pairs(
    recorded: Sequence[T], found: Sequence[T], distance: Callable[[T, T], float | None]
) -> tuple[MatchedPair[T], ...]:
    """Yield the matching items, the nearest first; then the rest of both."""
    near = sorted(
        (apart, i, j)
        for i, then in enumerate(recorded)
        for j, now in enumerate(found)
        if (apart := distance(then, now)) is not None
    )
    partner: dict[int, int] = {}
    matched: set[int] = set()
    for _, i, j in near:
        if i not in partner and j not in matched:
            partner[i] = j
            matched.add(j)
    pairs = [
        MatchedPair(recorded=then, found=found[partner[i]] if i in partner else None)
        for i, then in enumerate(recorded)
    ]
    pairs += [
        MatchedPair(recorded=None, found=now) for j, now in enumerate(found) if j not in matched
    ]
    return tuple(sorted(pairs, key=lambda pair: _time(pair.recorded or pair.found)))


def _contact_distance(then: Contact, now: Contact) -> float | None:
    """[s] between two contacts that may match; further apart if another joint detected them."""
    overlap = min(then.time, now.time) - max(then.onset_time, now.onset_time)
    if overlap < -MATCH_WINDOW:
        return None
    return abs(_time(now) - _time(then)) + MATCH_WINDOW * (now.joint != then.joint)


def _reflex_distance(then: LogEvent, now: LogEvent) -> float | None:
    apart = abs(now.time - then.time)
    same = (then.name, then.phase) == (now.name, now.phase)
    return apart if same and apart <= MATCH_WINDOW else None


def _time(item: Contact | LogEvent | None) -> float:
    if isinstance(item, Contact):
        return item.detection_time
    return np.nan if item is None else item.time


def _named(item: Contact | LogEvent) -> str:
    if isinstance(item, Contact):
        return f"{item.phase} of contact {item.id} ({item.joint or item.link})"
    return f"{item.phase} of reflex {item.name}"


def _counts(pairs: Sequence[MatchedPair[T]]) -> dict[str, Any]:
    both = [pair.later for pair in pairs if pair.later is not None]
    return {
        "recorded": sum(pair.recorded is not None for pair in pairs),
        "found": sum(pair.found is not None for pair in pairs),
        "both": len(both),
        "missed": sum(pair.found is None for pair in pairs),
        "new": sum(pair.recorded is None for pair in pairs),
        "earlier": sum(later < 0 for later in both),
        "later": sum(later > 0 for later in both),
    }


def _notes(run: LoggedRun, found: Replayed) -> Iterator[str]:
    log, summary = run.log, summarise(run.log)
    if not log.complete:
        yield "the log is cut short: what it may have lost of its last tick is not compared"
    if summary.dropped:
        yield f"{summary.dropped} ticks are not in the log: from there on observer and reflexes know less than then"
    if not run.from_start:
        yield "the log begins in the middle of a motion: the safety gate starts otherwise, its commands do not count"
    if not run.has_observer and found.values:
        yield "the run had no observer: contacts and reflexes of the replay are compared with nothing"
    if run.has_observer and not found.values:
        yield "the replay has no observer"
    for time, text in summary.faults:
        yield f"the run was stopped at {time:.3f} s: {text}"
    for name in ARITHMETIC:
        then, now = log.metadata.get(name), version(name.replace("_", "-"))
        if then not in (None, now):
            yield f"recorded with {name} {then}, replayed with {now}: last bits may differ"
