"""Identification of expected-error models: drive the robot in free motion, record, fit. Sec. IV of the paper."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from typing import Any
from urllib.parse import urlencode

import numpy as np
from joblib import Parallel, delayed

from pepper_driver.backends import Backend, make_backend
from pepper_driver.backends.selection import parse_uri
from pepper_driver.config import (
    ConfigError,
    RobotConfig,
    Scenario,
    load_observer_settings,
    load_robot,
)
from pepper_driver.config.parts import FloatArray
from pepper_driver.config.scenario_motion import Sweeps
from pepper_driver.observer import (
    TREE_TYPES,
    ExpectedErrorModel,
    ModelSet,
    MotorParameters,
    Recording,
    RecordingBuilder,
    TreeKind,
    expected_error,
    fit_joint,
    free_threshold,
    nrmse_fit,
)
from pepper_driver.robot import Pepper
from pepper_driver.staging import Stage, scenario_uri

Progress = Callable[[int, int], None]
"""Called with (runs done, runs in all)."""

Predictor = Callable[[Recording], FloatArray]
"""(n,) expected tracking error over a recording [rad]."""

CLOSED_FORM = "closed form"


@dataclass(frozen=True, kw_only=True)
class JointRecordings:
    """Free motion of one joint: the estimation runs, in order of their stiffness, and the faster test run."""

    joint: str
    estimation: tuple[Recording, ...]
    test: Recording


@dataclass(frozen=True, kw_only=True)
class Fit:
    """How well the tracking error of a joint is predicted, NRMSE [%]: estimation runs (mean), test run."""

    estimation: float
    test: float


@dataclass(frozen=True, kw_only=True)
class Identification:
    """The models, and by method and joint how well each predicts.

    ``fits`` holds the chosen tree first, then the other, then, on a simulated robot, the closed form of Eq. 11 with
    the plant's true parameters.
    """

    models: ModelSet
    fits: dict[str, dict[str, Fit]]

    def as_json(self) -> dict[str, Any]:
        """``fit.<method>.<joint>.{estimation,test}``, ``threshold_deg.<joint>``."""
        return {
            "fit": {
                method: {joint: asdict(fit) for joint, fit in fits.items()}
                for method, fits in self.fits.items()
            },
            "threshold_deg": {
                joint: float(np.degrees(bound)) for joint, bound in self.models.threshold.items()
            },
            "identity": self.models.identity,
        }


def record_joints(
    uri: str,
    joints: Sequence[str],
    scenario: Scenario,
    *,
    seed: int = 0,
    workers: int = -1,
    progress: Progress | None = None,
) -> tuple[JointRecordings, ...]:
    """Drive each joint through the estimation runs and the test run.

    Simulated backends run in parallel, each run on a robot and with a random sequence of its own; the result does not
    depend on ``workers``. A backend in real time runs one after the other.

    Args:
        uri: The backend. A seed in it makes other noise, not other motion.
        joints: Names of the joints to identify.
        scenario: Motion of kind sweeps; its joints are those given here.
        seed: Root of the random motion and noise.
        workers: Processes for simulated runs; -1 for one per core.
        progress: Told after each run.
    """
    robot = load_robot()
    if len(set(joints)) != len(joints):
        raise ConfigError(f"a joint is given twice: {', '.join(joints)}")
    motion = sweeps_of(scenario)
    uri = scenario_uri(uri, scenario)
    indices = [robot.joint_index(name) for name in joints]
    info = make_backend(uri, robot).info
    stiffnesses = (*motion.estimation_stiffness, scenario.stiffness)
    jobs = [
        delayed(record_run)(uri, name, scenario, stiffness, (seed, index, run))
        for name, index in zip(joints, indices, strict=True)
        for run, stiffness in enumerate(stiffnesses)
    ]
    pool = Parallel(n_jobs=1 if info.real_time else workers, return_as="generator")
    runs = list(_counted(pool(jobs), len(jobs), progress))
    per_joint = len(stiffnesses)
    return tuple(
        JointRecordings(
            joint=name,
            estimation=tuple(runs[i * per_joint : (i + 1) * per_joint - 1]),
            test=runs[(i + 1) * per_joint - 1],
        )
        for i, name in enumerate(joints)
    )


def _counted(
    runs: Iterable[Recording], total: int, progress: Progress | None
) -> Iterable[Recording]:
    for done, run in enumerate(runs, start=1):
        if progress is not None:
            progress(done, total)
        yield run


def record_run(
    uri: str,
    joint: str,
    scenario: Scenario,
    stiffness: float,
    seed: tuple[int, ...],
) -> Recording:
    """One run: the joint plays a random sequence twice, with other postures of its neighbours.

    Args:
        uri: The backend.
        joint: The joint to excite.
        scenario: The motion.
        stiffness: Of the posture task [1/s2].
        seed: Of the random sequence, and of a simulated robot's noise.
    """
    robot = load_robot()
    motion = replace(sweeps_of(scenario), joints=(joint,))
    scenario = replace(scenario, stiffness=stiffness, motion=motion)
    builder = RecordingBuilder(robot)
    pepper = Pepper(_seeded(uri, seed), observer=None, robot=robot)
    stage = Stage(pepper, scenario, seed)
    with pepper:
        stage.perform(on_tick=lambda tick, _: builder.append(tick))
    return builder.finish()


def sweeps_of(scenario: Scenario) -> Sweeps:
    """The motion of a scenario that can identify.

    Raises:
        ConfigError: Its motion is of another kind.
    """
    if not isinstance(scenario.motion, Sweeps):
        raise ConfigError(
            f"{scenario.source}: key 'motion.kind': identification takes sweeps, not {scenario.motion.kind}"
        )
    return scenario.motion


def _seeded(uri: str, seed: tuple[int, ...]) -> str:
    """The URI of the simulated Pepper with a noise seed of its own for this run; any other URI as it is."""
    parsed = parse_uri(uri)
    if parsed.scheme != "mujoco":
        return uri
    root = parsed.integer("seed", 0)
    number = int(np.random.SeedSequence((*seed, root)).generate_state(1)[0])
    return f"{parsed.scheme}://?{urlencode({**parsed.query, 'seed': number})}"


def identify_joints(
    uri: str,
    joints: Sequence[str],
    scenario: Scenario,
    kind: TreeKind,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> Identification:
    """Record free motion and fit a model of ``kind`` to each joint; see :func:`record_joints` for the rest.

    Raises:
        PepperError: A joint or backend that does not exist, a robot that refuses, data that determine nothing.
    """
    robot = load_robot()
    uri = scenario_uri(uri, scenario)
    recordings = record_joints(uri, joints, scenario, seed=seed, progress=progress)
    backend = make_backend(uri, robot)
    window = load_observer_settings().median_window
    fits: dict[str, dict[str, Fit]] = {}
    chosen: dict[str, ExpectedErrorModel] = {}
    for method in (kind, *(other for other in TREE_TYPES if other != kind)):
        fits[method] = {}
        for entry in recordings:
            model = fit_joint(entry.joint, entry.estimation, method)
            fits[method][entry.joint] = _fit(entry, _predictor(model, entry.joint))
            if method == kind:
                chosen[entry.joint] = model
    if "truth" in backend.info.capabilities:
        fits[CLOSED_FORM] = {
            entry.joint: _fit(entry, _oracle(backend, robot, entry.joint)) for entry in recordings
        }
    return Identification(
        models=ModelSet(
            robot=robot.name,
            joint_names=robot.joint_names,
            identity=backend.info.identity,
            kind=kind,
            cycle=robot.cycle,
            estimation_fit={name: fit.estimation for name, fit in fits[kind].items()},
            test_fit={name: fit.test for name, fit in fits[kind].items()},
            threshold={
                entry.joint: free_threshold(
                    entry.joint, (*entry.estimation, entry.test), chosen[entry.joint], window
                )
                for entry in recordings
            },
            version=version("pepper-driver"),
            models=chosen,
            created_by=f"pepper identify --backend {uri} --scenario {scenario.name} --joints {','.join(joints)} "
            f"--tree {kind} --seed {seed}",
        ),
        fits=fits,
    )


def _fit(entry: JointRecordings, predict: Predictor) -> Fit:
    """As in the paper: the mean over the estimation runs, and the test run."""
    index = entry.test.joint_names.index(entry.joint)
    scores = [
        nrmse_fit(run.tracking_error(index), predict(run))
        for run in (*entry.estimation, entry.test)
    ]
    return Fit(estimation=float(np.mean(scores[:-1])), test=scores[-1])


def _predictor(model: ExpectedErrorModel, joint: str) -> Predictor:
    return lambda run: model.predict(run.features(run.joint_names.index(joint)))


def _oracle(backend: Backend, robot: RobotConfig, joint: str) -> Predictor:
    """Eq. 11 with the plant's true parameters: what the method could know at best without friction's memory."""
    plant, info = backend.truth.plant, backend.info
    motor, ratio = robot.motors.of(joint), robot.motors.joints[joint].ratio
    actuator = plant.actuator(joint)
    friction = actuator.friction.contact
    parameters = MotorParameters(
        resistance=motor.resistance,
        torque_constant=motor.torque_constant,
        speed_constant=motor.torque_constant,
        rotor_inertia=motor.rotor_inertia,
        motor_damping=actuator.motor_damping,
        ratio=ratio,
        proportional_gain=actuator.kp,
        derivative_gain=actuator.kd,
        coulomb_friction=friction.motor + friction.link,
        viscous_friction=friction.motor_viscous + friction.link_viscous,
    )
    return lambda run: expected_error(
        parameters, run.features(run.joint_names.index(joint)), info.cycle
    )
