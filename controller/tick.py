"""One tick: measurement, reference of the controller, and the command that was sent."""

from __future__ import annotations

from dataclasses import dataclass

from pepper_driver.backends.fields import Command, Measurement
from pepper_driver.config.arrays import BoolArray, FloatArray


@dataclass(frozen=True, kw_only=True, slots=True)
class Reference:
    """Desired state at the end of a cycle; all fields belong to that one instant.

    Attributes:
        position: (17,) q_d [rad].
        velocity: (17,) [rad/s].
        acceleration: (17,) [rad/s2], constant over the cycle.
        load_torque: (17,) tau_ld [N m], Eq. 11 of the paper: inverse dynamics of (position, velocity, acceleration).
            Its parts are ``WholeBodyController.load_torque_parts``.
        base_twist: (3,) vx [m/s], vy [m/s], wz [rad/s] of base_link in its own axes.
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    load_torque: FloatArray
    base_twist: FloatArray


@dataclass(frozen=True, kw_only=True, slots=True)
class SentCommand:
    """Command as it was sent.

    Attributes:
        reference: Reference of the controller for the command.
        sent: Command after the safety gate.
        limited: (17,) where the safety gate altered the position, so that ``sent`` differs from ``reference``.
    """

    reference: Reference
    sent: Command
    limited: BoolArray


@dataclass(frozen=True, kw_only=True, slots=True)
class Tick(SentCommand):
    """One cycle: a command as it was sent, and the measurement that answers it.

    Its attributes are never changed, and none gives access to the truth of a simulation.

    Attributes:
        measurement: Measurement of the robot.
    """

    measurement: Measurement
