"""Identification of the constants of a stick-slip model from recordings of free motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import make_records
from pepper_driver.observer.fitting.samples import fit_samples
from pepper_driver.observer.fitting.tree import FittingError
from pepper_driver.observer.models.stick_slip import (
    MAX_TRANSPORT,
    MIN_TRANSPORT,
    NO_LIMIT,
    PARAMETERS,
    WEAK_GAIN,
    StickSlipModel,
    StickSlipParameters,
)
from pepper_driver.observer.recording import Recording

START_UP_TIME = 0.6
"""[s] at the start of a run that do not count: the friction with which the joint rests is unknown."""

LOSS_SCALE = np.radians(0.15)
"""[rad] Above it errors count linearly, no longer by their square: rare slips must not determine a constant."""

MIN_IMPROVEMENT = 0.05
"""Fraction by which a further constant must reduce the cost."""

MIN_LOAD_EFFECT = np.radians(0.05)
"""[rad] of tracking error: of a smaller load the current is the better measure of the stiffness."""

FIT_REST_SPEED = 0.03
"""[rad/s] Desired speed below which the error is that at rest."""

SLIDING_SPEED = 0.3
"""[rad/s] Desired speed from which a joint slides: its motor turns as fast as the joint is to."""

STEADY_ACCELERATION = 1.0
"""[rad/s2] Desired acceleration up to which the motor drives the joint."""

_STEP = 1e-3
"""Of finite differences, in units of the scales below."""

_OPTIONAL = (("integral_rate",), ("dead_band",), ("integral_rate", "dead_band"))
_FITTED = tuple(name for name in PARAMETERS if name != "target_speed")
_REQUIRED = tuple(name for name in _FITTED if name not in ("integral_rate", "dead_band"))


@dataclass(frozen=True)
class _Range:
    """Range of a constant; ``natural`` where joints may well have the lower bound itself."""

    lower: float
    upper: float
    scale: float
    natural: bool = False


_RANGES = {
    "inertia": _Range(0.0, 0.05, 5e-4, natural=True),
    "lag": _Range(0.0, 0.3, 0.02),
    "friction": _Range(0.0, 0.1, 0.005, natural=True),
    "load_friction": _Range(0.0, 0.5, 0.05, natural=True),
    "breakaway": _Range(1.0, 2.0, 0.1, natural=True),
    "load_gain": _Range(1e-4, 5.0, 0.005),
    "offset": _Range(-0.03, 0.03, 0.002),
    "dead_band": _Range(0.0, 0.02, 0.002, natural=True),
    "integral_rate": _Range(0.02, 3.0, 0.1, natural=True),
    "transport": _Range(MIN_TRANSPORT, MAX_TRANSPORT, 0.3),
}

STARTS = tuple(
    {
        "inertia": inertia,
        "lag": lag,
        "friction": friction,
        "load_friction": load_friction,
        "breakaway": breakaway,
        "load_gain": 0.005,
        "offset": 0.0,
        "dead_band": 0.002,
        "integral_rate": 0.2,
        "transport": 0.0,
    }
    for inertia, lag, friction, load_friction, breakaway in (
        (1e-3, 0.06, 0.012, 0.05, 1.4),
        (1e-3, 0.02, 0.004, 0.1, 1.6),
        (2e-4, 0.02, 0.025, 0.1, 1.2),
    )
)
"""Constants from which the fit begins, the best end counts: round numbers over the range of robots, of no plant's own.

