"""What one row of the log holds: field tables and ROS 2 message definitions.

A message is plain CDR of values and arrays of fixed size, wide ones first: so nothing needs padding, and the bytes of
the arrays, one after the other, are the message.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

from pepper_driver.backends.log_file import (
    LAYOUT_VERSION,
    TICK_TOPIC,
    UNANSWERED_TOPIC,
    Field,
    FieldType,
)
from pepper_driver.config import RobotConfig
from pepper_driver.log.contacts import CONTACTS
from pepper_driver.log.event import EVENTS
from pepper_driver.log.json_topic import JsonTopic
from pepper_driver.log.label import LABELS
from pepper_driver.observer.interface import JointState

TRUTH_TOPIC = "/truth"
JSON_TOPICS: tuple[JsonTopic[Any], ...] = (CONTACTS, LABELS, EVENTS)

_XYZ = ("x", "y", "z")


def _field(
    name: str, elements: Iterable[str] | None, meaning: str, type: FieldType = "float64"
) -> Field:
    names = None if elements is None else tuple(elements)
    return Field(name=name, elements=names, type=type, meaning=meaning)


def tick_fields(robot: RobotConfig) -> tuple[Field, ...]:
    """Fields of ``/tick``, scalars first, in the order of :mod:`pepper_driver.log.rows`."""
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
    """Fields of ``/unanswered``, scalars first, in the order of :mod:`pepper_driver.log.rows`."""
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
    """Fields of ``/truth``, scalars first, in the order of :mod:`pepper_driver.log.rows`."""
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
