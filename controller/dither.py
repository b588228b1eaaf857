"""Dither: a small oscillation of some joints, added to any motion, so that friction hides less of a touch.

A joint at rest hides a torque of up to twice its friction: its encoder, command and current are the same with and
without it. A joint that oscillates by more than friction takes away slides twice a period, and its friction then has
a known sign.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, floor, pi, sin

import numpy as np

from pepper_driver.backends.motion_profile import minimum_jerk, minimum_jerk_slope
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import Out, Records, kernel, make_records
from pepper_driver.config.settings import AttentiveSettings

CENTRE_RATE = 3.0
"""[1/s] At which the centre of an oscillation moves away from a joint limit: slow compared with a gesture."""

WAVE_SAMPLES = 1000
"""Of a period in which the extremes of a wave are searched."""


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


class Oscillator:
    """Constants and state of one joint.

    Attributes:
        amplitude: [rad]; 0 for a joint that does not oscillate.
        scale: Of the wave, to the amplitude [rad].
        phase: In periods.
        sine: True for a sine.
        turn: Duration of a turn in half periods.
        turning: Part of a swing that is crossed in a turn.
        lower, upper: Limits of the joint, with their margin [rad].
        centre: Distance of the centre of the oscillation from the motion that it is added to [rad].
        centre_velocity: [rad/s]
    """

    amplitude: float
    scale: float
    phase: float
    sine: bool
    turn: float
    turning: float
    lower: float
    upper: float
    centre: float
    centre_velocity: float


class Dither:
    """Oscillation c_j + A_j e_j(t) w_j(t / T + phase_j) of joint j: e_j between 0 and 1 along a minimum-jerk curve.

    It depends on the number of cycles alone, but for the centre c_j: it is 0, or leads the oscillation away from a
    joint limit. From rest to rest, t begins at 0. A wave has two turns in a period: those of the joints of a limb are
    spread evenly, and every second limb moves in the opposite direction.

    Args:
        robot: Its description.
        settings: Joints, wave, amplitudes, times.
        dt: Cycle [s].
        margin: Distance that is kept from joint limits [rad].

    Attributes:
        settings: The same.
        enabled: True to fade in and continue, False to fade out.
        withheld: (17,) joints that fade out, or do not fade in, while it is enabled.
        amplitude: (17,) at full size [rad]; 0 for joints that do not oscillate.
        position: (17,) oscillation in the joint positions of the controller [rad].
        velocity: (17,) oscillation in their velocities [rad/s].

    Raises:
        UnknownNameError: No such joint.
    """

    def __init__(
        self, robot: RobotConfig, settings: AttentiveSettings, dt: float, *, margin: float = 0.0
    ) -> None:
        self.settings = settings
        self.amplitude, phase, turning = np.zeros((3, len(robot.joint_names)))
        for name, start in _phases(robot, settings.joints).items():
            joint = robot.joint_index(name)
            self.amplitude[joint], phase[joint] = settings.amplitude(name), start
            turning[joint] = settings.turning(name)
        self._joints = make_records(
            Oscillator,
            len(phase),
            amplitude=self.amplitude,
            phase=phase,
            sine=settings.wave == "sine",
            turn=settings.turn_time / (0.5 * settings.period),
            turning=turning,
            lower=robot.lower + margin,
            upper=robot.upper - margin,
        )
        _scale_waves(self._joints)
        self._dt, self._rate = dt, 1.0 / settings.period
        self._fade_rate = 1.0 / settings.fade_time
        self._oscillate = _oscillate.load()
        self._none: BoolArray = np.zeros(len(self.amplitude), dtype=np.bool_)
        self.reset()

    def reset(self) -> None:
        """Stop at once."""
        self.enabled, self.withheld = False, self._none
        self._cycle = 0
        self._suspended: BoolArray | None = None
        self._level = np.zeros_like(self.amplitude)  # 0..1, fraction of the fade-in of each joint
        self._envelope, self._slope = np.zeros((2, len(self._level)))
        self._joints["centre"], self._joints["centre_velocity"] = 0.0, 0.0
        self.position, self.velocity = np.zeros((2, len(self._level)))

    @property
    def active(self) -> bool:
        """True while it fades in, oscillates or fades out."""
        return self.enabled or self._cycle > 0

    @property
    def full(self) -> BoolArray:
        """(17,) joints that oscillate with their whole amplitude."""
        full: BoolArray = (self._level >= 1.0) & (self.amplitude > 0.0)
        return full

    @property
    def centre(self) -> FloatArray:
        """(17,) distance by which oscillations are led away from joint limits [rad], a copy."""
        centre: FloatArray = self._joints["centre"].copy()
        return centre

    def suspend(self, joints: BoolArray) -> None:
        """Stop joints, a mask (17,), at once and for the next cycle; they fade in again later."""
        self._suspended = joints
        self._level = np.where(joints, 0.0, self._level)
        for name in ("centre", "centre_velocity"):
            self._joints[name][joints] = 0.0
        self.position = np.where(joints, 0.0, self.position)
        self.velocity = np.where(joints, 0.0, self.velocity)

    def step(self, motion: FloatArray) -> Superposition:
        """Advance by one cycle.

        Args:
            motion: (17,) positions of the motion that it is added to, at the start of the cycle [rad].
        """
        self._fade()
        self._cycle += 1
        before, before_velocity = self.position, self.velocity
        position, velocity, acceleration = np.empty((3, len(before)))
        self._oscillate(
            self._joints,
            self._envelope,
            self._slope,
            self._cycle * self._dt * self._rate,
            self._rate,
            self._dt,
            motion,
            before_velocity,
            position,
            velocity,
            acceleration,
        )
        self.position, self.velocity = position, velocity
        if not self.enabled and not np.count_nonzero(self._level):
            # The next oscillation must start at phase 0, without a step.
            self._cycle = 0
        return Superposition(before, before_velocity, acceleration)

    def _fade(self) -> None:
        """Advance the level of each joint, and what follows from it: the envelope and its rate."""
        change = self._fade_rate * self._dt
        rising = ~self.withheld if self.enabled else self._none
        level = np.clip(self._level + np.where(rising, change, -change), 0.0, 1.0)
        # Joints that were suspended fade in from the next cycle on.
        if self._suspended is not None:
            level[self._suspended] = 0.0
            self._suspended = None
        elif np.array_equal(level, self._level):
            self._slope = np.zeros_like(level)
            return
        fading = (level - self._level) / self._dt
        self._level = level
        self._envelope, self._slope = minimum_jerk(level), minimum_jerk_slope(level) * fading


def _phases(robot: RobotConfig, joints: list[str]) -> dict[str, float]:
    """Return the phase of each joint in periods."""
    limbs: dict[str, list[str]] = {}
    for name in joints:
        robot.joint_index(name)  # of a joint that does not exist: before any limb is asked
        limbs.setdefault(robot.limb_of(name), []).append(name)
    return {
        name: 0.5 * (number / len(names) + limb % 2)
        for limb, names in enumerate(limbs.values())
        for number, name in enumerate(names)
    }


@kernel
def _wave(turn: float, turning: float, sine: bool, phase: float) -> tuple[float, float]:
    """Return a wave at a phase in periods, about -1 to 1, and its slope per period.

    Each half of a period but of a sine begins with a turn from minus the speed to the speed of the slide. The velocity
    changes along a minimum-jerk curve; a second one crosses ``turning`` of the swing. Velocity and acceleration have no
    step.
    """
    if sine:
        return sin(2.0 * pi * phase), 2.0 * pi * cos(2.0 * pi * phase)
    half = floor(2.0 * phase)
    time = 2.0 * phase - half
    sign = 1.0 if half % 2.0 == 0.0 else -1.0
    speed = 2.0 * (1.0 - turning) / (1.0 - turn)
    if time < turn:
        s = time / turn
        # Minimum jerk from 0 to 1, its slope, its integral.
        blend = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
        bell = 30.0 * (s * (1.0 - s)) * (s * (1.0 - s))
        area = s * s * s * s * (2.5 - 3.0 * s + s * s)
        value = -1.0 + turn * speed * (2.0 * area - s) + 2.0 * turning * blend
        slope = speed * (2.0 * blend - 1.0) + 2.0 * turning / turn * bell
    else:
        value = -1.0 + 2.0 * turning + speed * (time - turn)
        slope = speed
    return sign * value, 2.0 * sign * slope


@kernel
def _scale_waves(joints: Out[Records[Oscillator]]) -> None:
    """Scale the waves of all joints to their amplitudes: in its turn a wave passes the ends of the slide."""
    for j in range(len(joints)):
        joint = joints[j]
        if joint.amplitude == 0.0:
            continue
        peak = 0.0
        for sample in range(WAVE_SAMPLES):
            value, _ = _wave(joint.turn, joint.turning, joint.sine, sample / WAVE_SAMPLES)
            peak = max(peak, value)
        joint.scale = joint.amplitude / peak


@kernel
def _oscillate(
    joints: Out[Records[Oscillator]],
    envelope: FloatArray,
    slope: FloatArray,
    periods: float,
    rate: float,
    dt: float,
    motion: FloatArray,
    before: FloatArray,
    position: Out[FloatArray],
    velocity: Out[FloatArray],
    acceleration: Out[FloatArray],
) -> None:
    """Write the oscillation after a cycle, its velocity, and the acceleration since the velocity ``before``."""
    for j in range(len(joints)):
        joint = joints[j]
        if joint.amplitude == 0.0:
            position[j] = velocity[j] = acceleration[j] = 0.0
            continue
        lower, upper = joint.lower + joint.amplitude, joint.upper - joint.amplitude
        middle = max(min(motion[j], max(upper, lower)), lower)
        # A critically damped spring leads the centre to where the whole oscillation is within the limits.
        away = envelope[j] * (middle - motion[j]) - joint.centre
        joint.centre_velocity += (
            (CENTRE_RATE * away - 2.0 * joint.centre_velocity) * CENTRE_RATE * dt
        )
        joint.centre += joint.centre_velocity * dt
        value, change = _wave(joint.turn, joint.turning, joint.sine, periods + joint.phase)
        position[j] = joint.centre + joint.scale * envelope[j] * value
        velocity[j] = joint.centre_velocity + joint.scale * (
            slope[j] * value + envelope[j] * change * rate
        )
        acceleration[j] = (velocity[j] - before[j]) / dt
