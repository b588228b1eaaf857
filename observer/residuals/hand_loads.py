"""Loads of the hands, which no model knows: estimated from the residuals of the arms while they move without touch.

A body in a hand adds to the load torque of each joint of its arm. The torque is linear in its mass m and its first
moment m c in the frame of the wrist: tau = Y(q, v, a) (m, m c). Recursive least squares with forgetting find these four
numbers from the joints that slide; friction hides the load from a joint at rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray, IntArray
from pepper_driver.config.kernels import Matrix, Out, Strided, kernel
from pepper_driver.controller.model import RobotModel
from pepper_driver.observer.constants import (
    LOAD_MASS_STD,
    LOAD_PLACE_STD,
    RISE,
)
from pepper_driver.observer.interface import HandLoad

MAX_MASS = 1.0
"""[kg] Twice what a hand of Pepper can hold."""

PERIOD = 5
"""Ticks between two updates, of one arm after the other: residuals hardly change in one tick."""


@kernel
def _apply_load(
    effect: Matrix[FloatArray],
    load: FloatArray,
    covariance: Matrix[FloatArray],
    joints: IntArray,
    load_gain: FloatArray,
    torque: Out[FloatArray],
    doubt: Out[FloatArray],
) -> None:
    """Set torque [N m] and doubt [rad] of the joints of an arm (m,) in those of all joints (n,)."""
    for i in range(len(joints)):
        j = joints[i]
        torque[j], variance = 0.0, 0.0
        for a in range(len(load)):
            torque[j] += effect[i, a] * load[a]
            for b in range(len(load)):
                variance += effect[i, a] * covariance[a, b] * effect[i, b]
        doubt[j] = load_gain[j] * math.sqrt(max(variance, 0.0))


@kernel
def _learn_load(
    effect: Matrix[FloatArray],
    joints: IntArray,
    load_gain: FloatArray,
    residual: Strided[FloatArray],
    threshold: Strided[FloatArray],
    use: Strided[BoolArray],
    prior: Matrix[FloatArray],
    load: Out[FloatArray],
    covariance: Out[Matrix[FloatArray]],
) -> bool:
    """Update a load by the residuals of its arm, one joint after the other; return False if none is of use."""
    before, learns = load.copy(), False
    for i in range(len(joints)):
        j = joints[i]
        if not use[j]:
            continue
        learns = True
        row = load_gain[j] * effect[i]
        seen = covariance @ row
        # The residual is what the load so far has not explained.
        fresh = residual[j] - np.sum(row * (load - before))
        gain = seen / (np.sum(row * seen) + threshold[j] ** 2)
        load += gain * fresh
        for a in range(len(load)):
            for b in range(len(load)):
                covariance[a, b] -= gain[a] * seen[b]
    if not learns:
        return False
    # Beyond what a hand can hold, the most likely of the loads that it can.
    beyond = load[0] - min(max(load[0], 0.0), MAX_MASS)
    load -= covariance[:, 0] / covariance[0, 0] * beyond
    covariance *= 1.0 + RISE
    limit = np.sqrt(np.minimum(1.0, np.diag(prior) / np.diag(covariance)))
    for a in range(len(load)):
        for b in range(len(load)):
            covariance[a, b] *= limit[a] * limit[b]
    return True


@dataclass(slots=True)
class _Arm:
    """Load of one hand.

    Attributes:
        name: Of the limb.
        joints: (m,) indices of its joints, without the hand.
        wrist: Joint that carries the hand.
        prior: (4, 4) covariance of m [kg] and m c [kg m] at the start.
        covariance: (4, 4) the same now.
        load: (4,) m and m c.
        effect: (m, 4) load torque of the joints per m and m c.
    """

    name: str
    joints: IntArray
    wrist: str
    prior: FloatArray
    covariance: FloatArray
    load: FloatArray
    effect: FloatArray


class HandLoads:
    """Recursive least squares for the loads of the hands.

    Its noise is the threshold: residuals of one motion have much in common. What has been learned is forgotten within a
    minute of motion. None of the four numbers is less certain than at the start.

    Args:
        robot: Its description; a limb with a joint of a hand is an arm.
        load_gain: (n,) g = 1 / K [rad/(N m)], NaN for joints without a model.

    Attributes:
        torque: (n,) load torque of the loads [N m].
        doubt: (n,) standard deviation of the tracking error that follows from what is not known of the loads [rad].
    """

    def __init__(self, robot: RobotConfig, load_gain: FloatArray) -> None:
        self._model, self._gain = RobotModel(robot), load_gain
        self._arms = []
        for name, joints in robot.limbs.items():
            chain = [joint for joint in joints if joint not in robot.hands.joints]
            hands = [joint for joint in joints if joint in robot.hands.joints]
            if hands:
                prior = _prior(self._model.joint_origin(hands[0]))
                self._arms.append(
                    _Arm(
                        name=name,
                        joints=np.array([robot.joint_index(joint) for joint in chain]),
                        wrist=chain[-1],
                        prior=prior,
                        covariance=prior.copy(),
                        load=np.zeros(4),
                        effect=np.zeros((len(chain), 4)),
                    )
                )
        self._wrists = [arm.wrist for arm in self._arms]
        self._apply, self._learn = _apply_load.load_unchecked(), _learn_load.load_unchecked()
        self.reset()

    def reset(self) -> None:
        """Return to loads that are not known."""
        for arm in self._arms:
            arm.covariance, arm.load = arm.prior.copy(), np.zeros(4)
            arm.effect = np.zeros_like(arm.effect)
        self.torque, self.doubt = np.zeros(len(self._gain)), np.zeros(len(self._gain))
        self._ticks = 0

    @property
    def by_limb(self) -> dict[str, HandLoad]:
        """Load of each hand, by the name of its arm."""
        return {
            arm.name: HandLoad(
                mass=float(arm.load[0]), mass_std=float(np.sqrt(arm.covariance[0, 0]))
            )
            for arm in self._arms
        }

    def step(
        self,
        position: FloatArray,
        velocity: FloatArray,
        acceleration: FloatArray,
    ) -> None:
        """Take in one tick.

        Args:
            position: (n,) commanded, or measured of joints that do not follow [rad].
            velocity: (n,) desired [rad/s].
            acceleration: (n,) desired [rad/s2].
        """
        self._ticks += 1
        if self._ticks % PERIOD != 0:
            return
        effects = self._model.body_torques(self._wrists, position, velocity, acceleration)
        for arm, effect in zip(self._arms, effects, strict=True):
            arm.effect = effect[arm.joints]
            self._update(arm)

    def _update(self, arm: _Arm) -> None:
        """Update torque and doubt of the joints of an arm."""
        self._apply(
            arm.effect, arm.load, arm.covariance, arm.joints, self._gain, self.torque, self.doubt
        )

    def learn(self, residual: FloatArray, threshold: FloatArray, use: BoolArray) -> None:
        """Learn from the residuals of a tick (n,) [rad], with their thresholds (n,) [rad].

        Args:
            residual: Positive where a joint is behind its model, as a load is.
            threshold: Of a contact.
            use: (n,) joints that slide without touch.
        """
        if self._ticks % PERIOD != 0 or not self._arms:
            return
        arm = self._arms[self._ticks // PERIOD % len(self._arms)]
        learns = self._learn(
            arm.effect,
            arm.joints,
            self._gain,
            residual,
            threshold,
            use,
            arm.prior,
            arm.load,
            arm.covariance,
        )
        if learns:
            self._update(arm)


def _prior(hand: FloatArray) -> FloatArray:
    """Return the (4, 4) covariance of a load at the start, around the (3,) origin of a hand [m]."""
    place = np.array([1.0, *hand])
    around = LOAD_PLACE_STD**2 * np.diag([0.0, 1.0, 1.0, 1.0])
    covariance: FloatArray = LOAD_MASS_STD**2 * (np.outer(place, place) + around)
    return covariance
