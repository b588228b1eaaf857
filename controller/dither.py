"""Dither: a small oscillation of some joints, added to any posture, so that friction hides less of a touch.

A joint at rest hides a torque of up to twice its friction: its encoder, command and current are the same with and
without it. A joint that oscillates by more than friction and backlash slides twice a period, and its friction then has
a known sign.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sin

import numpy as np

from pepper_driver.backends.motion_profile import minimum_jerk, minimum_jerk_slope
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import Out, kernel
from pepper_driver.config.settings import AttentiveSettings


@dataclass(frozen=True, slots=True)
class Superposition:
    """Motion that is added to another one in one cycle, arrays (17,).

    Attributes:
        position: At the start of the cycle [rad].
        velocity: At the start of the cycle [rad/s].
        acceleration: Mean of the cycle [rad/s2].
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


class Dither:
    """Oscillation A e_j(t) sin(2 pi f t + phase_j) of joint j, with e_j between 0 and 1 along a minimum-jerk curve.

    It depends on the number of cycles alone. From rest to rest, t begins at 0.

    Args:
        robot: Its description.
        settings: Joints, amplitude, frequency, fade time.
        dt: Cycle [s].

    Attributes:
        enabled: True to fade in and continue, False to fade out.
        position: (17,) oscillation in the joint positions of the controller [rad].
        velocity: (17,) oscillation in their velocities [rad/s].

    Raises:
        UnknownNameError: No such joint.
    """

    def __init__(self, robot: RobotConfig, settings: AttentiveSettings, dt: float) -> None:
        count = len(settings.joints)
        phase = np.zeros(len(robot.joint_names))
        amplitude = np.zeros_like(phase)
        for number, name in enumerate(settings.joints):
            joint = robot.joint_index(name)
            phase[joint] = 2.0 * pi * number / count
            amplitude[joint] = settings.amplitude(name)
        self._phase, self._amplitude, self._dt = phase, amplitude, dt
        self._rate = 2.0 * pi * settings.frequency
        self._fade_rate = 1.0 / settings.fade_time
        self._oscillate = _oscillate.load()
        self.reset()

    def reset(self) -> None:
        """Stop at once."""
        self.enabled = False
        self._cycle = 0
        self._suspended: BoolArray | None = None
        self._level = np.zeros_like(self._phase)  # 0..1, fraction of the fade-in of each joint
        self._steady = False  # the level stays as it is
        self._envelope, self._slope = np.zeros((2, len(self._phase)))
        self.position, self.velocity = np.zeros((2, len(self._phase)))

    @property
    def active(self) -> bool:
        """True while it fades in, oscillates or fades out."""
        return self.enabled or self._cycle > 0

    def suspend(self, joints: BoolArray) -> None:
        """Stop joints, a mask (17,), at once and for the next cycle; they fade in again later."""
        self._suspended = joints
        self._level, self._steady = np.where(joints, 0.0, self._level), False
        self.position = np.where(joints, 0.0, self.position)
        self.velocity = np.where(joints, 0.0, self.velocity)

    def step(self) -> Superposition:
        """Advance by one cycle."""
        if not (self._steady and self.enabled and self._suspended is None):
            self._fade()
        self._cycle += 1
        before, (position, velocity, acceleration) = self.velocity, np.empty((3, len(self._phase)))
        self._oscillate(
            self._amplitude,
            self._phase,
            self._envelope,
            self._slope,
            self._rate,
            self._cycle,
            self._dt,
            before,
            position,
            velocity,
            acceleration,
        )
        superposition = Superposition(self.position, before, acceleration)
        self.position, self.velocity = position, velocity
        if not self.enabled and not np.count_nonzero(self._level):
            # The next oscillation must start at sine 0, without a step.
            self._cycle = 0
        return superposition

    def _fade(self) -> None:
        """Advance the level of each joint, and what follows from it: the envelope and its rate."""
        change = self._fade_rate * self._dt
        level = np.clip(self._level + (change if self.enabled else -change), 0.0, 1.0)
        # Joints that were suspended fade in from the next cycle on.
        self._steady = self._suspended is None and np.array_equal(level, self._level)
        if self._suspended is not None:
            level[self._suspended] = 0.0
            self._suspended = None
        fading = (level - self._level) / self._dt
        self._level = level
        self._envelope, self._slope = minimum_jerk(level), minimum_jerk_slope(level) * fading


@kernel
def _oscillate(
    amplitude: FloatArray,
    phase: FloatArray,
    envelope: FloatArray,
    slope: FloatArray,
    rate: float,
    cycle: int,
    dt: float,
    before: FloatArray,
    position: Out[FloatArray],
    velocity: Out[FloatArray],
    acceleration: Out[FloatArray],
) -> None:
    """Write the oscillation A e sin(2 pi f t + phase), its velocity, and the acceleration since the one before."""
    for j in range(len(phase)):
        angle = rate * dt * cycle + phase[j]
        sine, cosine = sin(angle), cos(angle)
        position[j] = amplitude[j] * envelope[j] * sine
        velocity[j] = amplitude[j] * (slope[j] * sine + envelope[j] * rate * cosine)
        acceleration[j] = (velocity[j] - before[j]) / dt
