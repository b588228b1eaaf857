"""Score of one episode by one observer, and the signals that are drawn of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from time import perf_counter_ns
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray, IntArray
from pepper_driver.config.robot import TRUNK
from pepper_driver.evaluation.episodes import Episode
from pepper_driver.observer import (
    Contact,
    ContactObserver,
    FittingError,
    JointState,
    KnownPush,
    Observer,
    Recording,
    nrmse_fit,
    score,
)
from pepper_driver.observer.scoring import REBOUND_TIME, ContactTrack, DetectedPush, group_events


@dataclass(frozen=True, kw_only=True, eq=False)
class ObserverRun:
    """Outputs of an observer over a recording of n ticks and N joints; NaN where a joint was blind.

    Attributes:
        contacts: Its events, in their order.
        expected: (n, N) expected tracking error [rad].
        predicted: (n,) prediction for the requested joint, without any measurement; None if not available.
        residual: (n, N) contact observer signal r [rad].
        threshold: (n, N) [rad].
        torque: (n, N) external torque estimate [N m].
        state: (n, N) values of :class:`~pepper_driver.observer.JointState`.
        step_us: (n,) wall time of each step [us].
    """

    contacts: tuple[Contact, ...]
    expected: FloatArray
    predicted: FloatArray | None
    residual: FloatArray
    threshold: FloatArray
    torque: FloatArray
    state: NDArray[np.int8]
    step_us: FloatArray


def watch(observer: Observer, recording: Recording, joint: str | None = None) -> ObserverRun:
    """Reset the observer and show it every tick of the recording; ``joint`` is the one to predict."""
    shape = recording.position.shape
    expected, residual, threshold, torque = (np.empty(shape) for _ in range(4))
    state = np.empty(shape, dtype=np.int8)
    step_us = np.empty(len(recording))
    contacts: list[Contact] = []
    observer.reset()
    for row, tick in enumerate(recording.ticks()):
        before = perf_counter_ns()
        observation = observer.step(tick)
        step_us[row] = (perf_counter_ns() - before) * 1e-3
        contacts.extend(observation.contacts)
        expected[row] = observation.expected
        residual[row] = observation.residual
        threshold[row] = observation.threshold
        torque[row] = observation.torque
        state[row] = observation.state
    return ObserverRun(
        contacts=tuple(contacts),
        expected=expected,
        predicted=None if joint is None else _predicted(observer, recording, joint, expected),
        residual=residual,
        threshold=threshold,
        torque=torque,
        state=state,
        step_us=step_us,
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
    most = [i for i in np.argsort(-travel, kind="stable")[:3] if travel[i] > 0.0]
    return Trace(
        mode=mode,
        suite=episode.suite,
        experiment=episode.experiment,
        task_stiffness=episode.task_stiffness,
        joint=joint,
        time=recording.time.copy(),
        sent=recording.sent_position[:, index].copy(),
        position=recording.position[:, index].copy(),
        others={recording.joint_names[i]: recording.sent_position[:, i].copy() for i in most},
        expected=watched.expected[:, index].copy(),
        residual=watched.residual[:, index].copy(),
        threshold=watched.threshold[:, index].copy(),
        pushes=episode.pushes,
        contacts=watched.contacts,
    )


Group = Literal["plain", "trunk", "saturated", "axis", "hand"]

ISOLATION_TIMES = (0.0, 0.05, 0.15)
"""[s] after the alarm at which the joint of a contact is looked at."""
AXIS_DEGREES = 0.5
"""[deg] A force on a limb that puts less on its joint runs along the joint's axis, or through it."""
ONE_DEGREE = np.radians(1.0)
THRESHOLD_STRIDE = 25
"""One row in so many is kept of the thresholds in free motion: they change slowly."""
FASTEST_ESTIMATION = 5.0
"""[1/s2] task stiffness of the fastest estimation run; what is faster is a test run."""


@dataclass(frozen=True, kw_only=True)
class PushScore:
    """Detection of one push.

    Attributes:
        degrees: Its size [deg]; NaN where it was not measured.
        group: ``plain``, or why it is scored apart.
        detected: True if it was detected.
        delay: From the onset of the force to the alarm [s]; None when it was not detected.
        delay_from_1deg: From when its torque was 1 equivalent degree [s]; None too where it never was.
        direction: Whether the sign was right on the joint that the alarm named; None for trunk and base.
        isolation: Whether the joint was right, at ISOLATION_TIMES after the alarm; empty when it was not detected.
    """

    degrees: float
    group: Group
    detected: bool
    delay: float | None = None
    delay_from_1deg: float | None = None
    direction: bool | None = None
    isolation: tuple[bool, ...] = ()


