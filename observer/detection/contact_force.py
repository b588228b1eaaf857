"""Force of a contact on a limb, and its point: fitted to the torque estimates of all joints of the limb."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pepper_driver.config import RobotConfig, SelfCollisionSettings
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.self_collision import Capsule
from pepper_driver.controller.model import RobotModel
from pepper_driver.observer.residuals.torque_scale import TorqueScale

SPACING = 0.04
"""[m] Distance of the candidate points along a link, at most."""

SIZES = (2.0, 4.0, 8.0, 16.0, 32.0)
"""[N] Sizes of forces that are as likely beforehand: rms of a force in any direction."""

MIN_STD = 0.02
"""[N m] Standard deviation that every torque has: levers are not known better."""

MIN_JOINTS = 2
"""A force is determined by at least so many joints whose current shows their torque."""

DRAWS = 32
"""Samples of each component, of which the interval follows."""

MIN_WEIGHT = 0.01
"""Of the largest, below which a component does not count for the interval."""

COVERAGE = 0.9
"""Probability with which the interval has the size of the force."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactForce:
    """Force of a contact and its place, in the axes of base_link.

    Attributes:
        vector: (3,) on the robot [N]; its length is the median of the size, its direction that of the mean.
        covariance: (3, 3) [N2].
        interval: Least and largest size with a probability of COVERAGE [N].
        point: (3,) on the axis of its link [m].
        point_covariance: (3, 3) [m2].
        scale_known: True if a known weight has shown the scale of all torques that it is fitted to, but that of the
            wrist, which a weight hardly loads.
        torques: By index of a joint that it is fitted to and whose current shows its torque, its torque there, signed
            [N m], and the standard deviation. Where no force explains the torques, those that were measured.
    """

    vector: FloatArray
    covariance: FloatArray
    interval: tuple[float, float]
    point: FloatArray
    point_covariance: FloatArray
    scale_known: bool
    torques: dict[int, tuple[float, float]]

    def largest(self, stds: float = 0.0) -> int | None:
        """Return the index of the joint on which its torque is largest, of those beyond so many standard deviations."""
        certain = [j for j, (torque, std) in self.torques.items() if abs(torque) >= stds * std]
        return max(certain, key=lambda joint: abs(self.torques[joint][0]), default=None)


@dataclass(frozen=True, kw_only=True, eq=False)
class _LinkPoints:
    """Candidate points of one link, in its frame.

    Attributes:
        link: Its name.
        points: (m, 3) on the axes of its capsules [m].
        surface: (m, 3, 3) covariance of the surface around them [m2].
        radius: (m,) of the capsules [m].
        spacing: (m,) distance of the neighbours [m].
    """

    link: str
    points: FloatArray
    surface: FloatArray
    radius: FloatArray
    spacing: FloatArray


