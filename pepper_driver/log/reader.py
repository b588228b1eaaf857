"""Reader of a log: arrays of a run, and its topics as tables."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends.fields import Column
from pepper_driver.backends.log_file import (
    LAYOUT,
    TICK_TOPIC,
    UNMATCHED_TOPIC,
    Gap,
    RawLog,
    misfit,
    read_log_file,
)
from pepper_driver.backends.log_records import find_metadata
from pepper_driver.config import UnknownNameError, load_robot
from pepper_driver.config.arguments import as_path, checked_arguments
from pepper_driver.log.schema import TRUTH_TOPIC, layout_metadata
from pepper_driver.log.topics import (
    CONTACTS,
    EVENTS,
    FORCES,
    LABELS,
    JsonTopic,
    Label,
    LogEvent,
    TrueForce,
)
from pepper_driver.observer.interface import Contact

T = TypeVar("T")

BEGIN_SIZE = 2**17
"""[bytes] In which a log has its layout."""


@dataclass(frozen=True, kw_only=True)
class RunLog:
    """The contents of a log.

    Attributes:
        metadata: Text about the run, as given to ``LogWriter``.
        complete: False when the file ends early: the process was killed, the disk failed, or the end is damaged.
        gaps: What is missing before the end, because its bytes are damaged.
        missing: All that is missing, as text in one line; empty for a log that is whole.
        joint_names: Order of every joint vector.
        chains: Joints of each chain, from the trunk outwards.
        hand_joints: Joints that measure aperture, 0..1, not an angle.
        robot: Name of the robot.
        fields: Arrays over n ticks, (n,) or (n, width), by name; ``log["position"]`` is short for
            it. Units and meaning are in :data:`pepper_driver.backends.fields.TICK_FIELDS`.
        contacts: Contact events in the order they were raised.
        truth: Arrays of the simulation's ground truth, with a ``time`` of their own; None where
            there is no truth. Names are in :data:`pepper_driver.backends.fields.TRUTH_FIELDS`.
        forces: True forces on the robot in their order, one for each object, link and cycle; None where there is no
            truth, or where it is of a version that did not log them.
        labels: Ends of touches that ``pepper record`` received, in their order.
        events: Other events, in their order.
        unmatched: Arrays of the commands that no tick answers, by name; what they are is in
            :data:`pepper_driver.backends.fields.UNMATCHED_FIELDS`.
        elements: Names of the values of each vector in ``fields``, by its name; in ``truth``, as ``truth.<name>``.
    """

    metadata: dict[str, str]
    complete: bool
    joint_names: tuple[str, ...]
    chains: dict[str, tuple[str, ...]]
    hand_joints: tuple[str, ...]
    robot: str
    fields: dict[str, Column] = field(repr=False)
    contacts: list[Contact] = field(repr=False)
    truth: dict[str, Column] | None = field(repr=False)
    forces: list[TrueForce] | None = field(repr=False, default=None)
    labels: list[Label] = field(repr=False, default_factory=list)
    events: list[LogEvent] = field(repr=False, default_factory=list)
    unmatched: dict[str, Column] = field(repr=False, default_factory=dict)
    elements: dict[str, tuple[str, ...]] = field(repr=False, default_factory=dict)
    gaps: tuple[Gap, ...] = ()
    missing: str = ""

    def __getitem__(self, name: str) -> Column:
        """Return the array of one field.

        Raises:
            UnknownNameError: No such field.
        """
        try:
            return self.fields[name]
        except KeyError:
            raise UnknownNameError("log field", name, self.fields) from None

    def lasting_contacts(self) -> list[tuple[Contact, float]]:
        """Each contact as it was last seen, and when it ended [s]: at the last tick where the log does not say.

        The place of a contact becomes clearer after its begin: the last event has the best joint.
        """
        last = {contact.id: contact for contact in self.contacts}
        end = float(self["time"][-1]) if len(self) else np.nan
        return [(c, c.time if c.phase == "end" else end) for c in last.values()]

    def __len__(self) -> int:
        """Return the number of ticks."""
        return len(self.fields["time"])

    @classmethod
    def of(cls, file: RawLog) -> Self:
        """Return the log in a file.

        Raises:
            LogError: Its messages are not those of this package.
        """
        try:
            layout, ticks, truth = file.layout, file.tables[TICK_TOPIC], file.tables[TRUTH_TOPIC]
            has_forces = len(truth["time"]) > 0 and FORCES.topic in file.messages
            elements = [("", f) for f in file.fields[TICK_TOPIC]]
            elements += [("truth.", f) for f in file.fields[TRUTH_TOPIC]]
            return cls(
                metadata=file.metadata,
                complete=file.complete,
                gaps=file.gaps,
                missing=file.missing,
                joint_names=file.joint_names,
                chains={k: tuple(v) for k, v in json.loads(layout["chains"]).items()},
                hand_joints=tuple(json.loads(layout["hand_joints"])),
                robot=json.loads(layout["robot"]),
                fields=ticks,
                contacts=_items(file, CONTACTS),
                unmatched=file.tables[UNMATCHED_TOPIC],
                truth=truth if len(truth["time"]) else None,
                forces=_items(file, FORCES) if has_forces else None,
                labels=_items(file, LABELS),
                events=_items(file, EVENTS),
                elements={
                    p + f.name: f.elements
                    for p, f in elements
                    if f.elements is not None and f.name in (truth if p else ticks)
                },
            )
        except Exception as error:  # decoders raise anything on damaged bytes
            raise misfit(file.path, error) from error


@checked_arguments
def read_log(path: Path | str, *, names: Collection[str] | None = None) -> RunLog:
    """Read all of a log that is intact, and warn in one line of what is missing.

    Args:
        path: The file.
        names: Of the fields of ticks and of the truth that are kept, ``time`` among them; None for all. An hour of all
            is 0.8 GB in memory.

    Raises:
        LogError: The file is missing, no log of this package, or nothing of it is intact.
    """
    return RunLog.of(read_log_file(as_path("path", path), usual_layout(), names=names))


def begins_as_log(path: Path) -> bool:
    """Return True for a file whose begin is that of a log of this version and robot: reading it all takes longer."""
    try:
        with path.open("rb") as file:
            begin = file.read(BEGIN_SIZE)
    except OSError:
        return False
    return find_metadata(begin, (LAYOUT,)).get(LAYOUT) == usual_layout()


def usual_layout() -> dict[str, str]:
    """Return the layout of logs of the robot as this version describes it."""
    return layout_metadata(load_robot())


def _items(file: RawLog, topic: JsonTopic[T]) -> list[T]:
    return [topic.decode(message) for message in file.messages.get(topic.topic, [])]


TableColumn = NDArray[Any] | list[Any]
"""An array of numbers or truth values; a list of text, numbers, tuples of text, None."""

Table = Mapping[str, TableColumn]


def tick_table(log: RunLog) -> Table:
    """``time``, ``position.LShoulderRoll``, ...: each value of each tick in a column of its own."""
    return _columns(log.fields, log.elements, "")


def truth_table(log: RunLog) -> Table | None:
    """Return the arrays of the ground truth; None if the log has none."""
    return None if log.truth is None else _columns(log.truth, log.elements, "truth.")


def item_tables(log: RunLog) -> dict[str, tuple[JsonTopic[Any], Table]]:
    """``contacts`` and ``events``, ``labels`` and ``forces`` where there are any, with their topics."""
    lists: dict[str, tuple[JsonTopic[Any], Sequence[Any]]] = {
        "contacts": (CONTACTS, log.contacts),
        "events": (EVENTS, log.events),
    }
    if log.labels:
        lists["labels"] = (LABELS, log.labels)
    if log.forces:
        lists["forces"] = (FORCES, log.forces)
    return {
        name: (topic, {key: [getattr(item, key) for item in items] for key in topic.types})
        for name, (topic, items) in lists.items()
    }


def _columns(
    fields: Mapping[str, NDArray[Any]], elements: Mapping[str, tuple[str, ...]], prefix: str
) -> Table:
    table: dict[str, TableColumn] = {}
    for name, array in fields.items():
        if array.ndim == 1:
            table[name] = array
        else:
            for place, element in enumerate(elements[prefix + name]):
                table[f"{name}.{element}"] = np.ascontiguousarray(array[:, place])
    return table
