"""A log as moments: state, way of the base, contacts as they were known then."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence

import numpy as np

from pepper_driver.config import load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.log.reader import RunLog
from pepper_driver.observer import Contact
from pepper_driver.viewer.picture import Force, Picture, picture_of


class Moments:
    """Moments of a log with a tick at least.

    Args:
        log: What was recorded.

    Attributes:
        log: The same.
        base: (n, 3) pose of the base at each tick: x, y [m], yaw [rad].
        tilt: (n, 2) its pitch and roll [rad].
    """

    def __init__(self, log: RunLog) -> None:
        self.log = log
        self.base, self.tilt = base_path(log)
        self._ticks: list[float] = log["time"].tolist()
        self._contacts = by_contact(log.contacts)
        self._forces: dict[float, list[Force]] = {}
        for true in log.forces or ():
            force = Force(
                link=true.link,
                point=np.array([true.x, true.y, true.z]),
                force=np.array([true.force_x, true.force_y, true.force_z]),
            )
            self._forces.setdefault(true.time, []).append(force)
        self._truth_times = [] if log.truth is None else log.truth["time"].tolist()

    def row(self, time: float) -> int:
        """Return the number of the last tick that is not after a time [s]; 0 before the first."""
        return max(0, bisect_right(self._ticks, time + 1e-9) - 1)

    def picture(self, row: int) -> Picture:
        """Return the state at a tick, with the true forces that a simulation logged."""
        fields = {name: column[row] for name, column in self.log.fields.items()}
        return picture_of(fields, self.base[row], self.tilt[row], self._forces_at(self._ticks[row]))

    def _forces_at(self, time: float) -> tuple[Force, ...]:
        """Return the forces of the cycle of the truth that a tick shows: the one of :func:`base_path`."""
        if not self._forces:
            return ()
        number = min(bisect_left(self._truth_times, time), len(self._truth_times) - 1)
        return tuple(self._forces.get(self._truth_times[number], ()))

    def contacts(self, time: float) -> list[Contact]:
        """Return the contacts at a time [s] as they were known then; rebounds are none."""
        active = []
        for events in self._contacts:
            known = bisect_right(events, time, key=lambda event: event.time)
            if known and (now := events[known - 1]).phase != "end" and now.kind != "rebound":
                active.append(now)
        return active


def by_contact(events: Sequence[Contact]) -> list[list[Contact]]:
    """Return the events of each contact, in the order of time."""
    found: dict[int, list[Contact]] = {}
    for event in sorted(events, key=lambda event: event.time):
        found.setdefault(event.id, []).append(event)
    return list(found.values())


def base_path(log: RunLog) -> tuple[FloatArray, FloatArray]:
    """Return (n, 3) pose of the base and (n, 2) its tilt over the ticks of a log.

    They are the truth of a simulation where the log has it; else the pose comes from the speeds of the wheels.
    """
    ticks = log["time"]
    if log.truth is not None:
        rows = np.clip(np.searchsorted(log.truth["time"], ticks), 0, len(log.truth["time"]) - 1)
        return log.truth["base"][rows], log.truth["tilt"][rows]
    wheels = load_robot().wheels
    twist = np.nan_to_num(log["wheel_speed"]) @ np.asarray(wheels.inverse).T
    step = np.diff(ticks, prepend=ticks[:1])
    yaw = np.cumsum(twist[:, 2] * step)
    forward, left = twist[:, 0] * step, twist[:, 1] * step
    x = np.cumsum(np.cos(yaw) * forward - np.sin(yaw) * left)
    y = np.cumsum(np.sin(yaw) * forward + np.cos(yaw) * left)
    return np.stack([x, y, yaw], axis=1), np.zeros((len(ticks), 2))
