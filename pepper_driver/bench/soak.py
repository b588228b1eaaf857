"""A long run of the plant: does it stay finite, and its energy bounded?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any

import numpy as np

from pepper_driver.backends import Backend, Command, Measurement, make_backend
from pepper_driver.backends.motion_profile import minimum_jerk
from pepper_driver.config import RobotConfig, load_robot
from pepper_driver.config.arrays import FloatArray

GOAL_PERIOD = 4.0
"""[s] between two goals; in each period the robot is pushed once or held once."""

RANGE = 0.8
"""Of each joint's range around its middle: where goals lie. The legs stay near the upright posture."""

LEGS = 0.05
"""The same for the legs: more would topple the robot."""

TOUCHED = ("LForeArm", "RForeArm", "LBicep", "RBicep", "torso", "Head")


@dataclass(frozen=True, kw_only=True)
class Soak:
    """Results of a long run.

    Attributes:
        seconds: Simulated time [s].
        real_time_factor: Simulated time over wall-clock time.
        finite: Whether every number of every measurement was finite.
        largest_energy: Largest kinetic energy at the end of a cycle, by quarter of the run [J].
        fallen: Whether the robot fell over.
        charge: Of the battery at the end, 0..1.
        hottest: Warmest motor at the end [deg C].
    """

    seconds: float
    real_time_factor: float
    finite: bool
    largest_energy: tuple[float, float, float, float]
    fallen: bool
    charge: float
    hottest: float

    def as_json(self) -> dict[str, Any]:
        """All figures by name."""
        return asdict(self)


def run_soak(
    uri: str,
    seconds: float,
    *,
    seed: int = 0,
    on_progress: Callable[[float], None] | None = None,
) -> Soak:
    """Move all joints to random goals, drive about, push and hold the robot, for a long time; without a controller.

    Args:
        uri: A simulated backend.
        seconds: Simulated time [s].
        seed: Of motion and contacts.
        on_progress: Called with the fraction done, 0..1.

    Raises:
        PepperError: The backend refuses, or its simulation diverges.
    """
    robot, rng = load_robot(), np.random.default_rng(seed)
    report_progress = on_progress or (lambda fraction: None)
    with make_backend(uri, robot) as backend:
        backend.open()
        measurement = backend.activate()
        cycle, posture = backend.info.cycle, robot.posture("Stand")
        ticks, period = max(4, round(seconds / cycle)), round(GOAL_PERIOD / cycle)
        start = goal = np.clip(measurement.position, robot.lower, robot.upper)
        wheels, finite, energy = np.zeros(3), True, np.zeros(4)
        begin = perf_counter()
        for tick in range(ticks):
            if tick % period == 0:
                start, goal = goal, _goal(robot, posture, rng)
                wheels = robot.wheels.matrix @ rng.uniform(-0.1, 0.1, 3)
                _touch(backend, rng)
                report_progress(tick / ticks)
            smooth = minimum_jerk((tick % period + 1) / period)
            measurement = backend.exchange(
                Command(
                    position=start + smooth * (goal - start),
                    stiffness=np.ones(len(goal)),
                    wheel_speed=wheels,
                )
            )
            finite = finite and _finite(measurement)
            quarter = min(3, 4 * tick // ticks)
            energy[quarter] = max(energy[quarter], backend.truth.kinetic_energy)
        wall = perf_counter() - begin
        first, second, third, fourth = (float(value) for value in energy)
        return Soak(
            seconds=ticks * cycle,
            real_time_factor=ticks * cycle / wall,
            finite=finite,
            largest_energy=(first, second, third, fourth),
            fallen=backend.truth.fallen,
            charge=measurement.battery,
            hottest=float(measurement.temperature.max()),
        )


def _goal(robot: RobotConfig, posture: FloatArray, rng: np.random.Generator) -> FloatArray:
    middle, half = (robot.lower + robot.upper) / 2, (robot.upper - robot.lower) / 2
    goal = middle + RANGE * half * rng.uniform(-1.0, 1.0, len(half))
    legs = [robot.joint_index(name) for name in robot.chains["legs"]]
    goal[legs] = posture[legs] + LEGS * half[legs] * rng.uniform(-1.0, 1.0, len(legs))
    return np.clip(goal, robot.lower, robot.upper)


def _touch(backend: Backend, rng: np.random.Generator) -> None:
    """Order a push of at most 15 N, or a hand that pulls at most 3 cm, somewhere in the next period."""
    link, delay = str(rng.choice(TOUCHED)), float(rng.uniform(0.0, GOAL_PERIOD / 3))
    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    if rng.random() < 0.5:
        backend.push(link, rng.uniform(2.0, 15.0) * direction, duration=1.0, delay=delay)
    else:
        pull = rng.uniform(0.0, 0.03) * direction
        backend.grab(link, pull, stiffness=500.0, hold=0.5, max_force=20.0, delay=delay)


def _finite(m: Measurement) -> bool:
    parts = (m.position, m.current, m.wheel_speed, m.imu.acceleration, m.temperature)
    return bool(np.isfinite(np.concatenate(parts)).all())
