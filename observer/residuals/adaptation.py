"""Adaptation in a session: constants of each joint, and the loads of the hands.

A body in a hand adds to the load torque of every joint between it and the wheels. The torque is linear in its mass m
and its first moment m c: tau = Y (m, m c_x, m c_y, m c_z), with Y from inverse dynamics of the desired motion. There is
one estimate per arm. It is better than a factor on the load of each joint: a wrist has hardly any load of its own, and
the shoulder learns from the elbow. The inertia about the wrist, m c^2, is neglected.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import Block, Matrix, Out, kernel
from pepper_driver.controller.model import RobotModel
from pepper_driver.observer.interface import HandLoad
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.payload import PayloadRegressor
from pepper_driver.observer.models.stick_slip import StickSlipParameters

PRIOR_STD = np.array([0.25, 0.25, 0.1, 1.0])
"""Standard deviation at the start, relative to the identified values; the offset in OFFSET_UNIT."""

LEARN_PERIOD = 10
"""Ticks between two updates."""

PROCESS_NOISE = np.array([0.04, 0.02, 0.02, 0.1])
"""Standard deviation of the change in a minute, in the same units."""

OFFSET_UNIT = np.radians(0.1)
NOISE_FACTOR = 3.0
"""Times the spread of the free residual: its errors last for many samples, but are one observation."""

WEAR_RATIO = 0.4
"""Increase of friction or lag, relative to the identified value, above which a joint is reported as worn."""


@kernel
def quadratic_form(matrix: Matrix[FloatArray], vector: FloatArray) -> float:
    """Return x' M x."""
    total = 0.0
    for i in range(len(vector)):
        product = 0.0
        for k in range(len(vector)):
            product += matrix[i, k] * vector[k]
        total += product * vector[i]
    return total


@kernel
def dot(first: FloatArray, second: FloatArray) -> float:
    """Return the scalar product of two vectors."""
    total = 0.0
    for i in range(len(first)):
        total += first[i] * second[i]
    return total


@kernel
def limit_covariance(
    covariance: Out[Matrix[FloatArray]], prior: FloatArray, process_noise: FloatArray
) -> None:
    """Add the variances of the process noise; no variance may exceed that of the start.

    Without motion only the process noise acts. ``prior`` are the standard deviations at the start.
    """
    n = len(prior)
    shrink = np.empty(n)
    for i in range(n):
        covariance[i, i] += process_noise[i]
        shrink[i] = math.sqrt(min(1.0, prior[i] ** 2 / max(covariance[i, i], 1e-12)))
    for i in range(n):
        for k in range(n):
            covariance[i, k] *= shrink[i] * shrink[k]


@kernel
def _effects(
    lag: FloatArray,
    friction: FloatArray,
    velocity: FloatArray,
    load: FloatArray,
    effects: Out[Matrix[FloatArray]],
) -> None:
    for j in range(len(effects)):
        effects[j, 0] = friction[j]
        effects[j, 1] = lag[j] * velocity[j]
        effects[j, 2] = load[j]
        effects[j, 3] = OFFSET_UNIT


@kernel
def _variance(
    covariance: Block[FloatArray], effects: Matrix[FloatArray], variance: Out[FloatArray]
) -> None:
    for j in range(len(variance)):
        variance[j] = quadratic_form(covariance[j], effects[j])


@kernel
def _update(
    covariance: Out[Block[FloatArray]],
    deviation: Out[Matrix[FloatArray]],
    prior: FloatArray,
    process_noise: FloatArray,
    noise: FloatArray,
    residual: FloatArray,
    effects: Matrix[FloatArray],
    other: FloatArray,
    free: BoolArray,
) -> None:
    seen = np.empty(4)
    for j in range(len(residual)):
        p, e = covariance[j], effects[j]
        for i in range(4):
            seen[i] = dot(p[i], e)
        scale = noise[j] + other[j] + dot(e, seen)
        # A joint without a model has a scale of NaN, which would spoil its covariance.
        if free[j] and math.isfinite(scale):
            for i in range(4):
                gain = seen[i] / scale
                # A long touch that looks like free motion must not make a model useless.
                changed = deviation[j, i] + gain * residual[j]
                deviation[j, i] = min(max(changed, -3.0 * prior[i]), 3.0 * prior[i])
                for k in range(4):
                    p[i, k] -= gain * seen[k]
        limit_covariance(p, prior, process_noise)


