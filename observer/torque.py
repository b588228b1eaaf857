"""From the residual to the external torque on each joint, and how sure it is."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import FloatArray

FRICTION_SHARE = 0.5
"""Of the friction that a push has turned round: gears hold some of it back."""

DAHL = 0.003
"""[rad] of motion within which friction turns round."""

TOUCHED = 0.5
"""Share of its threshold beyond which a residual counts as touched."""


class TorqueEstimate:
    """External torque tau_ext = -K r, and some of the friction that it has turned round.

    Whoever pushes a joint also turns its friction round, which then helps to hold against the push. It turns with the
    motion that the residual shows (Dahl's model).

    Args:
        stiffness: (n,) K [N m/rad], NaN for joints without a model.
        friction: (n,) F / K [rad].
        spread: (n,) standard deviation of the residual in free motion [rad].
    """

    def __init__(self, stiffness: FloatArray, friction: FloatArray, spread: FloatArray) -> None:
        self._stiffness, self._friction, self._spread = stiffness, friction, spread
        self._push, self._certain = -stiffness, stiffness * spread
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._slip = np.zeros(len(self._friction))
        self._last = np.zeros(len(self._friction))

    def step(
        self, residual: FloatArray, friction: FloatArray, threshold: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Take in one tick.

        Args:
            residual: (n,) [rad].
            friction: (n,) on the joints if nothing touched them, over K [rad].
            threshold: (n,) of a contact [rad].

        Returns:
            (n,) external torque and its standard deviation [N m].
        """
        size = self._friction
        last, self._last = self._last, residual.copy()
        touched = np.abs(residual) > TOUCHED * threshold
        if not np.count_nonzero(touched):
            self._slip = friction
            return self._push * residual, self._certain.copy()
        motion = last - residual  # of the joint, away from where it would be
        slip = np.clip(self._slip + motion * (size / DAHL), -size, size)
        self._slip = np.where(touched, slip, friction)
        turned = np.where(touched, FRICTION_SHARE * (self._slip - friction), 0.0)
        unsure = np.where(touched, FRICTION_SHARE * size, 0.0)
        return self._stiffness * (turned - residual), self._stiffness * np.hypot(
            self._spread, unsure
        )