From a single start one joint in ten ends in a poor local minimum.
"""


AT_BOUND = 0.05
"""Distance from a bound, in units of the scales above, within which a constant counts as there."""


@dataclass(frozen=True, kw_only=True)
class BoundedConstant:
    """Constant that the fit would have moved further.

    Attributes:
        name: Of the constant.
        bound: Where it stopped.
        side: Which bound this is.
    """

    name: str
    bound: float
    side: Literal["lower", "upper"]


def bounded_constants(parameters: StickSlipParameters) -> tuple[BoundedConstant, ...]:
    """Return the constants at a bound of the fit that is no natural value: the model then lacks something."""
    found = []
    for name, r in _RANGES.items():
        side = _side_of_bound(name, getattr(parameters, name))
        if side == "upper" or (side == "lower" and not r.natural):
            found.append(BoundedConstant(name=name, bound=getattr(r, side), side=side))
    return tuple(found)


def _side_of_bound(name: str, value: float) -> Literal["lower", "upper"] | None:
    """Return which bound of its range a constant is at; None where it is at none."""
    r = _RANGES[name]
    near = AT_BOUND * r.scale
    if value >= r.upper - near:
        return "upper"
    return "lower" if value <= r.lower + near else None


class _Runs:
    """Recordings of one joint as columns, the shorter ones extended by their last sample."""

    def __init__(
        self, joint: str, recordings: Sequence[Recording], cycle: float, target_speed: float
    ) -> None:
        length = max(len(recording) for recording in recordings)
        columns = [(r, r.joint_names.index(joint)) for r in recordings]

        def columns_of(name: str) -> FloatArray:
            return np.stack(
                [
                    np.pad(getattr(r, name)[:, i], (0, length - len(r)), mode="edge")
                    for r, i in columns
                ],
                axis=1,
            )

        self.cycle = cycle
        self._target_speed = target_speed
        self.target = columns_of("sent_position")
        self.load_torque = columns_of("load_torque")
        self.position = columns_of("position")
        # Padded samples do not count, but the simulation must run over them.
        self.counts = np.zeros(self.position.shape, dtype=np.bool_)
        for run, (recording, index) in enumerate(columns):
            self.counts[: len(recording), run] = fit_samples(recording, index)
        self.counts[: round(START_UP_TIME / cycle)] = False
        self.current = columns_of("current")
        self.velocity = columns_of("velocity")
        speed = np.abs(self.velocity)
        self.slow = self.counts & (speed < FIT_REST_SPEED)
        steady = np.abs(columns_of("acceleration")) < STEADY_ACCELERATION
        self.sliding = self.counts & (speed > SLIDING_SPEED) & steady

    def load_gain_at_rest(self, torque_constant: float) -> float | None:
        """Return 1 / K [rad/(N m)] if the current follows from the error alone; None without current.

        Args:
            torque_constant: N Kt [N m/A].
        """
        current = self.current[self.slow]
        error = np.abs(self.target - self.position)[self.slow]
        power = float(current @ current)
        gain = float(current @ error) / power / torque_constant if power > 0.0 else 0.0
        return gain if gain > 0.0 else None

    def load_gain_sliding(self, torque_constant: float, resistance: float) -> float | None:
        """Return 1 / K [rad/(N m)] of a joint without load while it slides; None if it does not show.

        The voltage of its board, R i + N Ke v, grows by Kp with the error, beyond a dead band; K = Kp N Kt / R
        (Eq. 1 and 2 of the paper, with Ke = Kt).

        Args:
            torque_constant: N Kt [N m/A].
            resistance: R [ohm].
        """
        velocity = self.velocity[self.sliding]
        if len(velocity) < 2:
            return None
        error = np.sign(velocity) * (self.target - self.position)[self.sliding]
        voltage = resistance * self.current[self.sliding] + torque_constant * np.abs(velocity)
        (power, product), _ = np.cov(error, voltage)
        return float(resistance * power / (product * torque_constant)) if product > 0.0 else None

    def simulate(self, parameters: Mapping[str, FloatArray]) -> FloatArray:
        """Simulate p sets of parameters (p,) on all r runs; return (p, n, r) positions [rad]."""
        sets = len(parameters["lag"])
        constants = make_records(
            StickSlipParameters, sets, **parameters, target_speed=self._target_speed
        )
        model, positions = (
            StickSlipModel(constants, self.cycle),
            np.empty((sets, *self.target.shape)),
        )
        for number in range(sets):
            for run, start in enumerate(self.position[0].tolist()):
                states = model.play(number, start, self.target[:, run], self.load_torque[:, run])
                positions[number, :, run] = states["position"]
        return positions


def fit_stick_slip(
    joint: str,
    recordings: Sequence[Recording],
    cycle: float,
    *,
    torque_constant: float | None = None,
    resistance: float | None = None,
    target_speed: float = NO_LIMIT,
) -> StickSlipParameters:
    """Fit a stick-slip model by least squares of its position against the encoder, over whole runs.

    A dead band looks much like friction, and an integral part like neither droop nor friction. Each is included only if
    it reduces the cost by MIN_IMPROVEMENT, and does not end at a bound.

    Args:
        joint: Name of the joint.
        recordings: Runs of its free motion.
        cycle: Period of the ticks [s].
        torque_constant: Kt N, of motor and gear [N m/A]. With it, current over error at rest determines the stiffness
            of a joint with hardly any load.
        resistance: Of the motor [ohm]. With it, the current in motion determines the stiffness of a joint as weak as a
            wrist.
        target_speed: Largest speed of the board's target [rad/s], which is measured and not fitted.

    Raises:
        FittingError: No sample counts.
    """
    runs = _Runs(joint, recordings, cycle, target_speed)
    if not runs.counts.any():
        raise FittingError(
            f"{joint}: none of its samples counts: it falls behind in all of its runs, or they are altered or stale"
        )
    fit = _Fit(runs, torque_constant, resistance)
    starts = fit.starts()
    best, cost = min((fit.solve(_REQUIRED, start) for start in starts), key=lambda end: end[1])
    for optional in _OPTIONAL:
        candidate, candidate_cost = fit.solve((*_REQUIRED, *optional), starts[0] | best)
        # One that ends at a bound stands for something else: a dead band as wide as can be, for friction.
        inside = not any(_side_of_bound(name, candidate[name]) for name in optional)
        if inside and candidate_cost < (1.0 - MIN_IMPROVEMENT) * cost:
            best, cost = candidate, candidate_cost
            break
    constants = {name: best.get(name, 0.0) for name in _FITTED}
    return StickSlipParameters(**constants, target_speed=target_speed)


class _Fit:
    """Least-squares problem of one joint."""

    def __init__(
        self, runs: _Runs, torque_constant: float | None, resistance: float | None
    ) -> None:
        self._runs = runs
        self._measured = runs.position[runs.counts]
        self._load_gain, self._known = None, {}
        if torque_constant is not None:
            self._load_gain = runs.load_gain_at_rest(torque_constant)
            if resistance is not None and (self._load_gain or 0.0) > WEAK_GAIN:
                sliding = runs.load_gain_sliding(torque_constant, resistance)
                if sliding is not None:
                    self._load_gain = None
                    gain = min(sliding, _RANGES["load_gain"].upper)
                    self._known = {"load_gain": gain, "load_friction": 0.0}
        weight = len(self._measured) ** 0.5 * MIN_LOAD_EFFECT / LOSS_SCALE
        self._prior_weight = 0.0 if self._load_gain is None else weight

    def starts(self) -> list[dict[str, float]]:
        """Return what to begin from: where currents show the stiffness, it begins there."""
        shown = {} if self._load_gain is None else {"load_gain": self._load_gain}
        return [start | shown for start in STARTS]

    def solve(
        self, names: tuple[str, ...], start: Mapping[str, float]
    ) -> tuple[dict[str, float], float]:
        """Return the constants ``names``, with the others 0, and the remaining cost."""
        # Imported for identification only: the import is slow.
        from scipy.optimize import least_squares

        names = tuple(name for name in names if name not in self._known)
        ranges = [_RANGES[name] for name in names]
        scale = np.array([r.scale for r in ranges])

        # In place of all samples, n + 1 numbers with the same sum of squares and the same products with each other:
        # decompositions of all samples would take most of the time. The first number is along the errors.
        compact = np.zeros(len(names) + 1)

        def errors(point: FloatArray) -> FloatArray:
            compact[0] = np.linalg.norm(self._errors(names, (point * scale)[None]))
            return compact.copy()

        def slopes(point: FloatArray) -> FloatArray:
            values, changes = self._linearised(names, point, scale)
            along = values @ changes / max(float(np.linalg.norm(values)), 1e-12)
            square, axes = np.linalg.eigh(changes.T @ changes - np.outer(along, along))
            across = np.sqrt(np.maximum(square, 0.0))[:, None] * axes.T
            return np.concatenate((along[None], across))

        solution = least_squares(
            errors,
            [
                float(np.clip(start[name], r.lower, r.upper)) / r.scale
                for name, r in zip(names, ranges, strict=True)
            ],
            slopes,
            bounds=([r.lower / r.scale for r in ranges], [r.upper / r.scale for r in ranges]),
            max_nfev=40,
        )
        values = dict(zip(names, (solution.x * scale).tolist(), strict=True))
        return values | self._known, float(solution.cost)

    def _errors(self, names: tuple[str, ...], points: FloatArray) -> FloatArray:
        """Return (p, m) errors of p sets of constants in units of LOSS_SCALE; the last one is that of the prior.

        Large ones count linearly: the squares of what is returned add up to the cost of the loss ``soft_l1``.
        """
        known = {name: np.full(len(points), value) for name, value in self._known.items()}
        positions = self._runs.simulate(dict(zip(names, points.T, strict=True)) | known)
        errors = np.empty((len(points), len(self._measured) + 1))
        for row, of_set in zip(errors, positions, strict=True):
            np.subtract(of_set[self._runs.counts], self._measured, out=row[:-1])
        errors[:, :-1] /= LOSS_SCALE
        errors[:, -1] = 0.0
        if self._load_gain is not None:
            gain = points[:, names.index("load_gain")]
            # A ratio of gains, so that the prior is the same for strong and weak joints.
            errors[:, -1] = self._prior_weight * np.log(gain / self._load_gain)
        return errors * np.sqrt(2.0 / (1.0 + np.sqrt(1.0 + errors**2)))

    def _linearised(
        self, names: tuple[str, ...], point: FloatArray, scale: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the errors (m,) at a point, and their slopes (m, n)."""
        points = np.concatenate((point[None], point + _STEP * np.eye(len(point))))
        errors = self._errors(names, points * scale)
        return errors[0], (errors[1:] - errors[0]).T / _STEP
