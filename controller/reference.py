"""What the controller wants at the end of one cycle."""

from __future__ import annotations

from dataclasses import dataclass

from pepper_driver.config.arrays import FloatArray


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
