"""Interfaces of the observer: contacts, observations, and the residuals they are made from."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.contact_selector import Kind
from pepper_driver.controller.tick import Tick


@dataclass(frozen=True, kw_only=True)
class HandLoad:
    """Load of one hand.

    Attributes:
        mass: [kg]; below 0 where the robot's own masses are less than its description says.
        mass_std: Standard deviation of it [kg].
        first_moment: (3,) m c in the axes of the link that carries the hand [kg m].
    """

    mass: float
    mass_std: float
    first_moment: tuple[float, float, float]


Phase = Literal["begin", "update", "end"]
Direction = Literal[-1, 1]

INTENSITY_STEP_DEG = 0.1
"""[deg] Change of the intensity that is worth an update."""

TORQUE_STEP_STDS = 0.5
"""Standard deviations of the torque: change of it that is worth an update. Smaller ones are noise."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Contact:
    """One event in the life of a contact.

    Attributes:
        id: Number of the contact; its begin, updates and end share it.
        phase: ``begin``, ``update`` or ``end``. An update comes at once when kind, place or direction change. When only
            intensity or torque change, it comes ``update_period`` (settings) or more after the event before.
        kind: ``contact``; ``collision`` when it is hard; ``rebound`` when the joint only swings back after one.
        limb: ``left_arm``, ``right_arm``, ``head`` or ``trunk``, which includes the base: that of the joint.
        joint: The last joint of the chain that feels it; None for trunk and base.
        link: The link that hangs on that joint.
        direction: Sign of the external torque on the joint, in the joint's positive sense: minus the sign of the
            residual r = eps - eps_exp.
        intensity_deg: Largest size of the residual so far [deg]; 0 where only the wheels feel it.
        torque: External torque estimate on the joint [N m], signed; None where no estimate exists.
        torque_std: Its standard deviation [N m]; None where no estimate exists.
        onset_time: Clock of the robot when the residual began to leave its free-motion band [s].
        detection_time: When the contact was first reported [s].
        time: When this happened [s]; an ``end`` is raised a little later, once the residual has stayed low.
    """

    id: int
    phase: Phase
    kind: Kind
    limb: str
    joint: str | None
    link: str
    direction: Direction
    intensity_deg: float
    torque: float | None
    torque_std: float | None
    onset_time: float
    detection_time: float
    time: float


class JointState(IntEnum):
    """State of one joint, as the observer classifies it."""

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
        """Return what a log needs so that the results can be computed again: values by name, as text."""
        return {}


MIN_OBSERVED_STIFFNESS = 0.99
"""Models are identified on stiff joints: one with less follows its commands in another way."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Residuals:
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


class StaticGeneratorMixin:
    """Second half of a :class:`ResidualGenerator` that adapts to neither joints nor loads."""

    no_model: BoolArray

    @property
    def worn(self) -> BoolArray:
        """(n,) none."""
        return np.zeros(len(self.no_model), dtype=np.bool_)

    @property
    def held(self) -> dict[str, HandLoad]:
        """Nothing."""
        return {}

    def learn(
        self, signal: Residuals, free: BoolArray, settled: BoolArray, untouched: bool
    ) -> None:
        """Nothing: its constants stay as they are."""


class ResidualGenerator(Protocol):
    """Makes residuals of ticks.

    Attributes:
        no_model: (n,) joints without a model.
        bounds: (n,) largest threshold of known joints in use as identified [rad].
    """

    no_model: BoolArray
    bounds: FloatArray

    def step(self, tick: Tick) -> Residuals:
        """Take in one tick; never raises for bad sensor values."""
        ...

    @property
    def worn(self) -> BoolArray:
        """(n,) joints that have worn since they were identified, as far as the session tells."""
        ...

    @property
    def held(self) -> dict[str, HandLoad]:
        """Estimated loads of the hands, by arm; empty in modes without this estimate."""
        ...

    def learn(
        self, signal: Residuals, free: BoolArray, settled: BoolArray, untouched: bool
    ) -> None:
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
