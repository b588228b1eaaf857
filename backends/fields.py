"""Fields of a tick: measurements, commands, and the one table that log, recording, mirror and replay follow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import nan
from typing import Any, Literal, TypeVar

from numpy.typing import NDArray

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True, slots=True)
class Imu:
    """Inertial unit of the base: (3,) ``acceleration`` [m/s2], ``angular_velocity`` [rad/s], ``attitude`` rpy [rad]."""

    acceleration: FloatArray
    angular_velocity: FloatArray
    attitude: FloatArray


@dataclass(frozen=True, kw_only=True, slots=True)
class Measurement:
    """One sample of all sensors. Joint vectors are in the order of ``RobotConfig.joint_names``.

    The log and callbacks read it on threads of their own: its arrays are never changed once it was handed over.

    Attributes:
        time: Clock of the robot [s], counted from ``open``.
        tick: Number of the cycle that produced the sample; the one of ``open`` is 0.
        position: (17,) joint encoders [rad]; hands as aperture 0..1.
        current: (17,) absolute motor current [A].
        wheel_speed: (3,) [rad/s].
        imu: Inertial unit of the base.
        touch: (5,) 1.0 where touched, order of ``sensors.touch``.
        bumpers: (3,) 1.0 where pressed, order of ``sensors.bumpers``.
        buttons: (1,) 1.0 where pressed, order of ``sensors.buttons``.
        temperature: (17,) motors [deg C].
        battery: Charge, 0..1.
        age: Age of the sample [s], beyond the constant latency.
        charging_flap: 1.0 while the flap over the charging socket is open, NaN where unknown.
        response_delay: How many commands before the last written one the command was written that a sample without
            ``age`` answers, 0 for the last one; None where it is ``BackendInfo.response_delay``.
        dropped_commands: Commands since ``activate`` that were not sent, because too many were in flight.
        stiffness: (17,) at the motor boards, commanded by any program, 0..1; NaN for joints, or None for a robot,
            whose stiffness is unknown.
        stale_reason: Human-readable reason why there is no younger sample; empty if there is one, or if unknown.
        commanded_by_others: Joints and wheels that another program commands, by name, where the backend can see that.
            Not logged: the fault that it leads to names them.
    """

    time: float
    tick: int
    position: FloatArray
    current: FloatArray
    wheel_speed: FloatArray
    imu: Imu
    touch: FloatArray
    bumpers: FloatArray
    buttons: FloatArray
    temperature: FloatArray
    battery: float
    age: float
    charging_flap: float = nan
    response_delay: int | None = None
    dropped_commands: int = 0
    stiffness: FloatArray | None = None
    stale_reason: str = ""
    commanded_by_others: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Command:
    """Command for one cycle.

    Attributes:
        position: (17,) [rad], to be reached at the end of the cycle.
        stiffness: (17,) 0..1, scales the current limit of each motor board.
        wheel_speed: (3,) [rad/s].
    """

    position: FloatArray
    stiffness: FloatArray
    wheel_speed: FloatArray


FieldType = Literal["float64", "int64", "bool", "int8"]

Column = NDArray[Any]
"""Values of a field over the rows of a table, of its type: (n,) or (n, width)."""

Shape = Literal["scalar", "joints", "wheels", "touch", "bumpers", "buttons"]

# A mirror reverses a velocity along its normal, but a rate of rotation, a pseudovector, in the other two directions.
Mirror = Literal["", "angle", "size", "wheels", "vector", "axis", "twist"]
"""Change of a column in the plane of symmetry: that of joints by their signs, or without; of wheels; in base axes."""


@dataclass(frozen=True)
class TickField:
    """One field of a table.

    Attributes:
        owner: The part of the row that has it: one of :class:`pepper_driver.controller.Tick`, ``observation``,
            ``truth``; empty for the row itself.
        attribute: Its name there.
        shape: A scalar, a value for each joint, wheel or sensor of the robot, or the names of the values.
        unit: In brackets; empty where it has none.
        meaning: Where the name does not say it.
        type: Of the values.
        absent: In place of None.
        column: Name in a :class:`pepper_driver.observer.Recording`; empty where that has no such column.
        mirror: What a mirror makes of the column.
    """

    owner: str
    attribute: str
    shape: Shape | tuple[str, ...]
    unit: str
    meaning: str = ""
    type: FieldType = "float64"
    absent: float | None = None
    column: str = ""
    mirror: Mirror = ""

    @property
    def name(self) -> str:
        """Name in the log, with a prefix for commands, references and the inertial unit."""
        part = self.owner.rpartition(".")[2]
        return f"{part}_{self.attribute}" if part in _PREFIXES else self.attribute

    @property
    def source(self) -> str:
        """Attribute of the row: ``measurement.imu.attitude``."""
        return f"{self.owner}.{self.attribute}" if self.owner else self.attribute

    def elements(self, robot: RobotConfig) -> tuple[str, ...] | None:
        """Return the names of the values; None for a scalar."""
        if isinstance(self.shape, tuple):
            return self.shape
        if self.shape in ("touch", "bumpers", "buttons"):
            return tuple(getattr(robot.sensors, self.shape))
        return {"joints": robot.joint_names, "wheels": robot.wheels.names}.get(self.shape)


_PREFIXES = ("sent", "reference", "imu")
_XYZ, _RPY, _TWIST = ("x", "y", "z"), ("roll", "pitch", "yaw"), ("vx", "vy", "wz")
_TWIST_UNITS = "[m/s], [m/s], [rad/s]"
_M, _IMU, _R, _O, _T = "measurement", "measurement.imu", "reference", "observation", "truth"
_F = TickField


_GATED = "true where the safety gate altered the position"
_LIMITED = _F("", "limited", "joints", "", _GATED, "bool", column="limited", mirror="size")


def _command(meaning: str) -> tuple[TickField, ...]:
    return (
        _F("sent", "position", "joints", "[rad]", meaning, column="sent_position", mirror="angle"),
        _F("sent", "stiffness", "joints", "", "0..1", column="stiffness", mirror="size"),
        _F("sent", "wheel_speed", "wheels", "[rad/s]", column="sent_wheel_speed", mirror="wheels"),
        _F(_R, "position", "joints", "[rad]", column="reference_position", mirror="angle"),
        _F(_R, "velocity", "joints", "[rad/s]", column="velocity", mirror="angle"),
        _F(_R, "acceleration", "joints", "[rad/s2]", column="acceleration", mirror="angle"),
        _F(_R, "load_torque", "joints", "[N m]", column="load_torque", mirror="angle"),
        _F(_R, "base_twist", _TWIST, _TWIST_UNITS, column="base_twist", mirror="twist"),
    )


_STATES = "0 free, 1 contact, 2 release, 3 rebound, 4 blind, 5 doubtful"
_RESPONSE_DELAY = "ticks before this one in which the command was given that this sample answers; -1 for response_delay"
_STEP = "number of the tick since the log began, also of ticks not in it"
_PACED = "from the deadline of the tick to its end; NaN where not paced"
_MOTOR_STIFFNESS = "0..1 at the motor boards, NaN where unknown"
_PASSED = "clock of the robot at the first sample that answers a later command"

TICK_FIELDS: tuple[TickField, ...] = (
    _F(_M, "time", "scalar", "[s]", "clock of the robot", column="time"),
    _F(_M, "battery", "scalar", "", "charge, 0..1"),
    _F(_M, "age", "scalar", "[s]", "since the sample was measured", column="age"),
    _F("", "tick_end", "scalar", "[s]", _PACED),
    _F(_M, "charging_flap", "scalar", "", "1 while open, NaN where unknown"),
    _F(_M, "tick", "scalar", "", "number of the cycle", "int64"),
    _F("", "step", "scalar", "", _STEP, "int64"),
    _F(_M, "response_delay", "scalar", "", _RESPONSE_DELAY, "int64", absent=-1),
    _F("", "missed", "scalar", "", "ticks missed since the log began", "int64"),
    _F(_M, "dropped_commands", "scalar", "", "commands held back since the start", "int64"),
    _F(_M, "position", "joints", "[rad]", "measured", column="position", mirror="angle"),
    _F(_M, "current", "joints", "[A]", "absolute", column="current", mirror="size"),
    _F(_M, "wheel_speed", "wheels", "[rad/s]", "measured", column="wheel_speed", mirror="wheels"),
    *_command("the command this sample answers"),
    _F(_O, "expected", "joints", "[rad]", "expected tracking error"),
    _F(_O, "residual", "joints", "[rad]", "contact observer signal r"),
    _F(_O, "threshold", "joints", "[rad]", "bound of the residual"),
    _F(_O, "torque", "joints", "[N m]", "external torque estimate"),
    _F(_O, "torque_std", "joints", "[N m]", "its standard deviation"),
    _F(_IMU, "acceleration", _XYZ, "[m/s2]", column="linear_acceleration", mirror="vector"),
    _F(_IMU, "angular_velocity", _XYZ, "[rad/s]", column="angular_velocity", mirror="axis"),
    _F(_IMU, "attitude", _RPY, "[rad]", column="attitude", mirror="axis"),
    _F(_M, "touch", "touch", "", "1 where touched"),
    _F(_M, "bumpers", "bumpers", "", "1 where pressed"),
    _F(_M, "buttons", "buttons", "", "1 where pressed"),
    _F(_M, "temperature", "joints", "[deg C]", "motors"),
    _F(_M, "stiffness", "joints", "", _MOTOR_STIFFNESS, absent=nan),
    _LIMITED,
    _F(_O, "state", "joints", "", _STATES, "int8"),
)
"""One row a tick: ``/tick`` of a log, scalars first, and what a recording keeps of it."""

UNMATCHED_FIELDS: tuple[TickField, ...] = (
    _F("", "time", "scalar", "[s]", _PASSED),
    _F("", "step", "scalar", "", "of the tick that gave the command", "int64"),
    *_command("a command that no sample answers"),
    _LIMITED,
)
"""One row for each command that no tick answers."""

TRUTH_FIELDS: tuple[TickField, ...] = (
    _F("", "time", "scalar", "[s]", "clock of the robot"),
    _F(_T, "contact_torque", "joints", "[N m]", "J^T f, mean over the last cycle"),
    _F(_T, "peak_torque", "joints", "[N m]", "largest size of it in the last cycle"),
    _F(_T, "position", "joints", "[rad]", "link side, without encoder"),
    _F(_T, "base", ("x", "y", "yaw"), "[m], [m], [rad]", "of base_link in the world"),
    _F(_T, "tilt", ("pitch", "roll"), "[rad]", "of the base"),
    _F(_T, "wheel_load", "wheels", "[N]", "carried by the floor"),
    _F(_T, "in_gap", "joints", "", "true inside the backlash", "bool"),
    _F(_T, "saturated", "joints", "", "true where the motor board was at a limit", "bool"),
)
"""One row a tick of a simulation whose ground truth is logged."""

COMMAND_FIELDS: tuple[TickField, ...] = (*_command(""), _LIMITED)
"""Of a command as it was sent: those of :class:`pepper_driver.controller.tick.SentCommand`, in any table."""

RECORDED_FIELDS = tuple(field for field in TICK_FIELDS if field.column)
"""Columns of a recording."""


def fields_of(owner: str) -> tuple[TickField, ...]:
    """Return the fields of one part of a tick, such as ``sent``."""
    return tuple(field for field in TICK_FIELDS if field.owner == owner)


def objects(
    make: Callable[..., T], owner: str, columns: Mapping[TickField, Column], **more: Iterable[Any]
) -> Iterator[T]:
    """Rebuild one part of each row from columns. Vectors are read-only.

    Args:
        make: Class of the part.
        owner: Name of the part; columns of others do not count.
        columns: Of the table.
        more: Other attributes of the part, one value a row; columns come before them.
    """
    own = more | {f.attribute: _values(f, c) for f, c in columns.items() if f.owner == owner}
    return (make(**dict(zip(own, row, strict=True))) for row in zip(*own.values(), strict=True))


def _values(field: TickField, column: Column) -> Iterable[Any]:
    if column.ndim == 1:
        return [None if value == field.absent else value for value in column.tolist()]
    # A view: the caller's own array stays writable.
    column = column.view()
    column.flags.writeable = False
    return column
