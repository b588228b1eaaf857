"""Fit of the joint models to a robot that moves freely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from enum import Enum
from typing import Any

import numpy as np

from pepper_driver.config import DoctorSettings, ObserverSettings, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Tick
from pepper_driver.observer import ContactObserver, ModelSet, Observation


class Verdict(Enum):
    """Judgement on the model of a joint, from its residual."""

    FITS = "fits"
    WORN = "worn or carrying"
    MISFIT = "does not fit"
    STUCK = "does not follow"
    NO_MODEL = "no model"


@dataclass(frozen=True, kw_only=True)
class JointFit:
    """Quality of the prediction of one joint's free motion by its model.

    Attributes:
        joint: Its name.
        verdict: What that means.
        follows: Ratio of its distance to the commanded one.
        error: Residual, rms [rad].
        rms: Residual over the threshold that identification found, rms.
        peak: The same, largest.
        today: Largest residual over threshold of the observer that adapts: at 1 it detects a contact.
    """

    joint: str
    verdict: Verdict
    follows: float
    error: float
    rms: float
    peak: float
    today: float

    def as_json(self) -> dict[str, Any]:
        """All figures by name; None where there is no number."""
        plain = {**asdict(self), "verdict": self.verdict.value}
        return {k: None if isinstance(v, float) and np.isnan(v) else v for k, v in plain.items()}


class ModelFitMonitor:
    """Compares joints with models that do not adapt, and with an observer that does.

    Args:
        robot: Its description.
        models: To judge; None without: then only the motion is judged.
        settings: Of the observer.
        joints: Names of those that move.
    """

    def __init__(
        self,
        robot: RobotConfig,
        models: ModelSet | None,
        settings: ObserverSettings,
        joints: Sequence[str],
    ) -> None:
        self._strict = (
            None
            if models is None
            else ContactObserver(robot, models, replace(settings, adapt=False))
        )
        self._joints = tuple(joints)
        self._columns = [robot.joint_index(name) for name in joints]
        n = len(self._columns)
        self._ticks = 0
        self._square, self._load = np.zeros(n), np.zeros(n)
        self._peak, self._today = np.zeros(n), np.zeros(n)
        self._known = np.zeros(n, dtype=np.int64)
        self._lowest = np.full((2, n), np.inf)
        self._highest = np.full((2, n), -np.inf)

    def step(self, tick: Tick, observation: Observation | None) -> None:
        """Take in one tick and what the adapting observer made of it."""
        columns = self._columns
        if self._strict is not None:
            strict = self._strict.step(tick)
            residual = np.abs(strict.residual[columns])
            load = residual / strict.threshold[columns]
            seen = np.isfinite(load)
            self._known += seen
            self._square += np.where(seen, residual, 0.0) ** 2
            self._load += np.where(seen, load, 0.0) ** 2
            self._peak = np.fmax(self._peak, load)
        if observation is not None:
            today = np.abs(observation.residual[columns]) / observation.threshold[columns]
            self._today = np.fmax(self._today, today)
        both = np.array([tick.sent.position[columns], tick.measurement.position[columns]])
        self._lowest = np.fmin(self._lowest, both)
        self._highest = np.fmax(self._highest, both)

    def fits(self, settings: DoctorSettings) -> tuple[JointFit, ...]:
        """Return the verdict on each joint."""
        distance = np.maximum(self._highest - self._lowest, 0.0)
        with np.errstate(all="ignore"):
            follows = distance[1] / distance[0]
            error = np.sqrt(self._square / self._known)
            rms = np.sqrt(self._load / self._known)
        return tuple(
            self._fit(number, follows, error, rms, settings) for number in range(len(self._joints))
        )

    def _fit(
        self,
        number: int,
        follows: FloatArray,
        error: FloatArray,
        rms: FloatArray,
        settings: DoctorSettings,
    ) -> JointFit:
        known = bool(self._known[number])
        peak = float(self._peak[number]) if known else np.nan
        today = float(self._today[number]) if known else np.nan
        if not follows[number] >= settings.min_following_ratio:
            verdict = Verdict.STUCK
        elif not known:
            verdict = Verdict.NO_MODEL
        elif today > settings.misfit_peak:
            verdict = Verdict.MISFIT
        elif rms[number] > settings.worn_rms or peak > settings.worn_peak:
            verdict = Verdict.WORN
        else:
            verdict = Verdict.FITS
        return JointFit(
            joint=self._joints[number],
            verdict=verdict,
            follows=float(follows[number]),
            error=float(error[number]),
            rms=float(rms[number]),
            peak=peak,
            today=today,
        )