class Adaptation:
    """Recursive least squares with forgetting (a Kalman filter on a random walk), four numbers per joint.

    Args:
        models: By joint, None for those without.
        spread: (n,) standard deviation of the residual in free motion [rad].
        cycle: Period of the ticks [s].
        process_noise: (4,) standard deviation of the random walk within a minute, in the units of PRIOR_STD.

    Attributes:
        deviation: (n, 4) deviation of friction, lag, load and offset from their identified values, in the units of
            PRIOR_STD.
    """

    def __init__(
        self,
        models: list[StickSlipParameters | None],
        spread: FloatArray,
        cycle: float,
        *,
        process_noise: FloatArray = PROCESS_NOISE,
    ) -> None:
        self._lag = np.array([np.nan if m is None else m.lag for m in models])
        self._noise = (NOISE_FACTOR * spread) ** 2
        self._process_noise = process_noise**2 * LEARN_PERIOD * cycle / 60.0
        self._effects, self._variance, self._update = (
            _effects.load(),
            _variance.load(),
            _update.load(),
        )
        self.reset()

    def reset(self) -> None:
        """Return to the identified values."""
        n = len(self._lag)
        self.deviation = np.zeros((n, 4))
        self._covariance = np.tile(np.diag(PRIOR_STD**2), (n, 1, 1))

    def effects(self, friction: FloatArray, velocity: FloatArray, load: FloatArray) -> FloatArray:
        """Return the (n, 4) effects of a deviation of 1 on the tracking error [rad].

        Args:
            friction: (n,) on the stick-slip models [rad].
            velocity: (n,) of the stick-slip models [rad/s].
            load: (n,) g tau_ld [rad].
        """
        effects = np.empty((len(load), 4))
        self._effects(self._lag, friction, velocity, load, effects)
        return effects

    def variance(self, effects: FloatArray) -> FloatArray:
        """Return the (n,) variance of the expected tracking error that the unknown deviations cause [rad2]."""
        variance = np.empty(len(effects))
        self._variance(self._covariance, effects, variance)
        return variance

    def update(
        self, residual: FloatArray, effects: FloatArray, other: FloatArray, free: BoolArray
    ) -> None:
        """Learn from the last tick.

        Args:
            residual: (n,) [rad].
            effects: (n, 4) of each quantity.
            other: (n,) variance of the residual from other causes [rad2].
            free: (n,) joints without touch.
        """
        self._update(
            self._covariance,
            self.deviation,
            PRIOR_STD,
            self._process_noise,
            self._noise,
            residual,
            effects,
            other,
            free,
        )

    @property
    def worn(self) -> BoolArray:
        """(n,) True where friction or lag has grown beyond WEAR_RATIO, by two standard deviations of its estimate."""
        spread = np.sqrt(np.maximum(np.einsum("nii->ni", self._covariance)[:, :2], 0.0))
        grown: BoolArray = (self.deviation[:, :2] - 2.0 * spread > WEAR_RATIO).any(axis=1)
        return grown


LOAD_PRIOR_STD = np.array([0.3, 0.03, 0.03, 0.03])
"""Standard deviation of mass [kg] and first moment [kg m] at the start."""

LOAD_PROCESS_NOISE = np.array([0.02, 0.002, 0.002, 0.002])
"""Standard deviation of their change in a minute without contact."""

MAX_EFFECT = 200.0
"""[N m] per kilogram and per kilogram metre: an arm of one metre at twenty times gravity."""

ARM_CHECK_TICKS = 2
"""Ticks between two computations of the regressor."""

MIN_NOISE = np.radians(0.3) ** 2
"""[rad2] Smallest variance of a residual: errors of the models do not average out as noise does."""

FRICTION_UNCERTAINTY = 0.5
"""Fraction of the friction of a joint that counts as noise too."""

LOAD_UNCERTAINTY = 0.15
"""Fraction of the effect of a load that cannot be predicted: gears have more friction under load."""

MIN_MOVING_TICKS = 20
"""Ticks for which a joint must have moved: before, the direction of its friction is unknown."""


@kernel
def _load_torque(regressor: Matrix[FloatArray], load: FloatArray, torque: Out[FloatArray]) -> None:
    for j in range(len(torque)):
        torque[j] = dot(regressor[j], load)


