"""Identification of the models of mode ``fusion`` from recordings of free motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.observer.constants import REST_SPEED
from pepper_driver.observer.fitting.bounds import fit_spreads
from pepper_driver.observer.fitting.mobile_base import fit_base
from pepper_driver.observer.fitting.samples import fit_samples
from pepper_driver.observer.fitting.stick_slip import START_UP_TIME, fit_stick_slip
from pepper_driver.observer.fitting.tree import FittingError
from pepper_driver.observer.models.fusion_model import BaseModel, FusionModel, MomentumParameters
from pepper_driver.observer.models.stick_slip import (
    NO_LIMIT,
    StickSlipModel,
    StickSlipParameters,
)
from pepper_driver.observer.recording import Recording
from pepper_driver.observer.residuals.momentum import ErrorDerivatives

if TYPE_CHECKING:
    from pepper_driver.config.workers import Workers


@dataclass(frozen=True)
class _SimulatedRun:
    """Stick-slip model of a joint on a recording, with the recording; arrays (n,) of the samples that count."""

    model_error: FloatArray
    drive: FloatArray
    moves: BoolArray
    friction: FloatArray
    load: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    current: FloatArray


def _simulate(
    joint: str, recording: Recording, parameters: StickSlipParameters, cycle: float
) -> _SimulatedRun:
    index = recording.joint_names.index(joint)
    error = recording.tracking_error(index)
    sent, load_torque = recording.sent_position[:, index], recording.load_torque[:, index]
    position = recording.position[:, index]
    model = StickSlipModel.from_parameters([parameters], cycle)
    states = model.play(0, float(position[0]), sent, load_torque)
    change, curvature = ErrorDerivatives(1, cycle).play(error)
    counts = fit_samples(recording, index)
    # Until then the model may hold its friction in another direction than the joint does.
    counts[: round(START_UP_TIME / cycle)] = False
    features = recording.features(index)
    run = _SimulatedRun(
        model_error=states["position"] - position,
        drive=states["target"] - position + states["integral"],
        moves=np.abs(states["velocity"]) > REST_SPEED,
        friction=states["friction"],
        load=parameters.load_gain * features[:, 2],
        velocity=features[:, 0] - change,
        acceleration=features[:, 1] - curvature,
        current=recording.current[:, index],
    )
    return _SimulatedRun(
        **{name: getattr(run, name)[counts] for name in _SimulatedRun.__annotations__}
    )


UNKNOWN_SPREAD = np.radians(1.0)
"""[rad] Of a model until its spread is known."""


class FittedFusion(NamedTuple):
    """By joint: the models, and why a joint has none; and the base's model, if it moves in the calibration."""

    models: dict[str, FusionModel]
    left_out: dict[str, str]
    base: BaseModel | None


NO_THRESHOLD = "hardly any of its samples in the free motion for thresholds count: in the others it falls behind"
"""Why a joint with a model is left out."""

T = TypeVar("T")


def fit_fusion(
    robot: RobotConfig,
    sweeps: Mapping[str, Sequence[Recording]],
    mirrors: Mapping[str, str],
    shared: Mapping[str, str],
    calibration: Sequence[Recording],
    *,
    window: int,
    target_speeds: Mapping[str, float],
    workers: Workers = -1,
) -> FittedFusion:
    """Fit the models of all joints, and of the base if it moves in the calibration.

    A joint whose recordings determine no model or no threshold is left out.

    Args:
        robot: Its description.
        sweeps: By joint, the estimation runs.
        mirrors: By joint whose runs are mirror images of another joint, that joint.
        shared: By joint without a model of its own, the joint whose model it gets.
        calibration: Free motion of the whole body, for the thresholds.
        window: Samples of the median.
        target_speeds: By joint whose board limits it, the speed of its target [rad/s].
        workers: Processes, -1 for one per core; or a cluster. The result does not depend on it.

    Raises:
        FittingError: No joint is left.
    """
    from pepper_driver.config.workers import run_jobs  # slow to import, and needed here alone

    own = [joint for joint in sweeps if joint not in mirrors]
    jobs = (
        partial(
            _or_error,
            fit_joint_stick_slip,
            joint,
            sweeps[joint],
            robot,
            target_speed=target_speeds.get(joint, NO_LIMIT),
        )
        for joint in own
    )
    made = dict(zip(own, run_jobs(jobs, workers=workers), strict=True))
    stick_slips = {name: one for name, one in made.items() if not isinstance(one, FittingError)}
    left_out = {name: str(one) for name, one in made.items() if isinstance(one, FittingError)}
    for joint, source in mirrors.items():
        if source in left_out:
            left_out[joint] = left_out[source]
            continue
        _, sign = robot.mirror[robot.joint_index(joint)]
        stick_slips[joint] = replace(stick_slips[source], offset=sign * stick_slips[source].offset)
    # After the stick-slip models: those of mirrored joints come from their source.
    fits = (
        partial(fit_joint_fusion, joint, sweeps[joint], robot, stick_slip=stick_slip)
        for joint, stick_slip in stick_slips.items()
    )
    models = dict(zip(stick_slips, run_jobs(fits, workers=workers), strict=True))
    models |= {joint: models[source] for joint, source in shared.items() if source in models}
    left_out |= {joint: left_out[source] for joint, source in shared.items() if source in left_out}
    drives = [recording for recording in calibration if np.any(recording.sent_wheel_speed)]
    base = fit_base(robot, drives, window=window) if drives else None
    bounded = fit_spreads(models, calibration, window=window)
    left_out |= {joint: f"{joint}: {NO_THRESHOLD}" for joint in models if joint not in bounded}
    if not bounded:
        raise FittingError(next(iter(left_out.values())))
    return FittedFusion(models=bounded, left_out=left_out, base=base)


