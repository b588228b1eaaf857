"""Position, velocity, acceleration and jerk limits of base and joints, merged into one box of accelerations.

The box holds lo <= hi by construction: each limit is an interval, and the box of what matters less is projected onto
the interval of what matters more. Position counts more than velocity, velocity more than acceleration, acceleration
more than jerk.
"""

from __future__ import annotations

import numpy as np

from pepper_driver.config import ControllerSettings, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.constraints.braking import BrakingDistance, VelocityDamper
from pepper_driver.controller.model import BASE, RobotModel

BOX_TOLERANCE = 1e-9
"""By how much a bound may be violated and still count as kept."""

ANYWHERE = 1e9
"""[m], [rad] Position limit of the base."""


class AccelerationBox:
    """Bounds on the 20 accelerations.

    Args:
        robot: Position limits of joints, velocity and acceleration limits of the base.
        settings: Velocity, acceleration and jerk limits of joints, margin and law of position limits.
        model: For the order of the joints.
        dt: Cycle [s].

    Raises:
        ConfigError: A table of limits that lacks a joint.

    Attributes:
        lower: (20,) of the last update [m/s2], [rad/s2].
        upper: (20,) likewise.
        acceleration_limit: (20,) [m/s2], [rad/s2].
        joint_velocity_limit: (17,) in joint order [rad/s].
    """

    def __init__(
        self, robot: RobotConfig, settings: ControllerSettings, model: RobotModel, dt: float
    ) -> None:
        self._dt = dt
        base, names = robot.limits.base, robot.joint_names
        self.joint_velocity_limit = settings.joint_velocity(robot)
        order = np.argsort(model.joint_columns)  # all arrays from here on are in the model's order
        self._names = ("base_vx", "base_vy", "base_wz", *(names[i] for i in order))
        acceleration = settings.joint_acceleration(robot)[order]
        linear, angular = base.linear_velocity, base.angular_velocity
        self._velocity = np.concatenate(
            [[linear, linear, angular], self.joint_velocity_limit[order]]
        )
        linear, angular = base.linear_acceleration, base.angular_acceleration
        self.acceleration_limit = np.concatenate([[linear, linear, angular], acceleration])
        self._step = self.acceleration_limit * dt
        self._jerk_step: FloatArray | None = None
        jerk = settings.joint_jerk(robot)
        if jerk is not None:
            linear, angular = base.linear_jerk, base.angular_jerk
            self._jerk_step = np.array([linear, linear, angular, *jerk[order]]) * dt
        # A margin wider than the joint's range would leave no place to be; the base may be anywhere.
        margin = np.minimum(settings.position_margin, (robot.upper - robot.lower) / 4)
        anywhere = np.full(BASE, ANYWHERE)
        self._low = np.concatenate([-anywhere, (robot.lower + margin)[order]])
        self._high = np.concatenate([anywhere, (robot.upper - margin)[order]])
        self._position_limit: BrakingDistance | VelocityDamper = (
            BrakingDistance(self._low, self._high, self.acceleration_limit, dt)
            if settings.position_limit == "braking"
            else VelocityDamper(self._low, self._high, self._velocity)
        )
        # Arrays of 40 hold the upper sides, then the lower sides mirrored, so that one formula serves both. They are
        # contiguous and of one shape: that is what makes small NumPy operations quick.
        nv = model.nv
        self._state, self._before = np.zeros(2 * nv), np.zeros(nv)
        self._position, self._v = self._state[:nv], self._state[nv:]
        self._joints = self._position[BASE:]
        self._mirrored, self._bounds, self._other = np.zeros((3, 2 * nv))
        self._mirrored_low, self._bounds_low = self._mirrored[nv:], self._bounds[nv:]
        self._other_high, self._other_low = self._other[:nv], self._other[nv:]
        self._velocity_40, self._step_40 = np.tile(self._velocity, 2), np.tile(self._step, 2)
        self._against_velocity = -self._velocity_40
        self._rate_40 = np.full(2 * nv, 1.0 / dt)
        self.upper, self.lower = self._bounds[:nv], np.zeros(nv)

    def update(
        self, q: FloatArray, v: FloatArray, before: FloatArray, *, jerk: bool = True
    ) -> None:
        """Compute the box for a state of the model.

        Args:
            q: Configuration of the model.
            v: (20,) velocity.
            before: (20,) acceleration of the cycle before; only the jerk limit asks for it.
            jerk: Whether to keep the jerk limit, if there is one.
        """
        mirrored, bounds, other, nv = self._mirrored, self._bounds, self._other, len(v)
        self._joints[...] = q[BASE - nv :]
        self._v[...] = mirrored[:nv] = v
        self._before = before
        np.negative(v, self._mirrored_low)
        # Velocities after this cycle first, from accelerations at the end.
        np.add(mirrored, self._step_40, bounds)
        if jerk and self._jerk_step is not None:
            self._limit_jerk(before)
        np.minimum(bounds, self._velocity_40, out=bounds)
        np.maximum(bounds, self._against_velocity, out=bounds)
        reach = self._position_limit.max_velocity(self._state)
        np.minimum(bounds, reach, out=bounds)
        np.negative(reach[nv:], self._other_high)
        np.negative(reach[:nv], self._other_low)
        np.maximum(bounds, other, out=bounds)
        bounds -= mirrored
        bounds *= self._rate_40
        np.negative(self._bounds_low, self.lower)

    def _limit_jerk(self, before: FloatArray) -> None:
        """Velocities after this cycle that change the acceleration no faster than allowed, where that is possible."""
        assert self._jerk_step is not None
        nv, limit = len(before), self.acceleration_limit
        upper = np.clip(before + self._jerk_step, -limit, limit)
        lower = np.clip(before - self._jerk_step, -limit, limit)
        self._bounds[:nv] = self._mirrored[:nv] + upper * self._dt
        self._bounds[nv:] = self._mirrored[nv:] - lower * self._dt

    def relaxed(self, acceleration: FloatArray | None = None) -> tuple[str, ...]:
        """Limits that the last update gave up for one that matters more, as ``"LHand acceleration"``.

        A joint beyond a position limit is named too; all vectors are those of the last update.

        Args:
            acceleration: (20,) that was chosen, for the jerk it took where the last update was one without jerk limit;
                without it jerk is named where no acceleration in the box keeps it.
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
            most = self._jerk_step + BOX_TOLERANCE
            kinds["jerk"] = (low - self._before > most) | (high - self._before < -most)
        return tuple(
            f"{name} {kind}"
            for i, name in enumerate(self._names)
            for kind, given_up in kinds.items()
            if given_up[i]
        )

    def binding(self, acceleration: FloatArray) -> tuple[tuple[str, str], ...]:
        """Return the active bounds of (20,) accelerations: names of joint or base axis, each with its limit."""
        found = []
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
