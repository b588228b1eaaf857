"""Fit of the models of all joints to recordings, alone and by motor type."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from pepper_driver.config import PlantConfig, RobotConfig, load_observer_settings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.robot import TRUNK
from pepper_driver.config.workers import Workers
from pepper_driver.identification.dataset import (
    IdentificationDataset,
    JointDataset,
    mirror_joint,
)
from pepper_driver.observer import (
    BaseModel,
    FitScore,
    FittingError,
    JointModel,
    ModelKind,
    MotorParameters,
    Recording,
    expected_error,
    fit_fusion,
    fit_joint,
    fit_joint_fusion,
    free_threshold,
    nrmse_fit,
    predict_recording,
)
from pepper_driver.observer.detection.threshold import identified_thresholds
from pepper_driver.observer.fitting.samples import in_working_range
from pepper_driver.observer.models.stick_slip import NO_LIMIT


@dataclass(frozen=True, kw_only=True)
class SharedFit:
    """A shared model on the test run of another joint.

    Attributes:
        joint: That takes it.
        source: That it was fitted to.
        shared: Its fit, NRMSE [%].
        own: Fit of a model of the joint's own; None where the recordings do not determine one.
        halves: Whether the own model was fitted to one half of the test run and tried on the other, because the joint
            has no estimation runs. It then has the speed, so the loss is an upper bound.
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
    recordings: IdentificationDataset,
    robot: RobotConfig,
    fits: Mapping[str, FitScore[float]],
    target_speeds: Mapping[str, float] | None = None,
) -> tuple[SharedFit, ...]:
    """Return the loss of each recorded joint that takes a model.

    Args:
        kind: Of the models.
        recordings: What they were fitted to.
        robot: Its description.
        fits: Of the shared models.
        target_speeds: As the shared models have them; see :func:`fit_models`.
    """
    sources = model_sources(recordings, robot, mirror=False)
    return tuple(
        SharedFit(
            joint=entry.joint,
            source=sources[entry.joint],
            shared=fits[entry.joint].test,
            own=_own_fit(kind, entry, robot, (target_speeds or {}).get(entry.joint, NO_LIMIT)),
            halves=not entry.estimation,
        )
        for entry in recordings.sweeps
        if sources[entry.joint] != entry.joint and entry.joint in fits
    )


def _own_fit(
    kind: ModelKind, entry: JointDataset, robot: RobotConfig, target_speed: float
) -> float | None:
    def fit(*runs: Recording) -> Predictor:
        model = fit_one(kind, entry.joint, runs, robot, target_speed=target_speed)
        return predictor(model, entry.joint)

    try:
        if entry.estimation:
            return mean_fit(entry, (entry.test,), fit(*entry.estimation))
        # The sequence is played twice, with other postures of the neighbours: one half predicts the other.
        half = len(entry.test) // 2
        first, second = part(entry.test, 0, half), part(entry.test, half, len(entry.test))
        predicted = np.concatenate((fit(second)(first), fit(first)(second)))
        return nrmse_fit(entry.test.tracking_error(entry.index), predicted)
    except FittingError:
        return None


def part(recording: Recording, begin: int, end: int) -> Recording:
    """Return the samples from ``begin`` to before ``end``."""
    arrays = {
        field.name: getattr(recording, field.name)[begin:end]
        for field in fields(recording)
        if field.name != "joint_names"
    }
    return replace(recording, **arrays)


Predictor = Callable[[Recording], FloatArray]
"""(n,) expected tracking error over a recording [rad]."""

CLOSED_FORM = "closed form"


class FittedModels(NamedTuple):
    """By joint: the models, how well they predict, and the thresholds of the residual [rad]; and the base's model.

    ``left_out`` has the joints whose recordings determine no model of kind ``fusion``, and why.
    """

    models: dict[str, JointModel]
    fits: dict[str, FitScore[float]]
    thresholds: dict[str, float]
    left_out: dict[str, str]
    base: BaseModel | None = None


