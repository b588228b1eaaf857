"""An observer of your own: a joint at rest whose tracking error jumps is touched."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pepper_driver import Contact, Observation, Observer
from pepper_driver.config import RobotConfig
from pepper_driver.controller import Tick
from pepper_driver.observer import JointState

THRESHOLD = np.radians(1.0)  # [rad] beyond what the joint shows at rest
TICKS = 5  # in which it must be exceeded, or no longer exceeded
BASELINE_TIME = 1.0  # [s] in which the error at rest is learned, and relearned


class RestingObserver(Observer):
    """Detects contacts on joints whose command is to stand still; while the reference moves, they are blind.

    Args:
        robot: Its description.
    """

    def __init__(self, robot: RobotConfig) -> None:
        self._robot, self._gain = robot, robot.cycle / BASELINE_TIME
        self.reset()

    def reset(self) -> None:
        """Forget everything; called before the first tick of each run."""
        count = len(self._robot.joint_names)
        self._expected = np.full(count, np.nan)  # tracking error at rest [rad]
        self._beyond = np.zeros(count, dtype=np.int64)  # ticks beyond the threshold, or within it
        self._contacts: list[Contact | None] = [None] * count
        self._number = 0

    def step(self, tick: Tick) -> Observation:
        """Compare each joint's error with what it was; bounded time, never raises for bad values."""
        moving = np.abs(tick.reference.velocity) > 1e-3
        error = tick.sent.position - tick.measurement.position  # [rad], as sent, not as requested
        self._expected[moving] = np.nan
        new = np.isnan(self._expected) & ~moving & np.isfinite(error)
        self._expected[new] = error[new]
        residual = error - self._expected
        with np.errstate(invalid="ignore"):
            touched = np.abs(residual) > THRESHOLD
        quiet = ~touched & np.isfinite(residual)
        self._expected[quiet] += self._gain * residual[quiet]
        events = [self._judge(i, touched[i], residual[i], tick) for i in range(len(error))]
        state = np.where(np.isnan(residual), JointState.BLIND, JointState.FREE).astype(np.int8)
        state[[contact is not None for contact in self._contacts]] = JointState.CONTACT
        unknown = np.full(len(error), np.nan)
        return Observation(
            contacts=tuple(event for event in events if event is not None),
            expected=self._expected.copy(),  # an observation is never changed afterwards
            residual=residual,
            threshold=np.full(len(error), THRESHOLD),
            torque=unknown,
            torque_std=unknown,
            state=state,
        )

    def _judge(self, joint: int, touched: bool, residual: float, tick: Tick) -> Contact | None:
        """Begin or end of a contact of a joint, once it has lasted for some ticks."""
        now, contact = tick.measurement.time, self._contacts[joint]
        if touched == (contact is not None):
            self._beyond[joint] = 0
            return None
        self._beyond[joint] += 1
        if self._beyond[joint] < TICKS:
            return None
        self._beyond[joint] = 0
        if contact is not None:
            self._contacts[joint] = None
            return replace(contact, phase="end", time=now)
        self._number += 1
        begun = Contact(
            id=self._number,
            phase="begin",
            kind="contact",
            limb=self._robot.limb_of(self._robot.joint_names[joint]),
            joint=self._robot.joint_names[joint],
            shown_by=self._robot.joint_names[joint],
            link=self._robot.joints[joint].child,
            direction=1 if residual < 0.0 else -1,  # of the torque: the joint gives way to it
            intensity_deg=float(np.degrees(abs(residual))),
            torque=None,
            torque_std=None,
            onset_time=now - TICKS * self._robot.cycle,
            detection_time=now,
            time=now,
        )
        self._contacts[joint] = begun
        return begun

    def describe(self) -> str:
        """One line for the log."""
        return f"resting: joints at rest, threshold {np.degrees(THRESHOLD):.1f} deg"


def make(robot: RobotConfig, identity: str, models: Path | None) -> RestingObserver:
    """Make the observer, by the name of the entry point; it needs no models."""
    return RestingObserver(robot)
