"""Recording: the arrays of one run, their file, and the mirror image of a run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from io import BytesIO
from itertools import repeat
from operator import attrgetter
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends.fields import (
    RECORDED_FIELDS,
    Column,
    Command,
    Imu,
    Measurement,
    Mirror,
    objects,
)
from pepper_driver.config import PepperError, RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.errors import reason, short_reason
from pepper_driver.config.files import write_bytes
from pepper_driver.controller.tick import Reference, Tick

T = TypeVar("T")

FORMAT = 2

_FORMAT_NAME = "recording_format"
_REMEDY = "record the run again"


class RecordingError(PepperError, ValueError):
    """A recording is too short, of the wrong shape, not finite, of another robot, or its file is damaged."""


def arrays_as_bytes(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the content of a file of arrays, which :func:`read_arrays` reads."""
    file = BytesIO()
    np.savez_compressed(file, allow_pickle=False, **{_FORMAT_NAME: np.array(FORMAT)}, **arrays)
    return file.getvalue()


def read_arrays(path: Path, names: Iterable[str]) -> dict[str, NDArray[Any]]:
    """Read the arrays ``names``; a file without one of them, or with others, is refused.

    Raises:
        RecordingError: In one line: file, reason, remedy.
    """
    expected = {_FORMAT_NAME, *names}
    try:
        with path.open("rb") as stream:
            file = np.load(stream, allow_pickle=False)
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise RecordingError("a single array")
            found = set(file.files)
            if _FORMAT_NAME not in found:
                raise RecordingError("arrays of something else")
            version = file[_FORMAT_NAME]
            if version.shape != () or version != FORMAT:
                raise RecordingError(
                    f"of format {str(version)[:20]}, not the format {FORMAT} of this version"
                )
            if missing := sorted(expected - found):
                raise RecordingError(f"without {', '.join(missing)}")
            if extra := sorted(found - expected):
                raise RecordingError(f"with unknown {', '.join(extra)}")
            return {name: file[name] for name in names}
    except RecordingError as error:
        raise RecordingError(f"{path}: is no recording, it is {error}; {_REMEDY}") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({reason(error)}); {_REMEDY}") from error
    except Exception as error:  # the decoders of damaged bytes raise errors of many types
        raise RecordingError(f"{path}: damaged: {short_reason(error)}; {_REMEDY}") from error


# The reflection turns the sign of y of a vector, and of all but y of an axis of rotation.
_TWIST_SIGNS = np.array([1.0, -1.0, -1.0])
_VECTOR_SIGNS = np.array([1.0, -1.0, 1.0])
_AXIS_SIGNS = np.array([-1.0, 1.0, -1.0])

_MIRROR_SIGNS = {"twist": _TWIST_SIGNS, "vector": _VECTOR_SIGNS, "axis": _AXIS_SIGNS}


def mirrored_column(mirror: Mirror, column: Column, robot: RobotConfig) -> Column:
    """Return the mirror image of a column; the robot has the partners and signs of joints and the places of wheels."""
    if mirror in _MIRROR_SIGNS:
        column = column * _MIRROR_SIGNS[mirror]
    elif mirror == "wheels":
        column = column @ ((robot.wheels.matrix * _TWIST_SIGNS) @ robot.wheels.inverse).T
    elif mirror:
        column = column[:, [index for index, _ in robot.mirror]]
        if mirror == "angle":
            column = column * np.array([sign for _, sign in robot.mirror])
    return column


__all__ = ["STALE_AGE", "Recording", "RecordingBuilder", "RecordingError"]


STALE_AGE = 0.03
"""[s] An encoder sample older than this is no reply to the command it is paired with."""

_FIELDS = {field.column: field for field in RECORDED_FIELDS}

# Values of a rebuilt tick that a recording does not have.
_TEMPERATURE = 30.0  # [deg C]
_UNTOUCHED = {"touch": np.zeros(5), "bumpers": np.zeros(3), "buttons": np.zeros(1)}
for _zeros in _UNTOUCHED.values():
    _zeros.flags.writeable = False


def _with_all_columns(cls: type[T]) -> type[T]:
    """Declare the columns of the table as fields of a dataclass."""
    for name in _FIELDS:
        cls.__annotations__.setdefault(name, Column)
    return cls