@kernel
def _load_variance(
    regressor: Matrix[FloatArray],
    load: FloatArray,
    covariance: Matrix[FloatArray],
    gain: FloatArray,
    uncertainty: float,
    variance: Out[FloatArray],
) -> None:
    for j in range(len(variance)):
        unknown = quadratic_form(covariance, regressor[j])
        unpredicted = uncertainty * dot(regressor[j], load)
        variance[j] = gain[j] ** 2 * (unknown + unpredicted**2)


@kernel
def _learn_load(
    regressor: Matrix[FloatArray],
    load: Out[FloatArray],
    covariance: Out[Matrix[FloatArray]],
    gain: FloatArray,
    uncertainty: float,
    prior: FloatArray,
    process_noise: FloatArray,
    residual: FloatArray,
    noise: FloatArray,
    use: BoolArray,
    explained: Out[FloatArray],
) -> None:
    """Learn from the residuals of all joints, one after the other: the order does not matter."""
    n = len(load)
    change, seen = np.zeros(n), np.empty(n)
    for j in range(len(residual)):
        if not (use[j] and math.isfinite(noise[j])):
            continue
        unpredicted = uncertainty * dot(regressor[j], load)
        variance = noise[j] + gain[j] ** 2 * unpredicted**2
        for i in range(n):
            seen[i] = gain[j] * dot(covariance[i], regressor[j])
        variance += gain[j] * dot(regressor[j], seen)
        surprise = residual[j] - gain[j] * dot(regressor[j], change)
        for i in range(n):
            change[i] += seen[i] / variance * surprise
            for k in range(n):
                covariance[i, k] -= seen[i] / variance * seen[k]
    for j in range(len(residual)):
        learned = use[j] and math.isfinite(noise[j])
        explained[j] = gain[j] * dot(regressor[j], change) if learned else 0.0
    for i in range(n):
        load[i] += change[i]
    limit_covariance(covariance, prior, process_noise)


@kernel
def _reconcile(
    regressor: Matrix[FloatArray],
    load: Out[FloatArray],
    covariance: Matrix[FloatArray],
    gain: FloatArray,
    friction: FloatArray,
    beyond: FloatArray,
    use: BoolArray,
    explained: Out[FloatArray],
) -> bool:
    """Return True if a joint, with its (n,) ``friction`` at rest [rad], contradicts the load."""
    n, changed = len(load), False
    before, effect, spread = load.copy(), np.empty(n), np.empty(n)
    for j in range(len(beyond)):
        explained[j] = 0.0
        for i in range(n):
            effect[i] = gain[j] * regressor[j, i]
        if not (use[j] and beyond[j] * dot(effect, before) < 0.0):
            continue
        for i in range(n):
            spread[i] = dot(covariance[i], effect)
        unknown, droop = dot(effect, spread), dot(effect, load)
        if unknown <= friction[j] ** 2 or beyond[j] * droop >= 0.0:
            continue
        # No further than to zero load: the contradiction is no evidence of a load of the other sign.
        correction = min(max(beyond[j], -abs(droop)), abs(droop))
        for i in range(n):
            load[i] += spread[i] * (correction / unknown)
        explained[j], changed = correction, True
    return changed


