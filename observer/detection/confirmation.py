"""Confirmation of touches on limbs by the base, which often shows a push before the joints do."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray, IntArray
from pepper_driver.observer.constants import CONFIRMING_RATIO, PUSH_TICKS


class BaseConfirmation:
    """For PUSH_TICKS after the base was pushed, the limb that shows most of it has lower thresholds.

    A push that begins within PUSH_TICKS after another one, or while the robot is touched, confirms nothing: a hand that
    lets go shakes the base as well.

    Args:
        limbs: (n,) number of the limb of each joint, 0 for the trunk.

    Attributes:
        untouched: True if no part of the robot was touched in the tick before; set by the caller.
    """

    def __init__(self, limbs: IntArray) -> None:
        self._limbs = limbs
        self.reset()

    def reset(self) -> None:
        """Forget all pushes."""
        self._quiet_ticks, self._ticks_left = PUSH_TICKS, 0
        self.untouched = True

    @property
    def pushed(self) -> bool:
        """True if the base has shown a push in the last PUSH_TICKS."""
        return self._quiet_ticks < PUSH_TICKS

    def step(self, base_residual: float) -> bool:
        """Take in one tick; return True while a push on the base confirms one on a limb.

        Args:
            base_residual: In units of its threshold, NaN where it cannot be judged.
        """
        if abs(base_residual) > 1.0:
            if not self.pushed and self.untouched:
                self._ticks_left = PUSH_TICKS
            self._quiet_ticks = 0
        else:
            self._quiet_ticks += 1
        if not self._ticks_left:
            return False
        self._ticks_left -= 1
        return True

    def lower(
        self, threshold: FloatArray, residual: FloatArray, fresh: BoolArray, blind: BoolArray
    ) -> None:
        """Lower the thresholds of the limb that shows most: what shakes the base shakes all limbs a little.

        Args:
            threshold: (n,) is changed [rad].
            residual: (n,) [rad]
            fresh: (n,) joints that have not shown more than half of their threshold for longer: of another push, or of
                none.
            blind: (n,) joints that cannot be judged.
        """
        candidates = fresh & (self._limbs != 0) & ~blind
        ratio = np.where(candidates, np.abs(residual) / threshold, 0.0)
        largest = np.argmax(ratio)
        if ratio[largest] > 0.0:
            threshold[fresh & (self._limbs == self._limbs[largest])] *= CONFIRMING_RATIO
