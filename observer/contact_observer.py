"""The contact observer as published: expected tracking error, residual, median, threshold. Sec. III to V."""

from __future__ import annotations

import math
from itertools import count

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config import ObserverSettings, RobotConfig
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.contact import Contact
from pepper_driver.observer.interface import JointState, Observation, Observer
from pepper_driver.observer.isolation import ChainTracker
from pepper_driver.observer.median import RunningMedian
from pepper_driver.observer.model_file import ModelSet
from pepper_driver.observer.onset import ResidualHistory
from pepper_driver.observer.recording import STALE_AGE

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

FULL_STIFFNESS = 0.99
"""Models are identified on stiff joints: one with less follows its commands in another way."""

ONSET_LOOKBACK = 0.5
"""[s] before the median window; a touch that grows more slowly is dated too late."""


class ContactObserver(Observer):
    """Mode ``paper``: r = eps - eps_exp (Eq. 13) with eps_exp from trees (Eq. 12), filtered by a running median.

    A joint is BLIND, its values NaN, and takes part in no contact

    - as long as it has no model;
    - in a tick whose position the safety gate altered, whose stiffness is below FULL_STIFFNESS, whose sample is older
      than STALE_AGE, or whose values are not finite, and until the median window holds none of these samples any more:
      ``median_window`` ticks in all.

    At the start the median is that of the samples there are. The threshold is constant: the one of the settings for all
    joints, or each joint's own, which its identification found in free motion.

    Args:
        robot: Description of the robot.
        models: Models of its joints; those that have none stay blind.
        settings: Filter, threshold and times.

    Raises:
        ModelFileError: The models are of another robot.
    """

    def __init__(self, robot: RobotConfig, models: ModelSet, settings: ObserverSettings) -> None:
        models.check_robot(robot)
        names = robot.joint_names
        self._models = models
        self._settings = settings
        self._predict = [
            models.models[name].predict_one if name in models.models else None for name in names
        ]
        self._no_model = np.array([predict is None for predict in self._predict])
        self._resting_state = np.where(self._no_model, JointState.BLIND, JointState.FREE)
        self._threshold = np.array(
            [settings.threshold or models.threshold.get(name, np.nan) for name in names]
        )
        self._no_torque = np.full(len(names), np.nan)
        self._median = RunningMedian(settings.median_window, len(names))
        lookback = math.ceil(ONSET_LOOKBACK / robot.cycle)
        self._history = ResidualHistory(settings.median_window, lookback, len(names))
        self._chains = [
            ChainTracker(robot, chain, settings, self._history.onset, lambda: next(self._ids))
            for chain in robot.chains.values()
        ]
        self.reset()

    def reset(self) -> None:
        """Forget everything but the models; contacts are counted from 1 again."""
        self._ids = count(1)
        self._time = 0.0
        self._blind_ticks = np.zeros(len(self._predict), dtype=np.int64)
        self._median.reset()
        self._history.reset()
        for chain in self._chains:
            chain.reset()

    def describe(self) -> str:
        """One line: kind, models, thresholds."""
        known = np.degrees(self._threshold[~self._no_model])
        return (
            f"paper: {self._models.kind} trees of {len(self._models.models)} joints, identified on "
            f"{self._models.identity}; median of {self._settings.median_window}, "
            f"threshold {known.min():.2f} to {known.max():.2f} deg"
        )

    def step(self, tick: Tick) -> Observation:
        """Take in one tick; never raises for bad sensor values."""
        measurement, reference = tick.measurement, tick.reference
        # A clock that jumps back or is lost must not turn the order of events around.
        if measurement.time > self._time:
            self._time = measurement.time
        expected = self._expected(tick)
        with np.errstate(invalid="ignore", over="ignore"):
            error = tick.sent.position - measurement.position
            residual = error - expected
            inputs = error + reference.velocity + reference.acceleration + reference.load_torque
            bad = tick.changed | ~np.isfinite(inputs) | ~np.isfinite(residual)
        bad |= ~(tick.sent.stiffness >= FULL_STIFFNESS)  # NaN is bad too
        if not measurement.age <= STALE_AGE:
            bad[:] = True
        residual[bad] = np.nan
        self._history.append(self._time, residual)
        residual = self._median.push(residual)

        window = self._settings.median_window
        self._blind_ticks = np.where(bad, window, np.maximum(self._blind_ticks - 1, 0))
        blind = self._blind_ticks > 0
        threshold = self._threshold.copy()
        for values in (expected, residual, threshold):
            values[blind] = np.nan
        contacts, state = self._events(residual, threshold, blind)
        return Observation(
            contacts=contacts,
            expected=expected,
            residual=residual,
            threshold=threshold,
            torque=self._no_torque.copy(),
            torque_std=self._no_torque.copy(),
            state=state,
        )

    def _expected(self, tick: Tick) -> FloatArray:
        """(17,) Eq. 12 of all joints [rad], NaN where there is no model."""
        reference = tick.reference
        return np.array(
            [
                math.nan if predict is None else predict(velocity, acceleration, load_torque)
                for predict, velocity, acceleration, load_torque in zip(
                    self._predict,
                    reference.velocity.tolist(),
                    reference.acceleration.tolist(),
                    reference.load_torque.tolist(),
                    strict=True,
                )
            ]
        )

    def _events(
        self, residual: FloatArray, threshold: FloatArray, blind: BoolArray
    ) -> tuple[tuple[Contact, ...], NDArray[np.int8]]:
        """Events of this tick, and (17,) states."""
        quiet = not (np.abs(residual) > threshold).any() and not (blind > self._no_model).any()
        if quiet and all(chain.idle for chain in self._chains):
            return (), self._resting_state.astype(np.int8)
        residuals, thresholds = residual.tolist(), threshold.tolist()
        states = [JointState.BLIND] * len(residuals)
        contacts: list[Contact] = []
        for chain in self._chains:
            contacts += chain.step(self._time, residuals, thresholds, states)
        return tuple(contacts), np.array(states, dtype=np.int8)
