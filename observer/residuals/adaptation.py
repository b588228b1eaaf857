"""Adaptation in a session: constants of each joint, and what the hands hold.

A body in a hand adds to the load torque of every joint between it and the wheels, in proportion to its mass m and its
first moment m c: tau = Y (m, m c_x, m c_y, m c_z), with Y from inverse dynamics of the desired motion. One estimate an
arm says more than a share of the load on each joint would: a wrist that bears nothing by itself needs it, and the
shoulder learns from the elbow. Inertia about the wrist, m c^2, is left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.controller.model import RobotModel
from pepper_driver.observer.interface import HandLoad
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.stick_slip import StickSlipParameters

PRIOR_STD = np.array([0.25, 0.25, 0.1, 1.0])
"""Standard deviation before anything is known, as shares of the identified values; the offset in OFFSET_UNIT."""

LEARN_PERIOD = 10
"""Ticks between two updates."""

PROCESS_NOISE = np.array([0.04, 0.02, 0.02, 0.1])
"""By how much each may change in a minute."""

OFFSET_UNIT = np.radians(0.1)
NOISE_FACTOR = 3.0
"""Times the spread of the free residual: its errors last for many samples, and count once."""

WEAR_RATIO = 0.4
"""Friction or lag beyond this share of what was identified: the joint is worn, and should be identified again."""


class Adaptation:
    """Recursive least squares with forgetting (a Kalman filter on a random walk), four numbers a joint.

    Args:
        models: Of the joints; None where there is none.
        spread: (n,) standard deviation of the residual in free motion [rad].
        cycle: Period of the ticks [s].

    Attributes:
        share: (n, 4) deviation from the identified values, in the units of PRIOR_STD.
    """

    def __init__(
        self,
        models: list[StickSlipParameters | None],
        spread: FloatArray,
        cycle: float,
    ) -> None:
        self._prior = np.tile(PRIOR_STD, (len(models), 1))
        self._lag = np.array([np.nan if m is None else m.lag for m in models])
        self._noise = (NOISE_FACTOR * spread) ** 2
        self._wander = np.diag(PROCESS_NOISE**2 * LEARN_PERIOD * cycle / 60.0)
        self._count = len(models)
        self.reset()

    def reset(self) -> None:
        """Back to the identified values."""
        self.share = np.zeros((self._count, 4))
        self._covariance = self._prior[:, :, None] ** 2 * np.eye(4)

    def effects(self, friction: FloatArray, velocity: FloatArray, load: FloatArray) -> FloatArray:
        """(n, 4) what a full share of each would add to the tracking error [rad].

        Args:
            friction: (n,) on the stick-slip models [rad].
            velocity: (n,) of the stick-slip models [rad/s].
            load: (n,) g tau_ld [rad].
        """
        effects = np.empty((len(load), 4))
        effects[:, 0] = friction
        np.multiply(self._lag, velocity, out=effects[:, 1])
        effects[:, 2] = load
        effects[:, 3] = OFFSET_UNIT
        return effects

    def variance(self, effects: FloatArray) -> FloatArray:
        """(n,) of the expected tracking error, for not knowing the shares better [rad2]."""
        seen = (self._covariance @ effects[:, :, None])[:, :, 0]
        variance: FloatArray = (seen * effects).sum(axis=1)
        return variance

    def update(
        self, residual: FloatArray, effects: FloatArray, other: FloatArray | float, free: BoolArray
    ) -> None:
        """Learn from the last tick.

        Args:
            residual: (n,) [rad].
            effects: (n, 4) of each quantity.
            other: (n,) variance of the residual for what else is not known [rad2].
            free: (n,) joints that nothing touches.
        """
        effects = np.where(free[:, None], effects, 0.0)
        seen = np.einsum("nij,nj->ni", self._covariance, effects)
        scale = self._noise + other + np.einsum("ni,ni->n", effects, seen)
        free = free & np.isfinite(scale)
        gain = np.where(free[:, None], seen / scale[:, None], 0.0)
        self.share += gain * np.where(free, residual, 0.0)[:, None]
        np.clip(self.share, -3.0 * self._prior, 3.0 * self._prior, out=self.share)
        self._covariance -= gain[:, :, None] * seen[:, None, :]
        self._covariance += self._wander
        # No quantity gets less certain than at the start.
        known = np.einsum("nii->ni", self._covariance)
        shrink = np.sqrt(np.minimum(1.0, self._prior**2 / np.maximum(known, 1e-12)))
        self._covariance *= shrink[:, :, None] * shrink[:, None, :]

    @property
    def worn(self) -> BoolArray:
        """(n,) true where friction or lag has grown beyond WEAR_RATIO, by two standard deviations of its estimate."""
        spread = np.sqrt(np.maximum(np.einsum("nii->ni", self._covariance)[:, :2], 0.0))
        grown: BoolArray = (self.share[:, :2] - 2.0 * spread > WEAR_RATIO).any(axis=1)
        return grown


LOAD_PRIOR_STD = np.array([0.3, 0.03, 0.03, 0.03])
"""Standard deviation of mass [kg] and first moment [kg m] before anything is known."""

LOAD_PROCESS_NOISE = np.array([0.02, 0.002, 0.002, 0.002])
"""By how much each may change in a minute, as long as no contact is felt."""

MAX_EFFECT = 200.0
"""[N m] per kilogram and per kilogram metre: a metre of arm at ten times gravity, or an arm that is flung."""

SLOW_CHECK_PERIOD = 2
"""Ticks between two looks at where the arms are."""

LEAST_NOISE = np.radians(0.3) ** 2
"""[rad2] Of a residual: what else is wrong with the models is not noise, and does not average out."""

FRICTION_UNCERTAINTY = 0.5
"""Share of a joint's friction that counts as noise too."""

