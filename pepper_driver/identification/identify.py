"""Identification of expected-error models: drive the robot in free motion, record, fit. Sec. IV of the paper."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from pepper_driver.backends import make_backend
from pepper_driver.backends.selection import with_delay
from pepper_driver.config import (
    ConfigError,
    Experiment,
    PepperError,
    RobotConfig,
    load_controller_settings,
    load_robot,
)
from pepper_driver.config.file_lock import lock_folder
from pepper_driver.config.files import set_aside, write_bytes
from pepper_driver.config.workers import Workers, one_core, run_jobs
from pepper_driver.experiments.plan import experiment_uri
from pepper_driver.identification.dataset import (
    IdentificationDataset,
    Manifest,
    finished,
    load_measurement,
    load_recordings,
    make_manifest,
    mirror_joint,
    open_folder,
    read_manifest,
    recording_path,
    set_damaged_aside,
)
from pepper_driver.identification.fit import (
    CLOSED_FORM,
    SharedFit,
    closed_form_fits,
    fit_models,
    shared_fits,
)
from pepper_driver.identification.measurements.friction import HeldWeight
from pepper_driver.identification.measurements.program import (
    RESPONSE,
    WEIGHT,
    measure_robot,
    measured_joints,
    weighted_hand,
)
from pepper_driver.identification.measurements.response import (
    MeasuredResponse,
    ResponseError,
    measure_response,
)
from pepper_driver.identification.quality import Finding, inspect_recordings, wandering_targets
from pepper_driver.identification.runs import (
    IdentificationRun,
    check_dry_run,
    perform,
    plan_measurements,
    plan_runs,
    run_name,
    seeded_uri,
    sweeps_of,
)
from pepper_driver.identification.sensitivity import (
    JointSensitivity,
    blind_joints,
    joint_sensitivities,
)
from pepper_driver.observer import TREE_TYPES, FitScore, ModelKind, ModelSet
from pepper_driver.observer.models.measured_robot import MeasuredRobot

Progress = Callable[[str, float, float], None]
"""Called with (name of the current run, seconds of runs done, seconds in all)."""


Confirm = Callable[[IdentificationRun], None]
"""Called before a run that a person must watch; raises to end the recording there."""

OnTouch = Callable[[IdentificationRun, str], None]
"""Called inside the tick with the run and the name of a touch sensor or bumper that is pressed: must be quick."""

Repeat = Callable[[IdentificationRun, Sequence[str]], bool]
"""Called after a run in which these sensors were pressed, and which is kept; True to make it again."""


def record_missing(
    uri: str,
    runs: Sequence[IdentificationRun],
    *,
    every: Sequence[IdentificationRun],
    folder: Path,
    real_time: bool,
    takes_seed: bool,
    identity: str,
    workers: Workers = -1,
    confirm: Confirm | None = None,
    on_touch: OnTouch | None = None,
    repeat: Repeat | None = None,
    progress: Progress | None = None,
) -> None:
    """Make the runs whose file is not in the folder. Each file is written as soon as its run has ended.

    Simulated backends run in parallel, each run on a robot and with a random sequence of its own; the result does not
    depend on ``workers``, nor on what was there. A backend in real time runs one after the other; :func:`record_joints`
    has dry run them. After the run with a weight in the hand, the next one begins with a request to take it out, also
    where the run with the weight was made by an earlier call.

    Args:
        uri: The backend.
        runs: Those to make now.
        every: All runs of the identification: progress is that of them all.
        folder: Where their recordings are.
        real_time: True for a real robot.
        takes_seed: True where the URI takes a seed of the noise.
        identity: Of the simulated robot, which is to be the same in each process.
        workers: Processes for simulated runs, -1 for one per core; or a cluster.
        confirm: Asked before each run of a real robot that a person must watch.
        on_touch: Called when a sensor of a real robot shows that a person touches it.
        repeat: Asked after a run in which that was so; an earlier recording gets another name.
        progress: Called with the progress.

    Raises:
        PepperError: A robot that refuses, a run that would not go well, a folder that cannot be written to.
    """
    todo = _missing(folder, runs)
    if not todo:
        return
    report_progress = progress or _report_nothing
    total = sum(run.seconds for run in every)
    done = total - sum(run.seconds for run in _missing(folder, every))
    if not real_time:
        report_progress("recording in simulation", done, total)
        uris = [seeded_uri(uri, run) if takes_seed else uri for run in todo]
        jobs = (partial(_make, uri, run, identity) for uri, run in zip(uris, todo, strict=True))
        for run, recording in run_jobs(jobs, workers=workers, ordered=False):
            write_bytes(recording_path(folder, run.name), recording)
            done += run.seconds
            report_progress(f"recording in simulation: {run.name}", done, total)
        return
    latest = _latest(folder, every)
    for run in todo:
        weighed = latest is not None and latest.weight is not None
        asked = run.after_weight() if weighed and run.weight is None else run
        if confirm is not None and asked.watched:
            confirm(asked)
        before = done

        def advance(fraction: float, run: IdentificationRun = run, before: float = before) -> None:
            report_progress(run.name, before + fraction * run.seconds, total)

        _perform_untouched(
            uri, run, recording_path(folder, run.name), advance, on_touch=on_touch, repeat=repeat
        )
        latest = run
        done += run.seconds
        report_progress(run.name, done, total)


def _perform_untouched(
    uri: str,
    run: IdentificationRun,
    path: Path,
    advance: Callable[[float], None],
    *,
    on_touch: OnTouch | None,
    repeat: Repeat | None,
) -> None:
    """Make a run of a real robot, again as often as it was touched and is to be repeated; write its file each time."""
    pressed: list[str] = []

    def note(sensor: str) -> None:
        pressed.append(sensor)
        if on_touch is not None:
            on_touch(run, sensor)

    while True:
        pressed.clear()
        advance(0.0)
        perform(uri, run, stop_key=True, on_progress=advance, on_touch=note).save(path)
        if not pressed or repeat is None or not repeat(run, tuple(dict.fromkeys(pressed))):
            return
        set_aside(path)


def _missing(folder: Path, runs: Sequence[IdentificationRun]) -> list[IdentificationRun]:
    """Return the runs without a recording."""
    there = finished(folder, [run.name for run in runs])
    return [run for run in runs if run.name not in there]


def _report_nothing(what: str, done: float, total: float) -> None:
    """Report no progress."""


def _latest(folder: Path, runs: Sequence[IdentificationRun]) -> IdentificationRun | None:
    """Return the run that was recorded last; None where there is no recording."""
    there = finished(folder, [run.name for run in runs])
    return max(
        (run for run in runs if run.name in there),
        key=lambda run: recording_path(folder, run.name).stat().st_mtime_ns,
        default=None,
    )


def _make(uri: str, run: IdentificationRun, identity: str) -> tuple[IdentificationRun, bytes]:
    """Perform one run; returns it with the content of its file, which is written where the folder is."""
    return run, perform(uri, run, identity=identity).as_bytes()


def _dry_run_all(
    runs: Sequence[IdentificationRun], workers: Workers, report_progress: Progress
) -> None:
    total, done = sum(run.seconds for run in runs), 0.0
    report_progress("dry run", done, total)
    jobs = (partial(_dry_run, run) for run in runs)
    for seconds in run_jobs(jobs, workers=workers, ordered=False):
        done += seconds
        report_progress("dry run", done, total)


def _dry_run(run: IdentificationRun) -> float:
    check_dry_run(run)
    return run.seconds


def _check_balance(robot: RobotConfig) -> None:
    if not load_controller_settings(robot).constraints.balance:
        raise ConfigError(
            "controller.yaml: key 'constraints.balance' is false: legs and base are moved only with the balance "
            "constraint; switch it on, or give --joints without legs and --calibration none"
        )


class BlindModelError(PepperError, ValueError):
    """Models notice hardly any touch of a joint."""


@dataclass(frozen=True, kw_only=True)
class Identification:
    """The models, how well they predict, and what is wrong with the recordings.

    Attributes:
        models: Of the chosen kind.
        fits: By method and joint: the chosen kind first; where methods were compared, then the trees of the paper and,
            on a simulated robot, the closed form of Eq. 11 with the plant's true parameters.
        recorded: Joints that were recorded and have a model; the others that have one are their mirror images.
        shared: Loss of shared models, where motor types have one.
        sensitivities: By joint, the touch that it detects; of models of kind ``fusion``.
        findings: Why the models may be poor.
        blind: Joints that notice hardly any touch, with the likely cause.
    """

    models: ModelSet
    fits: dict[str, dict[str, FitScore[float]]]
    recorded: tuple[str, ...]
    shared: tuple[SharedFit, ...]
    sensitivities: dict[str, JointSensitivity]
    findings: tuple[Finding, ...]
    blind: tuple[Finding, ...]

    def refuse_blind(self) -> None:
        """Refuse models with blind joints.

        Raises:
            BlindModelError: There are such joints; the message names them.
        """
        if self.blind:
            joints = "; ".join(f"{finding.joint} {finding.text}" for finding in self.blind)
            raise BlindModelError(f"these models would notice hardly any touch: {joints}")

    def as_json(self) -> dict[str, Any]:
        """``fit.<method>.<joint>.{estimation,test}``, ``threshold_deg.<joint>``, ``sensitivity.<joint>``, and more."""
        return {
            "fit": {
                method: {joint: asdict(fit) for joint, fit in fits.items()}
                for method, fits in self.fits.items()
            },
            "threshold_deg": {
                joint: float(np.degrees(bound)) for joint, bound in self.models.threshold.items()
            },
            "sensitivity": {joint: one.as_json() for joint, one in self.sensitivities.items()},
            "identity": self.models.identity,
            "recorded": list(self.recorded),
            "shared": {fit.joint: {**asdict(fit), "loss": fit.loss} for fit in self.shared},
            "warnings": [asdict(finding) for finding in (*self.findings, *self.blind)],
        }


def chosen_joints(
    robot: RobotConfig,
    experiment: Experiment,
    joints: Sequence[str] | None,
    *,
    mirror: bool,
    share_types: bool,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Joints to identify, and joints to test only.

    Args:
        robot: Its description.
        experiment: An experiment with sweeps.
        joints: Those asked for; None for the experiment's, and without ``mirror`` also those of the other side.
        mirror: Whether the other side's models come from a mirror.
        share_types: Whether of each motor type only the first joint is identified.
    """
    names = tuple(sweeps_of(experiment).joints if joints is None else joints)
    if joints is None and not mirror:
        both = (*names, *(mirror_joint(name, robot) for name in names))
        names = tuple(dict.fromkeys(both))
    if not share_types:
        return names, ()
    first: dict[str, str] = {}
    for name in names:
        robot.joint_index(name)
        first.setdefault(robot.motors.joints[name].type, name)
    kept = tuple(name for name in names if name in first.values())
    return kept, tuple(name for name in names if name not in first.values())


