"""Where the robot would come to rest if it braked from the end of this cycle on.

Limits of single joints are kept by braking distance (``braking.py``). A limit that joints share, h(q) <= 0, is kept in
the same way: what must satisfy it is the posture in which all of them come to rest, each braking as the box allows.
One that satisfies it now can be brought to rest satisfying it, whatever the joints do in between, because braking is
always inside the box. With v+ = v + a dt and the way to rest s(v+) of ``braking.py``, the way from here is

    v dt + a dt^2 / 2 + s(v+),    s(v) = v dt for |v| <= b dt,   sign(v) (v^2 / (2 b) + b dt^2 / 2) above,

linearised in a about the velocity now: ``displacement`` + ``gain`` * a. s is convex on each side, so the linearisation
falls short by at most (a dt)^2 / (2 b), a millimetre or a milliradian; margins are wider.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepper_driver.controller.constraints.braking import BRAKE_SHARE

FloatArray = NDArray[np.float64]


class Stopping:
    """The way to rest of base and joints.

    Args:
        acceleration: (20,) limits [m/s2], [rad/s2].
        dt: Cycle [s].

    Attributes:
        dt: Cycle [s].
        acceleration: (20,) limits [m/s2], [rad/s2].
        brake: (20,) deceleration it is reckoned with [m/s2], [rad/s2].
    """

    def __init__(self, acceleration: FloatArray, dt: float) -> None:
        self.dt = dt
        self.acceleration = acceleration
        self.brake: FloatArray = BRAKE_SHARE * acceleration
        self._velocity = np.zeros(len(acceleration))
        self._displacement: FloatArray | None = None
        self._gain: FloatArray = np.zeros(len(acceleration))

    def update(self, velocity: FloatArray) -> None:
        """Take in the velocities (20,) at the start of a cycle; nothing is computed until it is asked for."""
        self._velocity = velocity
        self._displacement = None

    @property
    def displacement(self) -> FloatArray:
        """(20,) the way to rest when the velocity stays as it is in this cycle [m], [rad]."""
        if self._displacement is None:
            self._compute()
            assert self._displacement is not None
        return self._displacement

    @property
    def gain(self) -> FloatArray:
        """(20,) by how much an acceleration in this cycle lengthens that way [s2]."""
        if self._displacement is None:
            self._compute()
        return self._gain

    def _compute(self) -> None:
        v, b, dt = self._velocity, self.brake, self.dt
        speed = np.abs(v)
        slope = np.maximum(speed / b, dt)
        way = np.where(speed > b * dt, speed**2 / (2 * b) + b * dt**2 / 2, speed * dt)
        self._displacement = v * dt + np.sign(v) * way
        self._gain = (dt / 2 + slope) * dt