LOAD_UNCERTAINTY = 0.15
"""Share of what the hands' load does to a joint that nobody foresees: gears rub harder under load."""

MIN_MOVING_TICKS = 20
"""Ticks for which a joint must have moved: before, nobody knows what its friction holds."""


class HandLoads:
    """Recursive least squares on a random walk (a Kalman filter), four numbers an arm.

    Args:
        robot: Its description; every chain that ends in a hand is an arm.
        models: By joint, None for those without. Joints whose boards have an integral part tell nothing of loads.
    """

    def __init__(self, robot: RobotConfig, models: Sequence[FusionModel | None]) -> None:
        self._model = RobotModel(robot)
        self._arms, self._wrists = [], []
        for chain, joints in robot.chains.items():
            if joints[-1] in robot.hands.joints:
                wrist = next(joint for joint in reversed(joints) if joint not in robot.hands.joints)
                self._arms.append(chain)
                self._wrists.append(self._model.joint_id(wrist))
        # A board that sums errors up takes a load up, and nobody knows how far it had come at the start.
        tells = [m is not None and m.twin.integral_rate == 0.0 for m in models]
        gain = np.array([0.0 if m is None else m.twin.load_gain for m in models])
        self._gain = np.where(tells, gain, 0.0)
        friction = np.array([0.0 if m is None else m.twin.friction for m in models])
        self._noise = LEAST_NOISE + (FRICTION_UNCERTAINTY * friction) ** 2
        breakaway = np.array([1.0 if m is None else m.twin.breakaway for m in models])
        self._held = (breakaway * friction) ** 2
        arms = len(self._wrists)
        self._prior = np.tile(LOAD_PRIOR_STD, arms) ** 2
        self._wander = np.tile(LOAD_PROCESS_NOISE, arms) ** 2 * LEARN_PERIOD * robot.cycle / 60.0
        self.reset()

    def reset(self) -> None:
        """Empty hands, as far as anybody knows."""
        n, quantities = len(self._gain), len(self._prior)
        self._load = np.zeros(quantities)
        self._covariance = np.diag(self._prior)
        self._regressor = np.zeros((n, quantities))
        self._ticks = 0

    def step(
        self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Take in one tick; (n,) load torque of what the hands hold [N m].

        Args:
            position: (n,) measured [rad]: a weak wrist gives way by tens of degrees.
            velocity: (n,) desired [rad/s].
            acceleration: (n,) desired [rad/s2].
        """
        if self._ticks % SLOW_CHECK_PERIOD == 0:
            with np.errstate(all="ignore"):
                regressor = self._model.payload_regressor(
                    self._wrists, position, velocity, acceleration
                )
                # Not finite, or beyond what any arm can do: better the last one.
                if np.abs(regressor).max() < MAX_EFFECT:
                    self._regressor = regressor
        self._ticks += 1
        torque: FloatArray = self._regressor @ self._load
        return torque

    def variance(self) -> FloatArray:
        """(n,) of the expected tracking error, for not knowing better what the hands' load does [rad2]."""
        seen = self._regressor @ self._covariance
        unknown = np.einsum("ij,ij->i", seen, self._regressor)
        variance: FloatArray = self._gain**2 * (unknown + self._unforeseen())
        return variance

    def _unforeseen(self) -> FloatArray:
        """(n,) variance of the load torque that no estimate of the hands explains [(N m)2]."""
        torque: FloatArray = LOAD_UNCERTAINTY * (self._regressor @ self._load)
        return torque**2

    def update(self, residual: FloatArray, noise: FloatArray, use: BoolArray) -> FloatArray:
        """Learn from the residual of the last tick; (n,) how much of it that explains [rad].

        Args:
            residual: (n,) [rad].
            noise: (n,) variance of it for not knowing the joints better [rad2].
            use: (n,) joints to learn from: they move, and nothing touches them.
        """
        noise = noise + self._gain**2 * self._unforeseen()
        use = use & np.isfinite(noise)
        effect = self._regressor * np.where(use, self._gain, 0.0)[:, None]
        weighted = effect.T / np.where(use, self._noise + noise, 1.0)
        self._covariance = np.linalg.inv(np.linalg.inv(self._covariance) + weighted @ effect)
        change = self._covariance @ (weighted @ np.where(use, residual, 0.0))
        self._load = self._load + change
        # Nothing gets less certain than at the start.
        known = self._covariance.diagonal() + self._wander
        shrink = np.sqrt(np.minimum(1.0, self._prior / known))
        self._covariance = (self._covariance + np.diag(self._wander)) * shrink * shrink[:, None]
        explained: FloatArray = effect @ change
        return explained

    def reconcile(self, beyond: FloatArray, use: BoolArray) -> FloatArray | None:
        """Give up the part of the load that joints at rest contradict.

        In one posture a load in the hand and an offset of the shoulder's own model are the same to the shoulder. Their
        sum is known, and the share of each drifts. A wrist that stands still tells: its friction could not hold what
        the estimate makes it bear. The estimate then moves, along its covariance, to where friction could; it gets no
        more certain by that. A joint counts only where the load's uncertainty exceeds its friction: worn gears hold
        more than was identified, which would look like a lighter load.

        Args:
            beyond: (n,) part of the tracking error that friction cannot hold under the estimated load [rad].
            use: (n,) joints that stand still, and that nothing touches.

        Returns:
            (n,) how much of ``beyond`` is explained now [rad]; None if nothing has changed.
        """
        effect = self._regressor * self._gain[:, None]
        less = use & (beyond * (effect @ self._load) < 0.0)
        explained: FloatArray | None = None
        for joint in np.flatnonzero(less).tolist():
            row = effect[joint]
            spread = self._covariance @ row
            unknown, borne = float(row @ spread), float(row @ self._load)
            if unknown <= self._held[joint] or beyond[joint] * borne >= 0.0:
                continue
            wanted = float(np.clip(beyond[joint], -abs(borne), abs(borne)))
            self._load = self._load + spread * (wanted / unknown)
            explained = np.zeros(len(use)) if explained is None else explained
            explained[joint] = wanted
        return explained

    def held(self) -> dict[str, HandLoad]:
        """By arm, as its chain is called."""
        load, deviation = self._load.reshape(-1, 4), np.sqrt(np.diag(self._covariance))[::4]
        return {
            arm: HandLoad(
                mass=float(mass), mass_std=float(std), first_moment=(float(x), float(y), float(z))
            )
            for arm, (mass, x, y, z), std in zip(self._arms, load, deviation, strict=True)
        }
