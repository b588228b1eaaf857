"""What it costs a joint to take the model of another joint with the same type of motor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.identification.fitting import Fit, fit_one, mean_fit, model_sources, predictor
from pepper_driver.identification.recordings import IdentificationRecordings, JointRecordings
from pepper_driver.observer import FittingError, ModelKind, Recording, nrmse_fit


@dataclass(frozen=True, kw_only=True)
class SharedFit:
    """A shared model on the test run of another joint.

    Attributes:
        joint: That takes it.
        source: That it was fitted to.
        shared: Its fit, NRMSE [%].
        own: Fit of a model of the joint's own; None where the recordings do not determine one.
        halves: Whether the own model was fitted to one half of the test run and tried on the other, because the joint
            has no estimation runs. It knows the speed then, so the loss is an upper bound.
    """

    joint: str
    source: str
    shared: float
    own: float | None
    halves: bool

    @property
    def loss(self) -> float | None:
        """Points of fit lost."""
        return None if self.own is None else self.own - self.shared


def shared_fits(
    kind: ModelKind,
    recordings: IdentificationRecordings,
    robot: RobotConfig,
    fits: Mapping[str, Fit],
) -> tuple[SharedFit, ...]:
    """The loss of each recorded joint that takes a model; ``fits`` are those of the shared models."""
    sources = model_sources(recordings, robot, mirror=False)
    return tuple(
        SharedFit(
            joint=entry.joint,
            source=sources[entry.joint],
            shared=fits[entry.joint].test,
            own=_own_fit(kind, entry, robot),
            halves=not entry.estimation,
        )
        for entry in recordings.sweeps
        if sources[entry.joint] != entry.joint
    )


def _own_fit(kind: ModelKind, entry: JointRecordings, robot: RobotConfig) -> float | None:
    try:
        if entry.estimation:
            model = fit_one(kind, entry.joint, entry.estimation, robot)
            return mean_fit(entry, (entry.test,), predictor(model, entry.joint))
        # The sequence is played twice, with other postures of the neighbours: one half tells what the other will do.
        half = len(entry.test) // 2
        first, second = part(entry.test, 0, half), part(entry.test, half, len(entry.test))
        predicted = np.concatenate(
            (
                _predicted(kind, entry, second, first, robot),
                _predicted(kind, entry, first, second, robot),
            )
        )
        return nrmse_fit(entry.test.tracking_error(entry.index), predicted)
    except FittingError:
        return None


def _predicted(
    kind: ModelKind,
    entry: JointRecordings,
    known: Recording,
    unknown: Recording,
    robot: RobotConfig,
) -> FloatArray:
    return predictor(fit_one(kind, entry.joint, (known,), robot), entry.joint)(unknown)


def part(recording: Recording, begin: int, end: int) -> Recording:
    """The samples from ``begin`` to before ``end``."""
    arrays = {
        field.name: getattr(recording, field.name)[begin:end]
        for field in fields(recording)
        if field.name != "joint_names"
    }
    return replace(recording, **arrays)
