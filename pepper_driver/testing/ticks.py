"""Ticks for observers: of a robot that stands, or recorded."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from pepper_driver.backends import Measurement
from pepper_driver.backends.mock import Fault, MockBackend
from pepper_driver.config import RobotConfig, load_robot
from pepper_driver.controller import Tick
from pepper_driver.observer import Observation, Observer
from pepper_driver.replay import load_run
from pepper_driver.safety.plugins import check_observation, still_tick


def standing_measurement() -> Measurement:
    """Return a sample of a robot that stands, and that nothing touches."""
    return MockBackend().open()


def standing_ticks(
    count: int, faults: Mapping[int, Fault] | None = None, *, robot: RobotConfig | None = None
) -> tuple[Tick, ...]:
    """Ticks of a robot whose command is to stand still, numbered from 1.

    A joint that is pushed aside from tick 50 to 99: ``dict.fromkeys(range(50, 100), displaced("LElbowRoll", 0.08))``.

    Args:
        count: How many, 12 ms each.
        faults: Changes of measurements, by number of the tick.
        robot: Description of the robot, by default the shipped Pepper.
    """
    backend = MockBackend(robot or load_robot(), faults=faults)
    command = backend.open().position
    return tuple(still_tick(backend.read(), command) for _ in range(count))


def recorded_ticks(log: Path | str) -> tuple[Tick, ...]:
    """All ticks of a log, as the observer of that run saw them.

    Raises:
        PepperError: The log cannot be read.
    """
    return load_run(Path(log)).ticks


def observe(observer: Observer, ticks: Iterable[Tick]) -> tuple[Observation, ...]:
    """Run an observer on ticks, from its reset on.

    Raises:
        PluginInterfaceError: An observation is not as :class:`Observation` says.
    """
    observer.reset()
    found = []
    for tick in ticks:
        observation = observer.step(tick)
        check_observation(observer, observation, len(tick.measurement.position))
        found.append(observation)
    return tuple(found)
