"""Acceleration bounds from position, velocity, acceleration and jerk limits of base and joints.

lower <= upper holds by construction: each limit is an interval, and the interval of a less important limit is projected
onto that of a more important one. The order is position, velocity, acceleration, jerk.
"""

from __future__ import annotations

import numpy as np

from pepper_driver.config import ControllerSettings, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import Matrix, Out, Records, kernel, make_records
from pepper_driver.controller.constraints.braking import BrakingDistance, VelocityDamper
from pepper_driver.controller.model import BASE, RobotModel

BOX_TOLERANCE = 1e-9
"""Violation up to which a bound counts as satisfied."""

UNLIMITED_POSITION = 1e9
"""[m], [rad] Position limit of the base, which has none."""


class AccelerationLimit:
    """Limits of one velocity of the model.

    Attributes:
        velocity: [m/s], [rad/s].
        acceleration: [m/s2], [rad/s2].
        jerk_step: Largest change of the acceleration in one cycle [m/s2], [rad/s2]; infinite without a jerk limit.
    """

    velocity: float
    acceleration: float
    jerk_step: float


@kernel
def _bounds(
    velocity: FloatArray,
    before: FloatArray,
    towards: Matrix[FloatArray],
    limits: Records[AccelerationLimit],
    dt: float,
    jerk: bool,
    lower: Out[FloatArray],
    upper: Out[FloatArray],
) -> None:
    """Write the bounds on the accelerations.

    Args:
        velocity: v.
        before: Accelerations of the previous cycle.
        towards: (2, n) largest velocities after this cycle towards the upper, then the lower position limit.
        limits: Those of the velocities.
        dt: Cycle [s].
        jerk: Whether the jerk limit holds.
        lower: (n,) bounds to write.
        upper: (n,) the same.
    """
    for i in range(len(limits)):
        limit, v = limits[i], velocity[i]
        step = limit.jerk_step if jerk else np.inf
        for side in range(2):
            # The lower bound is the upper one of the mirrored joint.
            sign = 1.0 if side == 0 else -1.0
            most = np.minimum(sign * before[i] + step, limit.acceleration)
            most = np.maximum(most, -limit.acceleration)
            # The velocity after this cycle: from the least important limit to the most important one.
            after = sign * v + most * dt
            after = np.maximum(np.minimum(after, limit.velocity), -limit.velocity)
            after = np.maximum(np.minimum(after, towards[side, i]), -towards[1 - side, i])
            bound = (after - sign * v) * (1.0 / dt)
            if side == 0:
                upper[i] = bound
            else:
                lower[i] = -bound