def record_joints(
    uri: str,
    joints: Sequence[str],
    experiment: Experiment,
    folder: Path,
    *,
    tested: Sequence[str] = (),
    calibration: Experiment | None = None,
    measure: bool = False,
    measure_only: bool = False,
    weight: HeldWeight | None = None,
    seed: int = 0,
    workers: Workers = -1,
    confirm: Confirm | None = None,
    on_touch: OnTouch | None = None,
    repeat: Repeat | None = None,
    progress: Progress | None = None,
) -> IdentificationDataset:
    """Drive each joint through its runs, then the whole body; of these, what is in the folder whole is not made again.

    The robot itself is measured first, if asked for: the samples of the other runs are then paired with the commands
    that they answer, by the delay that was measured. Before a real robot moves, all that is to be made is dry run.

    Args:
        uri: The backend. A seed in it makes other noise, not other motion.
        joints: Names of the joints to identify.
        experiment: An experiment with sweeps; its joints are those given here.
        folder: For the recordings; made if need be.
        tested: Joints with a test run only.
        calibration: Free motion of the whole body; None for none.
        measure: Measure the robot too.
        measure_only: End after that: the same call without it makes the other runs.
        weight: Known weight in a hand, for one measurement more; None for none.
        seed: Root of the random motion and noise.
        workers: Processes for simulated runs, -1 for one per core; or a cluster.
        confirm: Asked before each run of a real robot that a person must watch.
        on_touch: Called when a sensor of a real robot shows that a person touches it.
        repeat: Asked after a run in which that was so; an earlier recording gets another name.
        progress: Called with the progress.

    Raises:
        ResponseError: The robot does not answer commands.
        PepperError: A joint or backend that does not exist, recordings of something else in the folder, a robot that
            refuses.
    """
    robot = load_robot()
    runs = plan_runs(robot, joints, experiment, tested=tested, calibration=calibration, seed=seed)
    measurements = plan_measurements(robot, seed, weight=weight) if measure else ()
    uri = experiment_uri(uri, experiment)
    _check_plant(experiment, calibration)
    backend = make_backend(uri, robot)
    every = (*measurements, *runs)
    with lock_folder(folder):
        open_folder(folder, make_manifest(robot, backend, every, experiment, calibration, seed))
        set_damaged_aside(folder, [run.name for run in every], robot)
        record = partial(
            record_missing,
            every=every,
            folder=folder,
            real_time=backend.real_time,
            takes_seed="seed" in backend.info.capabilities,
            identity=backend.info.identity,
            workers=workers,
            confirm=confirm,
            on_touch=on_touch,
            repeat=repeat,
            progress=progress,
        )
        todo = _missing(folder, measurements if measure_only else every)
        if any(run.moves_legs for run in todo):
            _check_balance(robot)
        if backend.real_time and todo:
            _dry_run_all(todo, workers, progress or _report_nothing)
        if measurements:
            record(uri, measurements)
            measured = _response(folder, robot)
            uri = with_delay(uri, max(0, backend.info.response_delay + measured.lead))
        if measure_only:
            measurement = load_measurement(folder, robot)
            return IdentificationDataset(sweeps=(), calibration=(), measurement=measurement)
        record(uri, runs)
    return load_recordings(folder, robot)


