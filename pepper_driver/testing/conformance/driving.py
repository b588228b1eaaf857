"""A backend under test, and how the suite drives it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields

import numpy as np
import pytest

from pepper_driver.backends import Backend, Command, Imu, Measurement
from pepper_driver.config import load_robot
from pepper_driver.config.arrays import FloatArray

ROBOT = load_robot()
LATEST = 20.0
"""[s] A call that has not come back by then hangs: far beyond what any of them takes, also on a busy machine."""


class BackendSuite:
    """Tests of one kind of backend.

    Attributes:
        follows: True where joints follow commands; a recording need not.
        drives: True where wheels follow commands; False for a robot on a fixed base.
        starts_at_zero: True where ticks and time are counted from ``open``; a recording has those of the recorded run.
        sequences: How many random sequences of calls are tried.
    """

    follows = True
    drives = True
    starts_at_zero = True
    sequences = 25

    def make_backend(self) -> Backend:
        """Return a new backend, closed."""
        raise NotImplementedError(f"{type(self).__name__} has no make_backend(self) -> Backend")

    @pytest.fixture
    def backend(self) -> Iterator[Backend]:
        """Yield a new one, closed; closed again afterwards."""
        backend = self.make_backend()
        yield backend
        backend.close()


def command(
    position: FloatArray, *, stiffness: float = 1.0, wheel_speed: FloatArray | None = None
) -> Command:
    """Arrays of its own, so that a test may change them."""
    return Command(
        position=position.copy(),
        stiffness=np.full(len(ROBOT.joint_names), stiffness),
        wheel_speed=np.zeros(3) if wheel_speed is None else wheel_speed.copy(),
    )


def hold(measurement: Measurement) -> Command:
    """Stay where the robot is."""
    return command(np.clip(measurement.position, ROBOT.lower, ROBOT.upper))


def run(backend: Backend, held: Command, seconds: float) -> list[Measurement]:
    """Give the same command for a time, as the loop would: once a cycle."""
    return list(cycles(backend, held, round(seconds / backend.info.cycle)))


def watch(backend: Backend, seconds: float) -> list[Measurement]:
    """Read for a time, and write nothing."""
    return list(cycles(backend, None, round(seconds / backend.info.cycle)))


def cycles(backend: Backend, held: Command | None, count: int) -> Iterator[Measurement]:
    """So many cycles, apart as the robot's where time passes by itself, or more on a machine that is late.

    Args:
        backend: Open.
        held: Command of each of them; None for no write at all.
        count: Of the cycles.
    """
    cycle, paced, clock = backend.info.cycle, backend.real_time, backend.clock
    due = clock.seconds()
    for _ in range(count):
        if held is not None:
            backend.write(held)
        yield backend.read()
        due = max(due + cycle, clock.seconds())
        if paced:
            clock.sleep(max(0.0, due - clock.seconds()))


def until(backend: Backend, held: Command, reached: Callable[[Measurement], object]) -> Measurement:
    """Give the same command until a sample is as it should be; returns that, or the last."""
    for measurement in cycles(backend, held, round(LATEST / backend.info.cycle)):
        if reached(measurement):
            break
    return measurement


def move(backend: Backend, start: FloatArray, goal: FloatArray, seconds: float) -> Measurement:
    """Lead all joints along a straight line, and wait there a while."""
    count = round(seconds / backend.info.cycle)
    for tick in range(count):
        run(backend, command(start + (goal - start) * (tick + 1) / count), backend.info.cycle)
    return run(backend, command(goal), 0.3)[-1]


def bits(measurement: Measurement) -> list[object]:
    """All that was measured, to be compared to the last bit."""
    values = [getattr(measurement, f.name) for f in fields(Measurement) if f.name != "imu"]
    values += [getattr(measurement.imu, f.name) for f in fields(Imu)]
    return [v.tobytes() if isinstance(v, np.ndarray) else repr(v) for v in values]
