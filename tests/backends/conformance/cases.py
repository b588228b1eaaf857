"""The backends that the suite is run on, and how it drives them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pytest
from stand_ins import patient_driver

from pepper_driver import Pepper
from pepper_driver.backends import Backend, Command, Imu, Measurement, make_backend
from pepper_driver.backends.naoqi.library import NoQiError, load_qi
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.config import load_robot
from pepper_driver.config.parts import FloatArray

ROBOT = load_robot()
LATEST = 20.0
"""[s] A call that has not come back by then hangs: far beyond what any of them takes, also on a busy machine."""

Make = Callable[[], Backend]


@dataclass(frozen=True, kw_only=True)
class Case:
    """A backend to be tested.

    Attributes:
        name: Of it, in the names of the tests.
        make: A new one, closed.
        follows: Whether joints go where they are told; a recording need not.
        drives: Whether wheels turn as they are told.
        starts_at_zero: Whether ticks and time are counted from ``open``; a recording has those of then.
        examples: How many sequences of calls the state machine tries.
    """

    name: str
    make: Make
    follows: bool = True
    drives: bool = True
    starts_at_zero: bool = True
    examples: int = 25


def mujoco() -> Iterator[Case]:
    """The simulated robot."""
    yield Case(name="mujoco", make=lambda: make_backend("mujoco://?seed=7"))


def mock() -> Iterator[Case]:
    """The robot without physics."""
    yield Case(name="mock", make=lambda: make_backend("mock://?delay=2"))


def replay(folder: Path) -> Iterator[Case]:
    """A recording of it, long enough for every test."""
    path = folder / "run.mcap"
    with Pepper("mujoco://?seed=7", observer=None, log=path) as pepper:
        pepper.set_posture({"LShoulderRoll": 0.6})
        pepper.run(1500 * ROBOT.cycle)
    yield Case(
        name="replay",
        make=lambda: make_backend(f"replay://{path}"),
        follows=False,
        drives=False,
        starts_at_zero=False,
    )


def naoqi() -> Iterator[Case]:
    """A robot over the real protocol: the stand-in."""
    try:
        qi = load_qi()
    except NoQiError as error:
        pytest.skip(str(error))
    with StandIn("mujoco://?seed=7", consent=True) as stand_in, patient_driver():
        session = qi.Session()
        session.connect(stand_in.url, _async=True).value(10_000)
        session.service("ALMotion").wakeUp(_async=True).value(20_000)
        session.close()
        uri = f"naoqi://127.0.0.1:{stand_in.port}"
        yield Case(name="naoqi", make=lambda: make_backend(uri), examples=2)


def by_uri(uri: str) -> Iterator[Case]:
    """Whatever somebody has registered."""
    recorded = uri.startswith("replay")
    yield Case(
        name=uri,
        make=lambda: make_backend(uri),
        follows=not recorded,
        drives=not recorded
        and "mode=angles" not in uri,  # which keeps the base of a robot over NAOqi still
        starts_at_zero=not recorded,
        examples=5,
    )


# -- driving a backend ----------------------------------------------------------------------------------------------


def command(
    position: FloatArray, *, stiffness: float = 1.0, wheel_speed: FloatArray | None = None
) -> Command:
    """Arrays of its own, so that nobody minds when they are changed."""
    return Command(
        position=position.copy(),
        stiffness=np.full(len(ROBOT.joint_names), stiffness),
        wheel_speed=np.zeros(3) if wheel_speed is None else wheel_speed.copy(),
    )


def hold(measurement: Measurement) -> Command:
    """Stay where the robot is."""
    return command(np.clip(measurement.position, ROBOT.lower, ROBOT.upper))


def run(backend: Backend, wanted: Command, seconds: float) -> list[Measurement]:
    """Give the same command for a time, as the loop would: once a cycle."""
    return list(cycles(backend, wanted, round(seconds / backend.info.cycle)))


def watch(backend: Backend, seconds: float) -> list[Measurement]:
    """Read for a time, and write nothing."""
    return list(cycles(backend, None, round(seconds / backend.info.cycle)))


def cycles(backend: Backend, wanted: Command | None, count: int) -> Iterator[Measurement]:
    """So many cycles, apart as the robot's where time passes by itself, or more on a machine that is late.

    Args:
        backend: Open.
        wanted: Written in each of them; None for no write at all.
        count: Of the cycles.
    """
    cycle, paced = backend.info.cycle, backend.real_time
    due = time.monotonic()
    for _ in range(count):
        if wanted is not None:
            backend.write(wanted)
        yield backend.read()
        due = max(due + cycle, time.monotonic())
        if paced:
            time.sleep(max(0.0, due - time.monotonic()))


def until(
    backend: Backend, wanted: Command, reached: Callable[[Measurement], object]
) -> Measurement:
    """Give the same command until a sample is as it should be; returns that, or the last."""
    for measurement in cycles(backend, wanted, round(LATEST / backend.info.cycle)):
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