def _response(folder: Path, robot: RobotConfig) -> MeasuredResponse:
    """Return the delay that was measured."""
    recording = load_measurement(folder, robot)[RESPONSE]
    try:
        return measure_response(recording, measured_joints(robot), robot)
    except ResponseError as error:
        raise ResponseError(
            f"{error} (a robot without such currents is identified by 'pepper identify --no-measure', with another "
            "folder for --recordings; many robots, with --draws, without --weight)"
        ) from error


def _check_plant(experiment: Experiment, calibration: Experiment | None) -> None:
    """One robot for all runs."""
    if calibration is None:
        return
    for key in ("plant", "world"):
        required = getattr(calibration, key)
        if required is not None and required != getattr(experiment, key):
            raise ConfigError(
                f"{calibration.source}: key '{key}': the plant and world of all runs are those of '{experiment.name}'; "
                "leave it out"
            )


def fit_folder(
    folder: Path,
    kind: ModelKind,
    *,
    compare: bool = True,
    mirror: bool = True,
    share_types: bool = False,
    workers: Workers = -1,
) -> Identification:
    """Fit models to the recordings in a folder; no robot is needed.

    Args:
        folder: Where :func:`record_joints` left them.
        kind: Of the models.
        compare: Whether trees and closed form are fitted too, to say how well they predict.
        mirror: Also models of the other side, from the recordings seen in a mirror.
        share_types: One model per motor type.
        workers: Processes, -1 for one per core; or a cluster. With 1, all runs on one core.

    Raises:
        PepperError: Recordings that are missing, damaged, of another robot, or determine nothing.
    """
    with one_core(workers):
        return _fit_folder(folder, kind, compare, mirror, share_types, workers)


