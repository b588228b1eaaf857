"""Motion of the base by its three wheels.

The base on its three wheels: velocities, paths to a pose, odometry. NAOqi 2.8 page "Locomotion control".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import cos, hypot, pi, sin
from threading import Event

import numpy as np

from pepper_driver.backends.motion_profile import PEAK_SPEED_RATIO, minimum_jerk, minimum_jerk_slope
from pepper_driver.config import NaoqiServices, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.clock import Clock

TWIST_EPSILON = 1e-6
"""[m/s], [rad/s] A twist below this counts as zero."""


@dataclass(frozen=True, kw_only=True)
class DriveLimits:
    """[m/s], [rad/s], [m/s2], [rad/s2], [m/s3], [rad/s3], by the drive parameters of the move config."""

    speed: float
    turn: float
    acceleration: float
    turn_acceleration: float
    jerk: float
    turn_jerk: float

    @classmethod
    def of(cls, settings: NaoqiServices, given: Mapping[str, float]) -> DriveLimits:
        """Return the defaults, replaced by what a move config gives; that is brought into its range."""
        values = {}
        for name, (least, usual, most) in vars(settings.drive).items():
            values[name] = min(max(given.get(name, usual), least), most)
        return cls(
            speed=values["MaxVelXY"],
            turn=values["MaxVelTheta"],
            acceleration=values["MaxAccXY"],
            turn_acceleration=values["MaxAccTheta"],
            jerk=values["MaxJerkXY"],
            turn_jerk=values["MaxJerkTheta"],
        )

    def duration(self, length: float, angle: float) -> float:
        """[s] of a minimum-jerk motion over a length [m] and an angle [rad] that keeps all limits."""
        # Minimum jerk: largest acceleration 10 / sqrt(3) = 5.774 d / T^2, largest jerk 60 d / T^3 (motion_profile.py).
        longest: float = max(
            PEAK_SPEED_RATIO * length / self.speed,
            (5.774 * length / self.acceleration) ** 0.5,
            (60.0 * length / self.jerk) ** (1 / 3),
            PEAK_SPEED_RATIO * angle / self.turn,
            (5.774 * angle / self.turn_acceleration) ** 0.5,
            (60.0 * angle / self.turn_jerk) ** (1 / 3),
        )
        return longest


@dataclass(eq=False, kw_only=True)
class Move:
    """A path to a pose: straight from ``start`` to ``goal`` (x, y, heading in the world), turning evenly.

    Attributes:
        duration: [s] that the robot needs for it.
        elapsed: [s] since it began.
        succeeded: Whether it came to its end; False while it drives, and when it was interrupted.
    """

    start: FloatArray
    goal: FloatArray
    duration: float
    elapsed: float = 0.0
    succeeded: bool = False
    _over: Event = field(default_factory=Event)

    def end(self, *, succeeded: bool) -> None:
        """Release the callers that wait."""
        self.succeeded = succeeded
        self._over.set()

    def wait(self, clock: Clock) -> bool:
        """Until it is over; whether it came to its end."""
        clock.wait_for(self._over.is_set)
        return self.succeeded

    def reference(self) -> tuple[FloatArray, FloatArray]:
        """(3,) pose and (3,) its rate in the world now: minimum jerk."""
        distance = self.goal - self.start
        s = min(self.elapsed / self.duration, 1.0) if self.duration > 0 else 1.0
        rate = minimum_jerk_slope(s) / self.duration if s < 1.0 else 0.0
        return self.start + minimum_jerk(s) * distance, rate * distance


class AlmotionBase:
    """Commands of the wheels, and odometry. Not safe for several threads: the engine locks.

    Attributes:
        twist: (3,) commanded velocity of the base in its own axes: [m/s], [m/s], [rad/s].
        measured: (3,) the same by the wheels' sensors.
        pose: (3,) in the world by the wheels' sensors: x, y [m], heading [rad].
        commanded: (3,) the same by what was commanded.
    """

    def __init__(self, config: RobotConfig, settings: NaoqiServices) -> None:
        self._wheels = config.wheels
        self._settings = settings
        self._limits = DriveLimits.of(settings, {})
        self._target: FloatArray = np.zeros(3)
        self._move: Move | None = None
        self.twist: FloatArray = np.zeros(3)
        self.measured: FloatArray = np.zeros(3)
        self.pose: FloatArray = np.zeros(3)
        self.commanded: FloatArray = np.zeros(3)

    @property
    def active(self) -> bool:
        """True if it drives, or has a target."""
        return bool(
            self._move is not None
            or np.abs(self._target).max() > TWIST_EPSILON
            or np.abs(self.twist).max() > TWIST_EPSILON
        )

    def measure(self, wheel_speed: FloatArray, dt: float) -> None:
        """Roll the odometry on by (3,) measured wheel speeds [rad/s]."""
        self.measured = self._wheels.inverse @ wheel_speed
        self.pose = _rolled(self.pose, self.measured, dt)

    def drive(self, twist: FloatArray, limits: DriveLimits) -> None:
        """Set a velocity (3,), within the limits, until the next command. The present move is interrupted."""
        self._interrupt()
        speed = hypot(twist[0], twist[1])
        if speed > limits.speed:
            # One factor for x and y, so that the direction stays.
            twist = twist * [limits.speed / speed, limits.speed / speed, 1.0]
        self._target = np.array([twist[0], twist[1], np.clip(twist[2], -limits.turn, limits.turn)])
        self._limits = limits

    def move(self, distance: FloatArray, limits: DriveLimits, least: float = 0.0) -> Move:
        """Go by (x, y, heading) in the robot's present axes, in ``least`` [s] or as long as the limits require."""
        self._interrupt()
        heading = self.pose[2]
        c, s = cos(heading), sin(heading)
        shift = np.array(
            [c * distance[0] - s * distance[1], s * distance[0] + c * distance[1], distance[2]]
        )
        self._target = np.zeros(3)
        self._limits = limits
        self._move = Move(
            start=self.pose,
            goal=self.pose + shift,
            duration=max(
                limits.duration(hypot(distance[0], distance[1]), abs(distance[2])), least, 1e-3
            ),
        )
        return self._move

    def stop(self, *, at_once: bool = False) -> None:
        """Brake, or stand ``at_once``; the present move is interrupted."""
        self._interrupt()
        self._target = np.zeros(3)
        if at_once:
            self.twist = np.zeros(3)

    def advance(self, dt: float) -> FloatArray:
        """(3,) speeds of the wheels [rad/s] ``dt`` [s] later."""
        goal = self._target if self._move is None else self._follow(self._move, dt)
        limits = self._limits
        change = goal - self.twist
        step = hypot(change[0], change[1])
        fraction = min(1.0, limits.acceleration * dt / step) if step > 0 else 1.0
        most = limits.turn_acceleration * dt
        self.twist = self.twist + np.array(
            [fraction * change[0], fraction * change[1], np.clip(change[2], -most, most)]
        )
        speeds: FloatArray = self._wheels.matrix @ self.twist
        fastest = float(np.abs(speeds).max())
        if fastest > self._wheels.speed_limit:  # all slowed by one factor: the direction stays
            self.twist = self.twist * (self._wheels.speed_limit / fastest)
            speeds = self._wheels.matrix @ self.twist
        self.commanded = _rolled(self.commanded, self.twist, dt)
        return speeds

    def _follow(self, move: Move, dt: float) -> FloatArray:
        """(3,) present velocity of a move, in the robot's axes."""
        move.elapsed += dt
        pose, rate = move.reference()
        error = pose - self.pose
        close, straight = self._settings.move_tolerance
        late = move.elapsed - move.duration
        there = late >= 0 and hypot(error[0], error[1]) < close and abs(error[2]) < straight
        # A base that cannot get there must not hold up its caller for ever.
        if there or late > self._settings.move_patience:
            self._move = None
            move.end(succeeded=True)
            return np.zeros(3)
        goal = rate + self._settings.move_gain * error
        c, s = cos(self.pose[2]), sin(self.pose[2])
        return np.array([c * goal[0] + s * goal[1], c * goal[1] - s * goal[0], goal[2]])

    def _interrupt(self) -> None:
        if self._move is not None:
            self._move.end(succeeded=False)
            self._move = None


def _rolled(pose: FloatArray, twist: FloatArray, dt: float) -> FloatArray:
    """Return a pose after ``dt`` [s] at a velocity in its own axes, by the heading in the middle."""
    heading = pose[2] + twist[2] * dt / 2
    c, s = cos(heading), sin(heading)
    step = np.array([c * twist[0] - s * twist[1], s * twist[0] + c * twist[1], twist[2]])
    return pose + step * dt


def wrapped_angle(angle: float) -> float:
    """Return an angle in -pi to pi [rad]."""
    return (angle + pi) % (2 * pi) - pi
