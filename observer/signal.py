"""What the residual stage of an observer hands to the stage that makes events of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.hand_load import HandLoad

FULL_STIFFNESS = 0.99
"""Models are identified on stiff joints: one with less follows its commands in another way."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Signal:
    """Arrays (n,), NaN where a joint is blind.

    Attributes:
        expected: Expected tracking error [rad].
        raw: r before the filter [rad]; NaN only where this very sample cannot be judged.
        residual: r, filtered [rad].
        threshold: Of a contact [rad].
        torque: External torque [N m]; NaN where there is no estimate.
        torque_std: Its standard deviation [N m].
        band: By how much friction can hold a joint off its place [rad]; 0 where nothing is known of it.
        blind: Joints that cannot be judged.
        base_raw: Residual of the base before the filter, as a share of its bound; NaN where it cannot be judged.
        base_residual: The same, filtered.
        detail: More that the same generator learns from, once the events of the tick are known.
    """

    expected: FloatArray
    raw: FloatArray
    residual: FloatArray
    threshold: FloatArray
    torque: FloatArray
    torque_std: FloatArray
    band: FloatArray
    blind: BoolArray
    base_raw: float = np.nan
    base_residual: float = np.nan
    detail: object = None


class Unchanging:
    """What a signal has to say that follows neither joints nor loads: the second half of :class:`ResidualSignal`."""

    no_model: BoolArray

    @property
    def worn(self) -> BoolArray:
        """(n,) none."""
        return np.zeros(len(self.no_model), dtype=np.bool_)

    @property
    def held(self) -> dict[str, HandLoad]:
        """Nothing."""
        return {}

    def learn(self, signal: Signal, free: BoolArray, settled: BoolArray, untouched: bool) -> None:
        """Nothing: its constants stay as they are."""


class ResidualSignal(Protocol):
    """Makes residuals of ticks.

    Attributes:
        no_model: (n,) joints without a model.
        bounds: (n,) largest threshold of known joints in use as identified [rad].
    """

    no_model: BoolArray
    bounds: FloatArray

    def step(self, tick: Tick) -> Signal:
        """Take in one tick; never raises for bad sensor values."""
        ...

    @property
    def worn(self) -> BoolArray:
        """(n,) joints that have worn since they were identified, as far as the session tells."""
        ...

    @property
    def held(self) -> dict[str, HandLoad]:
        """What is known of what the hands hold, by arm; empty in modes that do not follow it."""
        ...

    def learn(self, signal: Signal, free: BoolArray, settled: BoolArray, untouched: bool) -> None:
        """Take in what the events make of a tick.

        Args:
            signal: What :meth:`step` returned in it.
            free: (n,) joints that nothing touches, nor has shortly before.
            settled: (n,) joints whose contact ended in this tick.
            untouched: Whether nothing touches the robot anywhere, nor has shortly before.
        """
        ...

    def reset(self) -> None:
        """Forget everything but the models."""
        ...
