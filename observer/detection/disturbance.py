"""Parts of the robot that a touch on another part shakes, or has just shaken."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import BoolArray, IntArray
from pepper_driver.observer.constants import CORRECTION_TIME, PUSH_TICKS


class Disturbance:
    """Parts whose thresholds are HELD_FACTOR times as high, because a touch shakes them that is not theirs.

    - Joints of all other parts while a limb is touched.
    - Joints of parts that do not show it while the trunk is touched, once it has been for PUSH_TICKS: until then it may
      show a touch on a limb before the joints of the limb do. Where the base alone shows it, these are all joints.
    - The base for CORRECTION_TIME after a touch: the robot swings back.

    Args:
        limbs: (n,) number of the limb of each joint, 0 for the trunk.
        cycle: Period of the ticks [s].

    Attributes:
        joints: (n,) joints that are shaken, None while none is.
        base: True if the base is.
    """

    def __init__(self, limbs: IntArray, cycle: float) -> None:
        self._limbs, self._count = limbs, int(limbs.max()) + 1
        self._swing_ticks = round(CORRECTION_TIME / cycle)
        self.reset()

    def reset(self) -> None:
        """Forget all touches."""
        self.joints: BoolArray | None = None
        self.base = False
        self._touched_ticks = self._ticks_left = 0

    def step(self, free: BoolArray, blind: BoolArray, untouched: bool) -> None:
        """Take in one tick.

        Args:
            free: (n,) joints that show no touch.
            blind: (n,) joints that cannot be judged.
            untouched: True if no part of the robot is touched.
        """
        if untouched:
            self.joints, self._touched_ticks = None, 0
            self._ticks_left = max(self._ticks_left - 1, 0)
            self.base = self._ticks_left > 0
            return
        self._touched_ticks += 1
        self._ticks_left, self.base = self._swing_ticks, False
        of_limb = np.bincount(self._limbs[~(free | blind)], minlength=self._count) > 0
        if of_limb[1:].any() or self._touched_ticks > PUSH_TICKS:
            self.joints = ~of_limb[self._limbs]