def _fit_folder(
    folder: Path, kind: ModelKind, compare: bool, mirror: bool, share_types: bool, workers: Workers
) -> Identification:
    robot = load_robot()
    manifest, recordings = read_manifest(folder), load_recordings(folder, robot)
    share_types = share_types or bool(manifest.tested)
    measured = _measured(manifest, recordings, robot)
    target_speeds = None if measured is None else measured.target_speeds
    fitted = fit_models(
        kind,
        recordings,
        robot,
        mirror=mirror,
        share_types=share_types,
        target_speeds=target_speeds,
        workers=workers,
    )
    fits: dict[str, dict[str, FitScore[float]]] = {kind: fitted.fits}
    modelled = recordings.without(fitted.left_out)
    if compare:
        for other in TREE_TYPES:
            if other != kind:
                fits[other] = fit_models(
                    other, modelled, robot, mirror=mirror, share_types=share_types
                ).fits
        fits |= _closed_form(manifest, modelled, robot, mirror=mirror)
    findings = (
        *_weight_findings(measured),
        *inspect_recordings(recordings, fitted.models),
    )
    causes = (*findings, *wandering_targets(recordings, fitted.models))
    sensitivities = joint_sensitivities(fitted.models, robot)
    return Identification(
        models=ModelSet(
            robot=robot.name,
            joint_names=robot.joint_names,
            identity=manifest.identity,
            kind=kind,
            cycle=robot.cycle,
            estimation_fit={name: fit.estimation for name, fit in fitted.fits.items()},
            test_fit={name: fit.test for name, fit in fitted.fits.items()},
            threshold=fitted.thresholds,
            version=version("pepper-driver"),
            models=fitted.models,
            base=fitted.base,
            measured=measured,
            created_by=_command(manifest, kind, mirror=mirror, share_types=share_types),
        ),
        fits=fits,
        recorded=tuple(entry.joint for entry in modelled.sweeps),
        shared=shared_fits(kind, recordings, robot, fitted.fits, target_speeds)
        if share_types
        else (),
        sensitivities=sensitivities,
        findings=findings,
        blind=blind_joints(fitted.fits, sensitivities, causes, robot, fitted.left_out),
    )