class ForceEstimator:
    """Estimate of the force of a contact on a limb by its joint torques.

    The points on which a force may act are those of the capsules of the robot's description. At each of them the force
    follows from the torques by weighted least squares, with a size that is known beforehand to some degree (SIZES). How
    well a point and a size explain the torques is their weight; force and point are means over them. A direction in
    which no joint turns, and a place between which the joints cannot choose, thus show in the covariances.

    Left out are joints whose current does not show their torque, and those of the hands. Wrists count in any case: a
    force on the surface of the hand turns the wrist, one on the forearm does not.

    Args:
        robot: Its description.
        capsules: Capsules of its links.
        scale: Scale of the torques.
    """

    def __init__(
        self, robot: RobotConfig, capsules: SelfCollisionSettings, scale: TorqueScale
    ) -> None:
        self._model, self._scale = RobotModel(robot), scale
        self._draws = _normal_draws(DRAWS)
        self._joints: dict[str, list[int]] = {}
        self._wrists: set[int] = set()
        self._points: dict[str, list[_LinkPoints]] = {}
        for limb, chain in robot.limbs.items():
            moving = [name for name in chain if name not in robot.hands.joints]
            indices = [robot.joint_index(name) for name in moving]
            if len(moving) < len(chain):
                self._wrists.add(indices[-1])
            self._joints[limb] = [j for j in indices if scale.by_current[j] or j in self._wrists]
            links = [robot.joints[j].child for j in indices]
            self._points[limb] = [
                _sample(link, capsules.capsules[link])
                for link in links
                if link in capsules.capsules
            ]

    def estimate(
        self,
        limb: str,
        torque: FloatArray,
        torque_std: FloatArray,
        usable: BoolArray,
        position: FloatArray,
    ) -> ContactForce | None:
        """Fit a force to the torques of a limb.

        Args:
            limb: Name of the limb.
            torque: (n,) external torques [N m].
            torque_std: (n,) their standard deviation without that of their scale [N m].
            usable: (n,) joints that can be judged.
            position: (n,) measured [rad].

        Returns:
            None where fewer than MIN_JOINTS joints of the limb show their torque by a current, or its description has
            no points.
        """
        joints = [
            j for j in self._joints[limb] if usable[j] and np.isfinite(torque[j] + torque_std[j])
        ]
        parts = self._points[limb]
        if self._scale.by_current[joints].sum() < MIN_JOINTS or not parts:
            return None
        if not np.isfinite(position).all():
            return None
        placed = [self._model.place_points(part.link, part.points, position) for part in parts]
        points = np.concatenate([place for place, _, _ in placed])
        jacobians = np.concatenate([jacobian[:, :, joints] for _, jacobian, _ in placed])
        surface = np.concatenate(
            [
                lever_variance(part.surface, axes[:, joints])
                for part, (_, _, axes) in zip(parts, placed, strict=True)
            ]
        )
        radius = np.concatenate([part.radius for part in parts])
        spacing = np.concatenate([part.spacing for part in parts])
        measured = torque[joints]
        variance = np.maximum(torque_std[joints], MIN_STD) ** 2
        variance += (self._scale.std[joints] * measured) ** 2
        levers = jacobians.transpose(0, 2, 1)
        fits = fit_forces(levers, measured, variance, surface)
        excess = fits.misfit / len(joints)
        if excess > 1.0:
            # No force at one place explains these torques: they are less certain than they seem.
            fits = fit_forces(levers, measured, excess * variance, surface)
        force = self._average(fits, points, radius, spacing, levers, joints)
        if excess > 1.0:
            force = replace(force, torques=self._torques(joints, measured, torque_std[joints]))
        return force

    def _average(
        self,
        fits: ForceFits,
        points: FloatArray,
        radius: FloatArray,
        spacing: FloatArray,
        levers: FloatArray,
        joints: Sequence[int],
    ) -> ContactForce:
        weight = fits.weight
        mean, covariance = _mixture(weight, fits.mean, fits.covariance)
        low, middle, high = self._sizes(fits)
        length = float(np.linalg.norm(mean))
        at_point = weight.reshape(len(points), -1).sum(axis=1)
        around = (radius**2 / 3.0 + spacing**2 / 12.0)[:, None, None] * np.eye(3)
        point, point_covariance = _mixture(at_point, points, around)
        levers = np.repeat(levers, len(weight) // len(points), axis=0)  # of each component
        torque, torque_covariance = _mixture(
            weight,
            (levers @ fits.mean[..., None])[..., 0],
            levers @ fits.covariance @ levers.transpose(0, 2, 1),
        )
        torque_std = np.sqrt(np.diagonal(torque_covariance))
        return ContactForce(
            vector=mean * (middle / length) if length > 0.0 else mean,
            covariance=covariance,
            interval=(low, high),
            point=point,
            point_covariance=point_covariance,
            scale_known=bool(self._scale.known[[j for j in joints if j not in self._wrists]].all()),
            torques=self._torques(joints, torque, torque_std),
        )

    def _torques(
        self, joints: Sequence[int], torque: FloatArray, std: FloatArray
    ) -> dict[int, tuple[float, float]]:
        """Return torques and their standard deviations by joint, of joints whose current shows them [N m]."""
        found = zip(joints, torque.tolist(), std.tolist(), strict=True)
        return {j: (value, spread) for j, value, spread in found if self._scale.by_current[j]}

    def _sizes(self, fits: ForceFits) -> tuple[float, float, float]:
        """Return least, median and largest size of the force [N]."""
        likely = fits.weight > MIN_WEIGHT * fits.weight.max()
        roots = np.linalg.cholesky(fits.covariance[likely])
        forces = fits.mean[likely, None] + self._draws @ roots.transpose(0, 2, 1)
        sizes = np.sqrt(np.einsum("cdi,cdi->cd", forces, forces)).ravel()
        order = np.argsort(sizes)
        cumulative = np.cumsum(np.repeat(fits.weight[likely], len(self._draws))[order])
        tail = 0.5 * (1.0 - COVERAGE)
        places = np.searchsorted(cumulative, cumulative[-1] * np.array((tail, 0.5, 1.0 - tail)))
        low, middle, high = sizes[order[places]].tolist()
        return low, middle, high


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceFits:
    """Forces at m points with k sizes that are assumed beforehand, (m k,) components, sizes of one point in sequence.

    Attributes:
        weight: (m k,) probability.
        mean: (m k, 3) [N].
        covariance: (m k, 3, 3) [N2].
        misfit: Least sum of squares of a component, over their variances.
    """

    weight: FloatArray
    mean: FloatArray
    covariance: FloatArray
    misfit: float


def fit_forces(
    levers: FloatArray,
    torque: FloatArray,
    variance: FloatArray,
    surface: FloatArray,
    sizes: Sequence[float] = SIZES,
) -> ForceFits:
    """Fit a force at each point to joint torques.

    Args:
        levers: (m, n, 3) torque on each joint per force at each point [m].
        torque: (n,) measured [N m].
        variance: (n,) of it [N2 m2].
        surface: (m, n) variance of the levers to the surface around each point [m2]: the force acts there.
        sizes: (k,) that are assumed beforehand [N].
    """
    size = np.asarray(sizes)
    noise = variance + surface[:, None] * size[:, None] ** 2  # (m, k, n)
    prior = 3.0 / size**2  # per axis [1/N2]
    weighted = levers[:, None] / noise[..., None]  # (m, k, n, 3)
    precision = weighted.transpose(0, 1, 3, 2) @ levers[:, None]
    precision += prior[None, :, None, None] * np.eye(3)
    covariance = np.linalg.inv(precision)
    pull = torque @ weighted  # (m, k, 3)
    mean = (covariance @ pull[..., None])[..., 0]
    misfit = (torque**2 / noise).sum(axis=2) - (pull * mean).sum(axis=2)
    log_weight = -0.5 * (
        misfit + np.log(noise).sum(axis=2) + np.log(np.linalg.det(precision)) - 3.0 * np.log(prior)
    )
    weight = np.exp(log_weight - log_weight.max()).ravel()
    return ForceFits(
        weight=weight / weight.sum(),
        mean=mean.reshape(-1, 3),
        covariance=covariance.reshape(-1, 3, 3),
        misfit=float(misfit.min()),
    )


def lever_variance(surface: FloatArray, axes: FloatArray) -> FloatArray:
    """Return the variance of the levers of joints to a surface, for forces in any direction.

    A force f at a place d off the point has the torque (d x f) a about an axis a. Its variance is that of f along each
    axis times the mean of (a x d)^2.

    Args:
        surface: (m, 3, 3) covariance of d around each point [m2].
        axes: (3, n) of the joints, 0 where a joint does not carry the points.

    Returns:
        (m, n), torque per size of the force [m2].
    """
    size = np.trace(surface, axis1=1, axis2=2)[:, None] * (axes**2).sum(axis=0)
    along = np.einsum("in,mij,jn->mn", axes, surface, axes)
    variance: FloatArray = (size - along) / 3.0
    return variance


def _mixture(
    weight: FloatArray, means: FloatArray, covariances: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of a mixture."""
    mean = weight @ means
    off = means - mean
    covariance = np.einsum("c,cij->ij", weight, covariances) + (weight[:, None] * off).T @ off
    return mean, covariance


def _sample(link: str, capsules: Sequence[Capsule]) -> _LinkPoints:
    """Return points along the axes of the capsules of a link."""
    points, surface, radius, spacing = [], [], [], []
    for capsule in capsules:
        start, end = np.array(capsule.start), np.array(capsule.end)
        length = float(np.linalg.norm(end - start))
        count = 1 + int(np.ceil(length / SPACING))
        points.append(np.linspace(start, end, count))
        around = np.eye(3) / 3.0  # of a ball
        if length > 0.0:
            along = (end - start) / length
            around = 0.5 * (np.eye(3) - np.outer(along, along))
        surface += [capsule.radius**2 * around] * count
        radius += [capsule.radius] * count
        spacing += [length / max(count - 1, 1)] * count
    return _LinkPoints(
        link=link,
        points=np.concatenate(points),
        surface=np.array(surface),
        radius=np.array(radius),
        spacing=np.array(spacing),
    )


def _normal_draws(count: int) -> FloatArray:
    """Return (count, 3) samples of a standard normal, the same in every session: pairs of opposite ones."""
    half = np.random.default_rng(0).standard_normal((count // 2, 3))
    draws = np.concatenate((half, -half))
    # Exact second moments: a few samples must not make a force more certain.
    root = np.linalg.cholesky(draws.T @ draws / count)
    scaled: FloatArray = draws @ np.linalg.inv(root).T
    return scaled
