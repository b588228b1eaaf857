"""Logs as the judge sees them: touches that were labelled on a robot, or that really acted in a simulation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from pepper_driver.config import PepperError, RobotConfig, load_robot
from pepper_driver.config.touch_suites import TouchSuites, load_touch_suites
from pepper_driver.config.workers import Workers, run_jobs
from pepper_driver.evaluation.episodes import Episode
from pepper_driver.evaluation.evaluate import episode_of_log
from pepper_driver.evaluation.observers_under_test import ObserversUnderTest
from pepper_driver.evaluation.touch.observers import watch_all
from pepper_driver.evaluation.touch.records import LOG, ObserverRecord, RobotRecord, Take, Touched
from pepper_driver.observer import KnownPush, Observer

ELSEWHERE = "elsewhere"
"""Place of a touch on a link on which the suites have none."""


@dataclass(frozen=True, kw_only=True)
class LogFailure:
    """A log that could not be scored, and why."""

    path: Path
    reason: str


def judge_logs(
    paths: Sequence[Path], observers: ObserversUnderTest, *, workers: Workers = -1
) -> tuple[tuple[RobotRecord, ...], tuple[LogFailure, ...]]:
    """Return the record of each log, and those logs that could not be scored.

    Args:
        paths: Of the logs.
        observers: That report on them.
        workers: Processes, -1 for one per core; or a cluster.
    """
    jobs = (partial(_judge_log, path, observers) for path in paths)
    done = list(run_jobs(jobs, workers=workers))
    return (
        tuple(one for one in done if isinstance(one, RobotRecord)),
        tuple(one for one in done if isinstance(one, LogFailure)),
    )


def _judge_log(path: Path, observers: ObserversUnderTest) -> RobotRecord | LogFailure:
    try:
        return record_of_log(path, observers)
    except Exception as error:  # one log that fails must not cost the others
        return LogFailure(path=path, reason=reason_of(error))


def reason_of(error: Exception) -> str:
    """Return what went wrong in one line, with the kind of an error that is none of this package."""
    text = " ".join(str(error).split())
    return text if isinstance(error, PepperError) else f"{type(error).__name__}: {text}"


def record_of_log(path: Path, observers: ObserversUnderTest) -> RobotRecord:
    """Return the record of a log: its touches, and what each observer reports of it.

    Raises:
        PepperError: The log is damaged, of another robot, or has neither labels nor ground truth.
    """
    robot, episode = load_robot(), episode_of_log(path)
    take = take_of(
        episode,
        {mode: partial(observers.observer, mode, episode, robot) for mode in observers.modes},
        robot,
        load_touch_suites(robot),
    )
    return RobotRecord(
        robot=path.name, draw=None, law=None, identity=episode.identity, takes=(take,)
    )


def take_of(
    episode: Episode,
    observers: Mapping[str, Callable[[], Observer]],
    robot: RobotConfig,
    suites: TouchSuites,
    *,
    state: str = LOG,
    suite: Literal["touch", "free"] | None = None,
) -> Take:
    """Return the take of an episode: its touches, and what each observer reports of it.

    Args:
        episode: The episode.
        observers: By name, what makes each; one that cannot be made has a failure.
        robot: Its description.
        suites: For the places of touches.
        state: Of the robot.
        suite: Of the take; None for ``free`` without touches.
    """
    recording = episode.recording
    touches = tuple(
        _touched(push, episode, robot, suites) for push in sorted(episode.pushes, key=_onset)
    )
    made: dict[str, Observer] = {}
    failed: dict[str, ObserverRecord] = {}
    for mode, make in observers.items():
        try:
            made[mode] = make()
        except PepperError as error:
            failed[mode] = ObserverRecord(failure=reason_of(error))
    known = bool(np.isfinite(episode.contact_torque).all())
    reported = watch_all(
        made,
        recording,
        touches,
        robot,
        true_torque=episode.contact_torque if known else None,
        warn=True,
    )
    return Take(
        suite=suite or ("touch" if touches else "free"),
        state=state,
        number=0,
        day=None,
        seed=episode.seed,
        start=float(recording.time[0]),
        end=float(recording.time[-1]),
        touches=touches,
        hearings={mode: {**reported, **failed}[mode] for mode in observers},
    )


def _onset(push: KnownPush) -> float:
    return push.onset


def _touched(push: KnownPush, episode: Episode, robot: RobotConfig, suites: TouchSuites) -> Touched:
    """Return a touch; nothing is known of its rise, and of its force only what the label or the simulation says.

    A labelled force is what was asked for: there is no other truth, hence no torque.
    """
    time, limb = episode.recording.time, robot.limb_of_link(push.link)
    joints = [robot.joint_index(name) for name in robot.limbs[limb]]
    during = episode.contact_torque[(time >= push.onset) & (time <= push.release + robot.cycle)]
    torque: dict[str, float] = {}
    if len(during) and np.isfinite(during[:, joints]).all():
        peak = during[np.abs(during).argmax(axis=0), np.arange(during.shape[1])]
        torque = {robot.joint_names[i]: float(peak[i]) for i in joints}
    return Touched(
        row=LOG,
        place=place_of(push.link, suites),
        limb=limb,
        link=push.link,
        asked=push.force if math.isfinite(push.force) and not torque else None,
        force=push.force if math.isfinite(push.force) else None,
        rise=None,
        onset=push.onset,
        release=push.release,
        torque=torque,
        friction_bound=None,
        moving=push.moving,
        standing_start=bool(push.onset < time[0]),
    )


def place_of(link: str, suites: TouchSuites) -> str:
    """Return the place of the suites that a link has the most points of; ELSEWHERE where it has none."""
    counts = {
        name: sum(link in (point.link, point.mirrored.link) for point in place.points)
        for name, place in suites.places.items()
    }
    best = max(counts, key=counts.__getitem__)
    return best if counts[best] else ELSEWHERE
