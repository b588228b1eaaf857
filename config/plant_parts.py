"""Parts of a simulated Pepper, as typed objects: physics, boards, transport, supply, heat, wheels, drives, body."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.loading import STRICT
from pepper_driver.config.parts import NonNegative, Positive, Vector3

Origin = Literal["documented", "computed", "calibrated", "assumed"]

MAX_TICKS = 20
"""Longest delay, and most late samples in a row."""

Ticks = Annotated[int, Field(ge=0, le=MAX_TICKS)]
Probability = Annotated[float, Field(ge=0, lt=1)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Physics:
    """Integration of the equations of motion.

    ``timestep`` [s] divides the 12 ms cycle; the mechanical stops lie ``stop_margin`` [rad] beyond the limits.
    """

    timestep: Annotated[float, Field(gt=0, le=0.002)]
    stop_margin: NonNegative


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Board:
    """Motor board: its law runs once a physics step on its own encoder.

    ``voltage`` [V] of the supply at which the gains hold: the board sets a duty cycle, so a fuller battery makes it
    stiffer. ``derivative_time`` [s] is the time constant of the low-pass on the derivative of the error;
    ``integral_limit`` [V] bounds the integral part, which stands still at errors below ``integral_band`` [rad];
    ``brakes`` names the joints that hold when their stiffness is 0.
    """

    voltage: Positive
    encoder_bits: Annotated[int, Field(ge=8, le=24)]
    derivative_time: Positive
    integral_limit: Positive
    integral_band: NonNegative
    brakes: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Targets:
    """Way of a command to the boards: their targets may run after it slowly, and be off from it at rest.

    ``speed_limit`` [rad/s] bounds how fast a target runs (null: not at all). A chase lasts from when the first target
    falls behind its command until none is; with probability ``fast_chases`` the targets of ``fast_joints`` run twice as
    fast in it. ``wander_time`` [s] is the time constant with which targets wander (:attr:`Actuator.wander`);
    ``stray`` [rad] are the smallest and the largest drift at rest (:attr:`Actuator.strays`), small ones more often.
    """

    speed_limit: Positive | None
    fast_chases: Probability
    fast_joints: tuple[str, ...]
    wander_time: Positive
    stray: tuple[Positive, Positive]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Transport:
    """Delays between the physics and the reader, in ticks, and noise as standard deviations.

    A command acts ``command_delay`` ticks late, a sample of encoders and currents arrives ``sensor_delay`` ticks late.
    With probability ``late`` an encoder's is later still: the one before is read again, up to ``longest_late`` ticks in
    a row. With probability ``lost`` a joint's board brings none: the position before is read as if it were new.
    ``encoder_noise`` [rad], ``current_noise`` [A]; ``current_time`` [s] is the time constant of the current's low-pass.
    """

    command_delay: Ticks
    sensor_delay: Ticks
    late: Probability
    longest_late: Ticks
    lost: Probability
    encoder_noise: NonNegative
    current_noise: NonNegative
    current_time: Positive


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Battery:
    """Supply of all motors: open voltage falls in a line from ``full_voltage`` to ``empty_voltage`` [V].

    ``charge`` 0..1 at the start, ``resistance`` [ohm] inside, ``energy`` [J] when full, ``idle_power`` [W] of
    everything that is not a motor.
    """

    charge: Annotated[float, Field(gt=0, le=1)]
    full_voltage: Positive
    empty_voltage: Positive
    resistance: NonNegative
    energy: Positive
    idle_power: NonNegative


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Heat:
    """Motors warm with their losses; copper, magnets and grease change with it.

    Temperatures in deg C: of the air (``ambient``), of the motors at the ``start``, and the ``reference`` at which all
    other values of the plant hold. ``rise`` [K/W] by motor type, ``time_constant`` [s]. Per kelvin above the
    reference: ``copper`` of the resistance, ``magnet`` of the torque constant, ``grease`` of the friction.
    """

    ambient: float
    start: float
    reference: float
    time_constant: Positive
    rise: dict[str, NonNegative]
    copper: float
    magnet: float
    grease: float


@dataclass(frozen=True, kw_only=True, config=STRICT)
class WheelDrive:
    """Drive of the three wheels, and what they stand on.

    Speed control with ``gain`` [N m s/rad] and ``integral_time`` [s], bounded by ``torque_limit`` [N m];
    ``friction`` [N m] of motor and gear, at the wheel. ``floor_friction`` is the friction coefficient along the driven
    direction; along the other one the rollers turn freely.
    """

    gain: Positive
    integral_time: Positive
    torque_limit: Positive
    friction: NonNegative
    floor_friction: NonNegative


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Flexibility:
    """A spring in series with a joint, beyond its encoder: it is not measured.

    ``axis`` is in the frame of the link that the joint carries; ``stiffness`` [N m/rad], ``damping`` [N m s/rad].
    ``inertia`` [kg m2] is that of the parts between gear and spring; along the joint's own axis there must be some.
    """

    joint: str
    axis: Vector3
    stiffness: Positive
    damping: NonNegative
    inertia: NonNegative


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Payload:
    """A ball of ``mass`` [kg] and ``radius`` [m] fixed to a link at ``xyz`` [m]."""

    link: str
    mass: Positive
    radius: Positive
    xyz: Vector3


@dataclass(frozen=True, kw_only=True, config=STRICT)
class BodyParameters:
    """Differences between the links and the URDF, which the controller does not know.

    ``masses`` are factors on mass and inertia by link, ``coms`` shifts of centres of mass [m].
    """

    masses: dict[str, Positive]
    coms: dict[str, Vector3]
    payloads: tuple[Payload, ...]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TouchingFriction:
    """Friction while the teeth touch (Eq. 7, second case), of the motor's side and of the link's.

    Coulomb [N m] and ``viscous`` [N m s/rad], seen at the joint.
    """

    motor: NonNegative
    motor_viscous: NonNegative
    link: NonNegative
    link_viscous: NonNegative


@dataclass(frozen=True, kw_only=True, config=STRICT)
class GapFriction(TouchingFriction):
    """Friction inside the gap (Eq. 7, first case): as outside, and ``relative`` between the two sides."""

    relative: NonNegative
    relative_viscous: NonNegative


@dataclass(frozen=True, kw_only=True, config=STRICT)
class FrictionParameters:
    """Friction of one drive.

    ``breakaway`` is static over Coulomb friction, falling off over ``stribeck_velocity`` [rad/s]; ``load`` is the
    fraction of the torque through the teeth that adds to the motor's Coulomb friction; ``ripple`` the fraction by which
    that swells and shrinks ``ripple_count`` times a turn of the joint.
    """

    contact: TouchingFriction
    gap: GapFriction
    breakaway: Annotated[float, Field(ge=1)]
    stribeck_velocity: Positive
    load: Annotated[float, Field(ge=0, lt=1)]
    ripple: Annotated[float, Field(ge=0, lt=1)]
    ripple_count: NonNegative


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Actuator:
    """Drive of one or several joints, seen at the joint unless said otherwise.

    ``kp`` [V/rad], ``ki`` [V/(rad s)], ``kd`` [V s/rad] board gains; the board takes an error within ``dead_band``
    [rad] for none; ``current_limit`` [A] at stiffness 1; ``wander`` [rad] is the standard deviation by which its target
    wanders, ``strays`` the fraction of rests at which it drifts off the command; ``efficiency`` is the fraction of the
    motor's torque that reaches the joint; ``half_gap`` [rad] half the backlash;
    ``gear_stiffness`` [N m/rad] and ``gear_damping`` [N m s/rad] of teeth in contact; ``motor_damping``
    [N m s/rad] at the shaft. ``origin`` says where each value comes from.
    """

    joints: tuple[str, ...]
    # Eq. 1 of the paper: u = Kp eps + Kd d(eps)/dt; the integral part is not in it.
    kp: Positive
    ki: NonNegative
    kd: NonNegative
    # In recordings the wrist holds without current, which needs a dead band.
    dead_band: NonNegative
    # The stiffness of a command scales it: at stiffness 0 the motor turns freely.
    current_limit: Positive
    # In recordings currents creep at rest, and some rests are degrees off without a current that works against it.
    wander: NonNegative
    strays: Probability
    # In recordings gravity takes twice the current that torque constant and masses say.
    efficiency: Annotated[float, Field(gt=0, le=1)]
    # Eq. 5 to 8: the teeth are a spring and damper outside this gap, and have no effect inside.
    half_gap: NonNegative
    gear_stiffness: Positive
    gear_damping: NonNegative
    motor_damping: NonNegative
    friction: FrictionParameters
    origin: dict[Origin, tuple[str, ...]]