def fit_models(
    kind: ModelKind,
    recordings: IdentificationDataset,
    robot: RobotConfig,
    *,
    mirror: bool = True,
    share_types: bool = False,
    target_speeds: Mapping[str, float] | None = None,
    workers: Workers = -1,
) -> FittedModels:
    """Fit a model to each joint.

    Args:
        kind: Of the models.
        recordings: What they are fitted to.
        robot: Its description.
        mirror: Also models of the other side, from the recordings seen in a mirror.
        share_types: One model per motor type, that of the joint which :func:`model_sources` names.
        target_speeds: By joint whose board limits it, the measured speed of its target [rad/s]; of kind ``fusion``.
        workers: Processes for models of kind ``fusion``, -1 for one per core; or a cluster.

    Raises:
        FittingError: Recordings that determine nothing; of kind ``fusion``, those of all joints.
    """
    if kind == "fusion":
        return _fit_fusion(
            recordings,
            robot,
            mirror=mirror,
            share_types=share_types,
            target_speeds=target_speeds or {},
            workers=workers,
        )
    window = load_observer_settings().median_window
    sources = model_sources(recordings, robot, mirror=mirror) if share_types else {}
    fitted = FittedModels({}, {}, {}, {})
    # Joints that give their model away come before those that take it.
    entries = recordings.entries(robot, mirror=mirror)
    waiting = []
    for entry in entries:
        if sources.get(entry.joint, entry.joint) != entry.joint:
            waiting.append(entry)
            continue
        model = fit_one(kind, entry.joint, entry.estimation, robot)
        _add(fitted, entry, model, None, window)
    for entry in waiting:
        source = sources[entry.joint]
        _add(fitted, entry, fitted.models[source], fitted.fits[source].estimation, window)
    return fitted


def fit_one(
    kind: ModelKind,
    joint: str,
    recordings: Sequence[Recording],
    robot: RobotConfig,
    *,
    target_speed: float = NO_LIMIT,
) -> JointModel:
    """Return a model of one joint; of kind ``fusion``, with this speed of its target, without its thresholds."""
    if kind == "fusion":
        return fit_joint_fusion(joint, recordings, robot, target_speed=target_speed)
    return fit_joint(joint, recordings, kind)


def _fit_fusion(
    recordings: IdentificationDataset,
    robot: RobotConfig,
    *,
    mirror: bool,
    share_types: bool,
    target_speeds: Mapping[str, float],
    workers: Workers,
) -> FittedModels:
    """Fusion models; their thresholds are chosen on the calibration runs or, without these, on the test runs."""
    sources = model_sources(recordings, robot, mirror=mirror) if share_types else {}
    entries = list(recordings.entries(robot, mirror=mirror))
    own = [entry for entry in entries if sources.get(entry.joint, entry.joint) == entry.joint]
    models, left_out, base = fit_fusion(
        robot,
        {entry.joint: entry.estimation for entry in own},
        {
            entry.joint: mirror_joint(entry.joint, robot)
            for entry in own
            if entry.joint not in {swept.joint for swept in recordings.sweeps}
        },
        {entry.joint: sources[entry.joint] for entry in entries if entry not in own},
        recordings.calibration or [entry.test for entry in entries],
        window=load_observer_settings().fusion_window,
        target_speeds=target_speeds,
        workers=workers,
    )
    fits = {}
    for entry in entries:
        if entry.joint in models:
            try:
                fits[entry.joint] = _scores(entry, predictor(models[entry.joint], entry.joint))
            except FittingError as error:
                left_out[entry.joint] = str(error)
    # A joint whose model comes from one that is left out is not compared with anything.
    left_out |= {joint: left_out[source] for joint, source in sources.items() if source in left_out}
    if len(left_out) == len(entries):
        raise FittingError(next(iter(left_out.values())))
    kept = {name: model for name, model in models.items() if name not in left_out}
    false_contacts = load_observer_settings().false_contacts
    return FittedModels(
        models=dict(kept),
        fits={name: fits[name] for name in kept},
        thresholds={
            name: float(
                identified_thresholds(
                    model, false_contacts, trunk=robot.limb_of(name) == TRUNK
                ).max()
            )
            for name, model in kept.items()
        },
        left_out=left_out,
        base=base,
    )


def _scores(entry: JointDataset, predict: Predictor) -> FitScore[float]:
    """Return how well the runs of a joint are predicted; without estimation runs, the test run alone."""
    test = mean_fit(entry, (entry.test,), predict)
    runs = entry.estimation
    return FitScore(estimation=mean_fit(entry, runs, predict) if runs else test, test=test)


