"""Rows of a log: fields of the binary topics, their message definitions, packing and reading.

A message is plain CDR of values and arrays of fixed size, wide ones first: so nothing needs padding, and the bytes of
the arrays, one after the other, are the message.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from operator import attrgetter
from typing import Any

import numpy as np

from pepper_driver.backends.interface import Command
from pepper_driver.backends.log_file import (
    CDR_HEADER,
    LAYOUT_VERSION,
    TICK_TOPIC,
    UNANSWERED_TOPIC,
    Field,
    FieldType,
    row_type,
)
from pepper_driver.backends.simulated import TruthSample
from pepper_driver.config import RobotConfig
from pepper_driver.controller.tick import Reference, Sent, Tick
from pepper_driver.log.topics import CONTACTS, EVENTS, LABELS, JsonTopic
from pepper_driver.observer.interface import JointState, Observation

TRUTH_TOPIC = "/truth"
JSON_TOPICS: tuple[JsonTopic[Any], ...] = (CONTACTS, LABELS, EVENTS)

_XYZ = ("x", "y", "z")


def _field(
    name: str, elements: Iterable[str] | None, meaning: str, type: FieldType = "float64"
) -> Field:
    names = None if elements is None else tuple(elements)
    return Field(name=name, elements=names, type=type, meaning=meaning)


def tick_fields(robot: RobotConfig) -> tuple[Field, ...]:
    """Fields of ``/tick``, scalars first, in the order of :mod:`pepper_driver.log.schema`."""
    joints, wheels, sensors = robot.joint_names, robot.wheels.names, robot.sensors
    return (
        _field("time", None, "[s] clock of the robot"),
        _field("battery", None, "charge, 0..1"),
        _field("age", None, "[s] since the sample was taken"),
        _field(
            "tick_end", None, "[s] from the deadline of the tick to its end; NaN where not paced"
        ),
        _field("charging_flap", None, "1 while open, NaN where nobody knows"),
        _field("tick", None, "number of the cycle", "int64"),
        _field(
            "step", None, "number of the tick since the log began, also of ticks not in it", "int64"
        ),
        _field(
            "answers",
            None,
            "ticks before this one in which the command was given that this sample answers; -1 for response_delay",
            "int64",
        ),
        _field("missed", None, "ticks missed since the log began", "int64"),
        _field("withheld", None, "commands held back since the start", "int64"),
        _field("position", joints, "[rad] measured"),
        _field("current", joints, "[A] absolute"),
        _field("wheel_speed", wheels, "[rad/s] measured"),
        *_sent_fields(robot, "the command this sample answers"),
        _field("expected", joints, "[rad] expected tracking error"),
        _field("residual", joints, "[rad] contact observer signal r"),
        _field("threshold", joints, "[rad] bound of the residual"),
        _field("torque", joints, "[N m] external torque estimate"),
        _field("torque_std", joints, "[N m] its standard deviation"),
        _field("imu_acceleration", _XYZ, "[m/s2]"),
        _field("imu_angular_velocity", _XYZ, "[rad/s]"),
        _field("imu_attitude", ("roll", "pitch", "yaw"), "[rad]"),
        _field("touch", sensors.touch, "1 where touched"),
        _field("bumpers", sensors.bumpers, "1 where pressed"),
        _field("buttons", sensors.buttons, "1 where pressed"),
        _field("temperature", joints, "[deg C] motors"),
        _field("stiffness", joints, "0..1 that the boards are told, NaN where nobody knows"),
        _changed_field(robot),
        _field(
            "state", joints, ", ".join(f"{s.value} {s.name.lower()}" for s in JointState), "int8"
        ),
    )


def unanswered_fields(robot: RobotConfig) -> tuple[Field, ...]:
    """Fields of ``/unanswered``, scalars first, in the order of :mod:`pepper_driver.log.schema`."""
    return (
        _field(
            "time", None, "[s] clock of the robot at the first sample that answers a later command"
        ),
        _field("step", None, "of the tick that gave the command", "int64"),
        *_sent_fields(robot, "a command that no sample answers"),
        _changed_field(robot),
    )


def _sent_fields(robot: RobotConfig, what: str) -> tuple[Field, ...]:
    joints = robot.joint_names
    return (
        _field("sent_position", joints, f"[rad] {what}"),
        _field("sent_stiffness", joints, "0..1"),
        _field("sent_wheel_speed", robot.wheels.names, "[rad/s]"),
        _field("reference_position", joints, "[rad]"),
        _field("reference_velocity", joints, "[rad/s]"),
        _field("reference_acceleration", joints, "[rad/s2]"),
        _field("reference_load_torque", joints, "[N m]"),
        _field("reference_base_twist", ("vx", "vy", "wz"), "[m/s], [m/s], [rad/s]"),
    )


def _changed_field(robot: RobotConfig) -> Field:
    return _field(
        "changed", robot.joint_names, "true where the safety gate altered the position", "bool"
    )


def truth_fields(robot: RobotConfig) -> tuple[Field, ...]:
    """Fields of ``/truth``, scalars first, in the order of :mod:`pepper_driver.log.schema`."""
    joints = robot.joint_names
    return (
        _field("time", None, "[s] clock of the robot"),
        _field("contact_torque", joints, "[N m] J^T f, mean over the last cycle"),
        _field("peak_torque", joints, "[N m] largest size of it in the last cycle"),
        _field("position", joints, "[rad] link side, without encoder"),
        _field("base", ("x", "y", "yaw"), "[m], [m], [rad] of base_link in the world"),
        _field("tilt", ("pitch", "roll"), "[rad] of the base"),
        _field("wheel_load", robot.wheels.names, "[N] carried by the floor"),
        _field("in_gap", joints, "true inside the backlash", "bool"),
        _field("saturated", joints, "true where the motor board was at a limit", "bool"),
    )


def message_definition(fields: Iterable[Field]) -> str:
    """The fields as a ROS 2 message definition, without empty ones: ROS has no array of size 0."""
    lines = []
    for field in fields:
        if field.elements is None:
            lines.append(f"{field.type} {field.name}  # {field.meaning}\n")
        elif field.elements:
            size = len(field.elements)
            lines.append(f"{field.type}[{size}] {field.name}  # {field.meaning}\n")
    return "".join(lines)


def layout_metadata(robot: RobotConfig) -> dict[str, str]:
    """What the reader must know of rows and robot: text values of the file's ``layout`` record.

    Channels have the numbers of their topics in ``topics``, from 1: no reader needs the records that say so.
    """
    tables = {
        TICK_TOPIC: tick_fields(robot),
        UNANSWERED_TOPIC: unanswered_fields(robot),
        TRUTH_TOPIC: truth_fields(robot),
    }
    values: Mapping[str, object] = {
        "topics": [*tables, *(topic.topic for topic in JSON_TOPICS)],
        "fields": {topic: [asdict(f) for f in fields] for topic, fields in tables.items()},
        "robot": robot.name,
        "joint_names": robot.joint_names,
        "chains": robot.chains,
        "hand_joints": robot.hands.joints,
    }
    return {"version": LAYOUT_VERSION, **{k: json.dumps(v) for k, v in values.items()}}


_type_of = attrgetter("dtype")
_TICK_SCALARS = struct.Struct("<4s5d5q")
_UNANSWERED_SCALARS = struct.Struct("<4sdq")
_TRUTH_SCALARS = struct.Struct("<4sd")


class TickRows:
    """Makes messages of ``/tick``.

    Args:
        robot: The robot whose ticks will come.
    """

    def __init__(self, robot: RobotConfig) -> None:
        self._arrays = _Arrays(tick_fields(robot))
        self._unobserved = unobserved(robot)
        self._unknown = np.full(len(robot.joints), np.nan)

    def message(
        self,
        tick: Tick,
        observation: Observation | None,
        step: int,
        tick_end: float,
        missed: int,
    ) -> bytes:
        """One tick; without an observation nothing is known and all joints are blind.

        Raises:
            Exception: Values that are no row.
        """
        m, imu = tick.measurement, tick.measurement.imu
        seen = self._unobserved if observation is None else observation
        scalars = _TICK_SCALARS.pack(
            CDR_HEADER,
            m.time,
            m.battery,
            m.age,
            tick_end,
            m.charging_flap,
            m.tick,
            step,
            -1 if m.answers is None else m.answers,
            missed,
            m.withheld,
        )
        return self._arrays.message(
            scalars,
            (
                m.position,
                m.current,
                m.wheel_speed,
                *_sent_arrays(tick.sent, tick.reference),
                seen.expected,
                seen.residual,
                seen.threshold,
                seen.torque,
                seen.torque_std,
                imu.acceleration,
                imu.angular_velocity,
                imu.attitude,
                m.touch,
                m.bumpers,
                m.buttons,
                m.temperature,
                self._unknown if m.stiffness is None else m.stiffness,
                tick.changed,
                seen.state,
            ),
        )


class UnansweredRows:
    """Makes messages of ``/unanswered``.

    Args:
        robot: The robot whose commands will come.
    """

    def __init__(self, robot: RobotConfig) -> None:
        self._arrays = _Arrays(unanswered_fields(robot))

    def message(self, time: float, step: int, sent: Sent) -> bytes:
        """A command given in ``step``, passed over by the sample of ``time`` [s].

        Raises:
            Exception: Values that are no row.
        """
        return self._arrays.message(
            _UNANSWERED_SCALARS.pack(CDR_HEADER, time, step),
            (*_sent_arrays(sent.command, sent.reference), sent.changed),
        )


class TruthRows:
    """Makes messages of ``/truth``.

    Args:
        robot: The robot whose truth will come.
    """

    def __init__(self, robot: RobotConfig) -> None:
        self._arrays = _Arrays(truth_fields(robot))

    def message(self, time: float, truth: TruthSample) -> bytes:
        """The truth at ``time`` [s].

        Raises:
            Exception: Values that are no row.
        """
        return self._arrays.message(
            _TRUTH_SCALARS.pack(CDR_HEADER, time),
            (
                truth.contact_torque,
                truth.peak_torque,
                truth.position,
                truth.base,
                truth.tilt,
                truth.wheel_load,
                truth.in_gap,
                truth.saturated,
            ),
        )


def _sent_arrays(sent: Command, reference: Reference) -> tuple[Any, ...]:
    return (
        sent.position,
        sent.stiffness,
        sent.wheel_speed,
        reference.position,
        reference.velocity,
        reference.acceleration,
        reference.load_torque,
        reference.base_twist,
    )


class _Arrays:
    """Joins the arrays of a row, as its fields ask for them."""

    def __init__(self, fields: tuple[Field, ...]) -> None:
        vectors = [field for field in fields if field.elements is not None]
        self._types = [np.dtype(field.type) for field in vectors]
        self._size = len(CDR_HEADER) + row_type(fields).itemsize

    def message(self, scalars: bytes, arrays: tuple[Any, ...]) -> bytes:
        """The bytes of a message.

        Raises:
            ValueError: Arrays of other sizes.
        """
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

    def _converted(self, arrays: tuple[Any, ...]) -> list[Any]:
        return [
            np.ascontiguousarray(array, dtype=type)
            for array, type in zip(arrays, self._types, strict=True)
        ]


def unobserved(robot: RobotConfig) -> Observation:
    """What is logged where no observer ran: nothing known, all joints blind."""
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
