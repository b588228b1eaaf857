r"""The momentum channel: Eq. 10 solved for the external torque, with lumped constants of one joint.

What the motor gives, minus what motion, friction and load take, is what something else adds. All torques are divided by
the joint's stiffness K, so that the result is an angle and comparable with r = eps - eps_exp of Eq. 13:

    r = motor - (J a + friction + g tau_ld + offset)

The motor's torque comes from the board's absolute current, or, where that tells less, from its law: eps + I - d v.
Velocity and acceleration are the desired ones minus smoothed derivatives of the tracking error. The friction is the
twin's: a measured velocity near zero has no sign, and the twin knows how the joint came to rest.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import ClassVar, Literal

import numpy as np
from pydantic import ConfigDict

from pepper_driver.config import PepperError
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.loading import STRICT

MotorTorque = Literal["current", "voltage"]

SMOOTHING = 0.03
"""[s] Of the derivatives of the tracking error: an encoder step of 0.09 deg a tick is 0.13 rad/s."""


class MomentumError(PepperError, ValueError):
    """Parameters that make no momentum channel."""


@dataclass(frozen=True, kw_only=True)
class MomentumParameters:
    """One joint's constants.

    Attributes:
        source: Where the motor's torque comes from.
        torque_per_ampere: Motor torque / K per current [rad/A]; 0 where the source is the voltage.
        inertia: J / K [s2].
        lag: d / K [s]; back-EMF and viscous friction for the voltage, viscous friction for the current.
        offset: [rad]
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    source: MotorTorque
    torque_per_ampere: float
    inertia: float
    lag: float
    offset: float

    def __post_init__(self) -> None:
        if not np.isfinite(astuple(self)[1:]).all():
            raise MomentumError("a parameter is not finite")
        if self.source == "current" and self.torque_per_ampere <= 0.0:
            raise MomentumError("'torque_per_ampere' of a current must be above 0")


class ErrorDerivatives:
    """Smoothed first and second derivative of the tracking error, sample by sample.

    Args:
        cycle: Period of the ticks [s].
    """

    def __init__(self, cycle: float) -> None:
        self._gain = 1.0 - float(np.exp(-cycle / SMOOTHING))
        self._rate = self._gain / cycle
        self._error: FloatArray | None = None

    def step(self, error: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Take in one sample [rad]; returns its derivatives [rad/s], [rad/s2]."""
        if self._error is None:
            self._error, self._velocity = error.copy(), np.zeros_like(error)
        # Exact on a ramp.
        velocity = (error - self._error) * self._rate
        acceleration = (velocity - self._velocity) * self._rate
        self._error = self._error + self._gain * (error - self._error)
        self._velocity = self._velocity + self._gain * (velocity - self._velocity)
        return velocity, acceleration

    def put(self, where: BoolArray, error: FloatArray) -> None:
        """Start anew from ``error`` [rad], for the joints of ``where``."""
        if self._error is not None:
            self._error = np.where(where, error, self._error)
            self._velocity = np.where(where, 0.0, self._velocity)

    def reset(self) -> None:
        """Forget all samples."""
        self._error = None


class MomentumChannel:
    """The channel of several joints; NaN for those without parameters.

    Args:
        models: By joint.
        integrates: (n,) joints whose boards have an integral part: what these have summed up tells of the sign too.
    """

    def __init__(self, models: list[MomentumParameters | None], integrates: BoolArray) -> None:
        def each(name: str) -> FloatArray:
            return np.array([np.nan if m is None else getattr(m, name) for m in models])

        self._inertia, self._lag, self._offset = each("inertia"), each("lag"), each("offset")
        self._per_ampere = each("torque_per_ampere")
        self._integrates = integrates
        self._by_current = np.array([m is not None and m.source == "current" for m in models])

    def residual(
        self,
        *,
        current: FloatArray,
        drive: FloatArray,
        velocity: FloatArray,
        acceleration: FloatArray,
        resistance: FloatArray,
        twin_residual: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """External torque on the motor over K, with the sign of r.

        Args:
            current: Absolute [A].
            drive: What the board's law makes of the measured error: eps + I [rad].
            velocity: Of the joint, as measured [rad/s].
            acceleration: [rad/s2]
            resistance: Friction and load / K [rad].
            twin_residual: r as the twin sees it [rad], for the sign of the current.

        Returns:
            The residual [rad]; the motor's torque / K [rad].
        """
        needed = self._inertia * acceleration + self._lag * velocity + resistance + self._offset
        size = self._per_ampere * current
        # The board tells no sign: the one that is nearer to what the motor should be doing, and, where errors are
        # summed up, to what the board should be asking of it. Either alone is wrong for seconds at times.
        likely = needed + twin_residual + np.where(self._integrates, drive, 0.0)
        motor = np.where(self._by_current, np.copysign(size, likely), drive)
        return motor - needed, motor