def _add(
    fitted: FittedModels,
    entry: JointDataset,
    model: JointModel,
    estimation: float | None,
    window: int,
) -> None:
    """``estimation`` is that of the joint a shared model comes from."""
    predict = predictor(model, entry.joint)
    fitted.models[entry.joint] = model
    fitted.fits[entry.joint] = FitScore(
        estimation=mean_fit(entry, entry.estimation, predict) if estimation is None else estimation,
        test=mean_fit(entry, (entry.test,), predict),
    )
    try:
        bound = free_threshold(entry.joint, entry.runs, model, window)
    except FittingError:
        raise
    except ValueError as error:
        raise FittingError(str(error)) from error
    fitted.thresholds[entry.joint] = bound


def model_sources(
    recordings: IdentificationDataset, robot: RobotConfig, *, mirror: bool = True
) -> dict[str, str]:
    """Source of each joint's model with shared types: of each motor type the first joint with estimation runs.

    A joint seen in a mirror gets the model of that joint as the mirror shows it.

    Raises:
        FittingError: No joint of a type has estimation runs.
    """
    types = {name: drive.type for name, drive in robot.motors.joints.items()}
    first: dict[str, str] = {}
    for entry in recordings.sweeps:
        if entry.estimation:
            first.setdefault(types[entry.joint], entry.joint)
    sources = {}
    recorded = {entry.joint for entry in recordings.sweeps}
    for entry in recordings.sweeps:
        if types[entry.joint] not in first:
            raise FittingError(
                f"{entry.joint}: no joint with a motor of type {types[entry.joint]} has estimation runs"
            )
        source = first[types[entry.joint]]
        sources[entry.joint] = source
        other = mirror_joint(entry.joint, robot)
        if mirror and other not in recorded:
            seen = mirror_joint(source, robot)
            sources[other] = source if seen in recorded else seen
    return sources


def closed_form_fits(
    plant: PlantConfig,
    cycle: float,
    recordings: IdentificationDataset,
    robot: RobotConfig,
    *,
    mirror: bool,
) -> dict[str, FitScore[float]]:
    """Return by joint how well Eq. 11 predicts with the true parameters of a simulated robot; ``cycle`` in [s]."""
    return {
        entry.joint: _scores(entry, _oracle(plant, cycle, robot, entry.joint))
        for entry in recordings.entries(robot, mirror=mirror)
    }


def mean_fit(entry: JointDataset, runs: Sequence[Recording], predict: Predictor) -> float:
    """Mean NRMSE fit over runs of a joint [%], as the paper has it.

    Raises:
        FittingError: A run shows no tracking error at all.
    """
    try:
        scores = [_score(run, entry.index, predict) for run in runs]
    except FittingError as error:
        raise FittingError(f"{entry.joint}: {error}") from error
    return float(np.mean(scores))


def _score(run: Recording, index: int, predict: Predictor) -> float:
    """Return the NRMSE fit of a run [%], of the samples in which the joint keeps up."""
    within = in_working_range(run, index)
    if not within.any():
        raise FittingError("it falls behind in all of a run: use a slower motion")
    return nrmse_fit(run.tracking_error(index)[within], predict(run)[within])


def predictor(model: JointModel, joint: str) -> Predictor:
    """Return the function by which a model predicts a joint."""
    return lambda run: predict_recording(model, joint, run)


def _oracle(plant: PlantConfig, cycle: float, robot: RobotConfig, joint: str) -> Predictor:
    """Eq. 11 with the plant's true parameters: what the method could know at best without friction's memory."""
    motor, ratio = robot.motors.of(joint), robot.motors.joints[joint].ratio
    actuator = plant.actuator(joint)
    friction = actuator.friction.contact
    parameters = MotorParameters(
        resistance=motor.resistance,
        torque_constant=actuator.efficiency * motor.torque_constant,
        speed_constant=motor.torque_constant,
        rotor_inertia=motor.rotor_inertia,
        motor_damping=actuator.motor_damping,
        ratio=ratio,
        proportional_gain=actuator.kp,
        derivative_gain=actuator.kd,
        coulomb_friction=friction.motor + friction.link,
        viscous_friction=friction.motor_viscous + friction.link_viscous,
    )
    return lambda run: expected_error(parameters, run.features(run.joint_names.index(joint)), cycle)
