"""What a picture of one joint in one take needs, and no more: it travels between processes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.evaluation.takes import Take
from pepper_driver.evaluation.watching import Watched
from pepper_driver.observer import Contact, Push


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """One joint over n ticks of a take, as one observer saw it; angles [rad], NaN where the joint was blind.

    ``others`` are the positions sent of the joints that move besides, by name.
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
    pushes: tuple[Push, ...]
    contacts: tuple[Contact, ...]


def trace_of(mode: str, take: Take, watched: Watched, joint: str) -> Trace:
    """Cut one joint out of a take; the three joints that move most besides come along."""
    recording = take.recording
    index = recording.joint_names.index(joint)
    travel = np.ptp(recording.sent_position, axis=0)
    travel[index] = 0.0
    most = [i for i in np.argsort(-travel, kind="stable")[:3] if travel[i] > 0.0]
    return Trace(
        mode=mode,
        suite=take.suite,
        experiment=take.experiment,
        task_stiffness=take.task_stiffness,
        joint=joint,
        time=recording.time.copy(),
        sent=recording.sent_position[:, index].copy(),
        position=recording.position[:, index].copy(),
        others={recording.joint_names[i]: recording.sent_position[:, i].copy() for i in most},
        expected=watched.expected[:, index].copy(),
        residual=watched.residual[:, index].copy(),
        threshold=watched.threshold[:, index].copy(),
        pushes=take.pushes,
        contacts=watched.contacts,
    )
