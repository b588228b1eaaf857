"""Parts of tests with a stand-in robot: its cycles since a moment, and a driver that bears a busy machine.

Such a machine holds the stand-in up, which looks like a robot that is silent. What the driver's bounds on silence do is
tested in virtual time; how well an idle machine keeps to them, ``benchmarks/naoqi.py`` and ``naoqi_faults.py`` measure.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pepper_driver.backends.naoqi import backend, robot
from pepper_driver.backends.naoqi.timing import RoundTrips
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.backends.naoqi_server.shared_values import BlackBox
from pepper_driver.config import NaoqiSettings, load_naoqi_settings, load_safety_settings
from support.waiting import wait_until

SILENCE = 1.0
"""[s] that a stand-in may be silent."""

PATIENT = replace(load_safety_settings(), stale_hold=SILENCE / 2, stale_fault=SILENCE)
"""A safety gate that bears it."""


@contextmanager
def patient_driver(**timing: Any) -> Iterator[None]:
    """The driver bears it: while it measures the way and takes a robot over, and in the end.

    Commands are sent two cycles ahead, whatever was measured. ``timing``: further settings of this name.
    """

    def settings(path: Path | None = None) -> NaoqiSettings:
        loaded = load_naoqi_settings(path)
        changes = {"max_round_trip": SILENCE, **timing}
        return replace(
            loaded,
            timing=replace(loaded.timing, **changes),
            end_silence=SILENCE,
            alive_time=SILENCE,
            switch_time=5 * SILENCE,
        )

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(backend, "load_naoqi_settings", settings)
        patch.setattr(RoundTrips, "lead", lambda _, timing: timing.min_lead_time)
        patch.setattr(robot, "load_safety_settings", lambda: PATIENT)
        yield


def since(stand_in: StandIn, moment: float) -> BlackBox:
    """The cycles that were due after a moment of the monotonic clock."""
    box = stand_in.black_box()
    return BlackBox(**{name: rows[box.begin > moment] for name, rows in vars(box).items()})


def let_cycles_pass(stand_in: StandIn, count: int = 20) -> None:
    """Wait until the robot has made so many more cycles, however long a busy machine takes for them."""
    begin = time.monotonic()
    assert wait_until(lambda: len(since(stand_in, begin)) >= count)


def stays(stand_in: StandIn, value: Callable[[], object], cycles: int = 20) -> bool:
    """Return True if a value does not change while the robot makes so many cycles."""
    before = value()
    let_cycles_pass(stand_in, cycles)
    return value() == before


def url(stand_in: StandIn) -> str:
    """Return the address of a stand-in for clients."""
    return f"naoqi://127.0.0.1:{stand_in.port}"
