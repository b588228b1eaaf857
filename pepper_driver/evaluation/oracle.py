"""The ceiling for every observer: one that knows the plant, and simulates what the robot would do untouched."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pepper_driver.backends import Command, make_backend
from pepper_driver.backends.motion_profile import minimum_jerk
from pepper_driver.config import RobotConfig, load_observer_settings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Tick
from pepper_driver.observer import (
    CartTree,
    ContactObserver,
    ModelSet,
    Observation,
    Observer,
    Recording,
)

APPROACH, REST = 2.0, 1.0
"""[s] to reach the first posture of a recording, and to come to rest there."""

PAPER_THRESHOLD = float(np.radians(2.5))

_NOTHING = CartTree(feature=(-1,), threshold=(0.0,), left=(-1,), right=(-1,), value=(0.0,))


def untouched_error(recording: Recording, uri: str, robot: RobotConfig) -> FloatArray:
    """Tracking error of the same commands on a simulated robot that nobody touches, paired as in a tick.

    How the robot came to where the recording begins is not known: it comes there slowly and rests. The error is that
    of the joints, without noise and steps of the encoders, which nobody can foresee.

    Args:
        recording: Position, stiffness and wheel speed as they were sent.
        uri: Of the simulated robot.
        robot: Its description.

    Returns:
        (n, N) position sent - true position when it was to be reached [rad].

    Raises:
        PepperError: No such backend, or its simulation diverged.
    """
    backend = make_backend(uri, robot)
    plant = backend.plant.config
    assert plant is not None  # of MuJoCo
    delay = plant.transport.command_delay
    rows = [*range(len(recording)), *[len(recording) - 1] * delay]
    positions = []
    with backend:
        backend.open()
        start = np.clip(backend.activate().position, robot.lower, robot.upper)
        first = recording.sent_position[0]
        way = minimum_jerk(np.linspace(0.0, 1.0, round(APPROACH / robot.cycle)))
        for share in (*way, *[1.0] * round(REST / robot.cycle)):
            backend.exchange(
                Command(
                    position=start + share * (first - start),
                    stiffness=recording.stiffness[0],
                    wheel_speed=np.zeros(3),
                )
            )
        for row in rows:
            command = Command(
                position=recording.sent_position[row],
                stiffness=recording.stiffness[row],
                wheel_speed=recording.sent_wheel_speed[row],
            )
            backend.exchange(command)
            positions.append(backend.truth.position.copy())
    error: FloatArray = recording.sent_position - np.array(positions[delay:])
    return error


class OracleObserver(Observer):
    """Median and threshold of the paper on the residual to errors known beforehand, tick by tick of one recording.

    Args:
        robot: Description of the robot.
        expected: (n, N) from :func:`untouched_error` [rad].
    """

    def __init__(self, robot: RobotConfig, expected: FloatArray) -> None:
        nothing: dict[str, float] = dict.fromkeys(robot.joint_names, 0.0)
        models = ModelSet(
            robot=robot.name,
            joint_names=robot.joint_names,
            identity="oracle",
            kind="cart",
            cycle=robot.cycle,
            estimation_fit=nothing,
            test_fit=nothing,
            threshold=dict.fromkeys(robot.joint_names, PAPER_THRESHOLD),
            version="",
            models=dict.fromkeys(robot.joint_names, _NOTHING),
        )
        settings = load_observer_settings()
        self._watcher = ContactObserver(robot, models, settings)
        self._expected = expected
        self._row = 0

    def step(self, tick: Tick) -> Observation:
        """Take in the next tick of the recording; the last row stands for all that come after it."""
        expected = self._expected[min(self._row, len(self._expected) - 1)]
        self._row += 1
        measurement = tick.measurement
        moved = replace(measurement, position=measurement.position + expected)
        observation = self._watcher.step(replace(tick, measurement=moved))
        blind = np.isnan(observation.expected)
        return replace(observation, expected=np.where(blind, np.nan, expected))

    def reset(self) -> None:
        """Back to the first tick."""
        self._row = 0
        self._watcher.reset()

    def describe(self) -> str:
        """One line: kind, thresholds."""
        return f"oracle: the plant itself, untouched; {self._watcher.describe()}"
