"""Interfaces of the observer: contact events with their phases and kinds, observations, residuals."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.contact_selector import Kind
from pepper_driver.controller.tick import Tick

Phase = Literal["begin", "update", "end"]
Direction = Literal[-1, 1]

Three = tuple[float, float, float]
Nine = tuple[float, ...]
"""The 9 values of a 3 x 3 matrix, row by row."""

INTENSITY_STEP_DEG = 0.1
"""[deg] Change of the intensity that causes an update."""

TORQUE_STEP_STDS = 0.5
"""Change of the torque of a joint of the limb that causes an update, in standard deviations."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Contact:
    """One event in the life of a contact.

    Attributes:
        id: Number of the contact; its begin, updates and end share it.
        phase: ``begin``, ``update`` or ``end``. An update comes at once when kind, place or direction change. When only
            intensity or torque change, it comes ``update_period`` (settings) or more after the previous event.
        kind: :data:`~pepper_driver.config.contact_selector.Kind`, as far as it is known.
        limb: ``left_arm``, ``right_arm``, ``head`` or ``trunk``, which includes the base.
        limb_known: False for a contact on the trunk in mode ``fusion``: one on a limb, whose line of force passes near
            the axes of its joints or that friction hides, shakes the base in the same way.
        joint: The joint of the limb on which ``force`` has the largest torque, as of the detection or 50 or 150 ms
            later. On a joint of a hand, and without a force, it is ``shown_by``. None for trunk and base.
        shown_by: The last joint of the chain that detects the contact: the one whose residual is beyond its threshold.
            None for trunk and base.
        link: The link that ``shown_by`` carries; ``torso`` or ``base_link`` on the trunk.
        direction: Sign of the external torque on the joint then, in the joint's positive sense.
        intensity_deg: Largest size so far of the residual of ``shown_by``, on the trunk of a joint of the legs [deg]; 0
            where only the wheels detect it.
        torque: External torque on the joint [N m], signed: that of ``force``; without a force, that of the joint alone.
            None where no estimate exists.
        torque_std: Its standard deviation [N m]; None where no estimate exists.
        force: Force on the limb [N], in the axes of base_link, as the torques of all its joints show it; of an ``end``,
            the last one of the contact. Its length is the median of the size. None where too few joints have a torque,
            on trunk and base, and of a rebound.
        force_covariance: Of ``force`` [N2].
        force_interval: Sizes between which the size of the force is with a probability of 90 % [N].
        point: Where it acts, on the axis of a link, in base_link [m]: mean over the points of the limb that explain the
            torques.
        point_covariance: Of ``point`` [m2].
        scale_known: True if the scale of these torques was measured with a known weight (but of the wrist, which it
            hardly loads); otherwise it is that of documented motors and masses, whose uncertainty is in covariance and
            interval.
        onset_time: Clock of the robot when the residual began to leave its free-motion band [s].
        detection_time: When the contact was first reported [s].
        time: Time of the event [s]; an ``end`` is reported later, when the residual has stayed low.
    """

    id: int
    phase: Phase
    kind: Kind
    limb: str
    limb_known: bool = True
    joint: str | None
    shown_by: str | None
    link: str
    direction: Direction
    intensity_deg: float
    torque: float | None
    torque_std: float | None
    force: Three | None = None
    force_covariance: Nine | None = None
    force_interval: tuple[float, float] | None = None
    point: Three | None = None
    point_covariance: Nine | None = None
    scale_known: bool | None = None
    onset_time: float
    detection_time: float
    time: float

    @property
    def force_size(self) -> float | None:
        """Size of the force [N]; None where it is unknown."""
        return None if self.force is None else math.hypot(*self.force)

    @property
    def force_text(self) -> str:
        """Size of the force with its interval, human-readable, as ``18 N (12 to 27)``; empty where it is unknown."""
        if self.force_size is None or self.force_interval is None:
            return ""
        low, high = self.force_interval
        scale = "" if self.scale_known else ", scale unknown"
        return f"{self.force_size:.0f} N ({low:.0f} to {high:.0f}{scale})"


