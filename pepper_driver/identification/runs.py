"""What identification asks a robot to do: the runs in their order, each with a seed of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal
from urllib.parse import urlencode

import numpy as np

from pepper_driver.backends.selection import parse_uri
from pepper_driver.config import ConfigError, RobotConfig, Scenario, load_robot
from pepper_driver.config.scenario_motion import Sweeps
from pepper_driver.identification.recordings import run_name
from pepper_driver.observer import Recording, RecordingBuilder
from pepper_driver.robot import Pepper
from pepper_driver.staging import Stage
from pepper_driver.timeline import legs

Role = Literal["estimation", "test", "calibration"]

CALIBRATION_STIFFNESS = (3.0, 5.0, 8.0, 12.0)
"""[1/s2] of the posture task, one run of the calibration motion each, from slow to faster than the test run."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """One run of the robot, from its first posture to its last.

    Attributes:
        name: Of its file.
        joint: The joint to excite; None where the whole body moves.
        role: What it is for.
        scenario: With the stiffness and the joint of this run.
        seed: Of the random motion, and of a simulated robot's noise.
        seconds: How long it takes, from the first posture on [s].
        watched: Whether legs or base move: on a real robot somebody must be asked first.
    """

    name: str
    joint: str | None
    role: Role
    scenario: Scenario
    seed: tuple[int, ...]
    seconds: float
    watched: bool


def plan_runs(
    robot: RobotConfig,
    joints: Sequence[str],
    scenario: Scenario,
    *,
    tested: Sequence[str] = (),
    calibration: Scenario | None = None,
    seed: int = 0,
) -> tuple[Run, ...]:
    """All runs of an identification, as Sec. IV of the paper has them, then those of the whole body.

    What a run is does not depend on the other runs.

    Args:
        robot: Its description.
        joints: To identify: estimation runs and a test run each.
        scenario: Motion of kind sweeps; its joints are those given here.
        tested: Joints with a test run only, after the others.
        calibration: Free motion of the whole body; None for none.
        seed: Root of the random motion and noise.

    Raises:
        ConfigError: A joint given twice, motion of another kind, contacts.
        UnknownNameError: No such joint.
    """
    named = (*joints, *tested)
    if len(set(named)) != len(named):
        raise ConfigError(f"a joint is given twice: {', '.join(named)}")
    if not named:
        raise ConfigError("no joint is given: nothing to identify")
    for name in named:
        robot.joint_index(name)
    motion = sweeps_of(scenario)
    runs = []
    for name in named:
        stiffnesses = () if name in tested else motion.estimation_stiffness
        swept = replace(scenario, motion=replace(motion, joints=(name,)))
        # The test run has the same seed with or without estimation runs.
        numbers = [*range(len(stiffnesses)), len(motion.estimation_stiffness)]
        for number, stiffness in zip(numbers, (*stiffnesses, scenario.stiffness), strict=True):
            test = number == numbers[-1]
            runs.append(
                _run(
                    robot,
                    replace(swept, stiffness=stiffness),
                    name=run_name(name, None if test else number + 1),
                    joint=name,
                    role="test" if test else "estimation",
                    seed=(seed, robot.joint_index(name), number),
                )
            )
    if calibration is not None:
        runs.extend(_calibration_runs(robot, calibration, seed))
    return tuple(runs)


def _calibration_runs(robot: RobotConfig, scenario: Scenario, seed: int) -> list[Run]:
    if scenario.contacts:
        raise ConfigError(
            f"{scenario.source}: key 'contacts': thresholds are chosen on free motion; leave them out"
        )
    return [
        _run(
            robot,
            replace(scenario, stiffness=stiffness),
            name=run_name("calibration", number + 1),
            joint=None,
            role="calibration",
            seed=(seed, len(robot.joint_names), number),
        )
        for number, stiffness in enumerate(CALIBRATION_STIFFNESS)
    ]


def _run(
    robot: RobotConfig,
    scenario: Scenario,
    *,
    name: str,
    joint: str | None,
    role: Role,
    seed: tuple[int, ...],
) -> Run:
    ticks = sum(leg.ticks for leg in legs(scenario, robot, np.random.default_rng(seed)))
    return Run(
        name=name,
        joint=joint,
        role=role,
        scenario=scenario,
        seed=seed,
        seconds=ticks * robot.cycle,
        watched=joint is None or joint in robot.chains.get("legs", ()),
    )


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


def perform(uri: str, run: Run, *, on_progress: Callable[[float], None] | None = None) -> Recording:
    """Have a robot perform a run. However it ends, the robot is stopped safely.

    Args:
        uri: The backend.
        run: What to do.
        on_progress: Told the share of the time that is over, 0..1.

    Raises:
        PepperError: The robot refuses, or the safety gate stopped it.
    """
    robot = load_robot()
    builder = RecordingBuilder(robot)
    pepper = Pepper(_seeded(uri, run.seed), observer=None, robot=robot)
    stage = Stage(pepper, run.scenario, run.seed)
    with pepper:
        stage.perform(on_tick=lambda tick, _: builder.append(tick), on_progress=on_progress)
    return builder.finish()


def _seeded(uri: str, seed: tuple[int, ...]) -> str:
    """The URI of the simulated Pepper with a noise seed of its own for this run; any other URI as it is."""
    parsed = parse_uri(uri)
    if parsed.scheme != "mujoco":
        return uri
    root = parsed.integer("seed", 0)
    number = int(np.random.SeedSequence((*seed, root)).generate_state(1)[0])
    return f"{parsed.scheme}://?{urlencode({**parsed.query, 'seed': number})}"
