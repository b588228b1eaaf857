"""Position, velocity and acceleration limits of base and joints, merged into one box of accelerations.

The box holds lo <= hi by construction: each limit is an interval, and the box of what matters less is projected onto
the interval of what matters more. Position counts more than velocity, velocity more than acceleration.

Position limits are kept by braking distance. With d the distance to the limit now, v+ the velocity after this cycle
and b the deceleration, the distance after this cycle is d+ = d - (v + v+) dt / 2, and it must leave room

    to stop,          v+^2 / (2 b) <= d+ - b dt^2 / 2    where v+ is above b dt,
    to arrive,        v+ dt <= d+                        below.

The two meet at v+ = b dt with one tangent. Solved for v+, with w = (d - v dt / 2) / (1.5 dt):

    v+ <= w  for w <= b dt,   v+ <= sqrt(3 b dt w - 3/4 (b dt)^2) - b dt / 2  above.

The stopping distance alone, with no room to arrive, asks for v+ = 2 d / dt - v close to the limit: the velocity turns
round in every cycle for as long as a task pulls beyond the limit. With it the velocity goes down to a third in each
cycle, and v <= sqrt(2 b d) stays true. The velocity damper of older controllers lets joints as fast as Pepper's run
past their limits at 12 ms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config import ControllerSettings, RobotConfig
from pepper_driver.controller.model import BASE, RobotModel

FloatArray = NDArray[np.float64]

BRAKE_SHARE = 0.9
"""Of the acceleration limit: what the braking distance is reckoned with."""

TOLERANCE = 1e-9
"""By how much a bound may be missed and still count as kept."""


class AccelerationBox:
    """Bounds on the 20 accelerations.

    A joint that starts beyond a limit is brought back at b dt / 2, a few hundredths of a radian a second.

    Args:
        robot: Position limits of joints, velocity and acceleration limits of the base.
        settings: Velocity and acceleration limits of joints, margin of position limits.
        model: For the order of the joints.
        dt: Cycle [s].

    Attributes:
        lower: (20,) of the last update [m/s2], [rad/s2].
        upper: (20,) likewise.
        joint_velocity_limit: (17,) in joint order [rad/s].
    """

    def __init__(
        self, robot: RobotConfig, settings: ControllerSettings, model: RobotModel, dt: float
    ) -> None:
        self._dt = dt
        base, names = robot.limits.base, robot.joint_names
        self.joint_velocity_limit = np.array([settings.velocity_limit[name] for name in names])
        order = np.argsort(model.joint_columns)  # all arrays from here on are in the model's order
        self._names = ("base_vx", "base_vy", "base_wz", *(names[i] for i in order))
        acceleration = np.array([settings.acceleration_limit[names[i]] for i in order])
        linear, angular = base.linear_velocity, base.angular_velocity
        self._velocity = np.concatenate(
            [[linear, linear, angular], self.joint_velocity_limit[order]]
        )
        linear, angular = base.linear_acceleration, base.angular_acceleration
        self._acceleration = np.concatenate([[linear, linear, angular], acceleration])
        self._step = self._acceleration * dt
        # A margin wider than the joint's range would leave no place to be.
        margin = np.minimum(settings.position_margin, (robot.upper - robot.lower) / 4)
        # Every array of two rows holds the upper side and the lower side, mirrored, so that one formula serves both.
        self._limits = np.stack([robot.upper - margin, -(robot.lower + margin)])[:, order]
        brake = BRAKE_SHARE * acceleration * dt
        self._brake, self._slope, self._offset = brake, 3 * brake, 0.75 * brake**2
        self._floor = -brake / 2
        self._distance, self._reach, self._stop = (np.zeros((2, len(names))) for _ in range(3))
        self._v, self._bounds = np.zeros((2, model.nv)), np.zeros((2, model.nv))
        self.upper, self.lower = self._bounds[0], np.zeros(model.nv)

    def update(self, model: RobotModel) -> None:
        """Compute the box for the model's state."""
        v, bounds = self._v, self._bounds
        v[0] = model.v
        np.negative(v[0], out=v[1])
        # Velocities after this cycle first, from accelerations at the end.
        np.add(self._step, v, out=bounds)
        np.minimum(bounds, self._velocity, out=bounds)
        np.maximum(bounds, -self._velocity, out=bounds)
        self._update_reach(model)
        joints, reach = bounds[:, BASE:], self._reach
        np.minimum(joints, reach, out=joints)
        np.maximum(joints, -reach[::-1], out=joints)
        bounds -= v
        bounds /= self._dt
        np.negative(bounds[1], out=self.lower)

    def _update_reach(self, model: RobotModel) -> None:
        """Highest velocity after this cycle that the position limits allow [rad/s]."""
        distance, reach, stop = self._distance, self._reach, self._stop
        position = model.q[-distance.shape[1] :]
        np.subtract(self._limits[0], position, out=distance[0])
        np.add(self._limits[1], position, out=distance[1])
        np.multiply(distance, 1 / (1.5 * self._dt), out=reach)
        np.divide(self._v[:, BASE:], 3, out=stop)
        reach -= stop  # w
        np.maximum(reach, self._brake, out=stop)
        stop *= self._slope
        stop -= self._offset
        np.sqrt(stop, out=stop)
        stop += self._floor
        np.minimum(reach, stop, out=reach)
        np.maximum(reach, self._floor, out=reach)

    def relaxed(self) -> tuple[str, ...]:
        """Limits that the last update gave up for one that matters more, as ``"LHand acceleration"``.

        A joint beyond a position limit is named too; all vectors are those of the last update.
        """
        v, dt = self._v[0], self._dt
        fast = (v + self.lower * dt > self._velocity + TOLERANCE) | (
            v + self.upper * dt < -self._velocity - TOLERANCE
        )
        hard = (self.lower > self._acceleration + TOLERANCE) | (
            self.upper < -self._acceleration - TOLERANCE
        )
        beyond = np.zeros_like(hard)
        beyond[BASE:] = (self._distance < -TOLERANCE).any(axis=0)
        kinds = {"position": beyond, "velocity": fast, "acceleration": hard}
        return tuple(
            f"{name} {kind}"
            for i, name in enumerate(self._names)
            for kind, given_up in kinds.items()
            if given_up[i]
        )