class AccelerationBox:
    """Bounds on the 20 accelerations.

    Args:
        robot: Description with position limits of joints, velocity and acceleration limits of the base.
        settings: Velocity, acceleration and jerk limits of joints, margin and law of position limits.
        model: Model with the order of the joints.
        dt: Cycle [s].

    Raises:
        ConfigError: A table of limits without one of the joints.

    Attributes:
        lower: (20,) bounds of the last update [m/s2], [rad/s2].
        upper: (20,) the same.
        acceleration_limit: (20,) [m/s2], [rad/s2].
        joint_velocity_limit: (17,) in joint order [rad/s].
    """

    def __init__(
        self, robot: RobotConfig, settings: ControllerSettings, model: RobotModel, dt: float
    ) -> None:
        self._dt = dt
        base, names = robot.limits.base, robot.joint_names
        self.joint_velocity_limit = settings.joint_velocity(robot)
        order = np.argsort(
            model.joint_columns
        )  # from here on all arrays are in the order of the model
        self._names = ("base_vx", "base_vy", "base_wz", *(names[i] for i in order))
        acceleration = settings.joint_acceleration(robot)[order]
        linear, angular = base.linear_velocity, base.angular_velocity
        self._velocity = np.concatenate(
            [[linear, linear, angular], self.joint_velocity_limit[order]]
        )
        linear, angular = base.linear_acceleration, base.angular_acceleration
        self.acceleration_limit = np.concatenate([[linear, linear, angular], acceleration])
        self._jerk_step: FloatArray | None = None
        jerk = settings.joint_jerk(robot)
        if jerk is not None:
            linear, angular = base.linear_jerk, base.angular_jerk
            self._jerk_step = np.array([linear, linear, angular, *jerk[order]]) * dt
        # A margin wider than the range of a joint would leave no allowed position.
        margin = np.minimum(settings.position_margin, (robot.upper - robot.lower) / 4)
        unlimited = np.full(BASE, UNLIMITED_POSITION)
        self._low = np.concatenate([-unlimited, (robot.lower + margin)[order]])
        self._high = np.concatenate([unlimited, (robot.upper - margin)[order]])
        self._position_limit: BrakingDistance | VelocityDamper = (
            BrakingDistance(self._low, self._high, self.acceleration_limit, dt)
            if settings.position_limit == "braking"
            else VelocityDamper(self._low, self._high, self._velocity)
        )
        unlimited_jerk = np.full(model.nv, np.inf) if self._jerk_step is None else self._jerk_step
        self._limits = make_records(
            AccelerationLimit,
            model.nv,
            velocity=self._velocity,
            acceleration=self.acceleration_limit,
            jerk_step=unlimited_jerk,
        )
        self._position, self._v, self._before = np.zeros((3, model.nv))
        self._bounds = _bounds.load()
        self.lower, self.upper = np.zeros((2, model.nv))

    def update(
        self, q: FloatArray, v: FloatArray, before: FloatArray, *, jerk: bool = True
    ) -> None:
        """Compute the bounds for a state of the model.

        Args:
            q: Configuration of the model.
            v: (20,) velocity.
            before: (20,) acceleration of the previous cycle, for the jerk limit.
            jerk: False to ignore the jerk limit.
        """
        # The base has no position limit: its entries stay zero.
        self._position[BASE:] = q[BASE - len(v) :]
        self._v, self._before = v, before
        towards = self._position_limit.max_velocity(self._position, v)
        self._bounds(v, before, towards, self._limits, self._dt, jerk, self.lower, self.upper)

    def relaxed(self, acceleration: FloatArray | None = None) -> tuple[str, ...]:
        """Return limits that the last update relaxed for more important ones, as ``"LHand acceleration"``.

        Joints beyond a position limit are named too.

        Args:
            acceleration: (20,) accelerations of the solution, for their jerk after an update without jerk limit. By
                default jerk is named where no acceleration within the bounds satisfies it.
        """
        v, dt, limit = self._v, self._dt, self.acceleration_limit
        fast = (v + self.lower * dt > self._velocity + BOX_TOLERANCE) | (
            v + self.upper * dt < -self._velocity - BOX_TOLERANCE
        )
        hard = (self.lower > limit + BOX_TOLERANCE) | (self.upper < -limit - BOX_TOLERANCE)
        beyond = (self._position < self._low - BOX_TOLERANCE) | (
            self._position > self._high + BOX_TOLERANCE
        )
        kinds = {"position": beyond, "velocity": fast, "acceleration": hard}
        if self._jerk_step is not None:
            low, high = (self.lower, self.upper) if acceleration is None else (acceleration,) * 2
            max_change = self._jerk_step + BOX_TOLERANCE
            kinds["jerk"] = (low - self._before > max_change) | (high - self._before < -max_change)
        return tuple(
            f"{name} {kind}"
            for i, name in enumerate(self._names)
            for kind, relaxed in kinds.items()
            if relaxed[i]
        )

    def binding(self, acceleration: FloatArray) -> tuple[tuple[str, str], ...]:
        """Return the active bounds of (20,) accelerations: name of joint or base axis, and its limit."""
        found = []
        # The velocity limit applies at the end of the cycle.
        after = np.abs(self._v + acceleration * self._dt)
        jerk = np.abs(acceleration - self._before)
        for i, name in enumerate(self._names):
            a = acceleration[i]
            if self.lower[i] + BOX_TOLERANCE < a < self.upper[i] - BOX_TOLERANCE:
                continue
            if abs(a) >= self.acceleration_limit[i] - BOX_TOLERANCE:
                kind = "acceleration"
            elif after[i] >= self._velocity[i] - BOX_TOLERANCE:
                kind = "velocity"
            elif self._jerk_step is not None and jerk[i] >= self._jerk_step[i] - BOX_TOLERANCE:
                kind = "jerk"
            else:
                kind = "position"
            found.append((name, kind))
        return tuple(found)
