"""Score of one episode by one observer, and the signals that are drawn of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.evaluation.episodes import Episode
from pepper_driver.observer import (
    Contact,
    ContactObserver,
    FittingError,
    KnownPush,
    Observer,
    Recording,
    nrmse_fit,
    score,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class ObserverRun:
    """Outputs of an observer over a recording of n ticks and N joints; NaN where a joint was blind.

    Attributes:
        contacts: Its events, in their order.
        expected: (n, N) expected tracking error [rad].
        predicted: (n,) prediction for the requested joint, without any measurement; None if not available.
        residual: (n, N) contact observer signal r [rad].
        threshold: (n, N) [rad].
    """

    contacts: tuple[Contact, ...]
    expected: FloatArray
    predicted: FloatArray | None
    residual: FloatArray
    threshold: FloatArray


def watch(observer: Observer, recording: Recording, joint: str | None = None) -> ObserverRun:
    """Reset the observer and show it every tick of the recording; ``joint`` is the one to predict."""
    shape = recording.position.shape
    expected, residual, threshold = (np.empty(shape) for _ in range(3))
    contacts: list[Contact] = []
    observer.reset()
    for row, tick in enumerate(recording.ticks()):
        observation = observer.step(tick)
        contacts.extend(observation.contacts)
        expected[row] = observation.expected
        residual[row] = observation.residual
        threshold[row] = observation.threshold
    return ObserverRun(
        contacts=tuple(contacts),
        expected=expected,
        predicted=None if joint is None else _predicted(observer, recording, joint, expected),
        residual=residual,
        threshold=threshold,
    )


def _predicted(
    observer: Observer, recording: Recording, joint: str, expected: FloatArray
) -> FloatArray:
    if isinstance(observer, ContactObserver):
        return observer.predict(joint, recording)
    return expected[:, recording.joint_names.index(joint)]


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """One joint over n ticks of an episode, as one observer saw it; angles [rad], NaN where the joint was blind.

    ``others`` are the commanded positions of the other moving joints, by name.
    """

    mode: str
    suite: str
    experiment: str
    task_stiffness: float
    joint: str
    time: FloatArray
    sent: FloatArray
    position: FloatArray
    others: dict[str, FloatArray]
    expected: FloatArray
    residual: FloatArray
    threshold: FloatArray
    pushes: tuple[KnownPush, ...]
    contacts: tuple[Contact, ...]


def trace_of(mode: str, episode: Episode, watched: ObserverRun, joint: str) -> Trace:
    """Cut one joint out of an episode, with the three other joints that move most."""
    recording = episode.recording
    index = recording.joint_names.index(joint)
    travel = np.ptp(recording.sent_position, axis=0)
    travel[index] = 0.0
    # Stable: joints of equal travel keep their order, so that the page is the same each time.
    moved = [i for i in np.argsort(-travel, kind="stable")[:3] if travel[i] > 0.0]
    return Trace(
        mode=mode,
        suite=episode.suite,
        experiment=episode.experiment,
        task_stiffness=episode.task_stiffness,
        joint=joint,
        time=recording.time.copy(),
        sent=recording.sent_position[:, index].copy(),
        position=recording.position[:, index].copy(),
        others={recording.joint_names[i]: recording.sent_position[:, i].copy() for i in moved},
        expected=watched.expected[:, index].copy(),
        residual=watched.residual[:, index].copy(),
        threshold=watched.threshold[:, index].copy(),
        pushes=episode.pushes,
        contacts=watched.contacts,
    )


FASTEST_ESTIMATION = 5.0
"""[1/s2] task stiffness of the fastest estimation run; what is faster is a test run."""


@dataclass(frozen=True, kw_only=True)
class EpisodeScore:
    """One observer on one episode.

    Attributes:
        suite: Of the episode.
        experiment: Of the episode.
        false: Contacts that no push explains.
        missed: Pushes that were not detected.
        detected: Pushes that were.
        fit: By joint, NRMSE of the expected tracking error [%]; only of episodes that test it.
        fast: Whether it is a test run of a fit, not an estimation run.
    """

    suite: str
    experiment: str
    false: int
    missed: int
    detected: int
    fit: dict[str, float]
    fast: bool


def score_episode(episode: Episode, watched: ObserverRun, robot: RobotConfig) -> EpisodeScore:
    """Score what an observer said of an episode."""
    result = score(episode.pushes, watched.contacts, robot)
    return EpisodeScore(
        suite=episode.suite,
        experiment=episode.experiment,
        false=len(result.false),
        missed=len(result.missed),
        detected=len(result.detected),
        fit=_fit(episode, watched),
        fast=episode.task_stiffness > FASTEST_ESTIMATION,
    )


def _fit(episode: Episode, watched: ObserverRun) -> dict[str, float]:
    """NRMSE of the expected error of the joint that the episode is about, if it has one and no push."""
    recording, expected = episode.recording, watched.predicted
    if expected is None:
        return {}
    index = recording.joint_names.index(episode.experiment)
    usable = recording.usable(index) & np.isfinite(expected)
    if not usable.any():
        return {}
    try:
        fit = nrmse_fit(recording.tracking_error(index)[usable], expected[usable])
    except FittingError:  # a joint that stood still
        return {}
    return {episode.experiment: fit}
