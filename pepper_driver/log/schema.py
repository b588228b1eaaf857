"""What one row of the log holds: field tables, ROS 2 message definitions, from a tick to a row.

A message is the CDR header followed by float64 values only, so a row of a float64 array is its own
encoding: values of one width need no padding, and arrays of fixed size carry no length.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepper_driver.backends.interface import Truth
from pepper_driver.config import RobotConfig
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.contact import Contact, Kind, Phase
from pepper_driver.observer.interface import JointState, Observation

FloatArray = NDArray[np.float64]
FieldType = Literal["float64", "int64", "int8", "bool"]

TICK_TOPIC = "/tick"
TRUTH_TOPIC = "/truth"
CONTACT_TOPIC = "/contact"

CDR_HEADER = b"\x00\x01\x00\x00"
"""Plain CDR, little-endian, no options."""

LAYOUT_VERSION = "1"


@dataclass(frozen=True, kw_only=True)
class Field:
    """One field of a row.

    Attributes:
        name: Name in the message and in ``LogData``.
        width: Number of values; None for a scalar.
        type: What the reader turns the float64 values of the file back into.
        meaning: Unit and meaning, for the comment in the message definition.
    """

    name: str
    width: int | None
    type: FieldType
    meaning: str

    @property
    def columns(self) -> int:
        """Number of float64 values in a row."""
        return 1 if self.width is None else self.width


def _field(name: str, width: int | None, meaning: str, type: FieldType = "float64") -> Field:
    return Field(name=name, width=width, type=type, meaning=meaning)


def tick_fields(robot: RobotConfig) -> tuple[Field, ...]:
    """Fields of ``/tick``, in the order of :func:`tick_parts`."""
    n = len(robot.joints)
    return (
        _field("tick", None, "number of the cycle", "int64"),
        _field("time", None, "[s] clock of the robot"),
        _field("battery", None, "charge, 0..1"),
        _field("age", None, "[s] since the sample was taken"),
        _field("charging_flap", None, "1 while open, NaN where nobody knows"),
        _field("position", n, "[rad] measured"),
        _field("current", n, "[A] absolute"),
        _field("wheel_speed", 3, "[rad/s] measured"),
        _field("sent_position", n, "[rad] the command this sample answers"),
        _field("sent_stiffness", n, "0..1"),
        _field("sent_wheel_speed", 3, "[rad/s]"),
        _field("reference_position", n, "[rad]"),
        _field("reference_velocity", n, "[rad/s]"),
        _field("reference_acceleration", n, "[rad/s2]"),
        _field("reference_load_torque", n, "[N m]"),
        _field("reference_base_twist", 3, "vx [m/s], vy [m/s], wz [rad/s]"),
        _field("changed", n, "1 where the safety gate altered the position", "bool"),
        _field("expected", n, "[rad] expected tracking error"),
        _field("residual", n, "[rad] contact observer signal r"),
        _field("threshold", n, "[rad] bound of the residual"),
        _field("torque", n, "[N m] external torque estimate"),
        _field("torque_std", n, "[N m] its standard deviation"),
        _field("state", n, ", ".join(f"{s.value} {s.name.lower()}" for s in JointState), "int8"),
        _field("imu_acceleration", 3, "[m/s2]"),
        _field("imu_angular_velocity", 3, "[rad/s]"),
        _field("imu_attitude", 3, "[rad] roll, pitch, yaw"),
        _field("touch", len(robot.sensors.touch), "1 where touched"),
        _field("bumpers", len(robot.sensors.bumpers), "1 where pressed"),
        _field("buttons", len(robot.sensors.buttons), "1 where pressed"),
        _field("temperature", n, "[deg C] motors"),
    )


def truth_fields(robot: RobotConfig) -> tuple[Field, ...]:
    """Fields of ``/truth``, in the order of :func:`truth_parts`."""
    n = len(robot.joints)
    return (
        _field("time", None, "[s] clock of the robot"),
        _field("contact_torque", n, "[N m] J^T f, mean over the last cycle"),
        _field("peak_torque", n, "[N m] largest size of it in the last cycle"),
        _field("in_gap", n, "1 inside the backlash", "bool"),
        _field("saturated", n, "1 where the motor board was at a limit", "bool"),
        _field("position", n, "[rad] link side, without encoder"),
        _field("base", 3, "x [m], y [m], yaw [rad] of base_link in the world"),
        _field("tilt", 2, "[rad] pitch, roll of the base"),
        _field("wheel_load", 3, "[N] carried by the floor"),
    )


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


def tick_parts(tick: Tick, observation: Observation, scalars: FloatArray) -> list[ArrayLike]:
    """The 1-D arrays that make up a row of ``/tick``, not copied.

    ``scalars`` (5,) is filled and comes first.
    """
    m, sent, reference, imu = tick.measurement, tick.sent, tick.reference, tick.measurement.imu
    scalars[0] = m.tick
    scalars[1] = m.time
    scalars[2] = m.battery
    scalars[3] = m.age
    scalars[4] = m.charging_flap
    return [
        scalars,
        m.position,
        m.current,
        m.wheel_speed,
        sent.position,
        sent.stiffness,
        sent.wheel_speed,
        reference.position,
        reference.velocity,
        reference.acceleration,
        reference.load_torque,
        reference.base_twist,
        tick.changed,
        observation.expected,
        observation.residual,
        observation.threshold,
        observation.torque,
        observation.torque_std,
        observation.state,
        imu.acceleration,
        imu.angular_velocity,
        imu.attitude,
        m.touch,
        m.bumpers,
        m.buttons,
        m.temperature,
    ]


def truth_parts(time: float, truth: Truth) -> list[ArrayLike]:
    """The 1-D arrays that make up a row of ``/truth``, not copied."""
    return [
        (time,),
        truth.contact_torque,
        truth.peak_torque,
        truth.in_gap,
        truth.saturated,
        truth.position,
        truth.base,
        truth.tilt,
        truth.wheel_load,
    ]


def columns(fields: Iterable[Field]) -> int:
    """Number of float64 values in a row of ``fields``."""
    return sum(field.columns for field in fields)


def message_definition(fields: Iterable[Field]) -> str:
    """The fields as a ROS 2 message definition, without empty ones: ROS has no array of size 0."""
    lines = []
    for field in fields:
        size = "" if field.width is None else f"[{field.width}]"
        if field.columns:
            lines.append(f"float64{size} {field.name}  # {field.meaning}\n")
    return "".join(lines)


def contact_schema() -> str:
    """JSON schema of ``/contact``."""
    optional = {"type": ["number", "null"]}
    properties: dict[str, dict[str, object]] = {
        "id": {"type": "integer"},
        "phase": {"type": "string", "enum": list(get_args(Phase))},
        "kind": {"type": "string", "enum": list(get_args(Kind))},
        "joint": {"type": ["string", "null"]},
        "link": {"type": "string"},
        "direction": {"type": "integer", "enum": [-1, 1]},
        "intensity": {"type": "number", "description": "[deg]"},
        "torque": {**optional, "description": "[N m]"},
        "torque_std": {**optional, "description": "[N m]"},
        "onset_time": {"type": "number", "description": "[s]"},
        "detection_time": {"type": "number", "description": "[s]"},
        "time": {"type": "number", "description": "[s]"},
    }
    return json.dumps(
        {
            "title": "pepper_driver.Contact",
            "type": "object",
            "properties": properties,
            "required": list(properties),
        }
    )


def contact_to_json(contact: Contact) -> bytes:
    """A contact as JSON; floats keep every bit.

    Raises:
        TypeError: A value that is neither text nor number.
    """
    return json.dumps(asdict(contact), default=_plain).encode()


def _plain(value: object) -> object:
    """NumPy scalars, which observers easily let through, as Python numbers."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{value!r} has no place in a contact")


def layout_metadata(robot: RobotConfig) -> dict[str, str]:
    """What the reader must know of rows and robot: text values of the file's ``layout`` record."""
    tables = {TICK_TOPIC: tick_fields(robot), TRUTH_TOPIC: truth_fields(robot)}
    values: Mapping[str, object] = {
        "fields": {topic: [asdict(f) for f in fields] for topic, fields in tables.items()},
        "joint_names": robot.joint_names,
        "chains": robot.chains,
        "hand_joints": robot.hands.joints,
        "wheels": robot.wheels.names,
        "touch": list(robot.sensors.touch),
        "bumpers": list(robot.sensors.bumpers),
        "buttons": list(robot.sensors.buttons),
    }
    return {"version": LAYOUT_VERSION, **{k: json.dumps(v) for k, v in values.items()}}
