"""From a tick to a row of the log: its arrays, one behind the other, are the message."""

from __future__ import annotations

import struct
from operator import attrgetter
from typing import Any

import numpy as np

from pepper_driver.backends.interface import Command
from pepper_driver.backends.log_file import CDR_HEADER, Field, row_type
from pepper_driver.backends.simulated import TruthSample
from pepper_driver.config import RobotConfig
from pepper_driver.controller.tick import Reference, Sent, Tick
from pepper_driver.log.schema import tick_fields, truth_fields, unanswered_fields
from pepper_driver.observer.interface import JointState, Observation

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
