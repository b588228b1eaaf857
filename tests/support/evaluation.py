"""Takes and observers made by hand, with known answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pepper_driver.config import Experiment, load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_specs import RandomPushes
from pepper_driver.controller import Tick
from pepper_driver.evaluation.episodes import Episode
from pepper_driver.observer import Contact, JointState, KnownPush, Observation, Observer, Recording
from support import events

ROBOT = load_robot()
CYCLE = ROBOT.cycle
JOINTS = len(ROBOT.joint_names)
STIFFNESS = 50.0
"""[N m/rad] of every joint."""
JOINT = "LShoulderRoll"
INDEX = ROBOT.joint_index(JOINT)

PUSH = KnownPush(
    joint=JOINT,
    link="LBicep",
    direction=1,
    force=12.0,
    torque=4.0 * STIFFNESS * np.pi / 180.0,
    degrees=4.0,
    onset=2.0,
    release=3.0,
    moving=False,
)


def at_once(experiment: Experiment) -> Experiment:
    """The experiment with one goal alone, and its random pushes."""
    contacts = (replace(c, after=0.0) for c in experiment.contacts if isinstance(c, RandomPushes))
    return replace(experiment.with_goals(count=1), contacts=tuple(contacts))


def push(onset: float, degrees: float = 4.0, **changes: Any) -> KnownPush:
    """A push of one second."""
    return replace(PUSH, onset=onset, release=onset + 1.0, degrees=degrees, **changes)


def contact(number: int, time: float, **changes: Any) -> Contact:
    """The begin of a contact on JOINT."""
    values = {"joint": JOINT, "shown_by": JOINT, "link": "LBicep", "detection_time": time}
    return events.contact(number, **{**values, "time": time, "onset_time": time, **changes})


def recording(seconds: float, error: FloatArray | None = None) -> Recording:
    """A robot that stands; ``error`` (n,) is the tracking error of JOINT [rad]."""
    n = round(seconds / CYCLE)
    zeros = np.zeros((n, JOINTS))
    sent = zeros.copy()
    if error is not None:
        sent[:, INDEX] = error
    return Recording(
        joint_names=ROBOT.joint_names,
        time=np.arange(float(n)) * CYCLE,
        age=np.zeros(n),
        sent_position=sent,
        stiffness=np.ones((n, JOINTS)),
        limited=zeros.astype(np.bool_),
        position=zeros,
        current=zeros,
        reference_position=sent,
        velocity=zeros,
        acceleration=zeros,
        load_torque=zeros,
        base_twist=np.zeros((n, 3)),
        sent_wheel_speed=np.zeros((n, 3)),
        wheel_speed=np.zeros((n, 3)),
        linear_acceleration=np.zeros((n, 3)),
        angular_velocity=np.zeros((n, 3)),
        attitude=np.zeros((n, 3)),
    )


def make_episode(
    pushes: Sequence[KnownPush] = (),
    *,
    seconds: float = 12.0,
    suite: str = "paper",
    experiment: str = "left",
    task_stiffness: float = 8.0,
    error: FloatArray | None = None,
) -> Episode:
    """An episode of a robot that stands, and is said to be pushed."""
    run = recording(seconds, error)
    return Episode(
        recording=run,
        pushes=tuple(pushes),
        contact_torque=np.zeros((len(run), JOINTS)),
        suite=suite,
        experiment=experiment,
        plant="nominal",
        identity="hand-made",
        seed=7,
        task_stiffness=task_stiffness,
    )


class Script(Observer):
    """Reports what it was given: events at their time, and the same arrays in every tick.

    ``expected`` and ``torque`` are (n, N), ``threshold`` may be; a threshold of NaN makes a joint blind.
    """

    def __init__(
        self,
        contacts: Sequence[Contact] = (),
        *,
        expected: FloatArray | None = None,
        torque: FloatArray | None = None,
        threshold: FloatArray | float = 0.02,
    ) -> None:
        self._contacts = sorted(contacts, key=lambda event: event.time)
        self._expected, self._torque = expected, torque
        self._threshold = np.asarray(threshold, dtype=np.float64)
        self._row = 0

    def step(self, tick: Tick) -> Observation:
        row, now = self._row, tick.measurement.time
        self._row += 1
        said = tuple(e for e in self._contacts if now - CYCLE < e.time <= now)
        nothing = np.full(JOINTS, np.nan)
        threshold = self._threshold[row] if self._threshold.ndim == 2 else self._threshold
        threshold = np.broadcast_to(threshold, (JOINTS,))
        blind = np.isnan(threshold)
        return Observation(
            contacts=said,
            expected=np.zeros(JOINTS) if self._expected is None else self._expected[row],
            residual=np.zeros(JOINTS),
            threshold=threshold.copy(),
            torque=nothing if self._torque is None else self._torque[row],
            torque_std=nothing,
            state=np.where(blind, JointState.BLIND, JointState.FREE).astype(np.int8),
        )

    def reset(self) -> None:
        self._row = 0

    def describe(self) -> str:
        return "script"
