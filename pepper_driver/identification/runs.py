"""Runs of an identification: planned, dry run, and driven."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pepper_driver.backends.mock import MockBackend
from pepper_driver.backends.selection import parse_uri, with_query
from pepper_driver.callbacks.events import SensorEdges
from pepper_driver.config import (
    ConfigError,
    ControllerSettings,
    Experiment,
    PepperError,
    RobotConfig,
    load_controller_settings,
    load_experiment,
    load_robot,
)
from pepper_driver.config.passwords import without_secrets
from pepper_driver.config.steps import Setpoints, Sweeps
from pepper_driver.controller import Tick
from pepper_driver.experiments.plan import plan_experiment
from pepper_driver.identification.measurements.friction import GRAVITY, HeldWeight
from pepper_driver.identification.measurements.program import (
    FRICTION,
    MEASUREMENTS,
    SPEED,
    TESTED_SPEED,
    WEIGHT,
    weighted_hand,
)
from pepper_driver.observer import Observation, Recording, RecordingBuilder
from pepper_driver.recording.terminal_keys import StopKey
from pepper_driver.robot import Pepper
from pepper_driver.safety import FaultError


def run_name(what: str, number: int | None) -> str:
    """Name of a run: the joint or ``calibration``, then its number from 1 on, or ``test``."""
    return f"{what}-{'test' if number is None else number}"


Role = Literal["estimation", "test", "calibration", "measurement"]

CALIBRATION_STIFFNESS = (3.0, 5.0, 8.0, 12.0)
"""[1/s2] of the posture task, one run of the calibration motion each, from slow to faster than the test run."""


@dataclass(frozen=True, kw_only=True)
class IdentificationRun:
    """One run of the robot, from its first posture to its last.

    Attributes:
        name: Of its file.
        joint: The joint to excite; None where more than one moves.
        role: What it is for.
        experiment: With the joint of this run.
        stiffness: Of the posture task [1/s2].
        seed: Of the random motion, and of a simulated robot's noise.
        seconds: How long it takes, from the first posture on [s].
        watched: Reason for which the user of a real robot is asked first; empty for none.
        moves_legs: True where legs or base move.
        arm_speed: Largest speed of the arm joints [rad/s]; None for the controller's own.
        weight: That a person hangs into a hand before; it hangs in that of a simulated robot by itself. None for none.
    """

    name: str
    joint: str | None
    role: Role
    experiment: Experiment
    stiffness: float
    seed: tuple[int, ...]
    seconds: float
    watched: str
    moves_legs: bool = False
    arm_speed: float | None = None
    weight: HeldWeight | None = None

    def after_weight(self) -> IdentificationRun:
        """Return the run with the request to empty the hand before it."""
        watched = "; ".join(filter(None, (EMPTY_HAND, self.watched)))
        return replace(self, watched=watched)

    def controller(self, robot: RobotConfig) -> ControllerSettings:
        """Return the settings of the controller for this run."""
        settings = load_controller_settings(robot)
        if self.arm_speed is None:
            return settings
        arms = [name for chain in ("left_arm", "right_arm") for name in robot.chains[chain]]
        limits = settings.velocity_limit | dict.fromkeys(arms, self.arm_speed)
        return replace(settings, velocity_limit=limits)


LEGS_MOVE, BODY_MOVES = "the legs move", "the whole body and the base move"
FAST_ARMS = "both arms move fast, out to the front and back"
EMPTY_HAND = "take the weight out of the hand now"


WEIGHT_MARGIN = 10.0
"""[s] for which a simulated weight hangs longer than its run takes."""


def plan_measurements(
    robot: RobotConfig, seed: int = 0, *, weight: HeldWeight | None = None
) -> tuple[IdentificationRun, ...]:
    """All runs by which a robot is measured before its models are identified.

    Args:
        robot: Its description.
        seed: Of a simulated robot's noise.
        weight: For one run more, with it in a hand; None for none.
    """
    runs = []
    names = MEASUREMENTS if weight is None else (*MEASUREMENTS, WEIGHT)
    for number, name in enumerate(names):
        experiment = load_experiment(FRICTION if name == WEIGHT else name, robot)
        assert experiment.stiffness is not None
        run = _run(
            robot,
            experiment,
            stiffness=experiment.stiffness,
            name=run_name(name, 1),
            joint=None,
            role="measurement",
            seed=(seed, len(robot.joint_names) + 1, number),
            watched=FAST_ARMS if name == SPEED else "",
        )
        if name == SPEED:
            run = replace(run, arm_speed=TESTED_SPEED)
        elif name == WEIGHT and weight is not None:
            run = replace(run, weight=weight, watched=_hang(weight))
        runs.append(run)
    return tuple(runs)


def _hang(weight: HeldWeight) -> str:
    hand = weighted_hand(weight)
    return f"both arms move slowly, with a weight of {weight.mass:g} kg in the {hand} hand: hang it there now"


def plan_runs(
    robot: RobotConfig,
    joints: Sequence[str],
    experiment: Experiment,
    *,
    tested: Sequence[str] = (),
    calibration: Experiment | None = None,
    seed: int = 0,
) -> tuple[IdentificationRun, ...]:
    """All runs of an identification, as Sec. IV of the paper has them, then those of the whole body.

    What a run is does not depend on the other runs.

    Args:
        robot: Its description.
        joints: To identify: estimation runs and a test run each.
        experiment: An experiment with sweeps; its joints are those given here.
        tested: Joints with a test run only, after the others.
        calibration: Free motion of the whole body; None for none.
        seed: Root of the random motion and noise.

    Raises:
        ConfigError: A joint given twice, no sweeps, contacts.
        UnknownNameError: No such joint.
    """
    named = (*joints, *tested)
    if not named:
        raise ConfigError("no joint is given: nothing to identify")
    for name in named:
        robot.joint_index(name)
    if len(set(named)) != len(named):
        raise ConfigError(f"a joint is given twice: {', '.join(named)}")
    sweeps = sweeps_of(experiment)
    if experiment.stiffness is None:
        raise experiment.error(
            "stiffness", "missing: that of the posture task in the test run [1/s2]"
        )
    runs = []
    for name in named:
        stiffnesses = () if name in tested else sweeps.estimation_stiffness
        swept = experiment.with_goals(joints=(name,))
        # The test run has the same seed with or without estimation runs.
        numbers = [*range(len(stiffnesses)), len(sweeps.estimation_stiffness)]
        for number, stiffness in zip(numbers, (*stiffnesses, experiment.stiffness), strict=True):
            test = number == numbers[-1]
            legs = name in robot.chains.get("legs", ())
            runs.append(
                _run(
                    robot,
                    swept,
                    stiffness=stiffness,
                    name=run_name(name, None if test else number + 1),
                    joint=name,
                    role="test" if test else "estimation",
                    seed=(seed, robot.joint_index(name), number),
                    watched=LEGS_MOVE if legs else "",
                    moves_legs=legs,
                )
            )
    if calibration is not None:
        runs.extend(_calibration_runs(robot, calibration, seed))
    return tuple(runs)


def _calibration_runs(
    robot: RobotConfig, experiment: Experiment, seed: int
) -> list[IdentificationRun]:
    if experiment.contacts:
        raise experiment.error("contacts", "thresholds are chosen on free motion; leave them out")
    body = _moves_body(robot, experiment)
    return [
        _run(
            robot,
            experiment,
            stiffness=stiffness,
            name=run_name("calibration", number + 1),
            joint=None,
            role="calibration",
            seed=(seed, len(robot.joint_names), number),
            watched=BODY_MOVES if body else "",
            moves_legs=body,
        )
        for number, stiffness in enumerate(CALIBRATION_STIFFNESS)
    ]


def _moves_body(robot: RobotConfig, experiment: Experiment) -> bool:
    """Return False where arms and head alone move, by random set-points."""
    step = experiment.random_step
    if len(experiment.steps) != 1 or step is None or not isinstance(step.goals, Setpoints):
        return True
    joints = (*step.goals.joints, *step.goals.secondary_joints)
    return step.goals.base is not None or not set(robot.chains["legs"]).isdisjoint(joints)


def _run(
    robot: RobotConfig,
    experiment: Experiment,
    *,
    stiffness: float,
    name: str,
    joint: str | None,
    role: Role,
    seed: tuple[int, ...],
    watched: str,
    moves_legs: bool = False,
) -> IdentificationRun:
    experiment = replace(experiment, stiffness=stiffness)
    plan = plan_experiment(experiment, robot, MockBackend(robot), seed=seed)
    seconds = sum(segment.ticks for segment in plan.segments) * robot.cycle
    if experiment.random_step is None:  # segments do not have the repetitions of a block
        seconds = experiment.max_length
    return IdentificationRun(
        name=name,
        joint=joint,
        role=role,
        experiment=experiment,
        stiffness=stiffness,
        seed=seed,
        seconds=seconds,
        watched=watched,
        moves_legs=moves_legs,
    )


def sweeps_of(experiment: Experiment) -> Sweeps:
    """Return the sweeps of an experiment that can identify.

    Raises:
        ConfigError: It has none.
    """
    step = experiment.random_step
    if step is None or not isinstance(step.goals, Sweeps):
        raise experiment.error("steps", "identification takes a step with sweeps")
    return step.goals


def perform(
    uri: str,
    run: IdentificationRun,
    *,
    identity: str | None = None,
    stop_key: bool = False,
    on_progress: Callable[[float], None] | None = None,
    on_touch: Callable[[str], None] | None = None,
) -> Recording:
    """Have a robot perform a run. However it ends, the robot is stopped safely.

    Args:
        uri: The backend.
        run: What to do.
        identity: Of the robot that is expected; None for any.
        stop_key: Whether a key of the terminal stops the robot.
        on_progress: Called with the fraction of the time that has passed, 0..1.
        on_touch: Called inside the tick with the name of a touch sensor or bumper that is pressed: must be quick.

    Raises:
        ConfigError: It is another robot than is expected.
        PepperError: The robot refuses, or the safety gate stopped it.
    """
    robot = load_robot()
    builder = RecordingBuilder(robot)
    pepper = Pepper(uri, observer=None, robot=robot, controller=run.controller(robot))
    if identity is not None and pepper.backend.info.identity != identity:
        raise ConfigError(
            f"backend '{without_secrets(uri)}' is another robot on {platform.node()} than at the beginning: a file of "
            "its plant differs there, or was changed"
        )
    plan = plan_experiment(run.experiment, robot, pepper.backend, seed=run.seed)
    edges: SensorEdges | None = None

    def on_tick(tick: Tick, _: Observation | None) -> None:
        nonlocal edges
        builder.append(tick)
        if edges is None:  # a sensor that is jammed is no touch
            edges = SensorEdges(robot, tick.measurement)
        for event in edges.step(tick.measurement):
            if on_touch is not None and event.pressed and event.kind != "button":
                on_touch(event.name)

    with StopKey(pepper.emergency_stop) if stop_key else nullcontext(), pepper:
        if run.weight is not None and pepper.backend.info.simulated:
            force = (0.0, 0.0, -run.weight.mass * GRAVITY)
            # Until the end: the motion to the first posture comes before.
            duration = run.seconds + WEIGHT_MARGIN
            pepper.push(run.weight.link, force, run.weight.xyz, duration, rise=0.5)
        pepper.play(
            plan,
            on_tick=on_tick,
            on_progress=on_progress,
            skip_settling=True,
        )
    return builder.finish()


def seeded_uri(uri: str, run: IdentificationRun) -> str:
    """Return the URI of a simulated robot that takes a seed, with one of its own for the noise of this run."""
    root = parse_uri(uri).integer("seed", 0)
    return with_query(uri, seed=int(np.random.SeedSequence((*run.seed, root)).generate_state(1)[0]))


class DryRunError(PepperError, RuntimeError):
    """A run would fail; nothing has moved."""


def check_dry_run(run: IdentificationRun) -> None:
    """Have controller and gate play a run.

    Raises:
        DryRunError: The gate would stop the robot or alter a command, or the controller would find no motion that
            keeps its constraints.
    """
    robot = load_robot()
    pepper = Pepper("mock", observer=None, robot=robot, controller=run.controller(robot))
    time = 0.0

    def watch(tick: Tick, _: Observation | None) -> None:
        nonlocal time
        time = tick.measurement.time
        # Of the last cycle: it is the command of the next one.
        status = pepper.controller.status
        if status.solver != "solved":
            lost = ", ".join(status.violated) or status.solver
            raise DryRunError(f"the controller cannot keep its limits ({lost})")
        if tick.limited.any():
            joint = robot.joint_names[int(np.argmax(tick.limited))]
            raise DryRunError(f"the safety gate would alter the command of {joint}")

    plan = plan_experiment(run.experiment, robot, pepper.backend, seed=run.seed)
    try:
        with pepper:
            pepper.play(plan, on_tick=watch, skip_settling=True)
    except (DryRunError, FaultError) as error:
        raise DryRunError(
            f"run {run.name} would fail {time:.1f} s after its start: {error}; nothing has moved"
        ) from error