class JointState(IntEnum):
    """State of one joint, as the observer classifies it."""

    FREE = 0
    CONTACT = 1
    RELEASE = 2
    REBOUND = 3
    BLIND = 4
    """No model, or data that cannot be judged: neither free nor in contact."""
    DOUBTFUL = 5
    """At rest with an error that its motor does not work against, or with a threshold that no touch reaches."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Observation:
    """Result of one tick: arrays in joint order, NaN where a joint is blind. They are never changed afterwards.

    Attributes:
        contacts: Events of this tick.
        expected: (17,) expected tracking error eps_exp [rad], Eq. 12.
        residual: (17,) filtered residual r = eps - eps_exp [rad], Eq. 13.
        threshold: (17,) bound that ``residual`` is compared with [rad].
        torque: (17,) external torque estimate [N m]; NaN where it is unknown.
        torque_std: (17,) its standard deviation [N m]; NaN where it is unknown.
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
    """Plug-in on the tick of the controller. It has access to ticks only, not to the truth of a simulation."""

    @abstractmethod
    def step(self, tick: Tick) -> Observation:
        """Take in one tick; bounded time, never raises for bad sensor values."""

    @abstractmethod
    def reset(self) -> None:
        """Forget everything but the models."""

    @abstractmethod
    def describe(self) -> str:
        """Return one line: mode, models, thresholds."""

    def provenance(self) -> dict[str, str]:
        """Return what a log must have to compute the results again: values by name, as text."""
        return {}


MIN_OBSERVED_STIFFNESS = 0.99
"""Models are identified at full stiffness: a joint with less has another tracking error."""

MAX_PLAUSIBLE = 1e4
"""In SI units: larger commands and measurements are not valid."""


@dataclass(frozen=True, kw_only=True)
class HandLoad:
    """Load of a hand that no model knows.

    Attributes:
        mass: [kg]
        mass_std: Its standard deviation [kg].
    """

    mass: float
    mass_std: float


@dataclass(kw_only=True, slots=True)
class Residuals:
    """Residuals of one tick: arrays (n,), NaN where a joint is blind.

    It is not frozen: this takes less than half the time to make, in every tick.

    Attributes:
        expected: Expected tracking error [rad].
        raw: r before the filter [rad]; NaN only where this sample cannot be judged.
        residual: r, filtered [rad].
        threshold: Threshold of a contact [rad].
        torque: External torque [N m]; NaN where there is no estimate.
        torque_std: Its standard deviation [N m].
        friction_band: Largest error at which friction can hold a joint [rad]; 0 where it is unknown.
        blind: Joints that cannot be judged.
        doubtful: Joints at rest whose error is no touch.
        base_raw: Residual of the base before the filter, in units of its bound; NaN where it cannot be judged.
        base_residual: The same, filtered.
        base_drives: True while the base is commanded to drive, or has just been.
    """

    expected: FloatArray
    raw: FloatArray
    residual: FloatArray
    threshold: FloatArray
    torque: FloatArray
    torque_std: FloatArray
    friction_band: FloatArray
    blind: BoolArray
    doubtful: BoolArray
    base_raw: float = np.nan
    base_residual: float = np.nan
    base_drives: bool = False


class StaticGeneratorMixin:
    """Second half of a :class:`ResidualGenerator` that does not adapt to joints or loads."""

    no_model: BoolArray

    @property
    def worn(self) -> BoolArray:
        """(n,) False: wear is not estimated."""
        return np.zeros(len(self.no_model), dtype=np.bool_)

    @property
    def misses_inertial_unit(self) -> bool:
        """False: it is not used."""
        return False

    def learn(self, free: BoolArray, settled: BoolArray, untouched: bool) -> None:
        """Do nothing: the constants stay as they are."""


class ResidualGenerator(Protocol):
    """Stage that computes residuals from ticks.

    Attributes:
        no_model: (n,) joints without a model.
        bounds: (n,) largest identified threshold of each joint [rad], NaN without a model.
    """

    no_model: BoolArray
    bounds: FloatArray

    def step(self, tick: Tick) -> Residuals:
        """Take in one tick; never raises for bad sensor values."""
        ...

    @property
    def worn(self) -> BoolArray:
        """(n,) joints that this session shows to be worn since their identification."""
        ...

    @property
    def misses_inertial_unit(self) -> bool:
        """True while the inertial unit, which it uses, gives no values or always the same."""
        ...

    def learn(self, free: BoolArray, settled: BoolArray, untouched: bool) -> None:
        """Learn from the tick of the last :meth:`step`, once its events are known.

        Args:
            free: (n,) joints without touch now and shortly before.
            settled: (n,) joints whose contact ended in this tick.
            untouched: True if no part of the robot is touched now or was shortly before.
        """
        ...

    def reset(self) -> None:
        """Forget everything but the models."""
        ...