@dataclass(frozen=True, kw_only=True)
class TorqueSums:
    """Torque estimates within pushes, in equivalent radians; the sums are over the samples that have an estimate."""

    samples: int = 0
    estimated: int = 0
    squared_error: float = 0.0
    truth: float = 0.0
    squared_truth: float = 0.0

    def __add__(self, other: TorqueSums) -> TorqueSums:
        return TorqueSums(
            samples=self.samples + other.samples,
            estimated=self.estimated + other.estimated,
            squared_error=self.squared_error + other.squared_error,
            truth=self.truth + other.truth,
            squared_truth=self.squared_truth + other.squared_truth,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class EpisodeScore:
    """One observer on one episode.

    Attributes:
        suite: Of the episode.
        experiment: Of the episode.
        seconds: Its length [s].
        free: Whether nothing was pushed in it.
        false: Contacts that no push explains.
        pushes: Every push.
        swings: Alarms that began after a release, on the pushed limb.
        rebounds_reported: Those that were called rebounds.
        touches: Alarms that began during a push, on the pushed limb.
        contacts_misreported: Those that were called rebounds.
        fit: By joint, NRMSE of the expected tracking error [%]; only of episodes that test it.
        fast: Whether it is a test run of a fit, not an estimation run.
        threshold: (m, N) some thresholds while nothing touched the robot [rad].
        torque: Sums of the torque estimates.
        seen: (N,) ticks in which each joint was not blind.
        ticks: Ticks of the episode.
        stiffness_constant: (N,) K of the plant [N m/rad].
        step_us: (n,) wall time of each step [us].
    """

    suite: str
    experiment: str
    seconds: float
    free: bool
    false: int
    pushes: tuple[PushScore, ...]
    swings: int
    rebounds_reported: int
    touches: int
    contacts_misreported: int
    fit: dict[str, float]
    fast: bool
    threshold: FloatArray = field(repr=False)
    torque: TorqueSums
    seen: IntArray = field(repr=False)
    ticks: int
    stiffness_constant: FloatArray = field(repr=False)
    step_us: FloatArray = field(repr=False)


def score_episode(episode: Episode, watched: ObserverRun, robot: RobotConfig) -> EpisodeScore:
    """Score what an observer said of an episode."""
    result = score(episode.pushes, watched.contacts, robot)
    detected = {id(f.push): f for f in result.detected}
    swings, touches = _swings_and_touches(episode, watched, result.detected, robot)
    time = episode.recording.time
    return EpisodeScore(
        suite=episode.suite,
        experiment=episode.experiment,
        seconds=float(time[-1] - time[0]) + robot.cycle,
        free=not episode.pushes,
        false=len(result.false),
        pushes=tuple(_score_push(episode, p, detected.get(id(p)), robot) for p in episode.pushes),
        swings=len(swings),
        rebounds_reported=sum(alarm.begin.kind == "rebound" for alarm in swings),
        touches=len(touches),
        contacts_misreported=sum(alarm.begin.kind == "rebound" for alarm in touches),
        fit=_fit(episode, watched),
        fast=episode.task_stiffness > FASTEST_ESTIMATION,
        threshold=watched.threshold[_untouched(episode)][::THRESHOLD_STRIDE],
        torque=_torque(episode, watched, robot),
        seen=np.count_nonzero(watched.state != JointState.BLIND, axis=0),
        ticks=len(time),
        stiffness_constant=episode.stiffness_constant,
        step_us=watched.step_us,
    )


def _score_push(
    episode: Episode, push: KnownPush, detected: DetectedPush | None, robot: RobotConfig
) -> PushScore:
    group = _group(push, robot)
    if detected is None:
        return PushScore(degrees=push.degrees, group=group, detected=False)
    alarm_time = detected.contact.detection_time
    passed = _passes_1deg(episode, push, robot)
    return PushScore(
        degrees=push.degrees,
        group=group,
        detected=True,
        delay=detected.delay,
        delay_from_1deg=None if passed is None else alarm_time - passed,
        direction=_direction(episode, detected, robot),
        isolation=tuple(_is_there(detected, after, robot) for after in ISOLATION_TIMES),
    )


def _group(push: KnownPush, robot: RobotConfig) -> Group:
    if push.saturated or push.saturating:
        return "saturated"
    if push.joint in robot.hands.joints:
        return "hand"
    if push.joint is None:
        return "trunk"
    return "axis" if push.degrees < AXIS_DEGREES else "plain"


def _is_there(detected: DetectedPush, after: float, robot: RobotConfig) -> bool:
    """Check if the contact was on the right joint some time after the alarm, by the first tick that is so late."""
    grace = robot.cycle if after else 0.0
    joint = detected.track.at(detected.contact.detection_time + after + grace).joint
    if detected.push.joint is None:
        return robot.limb_of(joint) == TRUNK
    return joint == detected.push.joint


def _direction(episode: Episode, detected: DetectedPush, robot: RobotConfig) -> bool | None:
    """Compare the alarm's sign with that of the true torque on its joint; None for a torque near zero."""
    push, contact = detected.push, detected.contact
    if contact.joint is None or push.direction == 0:
        return None
    if contact.joint == push.joint:
        return contact.direction == push.direction
    # The alarm names another joint of the limb: the true torque on that joint decides.
    index = robot.joint_index(contact.joint)
    torque = episode.contact_torque[_during(episode, push), index]
    strongest = torque[np.argmax(np.abs(torque))] if len(torque) else 0.0
    if not abs(strongest) / episode.stiffness_constant[index] > ONE_DEGREE:
        return None
    return bool(np.sign(strongest) == contact.direction)


def _passes_1deg(episode: Episode, push: KnownPush, robot: RobotConfig) -> float | None:
    """Clock at which the torque on the pushed joint first is 1 equivalent degree [s]."""
    if push.joint is None:
        return None
    index = robot.joint_index(push.joint)
    rows = np.flatnonzero(_during(episode, push))
    size = np.abs(episode.contact_torque[rows, index]) / episode.stiffness_constant[index]
    above = rows[size >= ONE_DEGREE]
    return float(episode.recording.time[above[0]]) if len(above) else None


def _during(episode: Episode, push: KnownPush) -> BoolArray:
    """(n,) rows while the force acts."""
    time = episode.recording.time
    during: BoolArray = (time >= push.onset) & (time <= push.release)
    return during


def _untouched(episode: Episode) -> BoolArray:
    """(n,) rows without a push and without the rebound of one."""
    time = episode.recording.time
    free = np.ones(len(time), dtype=np.bool_)
    for push in episode.pushes:
        free &= (time < push.onset) | (time > push.release + REBOUND_TIME)
    return free


def _swings_and_touches(
    episode: Episode, watched: ObserverRun, detected: tuple[DetectedPush, ...], robot: RobotConfig
) -> tuple[list[ContactTrack], list[ContactTrack]]:
    """Alarms on the pushed limb that began after the release, and those that began before it."""
    swings, touches = [], []
    first = {(f.contact.id, f.contact.detection_time) for f in detected}
    for alarm in group_events(watched.contacts):
        begin = alarm.begin
        near = [
            push
            for push in episode.pushes
            if push.onset <= begin.detection_time <= push.release + REBOUND_TIME
            and robot.limb_of(push.joint) == robot.limb_of(begin.joint)
        ]
        if not near:
            continue
        if begin.detection_time <= near[-1].release:
            touches.append(alarm)
        # A push that is detected after its release is no rebound.
        elif (begin.id, begin.detection_time) not in first:
            swings.append(alarm)
    return swings, touches


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


def _torque(episode: Episode, watched: ObserverRun, robot: RobotConfig) -> TorqueSums:
    sums = TorqueSums()
    for push in episode.pushes:
        if push.joint is None or _group(push, robot) != "plain":
            continue
        index = robot.joint_index(push.joint)
        rows, unit = _during(episode, push), episode.stiffness_constant[index]
        truth = episode.contact_torque[rows, index] / unit
        estimate = watched.torque[rows, index] / unit
        known = np.isfinite(truth)
        both = known & np.isfinite(estimate)
        sums += TorqueSums(
            samples=int(known.sum()),
            estimated=int(both.sum()),
            squared_error=float(np.sum((estimate[both] - truth[both]) ** 2)),
            truth=float(truth[both].sum()),
            squared_truth=float(np.sum(truth[both] ** 2)),
        )
    return sums
