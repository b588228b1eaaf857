"""External torque of the joints by the residuals of mode ``fusion``, and how well it is known."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import Matrix, Out, Records, kernel, make_records
from pepper_driver.observer.constants import QUIET_RATIO
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.stick_slip import stick_slip_constants

DAHL_DISTANCE = 0.003
"""[rad] of motion within which friction reverses."""

SLIDING_DOUBT = 0.25
"""Standard deviation of the friction of a joint in motion, over the friction: between two directions it is unknown."""

RESTING_DOUBT = 0.5
"""The same of a joint that was to rest, and that a push has moved."""

HIDING_DOUBT = 1.0
"""The same of one that it has not moved: friction may hide a torque up to twice itself, in either direction."""

TORQUE_DOUBT = 0.1
"""Standard deviation of a torque over its size: the friction of gears grows with it."""

SPREAD_STDS = 3.0
"""Standard deviations in a spread: 2.6 of a residual that is normal, 3.3 of one with an exponential tail."""


class TorqueState:
    """External torque estimate of one joint.

    Attributes:
        stiffness: K [N m/rad], NaN for a joint without a model.
        friction: F / K [rad].
        spread: Standard deviation of the residual in free motion [rad].
        offset: Constant part of the load [rad].
        held: Friction at rest / K without load [rad].
        held_per_load: Its increase with the size of the load [rad/rad].
        torque_per_ampere: Motor torque / K per current [rad/A]; 0 where the current does not show it.
        motor_torque: Largest that the motor can give [N m].
        slip: Friction that acts by the measured motion [rad].
        position: In the last tick [rad].
    """

    stiffness: float
    friction: float
    spread: float
    offset: float
    held: float
    held_per_load: float
    torque_per_ampere: float
    motor_torque: float
    slip: float
    position: float


@kernel
def _bounded_torque(
    states: Records[TorqueState], j: int, torque: float, load_torque: float, current: float
) -> float:
    """Return the external torque [N m], at most as large as motor, friction and load [N m] can oppose."""
    state = states[j]
    motor = state.motor_torque
    if state.torque_per_ampere > 0.0:
        motor = min(motor, state.stiffness * state.torque_per_ampere * current)
    load = load_torque + state.stiffness * state.offset
    opposed = motor + state.stiffness * state.held + state.held_per_load * abs(load)
    # Never further from 0: a current that does not carry the load is no evidence of a hand.
    return min(max(torque, min(load - opposed, 0.0)), max(load + opposed, 0.0))


@kernel
def estimate_torque(
    states: Out[Records[TorqueState]],
    currents: Out[Matrix[FloatArray]],
    count: int,
    j: int,
    by_model: float,
    by_current: float,
    friction: float,
    threshold: float,
    position: float,
    moving: bool,
    load_torque: float,
    current: float,
) -> tuple[float, float]:
    """Take in the tick number ``count`` of a joint; return its external torque and standard deviation [N m].

    Args:
        states: Of the joints.
        currents: (n, window) of the last ticks [A].
        count: Number of the tick.
        j: Index of the joint.
        by_model: Residual by the model [rad].
        by_current: Residual by the current [rad].
        friction: Of the joint without touch, over K [rad].
        threshold: Of a contact [rad].
        position: Measured [rad].
        moving: True if it slides without touch, or did just before.
        load_torque: Desired [N m].
        current: Measured, without its sign [A].
    """
    state, ring, residual = states[j], currents[j], 0.0
    ring[count % len(ring)] = current
    if not math.isfinite(state.position):
        state.slip, state.position = friction, position
    slip = state.slip + (position - state.position) * (state.friction / DAHL_DISTANCE)
    state.slip = min(max(slip, -state.friction), state.friction)
    state.position = position
    # A board at its limit, or one that sums up errors, does not hold what its law says: the current shows it.
    if by_model * by_current > 0.0:
        limited = min(abs(by_model), 2.0 * abs(by_current))
        residual = 0.5 * (by_current + math.copysign(limited, by_current))
    reversed_part, doubt = 0.0, SLIDING_DOUBT
    if not moving:
        doubt = HIDING_DOUBT
        if abs(residual) > QUIET_RATIO * threshold:
            doubt, reversed_part = RESTING_DOUBT, state.slip - friction
    estimate = state.stiffness * (reversed_part - residual)
    # The residual is filtered: the current that belongs to it may be over.
    torque = _bounded_torque(states, j, estimate, load_torque, np.max(ring))
    measured = math.hypot(state.spread, by_current - residual)
    unknown = math.hypot(doubt * state.friction, TORQUE_DOUBT * torque / state.stiffness)
    return torque, state.stiffness * math.hypot(measured, unknown)


class TorqueEstimate:
    """External torque tau_ext = -K r, and of a joint at rest the friction that the push has reversed.

    r is the mean of both channels, and 0 where they contradict each other; that of the model counts at most twice that
    of the current. A push that moves a joint at rest also reverses its friction, which then acts against the push
    (Dahl's model, on the measured motion). A joint that moves goes on sliding: there the friction stays as expected.

    -K r is the torque that a board without limits would have given. Once a motor board gives no more, the joint is
    moved by any torque beyond it, and r no longer shows how large this is. The estimate is therefore at most what can
    oppose a hand: the torque of the motor, friction, and the load. The current shows the torque of the motor, where
    identification found that it does; in any case it is at most the documented one.

    The standard deviation has the spread of r in free motion, its difference from the current's, friction, and
    TORQUE_DOUBT; not that of the scale K.

    Args:
        models: By joint, None for those without.
        window: Samples of the median of the residual.
        stiffness: (n,) K [N m/rad], NaN without a model.
        spread: (n,) standard deviation of the residual in free motion [rad].
        motor_torque: (n,) largest torque of the motors, at the joints [N m]; infinite where it is unknown.

    Attributes:
        states: Of the joints, for :func:`estimate_torque`.
        currents: (n, window) of the last ticks [A].
        count: Number of ticks so far.
    """

    def __init__(
        self,
        models: Sequence[FusionModel | None],
        *,
        window: int,
        stiffness: FloatArray,
        spread: FloatArray,
        motor_torque: FloatArray | float = math.inf,
    ) -> None:
        twins = stick_slip_constants([None if m is None else m.twin for m in models])
        self.states = make_records(
            TorqueState,
            len(models),
            stiffness=stiffness,
            friction=twins["friction"],
            spread=spread,
            offset=twins["offset"],
            held=twins["breakaway"] * twins["friction"],
            held_per_load=twins["breakaway"] * twins["load_friction"],
            torque_per_ampere=[
                0.0 if m is None or m.momentum.source != "current" else m.momentum.torque_per_ampere
                for m in models
            ],
            motor_torque=motor_torque,
        )
        self.currents = np.zeros((len(models), window))
        self.reset()

    def reset(self) -> None:
        """Forget the previous ticks."""
        self.states["slip"], self.states["position"] = 0.0, np.nan
        self.currents[:], self.count = 0.0, 0
