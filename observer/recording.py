"""What one run of the robot leaves behind: commands, references and measurements of all joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config import PepperError, RobotConfig
from pepper_driver.controller.tick import Tick

FloatArray = NDArray[np.float64]

STALE_AGE = 0.03
"""[s] An encoder sample older than this says nothing about the command it is paired with."""

_JOINT_COLUMNS = (
    "sent_position",
    "position",
    "velocity",
    "acceleration",
    "load_torque",
    "current",
)


class RecordingError(PepperError, ValueError):
    """A recording is too short, of the wrong shape, or holds values that are not finite."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """One run, n samples of N joints. The arrays are read-only.

    Each row pairs a measurement with the command and the reference that it answers.

    Attributes:
        joint_names: Order of the columns.
        time: (n,) clock of the robot [s], increasing.
        sent_position: (n, N) position really sent [rad].
        position: (n, N) measured position [rad].
        velocity: (n, N) desired velocity [rad/s].
        acceleration: (n, N) desired acceleration [rad/s2].
        load_torque: (n, N) desired load torque tau_ld [N m].
        changed: (n, N) where the safety gate altered the position.
        current: (n, N) absolute motor current [A].
        age: (n,) age of the encoder sample beyond the usual transport [s].

    Raises:
        RecordingError: Fewer than two samples, a wrong shape, a value that is not finite, time that stands still.
    """

    joint_names: tuple[str, ...]
    time: FloatArray
    sent_position: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    load_torque: FloatArray
    changed: NDArray[np.bool_]
    current: FloatArray
    age: FloatArray

    def __post_init__(self) -> None:
        samples = len(self.time)
        if samples < 2:
            raise RecordingError(f"a recording needs two samples or more, got {samples}")
        for name, array in self._arrays():
            expected = (samples,) if name in ("time", "age") else (samples, len(self.joint_names))
            if array.shape != expected:
                raise RecordingError(
                    f"recording: '{name}' has shape {array.shape}, expected {expected}"
                )
            if not np.isfinite(array).all():
                self._refuse_not_finite(name, array)
            array = array.view()
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        steps = np.diff(self.time)
        if not (steps > 0).all():
            raise RecordingError(
                f"recording: time does not increase at sample {int(np.argmin(steps > 0)) + 1}"
            )

    def _arrays(self) -> Iterator[tuple[str, NDArray[np.float64] | NDArray[np.bool_]]]:
        for field in fields(self):
            if field.name != "joint_names":
                yield field.name, getattr(self, field.name)

    def _refuse_not_finite(self, name: str, array: NDArray[np.generic]) -> None:
        place = np.argwhere(~np.isfinite(np.asarray(array, dtype=np.float64)))[0]
        of = f" of {self.joint_names[place[1]]}" if len(place) > 1 else ""
        raise RecordingError(f"recording: '{name}'{of} is not finite at sample {place[0]}")

    def __len__(self) -> int:
        return len(self.time)

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

    def usable(self, joint_index: int) -> NDArray[np.bool_]:
        """(n,) where the tracking error answers the reference: command not altered, sample not stale."""
        return ~self.changed[:, joint_index] & (self.age <= STALE_AGE)


class RecordingBuilder:
    """Collects ticks into a :class:`Recording`.

    Args:
        robot: Gives the number and order of the joints.
        capacity: Samples to make room for at first; the room doubles when it is full.
    """

    def __init__(self, robot: RobotConfig, capacity: int = 8192) -> None:
        self._joint_names = robot.joint_names
        shape = (max(capacity, 1), len(robot.joint_names))
        self._columns = {name: np.empty(shape) for name in _JOINT_COLUMNS}
        self._changed = np.empty(shape, dtype=np.bool_)
        self._clock = np.empty((shape[0], 2))
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, tick: Tick) -> None:
        """Add one tick; its arrays are copied."""
        row = self._count
        if row == len(self._clock):
            self._grow()
        columns = self._columns
        columns["sent_position"][row] = tick.sent.position
        columns["position"][row] = tick.measurement.position
        columns["velocity"][row] = tick.reference.velocity
        columns["acceleration"][row] = tick.reference.acceleration
        columns["load_torque"][row] = tick.reference.load_torque
        columns["current"][row] = tick.measurement.current
        self._changed[row] = tick.changed
        self._clock[row] = (tick.measurement.time, tick.measurement.age)
        self._count += 1

    def _grow(self) -> None:
        self._columns = {name: np.concatenate((a, a)) for name, a in self._columns.items()}
        self._changed = np.concatenate((self._changed, self._changed))
        self._clock = np.concatenate((self._clock, self._clock))

    def finish(self) -> Recording:
        """The recording of the ticks so far; the builder may go on.

        Raises:
            RecordingError: See :class:`Recording`.
        """
        n = self._count
        return Recording(
            joint_names=self._joint_names,
            time=self._clock[:n, 0].copy(),
            age=self._clock[:n, 1].copy(),
            changed=self._changed[:n].copy(),
            **{name: array[:n].copy() for name, array in self._columns.items()},
        )