@dataclass(frozen=True, kw_only=True, eq=False)
@_with_all_columns
class Recording:
    """One run, n samples of N joints. The arrays are read-only.

    Each row pairs a measurement with the command and the reference that it answers.

    Attributes:
        joint_names: Order of the columns.
        time: (n,) clock of the robot [s], increasing.
        age: (n,) age of the encoder sample beyond the usual transport [s].
        sent_position: (n, N) position sent [rad].
        stiffness: (n, N) stiffness sent, 0..1.
        limited: (n, N) where the safety gate altered the position.
        position: (n, N) measured position [rad].
        current: (n, N) absolute motor current [A].
        reference_position: (n, N) desired position [rad]; differs from the one sent where the gate altered it.
        velocity: (n, N) desired velocity [rad/s].
        acceleration: (n, N) desired acceleration [rad/s2].
        load_torque: (n, N) desired load torque tau_ld [N m].
        base_twist: (n, 3) desired vx [m/s], vy [m/s], wz [rad/s] of base_link in its own axes.
        sent_wheel_speed: (n, 3) wheel speeds sent [rad/s].
        wheel_speed: (n, 3) measured wheel speeds [rad/s].
        linear_acceleration: (n, 3) inertial unit of the base [m/s2].
        angular_velocity: (n, 3) the same [rad/s].
        attitude: (n, 3) the same, roll, pitch, yaw [rad].

    Raises:
        RecordingError: Fewer than two samples, a wrong shape, a value that is not finite, time that does not increase.
    """

    joint_names: tuple[str, ...]
    time: FloatArray
    age: FloatArray
    sent_position: FloatArray
    stiffness: FloatArray
    limited: BoolArray
    position: FloatArray
    current: FloatArray
    reference_position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    load_torque: FloatArray
    base_twist: FloatArray
    sent_wheel_speed: FloatArray
    wheel_speed: FloatArray
    linear_acceleration: FloatArray
    angular_velocity: FloatArray
    attitude: FloatArray

    def __post_init__(self) -> None:
        samples = len(self.time)
        if samples < 2:
            raise RecordingError(f"a recording needs two samples or more, got {samples}")
        for name, array in self._arrays():
            expected = (samples, *_row_shape(name, len(self.joint_names)))
            if array.shape != expected:
                raise RecordingError(
                    f"recording: '{name}' has shape {array.shape}, expected {expected}"
                )
            if not np.isfinite(array).all():
                self._refuse_not_finite(name, array)
            # A view: the caller's own array stays writeable.
            array = array.view()
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        steps = np.diff(self.time)
        if not (steps > 0).all():
            raise RecordingError(
                f"recording: time does not increase at sample {int(np.argmin(steps > 0)) + 1}"
            )

    def _arrays(self) -> Iterator[tuple[str, NDArray[Any]]]:
        for field in fields(self):
            if field.name != "joint_names":
                yield field.name, getattr(self, field.name)

    def _refuse_not_finite(self, name: str, array: NDArray[Any]) -> None:
        place = np.argwhere(~np.isfinite(array))[0]
        of = f" of {self.joint_names[place[1]]}" if _FIELDS[name].shape == "joints" else ""
        raise RecordingError(f"recording: '{name}'{of} is not finite at sample {place[0]}")

    def __len__(self) -> int:
        return len(self.time)

    @property
    def cycle(self) -> float:
        """Period of the ticks [s]."""
        # The median ignores skipped ticks; rounding removes the error of the differences.
        return round(float(np.median(np.diff(self.time))), 6)

    def features(self, joint_index: int) -> FloatArray:
        """(n, 3) inputs of the expected-error model, Eq. 12.

        Columns: desired velocity [rad/s], desired acceleration [rad/s2], desired load torque [N m].
        """
        return np.column_stack(
            (
                self.velocity[:, joint_index],
                self.acceleration[:, joint_index],
                self.load_torque[:, joint_index],
            )
        )

    def tracking_error(self, joint_index: int) -> FloatArray:
        """(n,) eps = position sent - position measured [rad], Sec. III."""
        error: FloatArray = self.sent_position[:, joint_index] - self.position[:, joint_index]
        return error

    def usable(self, joint_index: int) -> BoolArray:
        """(n,) True where the tracking error belongs to the reference: command not altered, sample not stale."""
        return ~self.limited[:, joint_index] & (self.age <= STALE_AGE)

    def ticks(self) -> Iterator[Tick]:
        """Yield the ticks again, to run an observer on them. Their arrays are read-only rows of the recording.

        Values that are not recorded are neutral: no contact sensor pressed, warm motors, a full battery, ticks from 0.
        """
        temperature = np.full(len(self.joint_names), _TEMPERATURE)
        temperature.flags.writeable = False
        columns = {field: getattr(self, name) for name, field in _FIELDS.items()}
        neutral: dict[str, Any] = {"temperature": temperature, "battery": 1.0, **_UNTOUCHED}
        measurements = objects(
            Measurement,
            "measurement",
            columns,
            tick=range(len(self)),
            imu=objects(Imu, "measurement.imu", columns),
            **{name: repeat(value, len(self)) for name, value in neutral.items()},
        )
        return objects(
            Tick,
            "",
            columns,
            measurement=measurements,
            reference=objects(Reference, "reference", columns),
            sent=objects(Command, "sent", columns),
        )

    def mirrored(self, robot: RobotConfig) -> Self:
        """Return the mirror image of the run: left and right swapped, signs by ``robot.mirror``.

        Raises:
            RecordingError: The recording is of another robot.
        """
        self.check_robot(robot)
        columns: dict[str, Any] = {
            name: mirrored_column(_FIELDS[name].mirror, column, robot)
            for name, column in self._arrays()
        }
        return replace(self, **columns)

    def check_robot(self, robot: RobotConfig) -> None:
        """Refuse to be used as a recording of another robot.

        Raises:
            RecordingError: Other joints, or another order of them.
        """
        if self.joint_names != robot.joint_names:
            raise RecordingError(
                f"this recording is of a robot with other joints, or another order of them, than '{robot.name}'"
            )

    def save(self, path: Path) -> None:
        """Write a file; at no time is there half a file at ``path``.

        Raises:
            RecordingError: The place cannot be written to.
        """
        write_bytes(path, self.as_bytes())

    def as_bytes(self) -> bytes:
        """Return the content of its file."""
        return arrays_as_bytes({"joint_names": np.array(self.joint_names), **dict(self._arrays())})

    @classmethod
    def load(cls, path: Path, robot: RobotConfig | None = None) -> Self:
        """Read a file that ``save`` wrote.

        Args:
            path: The file.
            robot: If given, the recording must be of this robot.

        Raises:
            RecordingError: In one line: file, reason, remedy.
        """
        arrays = read_arrays(path, [field.name for field in fields(cls)])
        names = arrays.pop("joint_names")
        for name, array in {"joint_names": names, **arrays}.items():
            kind = "U" if name == "joint_names" else np.dtype(_FIELDS[name].type).kind
            if array.dtype.kind != kind or array.ndim == 0 or (kind == "U" and array.ndim > 1):
                raise RecordingError(
                    f"{path}: damaged: '{name}' is of shape {array.shape} and type {array.dtype}"
                )
        try:
            recording = cls(joint_names=tuple(map(str, names)), **arrays)
            if robot is not None:
                recording.check_robot(robot)
        except RecordingError as error:
            raise RecordingError(f"{path}: {error}") from None
        return recording


