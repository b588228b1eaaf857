r"""Stick-slip model: expected tracking error with the memory of friction, Eq. 7 and Eq. 11 of the paper in time.

Eq. 12 maps the desired motion of one instant to the expected error. The error of a joint also depends on its path:
friction holds it on either side of its target. This model is a joint in time, driven by the command and the desired
load, but never by a measurement. All its torques are divided by the stiffness K = Kp N Kt / R, so that they are angles:

    J dv/dt = (x - q) + I - d v - friction - g tau_ld - offset,      dI/dt = ki (x - q)

with x the position sent and friction of size F + load_friction |g tau_ld + offset|, ``breakaway`` times that at rest.
The step is implicit in velocity and friction (time stepping of Moreau): it sticks exactly, and is stable for any step.
Boards that limit the speed of their targets follow the command with that speed: x is then the limited target.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from typing import ClassVar, Self

import numpy as np
from pydantic import ConfigDict

from pepper_driver.config import PepperError
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import Out, Records, Strided, kernel, make_records
from pepper_driver.config.loading import STRICT

MIN_TRANSPORT, MAX_TRANSPORT = -3.0, 2.0
"""[ticks] A board with a derivative of time T on its error answers as if the command came T earlier, with a lag that
is T longer: its part of the command extrapolates it. 18 ms are one tick and a half."""


WEAK_GAIN = 0.1
"""[rad/(N m)] 1 / K of a joint as weak as a wrist or a hand. Too little is known of its load to show K, or friction by
load: a hand has its centre of mass a millimetre from the axis. At rest its current is lost in noise and dead band."""

NO_LIMIT = 1e3
"""[rad/s] Target speed of a board that follows every command at once."""


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
        transport: Ticks by which the response is later than the backend reports, earlier if negative; MIN_TRANSPORT to
            MAX_TRANSPORT.
        target_speed: Largest speed at which the board lets its target run [rad/s]; NO_LIMIT without such a limit.
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
    target_speed: float = NO_LIMIT

    def __post_init__(self) -> None:
        if not np.isfinite(astuple(self)).all():
            raise StickSlipError("a parameter is not finite")
        for name in ("inertia", "lag", "friction", "load_friction", "dead_band", "integral_rate"):
            if getattr(self, name) < 0.0:
                raise StickSlipError(f"'{name}' is negative")
        if self.load_gain <= 0.0 or self.breakaway < 1.0:
            raise StickSlipError("load_gain above 0, breakaway of 1 or more")
        if self.target_speed <= 0.0:
            raise StickSlipError("target_speed above 0")
        if not MIN_TRANSPORT <= self.transport <= MAX_TRANSPORT:
            raise StickSlipError(f"transport of {MIN_TRANSPORT:g} to {MAX_TRANSPORT:g}")

    @property
    def stiffness(self) -> float:
        """K = 1 / g [N m/rad]."""
        return 1.0 / self.load_gain

    @property
    def settling_time(self) -> float:
        """Time in which the swing of the joint around its target decays to 5 %, without friction [s].

        By the poles of Eq. 11 with the integral: J s3 + d s2 + s + ki = 0. 0 for a joint that does not swing, infinite
        for one whose swing does not decay.
        """
        poles = np.roots([self.inertia, self.lag, 1.0, self.integral_rate])
        decay = -poles[np.iscomplex(poles)].real
        if not len(decay):
            return 0.0
        return math.log(20.0) / min(decay) if min(decay) > 0.0 else math.inf


PARAMETERS = tuple(field.name for field in fields(StickSlipParameters))


class StickSlipState:
    """State of the model of one joint.

    Attributes:
        position: [rad]
        velocity: [rad/s]; 0 while it sticks.
        integral: I of the motor board [rad].
        friction: Friction on the joint, positive against positive motion [rad].
        sticks: True while friction holds it.
        target: Target of the board in the last tick: the position sent, behind it where its speed is limited [rad].
        target_before: The same in the tick before that [rad].
    """

    position: float
    velocity: float
    integral: float
    friction: float
    sticks: bool
    target: float
    target_before: float


@kernel
def beyond(error: float, band: float) -> float:
    """Return the part of an error beyond a band around 0."""
    return error - min(max(error, -band), band)


@kernel
def step_stick_slip(
    constants: Records[StickSlipParameters],
    i: int,
    states: Out[Records[StickSlipState]],
    j: int,
    sent: float,
    load_torque: float,
    cycle: float,
) -> None:
    """Step the state ``j`` by one tick with the constants ``i``: position sent [rad], desired load torque [N m]."""
    p, state = constants[i], states[j]
    before, older = state.target, state.target_before
    reach = p.target_speed * cycle
    limited = before + min(max(sent - before, -reach), reach)
    # The target at the time of the response, between two ticks. A response that is earlier than reported belongs to a
    # target that was not sent yet, or to a board with a derivative: the target is extrapolated.
    target = limited + min(p.transport, 1.0) * (before - limited)
    target += max(p.transport - 1.0, 0.0) * (older - before)
    state.target, state.target_before = limited, before

    momentum = p.inertia / cycle
    gain = 1.0 / (momentum + p.lag + cycle)
    load = p.load_gain * load_torque + p.offset
    pull = target - state.position
    push = momentum * state.velocity - load + state.integral
    drive = push + beyond(pull, p.dead_band)
    friction = p.friction + p.load_friction * abs(load)
    # A joint at rest starts only beyond its break-away friction.
    state.sticks = not abs(drive) > (friction * p.breakaway if state.sticks else friction)
    if state.sticks:
        state.friction, state.velocity = drive, 0.0
    else:
        # Implicit in the velocity: the friction of this step is the one that acts at its end.
        signed = math.copysign(friction, drive)
        velocity = (push + pull - signed) * gain
        if p.dead_band > 0.0:
            # The dead band applies to the error after the step. It may end the motion, but not reverse it.
            alone = (push - signed) / max(momentum + p.lag, 1e-9)
            band = p.dead_band * gain
            pulled = max(velocity - band - alone, 0.0) + min(velocity + band - alone, 0.0)
            velocity = alone + pulled
            velocity = velocity if velocity * drive > 0.0 else 0.0
        state.friction, state.velocity = signed, velocity
    state.position += cycle * state.velocity
    state.integral += p.integral_rate * cycle * beyond(target - state.position, p.dead_band)


@kernel
def _step(
    constants: Records[StickSlipParameters],
    states: Out[Records[StickSlipState]],
    target: Strided[FloatArray],
    load_torque: Strided[FloatArray],
    cycle: float,
) -> None:
    for j in range(len(target)):
        step_stick_slip(constants, j, states, j, target[j], load_torque[j], cycle)


@kernel
def _play(
    constants: Records[StickSlipParameters],
    j: int,
    target: FloatArray,
    load_torque: FloatArray,
    cycle: float,
    history: Out[Records[StickSlipState]],
) -> None:
    for k in range(len(target)):
        if k > 0:
            history[k] = history[k - 1]
        step_stick_slip(constants, j, history, k, target[k], load_torque[k], cycle)


@kernel
def _put(
    states: Out[Records[StickSlipState]],
    where: BoolArray,
    position: FloatArray,
    velocity: FloatArray,
    integral: FloatArray,
) -> None:
    for j in range(len(where)):
        if where[j]:
            state = states[j]
            state.position, state.velocity = position[j], velocity[j]
            state.integral = integral[j]
            state.sticks = velocity[j] == 0.0


class StickSlipModel:
    """Stick-slip models of several joints.

    Args:
        constants: Of each joint, NaN for one without a model.
        cycle: Period of the ticks [s].

    Attributes:
        constants: The same.
        states: States after the last step.
    """

    def __init__(self, constants: Records[StickSlipParameters], cycle: float) -> None:
        self._cycle = cycle
        self.constants = constants
        self.states = make_records(StickSlipState, len(constants))
        self._step = _step.load_unchecked()
        self._play, self._put = _play.load(), _put.load()

    @classmethod
    def from_parameters(cls, models: Sequence[StickSlipParameters | None], cycle: float) -> Self:
        """Return the models of joints, NaN for those without parameters."""
        return cls(stick_slip_constants(models), cycle)

    def start(self, position: FloatArray, target: FloatArray) -> None:
        """Start at rest at (n,) ``position`` [rad] with the command (n,) ``target`` [rad]."""
        self.states = _start(len(self.constants), position, target)

    def step(self, target: FloatArray, load_torque: FloatArray) -> Records[StickSlipState]:
        """Step by one tick; return a copy of the (n,) states.

        Args:
            target: (n,) positions sent [rad].
            load_torque: (n,) desired [N m].
        """
        self._step(self.constants, self.states, target, load_torque, self._cycle)
        return self.states.copy()

    def play(
        self, joint: int, position: float, target: FloatArray, load_torque: FloatArray
    ) -> Records[StickSlipState]:
        """Play a run of one joint from its beginning, apart from ``states``; return its (n,) states after each tick.

        Args:
            joint: Index of its constants.
            position: Where it starts at rest [rad].
            target: (n,) positions sent [rad].
            load_torque: (n,) desired [N m].
        """
        # The kernel continues from the state of the first tick.
        history = _start(len(target), position, target[0])
        columns = np.ascontiguousarray(target), np.ascontiguousarray(load_torque)
        self._play(self.constants, joint, *columns, self._cycle, history)
        return history

    def put(
        self, where: BoolArray, position: FloatArray, velocity: FloatArray, integral: FloatArray
    ) -> None:
        """Set ``position`` [rad], ``velocity`` [rad/s] and ``integral`` [rad] of the joints ``where``, all (n,)."""
        self._put(self.states, where, position, velocity, integral)


def _start(
    count: int, position: FloatArray | float, target: FloatArray | float
) -> Records[StickSlipState]:
    """Return states at rest. Before the start the command is taken as constant."""
    return make_records(
        StickSlipState,
        count,
        position=position,
        sticks=True,
        target=target,
        target_before=target,
    )


def stick_slip_constants(
    models: Sequence[StickSlipParameters | None],
) -> Records[StickSlipParameters]:
    """Return the constants of joints, NaN for those without parameters."""
    return make_records(
        StickSlipParameters,
        len(models),
        **{
            name: [np.nan if m is None else getattr(m, name) for m in models] for name in PARAMETERS
        },
    )