def _or_error(fit: Callable[..., T], *args: object, **options: object) -> T | FittingError:
    """Return what a fit returns, or the error that it raises: one joint must not cost the others."""
    try:
        return fit(*args, **options)
    except FittingError as error:
        return error


def _joined(parts: Sequence[_SimulatedRun]) -> _SimulatedRun:
    return _SimulatedRun(
        **{
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in _SimulatedRun.__annotations__
        }
    )


def fit_joint_stick_slip(
    joint: str, recordings: Sequence[Recording], robot: RobotConfig, target_speed: float = NO_LIMIT
) -> StickSlipParameters:
    """Fit the stick-slip model of a joint, with the constants of its motor; see :func:`fit_stick_slip`."""
    motors = robot.motors
    return fit_stick_slip(
        joint,
        recordings,
        robot.cycle,
        torque_constant=motors.joint_torque_constant(joint),
        resistance=motors.of(joint).resistance,
        target_speed=target_speed,
    )


def fit_joint_fusion(
    joint: str,
    recordings: Sequence[Recording],
    robot: RobotConfig,
    *,
    stick_slip: StickSlipParameters | None = None,
    target_speed: float = NO_LIMIT,
) -> FusionModel:
    """Fit a model without its threshold, which requires all joints at once; see :func:`fit_spreads`.

    Args:
        joint: Name of the joint.
        recordings: The estimation runs.
        robot: Its description.
        stick_slip: Its stick-slip model, if it is known already.
        target_speed: Largest speed of its board's target [rad/s]; one that is known already has it.
    """
    cycle = robot.cycle
    if stick_slip is None:
        stick_slip = fit_joint_stick_slip(joint, recordings, robot, target_speed)
    data = _joined([_simulate(joint, recording, stick_slip, cycle) for recording in recordings])
    candidates = [_fit_voltage(data), _fit_current(data)]
    errors = [_momentum_residual(data, parameters) for parameters in candidates]
    best = int(np.argmin([error.std() for error in errors]))
    return FusionModel(
        twin=stick_slip,
        momentum=candidates[best],
        spread=(UNKNOWN_SPREAD,) * 3,
        momentum_bound=np.radians(2.5),
    )


def _fit_voltage(data: _SimulatedRun) -> MomentumParameters:
    needed = np.stack((data.acceleration, data.velocity, np.ones_like(data.load)), axis=1)
    inertia, lag, offset = _bounded(needed, data.drive - data.friction - data.load, (0, 1))
    return MomentumParameters(
        source="voltage", torque_per_ampere=0.0, inertia=inertia, lag=lag, offset=offset
    )


def _fit_current(data: _SimulatedRun) -> MomentumParameters:
    resistance = data.friction + data.load
    signed = np.copysign(data.current, resistance + data.model_error)
    columns = np.stack(
        (signed, -data.acceleration, -data.velocity, -np.ones_like(data.load)), axis=1
    )
    gain, inertia, lag, offset = _bounded(columns, resistance, (0, 1, 2))
    return MomentumParameters(
        source="current",
        torque_per_ampere=max(gain, 1e-6),
        inertia=inertia,
        lag=lag,
        offset=offset,
    )


def _bounded(columns: FloatArray, target: FloatArray, positive: tuple[int, ...]) -> list[float]:
    """Solve least squares with some coefficients not below 0."""
    # Imported for identification only: the import is slow.
    from scipy.optimize import lsq_linear

    lower = np.full(columns.shape[1], -np.inf)
    lower[list(positive)] = 0.0
    # Columns of unit size: inertia, velocity and offset differ by orders of magnitude.
    scale = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
    solution = lsq_linear(columns / scale, target, bounds=(lower, np.inf))
    values: list[float] = (solution.x / scale).tolist()
    return values


def _momentum_residual(data: _SimulatedRun, parameters: MomentumParameters) -> FloatArray:
    needed = (
        parameters.inertia * data.acceleration
        + parameters.lag * data.velocity
        + data.friction
        + data.load
        + parameters.offset
    )
    if parameters.source == "voltage":
        return data.drive - needed
    # In use, the estimated integral of the motor board counts too. Only the model's integral exists here, which does
    # not help to find the sign.
    return (
        np.copysign(parameters.torque_per_ampere * data.current, needed + data.model_error) - needed
    )
