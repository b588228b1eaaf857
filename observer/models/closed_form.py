r"""Tracking error of a DC motor under a PD law in closed form: Eq. 10 and Eq. 11 of the paper.

For a joint behind a gear of ratio N, with voltage u = Kp eps + Kd deps/dt (Eq. 1), and with the inductance neglected
as in Eq. 9, the expected tracking error in free motion is

    eps + Kd/Kp deps/dt = R Jm N / (Kt Kp) qdd + (R/Kt mu + Ke) N/Kp qd + R / (Kt Kp N) (tau_ld + tau_f)

Differences from the printed equations, and what is neglected:

- Eq. 11 leaves out the 1/N of the load torque, although it has omega = N qd: tau_l of Eq. 5 acts on the motor's side
  of the gear, M(q) qdd + c of Eq. 6 on the joint's. With it, a load acts against the stiffness K = Kp N Kt / R.
- Eq. 8 prints the alpha of its two outer cases with swapped signs: the torque of the teeth would jump by 2 alpha at the
  edge of the gap. It is K (phi - alpha) for phi >= alpha, K (phi + alpha) for phi <= -alpha. Eq. 6 as printed also
  counts it twice: while the teeth touch, tau_B is the load torque. Here the gap is neglected: tau_B adds nothing.
- Friction is that of Eq. 7 outside the gap, on the joint, with a smooth sign; stiction, saturation, quantisation and
  the elasticity of the gear are neglected. The load at the true angle is taken as that at the desired angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pepper_driver.config.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class MotorParameters:
    """Motor, gear and PD law of one joint.

    Attributes:
        resistance: R [ohm].
        torque_constant: Kt [N m/A].
        speed_constant: Ke [V s/rad].
        rotor_inertia: Jm [kg m2].
        motor_damping: mu [N m s/rad], at the shaft of the motor.
        ratio: N, turns of the motor per turn of the joint.
        proportional_gain: Kp [V/rad], on the joint's error.
        derivative_gain: Kd [V s/rad].
        coulomb_friction: Friction of joint and gear, on the side of the joint [N m].
        viscous_friction: The same [N m s/rad].
        friction_velocity: Joint velocity below which the sign of Coulomb friction is smoothed [rad/s].
    """

    resistance: float
    torque_constant: float
    speed_constant: float
    rotor_inertia: float
    motor_damping: float
    ratio: float
    proportional_gain: float
    derivative_gain: float = 0.0
    coulomb_friction: float = 0.0
    viscous_friction: float = 0.0
    friction_velocity: float = 0.01

    @property
    def stiffness(self) -> float:
        """K = Kp N Kt / R [N m/rad]: load that makes one radian of error at rest."""
        return self.proportional_gain * self.ratio * self.torque_constant / self.resistance

    @property
    def lag(self) -> float:
        """Error per velocity of a motion without load and friction [s]: (R mu / Kt + Ke) N / Kp."""
        back_voltage = self.resistance * self.motor_damping / self.torque_constant
        return (back_voltage + self.speed_constant) * self.ratio / self.proportional_gain

    @property
    def derivative_time(self) -> float:
        """Kd / Kp [s]."""
        return self.derivative_gain / self.proportional_gain

    def free_torque(self, features: FloatArray) -> FloatArray:
        """Return (n,) torques at the joint [N m] that (n, 3) velocity, acceleration and load torque require.

        The right-hand side of Eq. 10 times N Kt / R, without tau_ext.
        """
        velocity, acceleration, load_torque = features.T
        friction = (
            self.coulomb_friction * np.tanh(velocity / self.friction_velocity)
            + self.viscous_friction * velocity
        )
        rotor = self.rotor_inertia * self.ratio**2 * acceleration
        torque: FloatArray = rotor + self.stiffness * self.lag * velocity + load_torque + friction
        return torque


def expected_error(
    parameters: MotorParameters, features: FloatArray, cycle: float, *, delay: int = 0
) -> FloatArray:
    """Compute the expected tracking error of one joint over a run: Eq. 11, with its derivative term integrated.

    The right-hand side is linear between ticks. At the first tick the error has settled.

    Args:
        parameters: Constants of the joint.
        features: (n, 3) desired velocity [rad/s], acceleration [rad/s2] and load torque [N m], as
            :meth:`pepper_driver.observer.recording.Recording.features` gives them.
        cycle: Period of the ticks [s].
        delay: Ticks by which the measurement is older than the command it is compared with. The command has then
            moved on: eps[k] = q_d[k] - q_d[k - delay] + eps_exp[k - delay].

    Returns:
        (n,) [rad].

    Raises:
        ValueError: A negative delay.
    """
    if delay < 0:
        raise ValueError(f"the delay must not be negative, got {delay}")
    settled = parameters.free_torque(features) / parameters.stiffness
    error = _lowpass(settled, parameters.derivative_time, cycle)
    if delay == 0 or not len(error):
        return error
    velocity = features[:, 0]
    # Acceleration is constant over a cycle: the trapezoid is exact.
    travel = np.concatenate(([0.0], np.cumsum((velocity[1:] + velocity[:-1]) / 2) * cycle))
    answered = np.maximum(np.arange(len(error)) - delay, 0)
    delayed: FloatArray = travel - travel[answered] + error[answered]
    return delayed


def _lowpass(signal: FloatArray, time_constant: float, cycle: float) -> FloatArray:
    """Return the (n,) exact response of y + T dy/dt = signal to a signal that is linear between ticks."""
    if time_constant <= 0.0 or len(signal) < 2:
        return signal.copy()
    decay = math.exp(-cycle / time_constant)
    # The exact solution is signal - T slope plus a difference that decays.
    lag = np.diff(signal) / cycle * time_constant
    response = signal.copy()
    value = float(signal[0])
    for k, (before, after, behind) in enumerate(
        zip(signal[:-1].tolist(), signal[1:].tolist(), lag.tolist(), strict=True), start=1
    ):
        value = after - behind + (value - before + behind) * decay
        response[k] = value
    return response


def external_torque(
    parameters: MotorParameters, error: FloatArray, features: FloatArray, cycle: float
) -> FloatArray:
    """External torque on one joint from its measured tracking error: Eq. 10 solved for tau_ext.

    Args:
        parameters: Constants of the joint.
        error: (n,) measured tracking error eps [rad]; its derivative is taken as central differences.
        features: (n, 3) velocity [rad/s], acceleration [rad/s2] and load torque M qdd + c [N m] of the true motion;
            those of the desired motion where the two differ little.
        cycle: Period of the ticks [s].

    Returns:
        (n,) [N m], positive in the positive direction of the joint.
    """
    rate = np.gradient(error, cycle) if len(error) > 1 else np.zeros_like(error)
    motor = parameters.stiffness * (error + parameters.derivative_time * rate)
    torque: FloatArray = parameters.free_torque(features) - motor
    return torque