def _measured(
    manifest: Manifest, recordings: IdentificationDataset, robot: RobotConfig
) -> MeasuredRobot | None:
    """Return the facts about the robot, where it was measured."""
    if not recordings.measurement:
        return None
    return measure_robot(recordings.measurement, manifest.response_delay, robot, manifest.weight)


def _weight_findings(measured: MeasuredRobot | None) -> tuple[Finding, ...]:
    """Find a known weight that was not in the hand during all of its run."""
    if measured is None or measured.weight_doubt is None:
        return ()
    text = f"{measured.weight_doubt}; the scale of torques by it is left out"
    return (Finding(kind="weight", joint=None, run=run_name(WEIGHT, 1), text=text),)


def _closed_form(
    manifest: Manifest, recordings: IdentificationDataset, robot: RobotConfig, *, mirror: bool
) -> dict[str, dict[str, FitScore[float]]]:
    """Return the closed-form fit of a simulated robot with the motors of Eq. 11, unless its plant has changed since."""
    if not manifest.simulated or manifest.real_time:
        return {}
    backend = make_backend(manifest.backend, robot)
    info = backend.info
    if info.identity != manifest.identity:
        return {}
    plant = backend.plant.config
    if plant is None:
        return {}
    fits = closed_form_fits(plant, info.cycle, recordings, robot, mirror=mirror)
    return {CLOSED_FORM: fits}


def _command(manifest: Manifest, kind: ModelKind, *, mirror: bool, share_types: bool) -> str:
    """Return the command that makes these models again."""
    options = [
        f"--backend {manifest.backend}",
        f"--experiment {manifest.experiment}",
        f"--calibration {manifest.calibration or 'none'}",
        f"--joints {','.join((*manifest.joints, *manifest.tested))}",
        f"--model-type {kind}",
        f"--seed {manifest.seed}",
    ]
    if not manifest.measured_by:
        options.append("--no-measure")
    if manifest.weight is not None:
        options.append(f"--weight {manifest.weight.mass:g} --hand {weighted_hand(manifest.weight)}")
    if not mirror:
        options.append("--no-mirror")
    if share_types:
        options.append("--share-types")
    return f"pepper identify {' '.join(options)}"


def identify_joints(
    uri: str,
    joints: Sequence[str],
    experiment: Experiment,
    kind: ModelKind,
    *,
    seed: int = 0,
    workers: Workers = -1,
    progress: Progress | None = None,
) -> Identification:
    """Record free motion of these joints and fit a model of ``kind`` to each; the recordings are not kept.

    Raises:
        PepperError: See :func:`record_joints` and :func:`fit_folder`.
    """
    with TemporaryDirectory() as name:
        folder = Path(name)
        record_joints(
            uri, joints, experiment, folder, seed=seed, workers=workers, progress=progress
        )
        return fit_folder(folder, kind, mirror=False, workers=workers)