class HandLoads:
    """Recursive least squares on a random walk (a Kalman filter), four numbers per arm.

    Args:
        robot: Its description; every chain that ends in a hand is an arm.
        models: By joint, None for those without. Joints whose motor boards integrate errors do not show loads.
        process_noise: (4,) standard deviation of the random walk of a load within a minute [kg, kg m, kg m, kg m].
        uncertainty: Standard deviation of a load's torque that no estimate explains, as a fraction of it.
    """

    def __init__(
        self,
        robot: RobotConfig,
        models: Sequence[FusionModel | None],
        *,
        process_noise: FloatArray = LOAD_PROCESS_NOISE,
        uncertainty: float = LOAD_UNCERTAINTY,
    ) -> None:
        self._uncertainty = uncertainty
        self._arms, wrists = [], []
        for chain, joints in robot.chains.items():
            if joints[-1] in robot.hands.joints:
                wrist = next(joint for joint in reversed(joints) if joint not in robot.hands.joints)
                self._arms.append(chain)
                wrists.append(wrist)
        self._payloads = PayloadRegressor(RobotModel(robot), wrists)
        # The integral of a motor board cancels the droop of a load, and its value at the start is unknown.
        shows_load = [m is not None and m.twin.integral_rate == 0.0 for m in models]
        gain = np.array([0.0 if m is None else m.twin.load_gain for m in models])
        self._gain = np.where(shows_load, gain, 0.0)
        friction = np.array([0.0 if m is None else m.twin.friction for m in models])
        self._noise = MIN_NOISE + (FRICTION_UNCERTAINTY * friction) ** 2
        breakaway = np.array([1.0 if m is None else m.twin.breakaway for m in models])
        self._friction = breakaway * friction
        arms = len(wrists)
        self._prior = np.tile(LOAD_PRIOR_STD, arms)
        self._process_noise = np.tile(process_noise, arms) ** 2 * LEARN_PERIOD * robot.cycle / 60.0
        self._load_torque, self._load_variance = _load_torque.load(), _load_variance.load()
        self._learn, self._reconcile = _learn_load.load(), _reconcile.load()
        self.reset()

    def reset(self) -> None:
        """Return to empty hands."""
        n, quantities = len(self._gain), len(self._prior)
        self._load = np.zeros(quantities)
        self._covariance = np.diag(self._prior**2)
        self._regressor = np.zeros((n, quantities))
        self._ticks = 0

    def step(
        self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Take in one tick; return the (n,) load torque of the hands' loads [N m].

        Args:
            position: (n,) measured [rad]: a load moves a weak wrist by tens of degrees.
            velocity: (n,) desired [rad/s].
            acceleration: (n,) desired [rad/s2].
        """
        if self._ticks % ARM_CHECK_TICKS == 0:
            regressor = self._payloads.compute(position, velocity, acceleration)
            # Only bad samples give values that are not finite or larger than an arm allows.
            if np.abs(regressor).max() < MAX_EFFECT:
                self._regressor = regressor
        self._ticks += 1
        torque = np.empty(len(position))
        self._load_torque(self._regressor, self._load, torque)
        return torque

    def variance(self) -> FloatArray:
        """Return the (n,) variance of the expected tracking error that the unknown loads cause [rad2]."""
        variance = np.empty(len(self._gain))
        self._load_variance(
            self._regressor, self._load, self._covariance, self._gain, self._uncertainty, variance
        )
        return variance

    def update(self, residual: FloatArray, noise: FloatArray, use: BoolArray) -> FloatArray:
        """Learn from the residual of the last tick; return the (n,) part of it that is now explained [rad].

        Args:
            residual: (n,) [rad].
            noise: (n,) variance of it that the unknown constants of the joints cause [rad2].
            use: (n,) joints to learn from: they move without touch.
        """
        explained = np.empty(len(residual))
        self._learn(
            self._regressor,
            self._load,
            self._covariance,
            self._gain,
            self._uncertainty,
            self._prior,
            self._process_noise,
            residual,
            self._noise + noise,
            use,
            explained,
        )
        return explained

    def reconcile(self, beyond: FloatArray, use: BoolArray) -> FloatArray | None:
        """Remove the part of the load that joints at rest contradict.

        In one posture a load in the hand and an offset of the shoulder's own model have the same effect on the
        shoulder. Their sum is known, but their split drifts. A wrist at rest shows the drift: its friction could not
        hold the estimated load. The estimate then moves, along its covariance, to a load that friction could hold; its
        covariance does not change. A joint counts only where the uncertainty of the load exceeds its friction: worn
        gears hold more than was identified, which would look like a lighter load.

        Args:
            beyond: (n,) part of the tracking error that friction cannot hold under the estimated load [rad].
            use: (n,) joints at rest without touch.

        Returns:
            (n,) part of ``beyond`` that is explained now [rad]; None if nothing has changed.
        """
        explained = np.empty(len(use))
        changed = self._reconcile(
            self._regressor,
            self._load,
            self._covariance,
            self._gain,
            self._friction,
            beyond,
            use,
            explained,
        )
        return explained if changed else None

    def by_arm(self) -> dict[str, HandLoad]:
        """Return the loads by arm, with the names of the chains."""
        load, deviation = self._load.reshape(-1, 4), np.sqrt(np.diag(self._covariance))[::4]
        return {
            arm: HandLoad(
                mass=float(mass), mass_std=float(std), first_moment=(float(x), float(y), float(z))
            )
            for arm, (mass, x, y, z), std in zip(self._arms, load, deviation, strict=True)
        }
