"""Labelled logs as the observer's tools want them: a recording, and the touches that someone knows of."""

from __future__ import annotations

import logging
import math

import numpy as np

from pepper_driver.config import PepperError, RobotConfig
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.log import Label, LogData
from pepper_driver.observer import Push, Recording, RecordingError

logger = logging.getLogger("pepper_driver")

_COLUMNS = {
    "time": "time",
    "age": "age",
    "sent_position": "sent_position",
    "stiffness": "sent_stiffness",
    "changed": "changed",
    "position": "position",
    "current": "current",
    "reference_position": "reference_position",
    "velocity": "reference_velocity",
    "acceleration": "reference_acceleration",
    "load_torque": "reference_load_torque",
    "base_twist": "reference_base_twist",
    "sent_wheel_speed": "sent_wheel_speed",
    "wheel_speed": "wheel_speed",
    "linear_acceleration": "imu_acceleration",
    "angular_velocity": "imu_angular_velocity",
    "attitude": "imu_attitude",
}
"""Field of the log behind each column of a recording."""


class LabelError(PepperError, ValueError):
    """Touches cannot be labelled this way, or a log does not say what was touched when."""


@checked_arguments
def recording_of(log: LogData, robot: RobotConfig) -> Recording:
    """The recording that a log holds; ticks that repeat a cycle of the robot are left out.

    Raises:
        RecordingError: Another robot, fewer than two ticks, a value that is not finite.
    """
    if log.joint_names != robot.joint_names:
        raise RecordingError(
            f"this log is of a robot with other joints, or another order of them, than '{robot.name}'"
        )
    goes_on = np.diff(log["time"], prepend=-np.inf) != 0
    columns = {name: log[source][goes_on] for name, source in _COLUMNS.items()}
    return Recording(joint_names=log.joint_names, **columns)


@checked_arguments
def pushes_of(
    log: LogData, *, link: str | None = None, joint: str | None = None
) -> tuple[Push, ...]:
    """The touches that a log's labels tell of. Size and direction are not known: NaN and 0.

    A touch that was not released counts until the end of the log, a release without an onset not at all; both are
    warned of.

    Args:
        log: Of ``pepper record``.
        link: What was touched, for labels that do not say so.
        joint: The last joint that moves it; None on trunk and base.

    Raises:
        LabelError: There is no label of a touch, or nobody said which link was touched.
    """
    spans, open_label = [], None
    for label in log.labels:
        if (label.phase == "onset") == (open_label is None):
            if open_label is not None:
                spans.append((open_label, label.time))
            open_label = label if label.phase == "onset" else None
        else:
            what = "onset inside a touch" if open_label is not None else "release without an onset"
            logger.warning("label at %.3f s: %s, left out", label.time, what)
    if open_label is not None:
        end = float(log["time"][-1]) if len(log) else open_label.time
        logger.warning(
            "label at %.3f s: the touch was not released, it counts until the end of the log",
            open_label.time,
        )
        spans.append((open_label, end))
    if not spans:
        raise LabelError("this log has no labelled touch; make one with 'pepper record --label'")
    return tuple(_push(onset, release, link, joint) for onset, release in spans)


def _push(onset: Label, release: float, link: str | None, joint: str | None) -> Push:
    if onset.link is not None:
        link, joint = onset.link, onset.joint
    if link is None:
        raise LabelError(
            f"the label at {onset.time:.3f} s does not say what was touched; record with --link"
        )
    return Push(
        joint=joint,
        link=link,
        direction=0,
        force=math.nan,
        torque=math.nan,
        degrees=math.nan,
        onset=onset.time,
        release=release,
        moving=False,
    )
