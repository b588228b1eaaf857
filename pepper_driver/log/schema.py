"""Rows of a log: message definitions and packing of the tables of :mod:`pepper_driver.backends.fields`.

A message is plain CDR of values and arrays of fixed size, wide ones first: so nothing needs padding, and the bytes of
the arrays, one after the other, are the message.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from pepper_driver.backends.fields import (
    TICK_FIELDS,
    TRUTH_FIELDS,
    UNMATCHED_FIELDS,
    Command,
    Measurement,
    TickField,
)
from pepper_driver.backends.log_file import (
    CDR_HEADER,
    LAYOUT_VERSION,
    TICK_TOPIC,
    UNMATCHED_TOPIC,
    Field,
    row_type,
)
from pepper_driver.backends.simulated import TruthSample
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray
from pepper_driver.controller.tick import Reference
from pepper_driver.log.ros_messages import ROS_TOPICS
from pepper_driver.log.topics import CONTACTS, EVENTS, FORCES, LABELS, JsonTopic
from pepper_driver.observer.interface import JointState, Observation

TRUTH_TOPIC = "/truth"
JSON_TOPICS: tuple[JsonTopic[Any], ...] = (CONTACTS, LABELS, EVENTS, FORCES)


def layout_fields(table: Iterable[TickField], robot: RobotConfig) -> tuple[Field, ...]:
    """Return the fields of a table as a file names them, with the values of this robot."""
    return tuple(
        Field(
            name=field.name,
            elements=field.elements(robot),
            type=field.type,
            meaning=" ".join(filter(None, (field.unit, field.meaning))),
        )
        for field in table
    )


def message_definition(fields: Iterable[Field]) -> str:
    """Return the fields as a ROS 2 message definition, without empty ones: ROS has no array of size 0."""
    lines = []
    for field in fields:
        if field.elements is None:
            lines.append(f"{field.type} {field.name}  # {field.meaning}\n")
        elif field.elements:
            size = len(field.elements)
            lines.append(f"{field.type}[{size}] {field.name}  # {field.meaning}\n")
    return "".join(lines)


def layout_metadata(robot: RobotConfig) -> dict[str, str]:
    """Describe rows and robot to the reader: text values of the file's ``layout`` record.

    Channels have the numbers of their topics in ``topics``, from 1: no reader needs the records that say so.
    """
    tables = {
        TICK_TOPIC: layout_fields(TICK_FIELDS, robot),
        UNMATCHED_TOPIC: layout_fields(UNMATCHED_FIELDS, robot),
        TRUTH_TOPIC: layout_fields(TRUTH_FIELDS, robot),
    }
    # New ones at the end: then older logs whose layout is damaged are read by this one.
    items = (CONTACTS, LABELS, EVENTS, *ROS_TOPICS, FORCES)
    values: Mapping[str, object] = {
        "topics": [*tables, *(topic.topic for topic in items)],
        "fields": {topic: [asdict(f) for f in fields] for topic, fields in tables.items()},
        "robot": robot.name,
        "joint_names": robot.joint_names,
        "chains": robot.chains,
        "hand_joints": robot.hands.joints,
    }
    return {"version": LAYOUT_VERSION, **{k: json.dumps(v) for k, v in values.items()}}


_type_of = attrgetter("dtype")


class Rows:
    """Makes messages of one table.

    Args:
        table: Its fields, scalars first.
        robot: The robot whose rows will come.
    """

    def __init__(self, table: Sequence[TickField], robot: RobotConfig) -> None:
        fields = layout_fields(table, robot)
        scalars = [f for f in fields if f.elements is None]
        self._scalars = struct.Struct(
            "<4s" + "".join("q" if f.type == "int64" else "d" for f in scalars)
        )
        self._first_array = len(scalars)
        self._types = [np.dtype(f.type) for f in fields[self._first_array :]]
        self._size = len(CDR_HEADER) + row_type(fields).itemsize
        self._values = attrgetter(*(field.source for field in table))
        self._absent = [
            (place, entry.absent if f.elements is None else np.full(len(f.elements), entry.absent))
            for place, (entry, f) in enumerate(zip(table, fields, strict=True))
            if entry.absent is not None
        ]

    def message(self, row: object) -> bytes:
        """Return the bytes of a row, an object with the parts that the table names.

        Raises:
            Exception: Values that are no row.
        """
        values = list(self._values(row))
        for place, absent in self._absent:
            if values[place] is None:
                values[place] = absent
        scalars = self._scalars.pack(CDR_HEADER, *values[: self._first_array])
        arrays = values[self._first_array :]
        try:
            as_asked = list(map(_type_of, arrays)) == self._types
            message = b"".join((scalars, *arrays)) if as_asked else b""
        except (AttributeError, BufferError):  # no array, or one with gaps
            message = b""
        if not message:
            message = b"".join((scalars, *self._converted(arrays)))
        if len(message) != self._size:
            raise ValueError(f"a row of {len(message)} bytes in place of {self._size}")
        return message

    def _converted(self, arrays: list[Any]) -> list[Any]:
        return [
            np.ascontiguousarray(array, dtype=type)
            for array, type in zip(arrays, self._types, strict=True)
        ]


class TickRow(NamedTuple):
    """Parts of a row of ``/tick``."""

    measurement: Measurement
    reference: Reference
    sent: Command
    limited: BoolArray
    observation: Observation
    step: int
    tick_end: float
    missed: int


class UnmatchedRow(NamedTuple):
    """Parts of a row of ``/unmatched``: a command given in ``step``, passed over by the sample of ``time`` [s]."""

    time: float
    step: int
    sent: Command
    reference: Reference
    limited: BoolArray


class TruthRow(NamedTuple):
    """Parts of a row of ``/truth``."""

    time: float
    truth: TruthSample


def unobserved(robot: RobotConfig) -> Observation:
    """Return the observation of a run without observer: nothing known, all joints blind."""
    nothing = np.full(len(robot.joints), np.nan)
    blind = np.full(len(robot.joints), JointState.BLIND, dtype=np.int8)
    return Observation(
        contacts=(),
        expected=nothing,
        residual=nothing,
        threshold=nothing,
        torque=nothing,
        torque_std=nothing,
        state=blind,
    )
