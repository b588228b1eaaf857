r"""Stick-slip model: expected tracking error with the memory of friction, Eq. 7 and Eq. 11 of the paper in time.

Eq. 12 maps the desired motion of one instant to the expected error. The error of a joint also depends on its path:
friction holds it on either side of its target. This model is a joint in time, driven by the command and the desired
load, but never by a measurement. All its torques are divided by the stiffness K = Kp N Kt / R, so that they are angles:

    J dv/dt = (x - q) + I - d v - friction - g tau_ld - offset,      dI/dt = ki (x - q)

with x the position sent and friction of size F + load_friction |g tau_ld + offset|, ``breakaway`` times that at rest.
The step is implicit in velocity and friction (time stepping of Moreau): it sticks exactly, and is stable for any step.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields
from typing import ClassVar, Self

import numpy as np
from pydantic import ConfigDict

from pepper_driver.config import PepperError
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.loading import STRICT


class StickSlipError(PepperError, ValueError):
    """Invalid parameters of a stick-slip model."""


@dataclass(frozen=True, kw_only=True)
class StickSlipParameters:
    """Lumped constants of one joint. Torques are divided by its stiffness K, so they are angles.

    Attributes:
        inertia: J / K of rotor and gear [s2].
        lag: d / K, back-EMF and viscous friction [s].
        friction: F / K [rad].
        load_friction: Fraction of the load, as an angle, that adds to the friction.
        breakaway: Friction at rest over friction in motion, 1 or more.
        load_gain: g = 1 / K [rad/(N m)], above 0.
        offset: Constant part of the load [rad].
        dead_band: Error that the motor board ignores [rad].
        integral_rate: ki / kp of the motor board [1/s].
        transport: Ticks by which the response is later than the backend reports, earlier if negative; -1 to 2.
    """

    # For reading from files: strict types, no unknown key.
    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    inertia: float
    lag: float
    friction: float
    load_friction: float
    breakaway: float
    load_gain: float
    offset: float
    dead_band: float
    integral_rate: float
    transport: float

    def __post_init__(self) -> None:
        if not np.isfinite(astuple(self)).all():
            raise StickSlipError("a parameter is not finite")
        for name in ("inertia", "lag", "friction", "load_friction", "dead_band", "integral_rate"):
            if getattr(self, name) < 0.0:
                raise StickSlipError(f"'{name}' is negative")
        if self.load_gain <= 0.0 or self.breakaway < 1.0 or not -1.0 <= self.transport <= 2.0:
            raise StickSlipError("load_gain above 0, breakaway of 1 or more, transport of -1 to 2")

    @property
    def stiffness(self) -> float:
        """K = 1 / g [N m/rad]."""
        return 1.0 / self.load_gain


PARAMETERS = tuple(field.name for field in fields(StickSlipParameters))


class StickSlipModel:
    """Stick-slip models of several joints; arrays broadcast against the shape of the inputs.

    Args:
        parameters: By name of :class:`StickSlipParameters`, arrays of one shape, NaN for a joint without a model.
        cycle: Period of the ticks [s].

    Attributes:
        position: Positions of the models [rad].
        velocity: [rad/s]
        integral: I of their motor boards [rad].
        friction: Friction on them, positive against positive motion [rad].
    """

    def __init__(self, parameters: dict[str, FloatArray], cycle: float) -> None:
        self._cycle = cycle
        self.set(parameters)

    @classmethod
    def from_parameters(cls, models: list[StickSlipParameters | None], cycle: float) -> Self:
        """Return the models of joints, NaN for those without parameters."""
        return cls(
            {
                name: np.array([np.nan if m is None else getattr(m, name) for m in models])
                for name in PARAMETERS
            },
            cycle,
        )

    def set(self, parameters: dict[str, FloatArray]) -> None:
        """Set other constants from the next step on."""
        self._p = parameters
        self._momentum = parameters["inertia"] / self._cycle
        self._gain = 1.0 / (self._momentum + parameters["lag"] + self._cycle)
        late = parameters["transport"]
        self._first, self._second = np.minimum(late, 1.0), np.maximum(late - 1.0, 0.0)
        self._has_dead_band = bool((parameters["dead_band"] > 0.0).any())
        self._has_integral = bool((parameters["integral_rate"] > 0.0).any())

    def start(self, position: FloatArray, target: FloatArray) -> None:
        """Start at rest at ``position`` [rad] with the command ``target`` [rad]."""
        self.position = np.array(position)
        self.velocity = np.zeros_like(self.position)
        self.integral = np.zeros_like(self.position)
        self.friction = np.zeros_like(self.position)
        self._sticks = np.ones(self.position.shape, dtype=np.bool_)
        # Before the start the command is taken as constant.
        self._targets = (target, target, target)

    def step(self, target: FloatArray, load_torque: FloatArray) -> FloatArray:
        """Step by one tick: position sent [rad], desired load torque [N m]; return the model positions [rad]."""
        p, dt = self._p, self._cycle
        target = self._delayed(target)
        load = p["load_gain"] * load_torque + p["offset"]
        pull = target - self.position
        push = self._momentum * self.velocity - load
        if self._has_integral:
            push = push + self.integral
        # Implicit in the velocity: the friction of this step is the one that acts at its end.
        drive = push + self._beyond_dead_band(pull)
        friction = p["friction"] + p["load_friction"] * np.abs(load)
        # A joint at rest starts only beyond its break-away friction.
        moves = np.abs(drive) > np.where(self._sticks, friction * p["breakaway"], friction)
        signed = np.copysign(friction, drive)
        self.friction = np.where(moves, signed, drive)
        velocity = (push + pull - signed) * self._gain
        if self._has_dead_band:
            velocity = self._within_dead_band(velocity, push - signed, drive)
        self.velocity = np.where(moves, velocity, 0.0)
        self._sticks = ~moves
        self.position = self.position + dt * self.velocity
        if self._has_integral:
            left = self._beyond_dead_band(target - self.position)
            self.integral = self.integral + p["integral_rate"] * dt * left
        return self.position

    def beyond_friction(self, error: FloatArray, load: FloatArray) -> FloatArray:
        """Return the part of the error of joints at rest that their friction cannot hold under a load, all [rad].

        The integrals of the motor boards are taken as zero.
        """
        p = self._p
        drive = self._beyond_dead_band(error) - load
        held = p["breakaway"] * (p["friction"] + p["load_friction"] * np.abs(load))
        return drive - np.minimum(np.maximum(drive, -held), held)

    def put(
        self, where: BoolArray, position: FloatArray, velocity: FloatArray, integral: FloatArray
    ) -> None:
        """Set ``position`` [rad], ``velocity`` [rad/s] and ``integral`` [rad] of the joints ``where``."""
        self.position = np.where(where, position, self.position)
        self.velocity = np.where(where, velocity, self.velocity)
        self.integral = np.where(where, integral, self.integral)
        self._sticks = np.where(where, velocity == 0.0, self._sticks)

    def _beyond_dead_band(self, error: FloatArray) -> FloatArray:
        if not self._has_dead_band:
            return error
        band = self._p["dead_band"]
        return error - np.minimum(np.maximum(error, -band), band)

    def _within_dead_band(
        self, velocity: FloatArray, push: FloatArray, drive: FloatArray
    ) -> FloatArray:
        """Return the velocity if the dead band applies to the error after the step."""
        p = self._p
        alone = push / np.maximum(self._momentum + p["lag"], 1e-9)
        band = p["dead_band"] * self._gain
        pulled = np.maximum(velocity - band - alone, 0.0) + np.minimum(velocity + band - alone, 0.0)
        velocity = alone + pulled
        # The dead band may end the motion, but not reverse it.
        return np.where(velocity * drive > 0.0, velocity, 0.0)

    def _delayed(self, target: FloatArray) -> FloatArray:
        """Return the target at the time of the response: interpolated, or extrapolated from the last two ticks."""
        # A response that is earlier than reported belongs to a target that was not sent yet.
        _, before, now = self._targets = (*self._targets[1:], target)
        older = self._targets[0]
        delayed: FloatArray = now + self._first * (before - now) + self._second * (older - before)
        return delayed
