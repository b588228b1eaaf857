"""Identifies the constants of a stick-slip twin from recordings of free motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pepper_driver.observer.recording import Recording
from pepper_driver.observer.twin import TwinParameters, Twins

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

START_UP = 0.6
"""[s] at the start of a run that do not count: the twin does not know where in its friction the joint rests."""

ROBUSTNESS = np.radians(0.15)
"""[rad] Errors beyond this count by their size, no longer by its square: no rare slip sets a constant."""

_STEP = 1e-3  # of the scales below, for the differences


@dataclass(frozen=True)
class _Range:
    lower: float
    upper: float
    start: float
    scale: float


_RANGES = {
    "inertia": _Range(0.0, 0.05, 5e-4, 5e-4),
    "lag": _Range(0.0, 0.3, 0.03, 0.02),
    "friction": _Range(0.0, 0.1, 0.008, 0.005),
    "load_friction": _Range(0.0, 0.5, 0.02, 0.05),
    "breakaway": _Range(1.0, 2.0, 1.1, 0.1),
    "load_gain": _Range(1e-4, 5.0, 0.008, 0.005),
    "offset": _Range(-0.03, 0.03, 0.0, 0.002),
    "dead_band": _Range(0.0, 0.02, 0.001, 0.002),
    "integral_rate": _Range(0.0, 3.0, 0.05, 0.1),
    "transport": _Range(-1.0, 2.0, 0.0, 0.3),
}


class _Runs:
    """Recordings of one joint side by side, the shorter ones continued by their last sample."""

    def __init__(self, joint: str, recordings: Sequence[Recording], cycle: float) -> None:
        length = max(len(recording) for recording in recordings)
        columns = [(r, r.joint_names.index(joint)) for r in recordings]

        def side_by_side(name: str) -> FloatArray:
            return np.stack(
                [
                    np.pad(getattr(r, name)[:, i], (0, length - len(r)), mode="edge")
                    for r, i in columns
                ],
                axis=1,
            )

        self.cycle = cycle
        self.target = side_by_side("sent_position")
        self.load_torque = side_by_side("load_torque")
        self.position = side_by_side("position")
        self.counts = np.zeros(self.position.shape, dtype=np.bool_)
        for run, (recording, index) in enumerate(columns):
            self.counts[: len(recording), run] = recording.usable(index)
        self.counts[: round(START_UP / cycle)] = False

    def play(self, parameters: dict[str, FloatArray]) -> FloatArray:
        """(n, p, r) positions of twins with p sets of parameters (p, 1) on all r runs [rad]."""
        twins = Twins(parameters, self.cycle)
        sets = len(parameters["lag"])
        start = np.broadcast_to(self.position[0], (sets, self.position.shape[1]))
        twins.start(start, np.broadcast_to(self.target[0], start.shape))
        return np.stack(
            [
                twins.step(target, load)
                for target, load in zip(self.target, self.load_torque, strict=True)
            ]
        )


def fit_twin(joint: str, recordings: Sequence[Recording], cycle: float) -> TwinParameters:
    """Least squares of the twin's position against the encoder, over whole runs: its errors feed back on it.

    Args:
        joint: Name of the joint.
        recordings: Of its free motion.
        cycle: Period of the ticks [s].
    """
    from scipy.optimize import least_squares

    runs = _Runs(joint, recordings, cycle)
    names = tuple(_RANGES)
    scale = np.array([_RANGES[name].scale for name in names])
    measured = runs.position[runs.counts]

    def parameters(points: FloatArray) -> dict[str, FloatArray]:
        return {
            name: column[:, None] for name, column in zip(names, (points * scale).T, strict=True)
        }

    def residual(point: FloatArray) -> FloatArray:
        errors: FloatArray = runs.play(parameters(point[None]))[:, 0][runs.counts] - measured
        return np.asarray(errors / ROBUSTNESS)

    def slopes(point: FloatArray) -> FloatArray:
        points = np.concatenate((point[None], point + _STEP * np.eye(len(point))))
        positions = runs.play(parameters(points))
        base = positions[:, 0][runs.counts]
        return np.stack(
            [
                (positions[:, 1 + i][runs.counts] - base) / (_STEP * ROBUSTNESS)
                for i in range(len(point))
            ],
            axis=1,
        )

    solution = least_squares(
        residual,
        [_RANGES[name].start / _RANGES[name].scale for name in names],
        slopes,
        bounds=(
            [_RANGES[name].lower / _RANGES[name].scale for name in names],
            [_RANGES[name].upper / _RANGES[name].scale for name in names],
        ),
        loss="soft_l1",
        max_nfev=40,
    )
    values = dict(zip(names, (solution.x * scale).tolist(), strict=True))
    return TwinParameters(**values)