def _row_shape(name: str, joints: int) -> tuple[int, ...]:
    shape = _FIELDS[name].shape
    if isinstance(shape, tuple):
        return (len(shape),)
    if shape == "scalar":
        return ()
    return ({"joints": joints, "wheels": 3}.get(shape) or len(_UNTOUCHED[shape]),)


class RecordingBuilder:
    """Collects ticks into a :class:`Recording`.

    Args:
        robot: Gives the number and order of the joints.
        capacity: Samples that fit at first; the arrays double in length when they are full.
    """

    def __init__(self, robot: RobotConfig, capacity: int = 8192) -> None:
        self._joint_names = robot.joint_names
        self._capacity = max(capacity, 1)
        self._columns: dict[str, NDArray[Any]] = {
            name: np.empty((self._capacity, *_row_shape(name, len(robot.joint_names))), field.type)
            for name, field in _FIELDS.items()
        }
        self._sources = {name: attrgetter(field.source) for name, field in _FIELDS.items()}
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, tick: Tick) -> None:
        """Add one tick; its arrays are copied.

        A tick with the same cycle of the robot as the previous tick is left out. The clock of a real robot is not
        that of this computer, so a tick may come before the robot's next cycle.
        """
        row = self._count
        if row and tick.measurement.time == self._columns["time"][row - 1]:
            return
        if row == self._capacity:
            # Doubling keeps the mean cost of an append constant.
            self._columns = {name: np.concatenate((a, a)) for name, a in self._columns.items()}
            self._capacity *= 2
        for name, column in self._columns.items():
            column[row] = self._sources[name](tick)
        self._count += 1

    def finish(self) -> Recording:
        """Return the recording of the ticks so far; more ticks may follow.

        Raises:
            RecordingError: See :class:`Recording`.
        """
        n = self._count
        # Copies: the builder may continue to write, and a recording must not change.
        columns: dict[str, Any] = {name: a[:n].copy() for name, a in self._columns.items()}
        return Recording(joint_names=self._joint_names, **columns)
