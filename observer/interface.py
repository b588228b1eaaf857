"""What an observer is: it sees ticks and says what touches the robot."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.contact import Contact


class JointState(IntEnum):
    """What an observer thinks of one joint."""

    FREE = 0
    CONTACT = 1
    RELEASE = 2
    REBOUND = 3
    SETTLING = 4
    BLIND = 5
    """No model, or the data cannot be judged: neither free nor touched."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Observation:
    """Result of one tick; arrays in joint order, NaN where the joint is blind, never changed once it was handed over.

    Attributes:
        contacts: Events raised in this tick.
        expected: (17,) expected tracking error eps_exp [rad], Eq. 12.
        residual: (17,) filtered contact observer signal r = eps - eps_exp [rad], Eq. 13.
        threshold: (17,) bound that ``residual`` is compared with [rad].
        torque: (17,) external torque estimate [N m]; NaN where there is none.
        torque_std: (17,) its standard deviation [N m]; NaN where there is none.
        state: (17,) values of :class:`JointState`.
    """

    contacts: tuple[Contact, ...]
    expected: FloatArray
    residual: FloatArray
    threshold: FloatArray
    torque: FloatArray
    torque_std: FloatArray
    state: NDArray[np.int8]


class Observer(ABC):
    """A plug-in on the controller's tick. Has no access to anything but ticks."""

    @abstractmethod
    def step(self, tick: Tick) -> Observation:
        """Take in one tick; bounded time, never raises for bad sensor values."""

    @abstractmethod
    def reset(self) -> None:
        """Forget everything but the models."""

    @abstractmethod
    def describe(self) -> str:
        """One line: kind, models, thresholds."""

    def provenance(self) -> dict[str, str]:
        """What a log must say of it so that its results can be had again: values by name, as text."""
        return {}
