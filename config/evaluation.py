"""The frozen evaluation: suites, the experiments they perform, and hashes that show when one was changed.

``python -m pepper_driver.config.evaluation`` freezes the suites again after a change that is meant. Models that were
fitted before then were not evaluated on what they had never seen: say so, or fit them again.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from math import ceil
from pathlib import Path
from typing import Annotated, Literal
from zlib import crc32

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.contact_specs import RandomTouch
from pepper_driver.config.errors import ConfigError, UnknownNameError
from pepper_driver.config.experiment import Experiment, load_experiment
from pepper_driver.config.files import content_hash
from pepper_driver.config.frozen import frozen_part_hash, text_hash, write_frozen
from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import STRICT, own_or_shipped, parse, read_yaml
from pepper_driver.config.parts import Positive
from pepper_driver.config.plant import plant_names
from pepper_driver.config.robot import RobotConfig, load_robot
from pepper_driver.config.steps import Holds, Setpoints, Sweeps

FOLDER = "evaluation_experiments"

_MARK = 0xE7A1
_FILE = "evaluation.yaml"
_CURE = "python -m pepper_driver.config.evaluation"


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SuiteEntry:
    """Runs of a suite and their robots.

    Attributes:
        name: As it is called in results. With ``joints`` each of them is an experiment, and called like that.
        experiment: By name, of ``evaluation_experiments``.
        plants: Names of plants.
        task_stiffness: Of the posture task [1/s2]; one episode each.
        joints: Of sweeps: these, one after the other.
    """

    name: str
    experiment: str
    plants: Annotated[tuple[str, ...], Field(min_length=1)]
    task_stiffness: Annotated[tuple[Positive, ...], Field(min_length=1)]
    joints: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Frozen:
    """SHA-256 of the file without this part, and of each experiment."""

    suites: str
    experiments: dict[str, str]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class _File:
    """``evaluation.yaml`` as it stands."""

    version: Literal[1]
    root: Annotated[int, Field(ge=1)]
    suites: dict[str, Annotated[tuple[SuiteEntry, ...], Field(min_length=1)]]
    frozen: Frozen


@dataclass(frozen=True, kw_only=True)
class SuiteRun:
    """One episode that is to be performed.

    Attributes:
        suite, entry: Where it belongs.
        experiment: What is performed, with the task stiffness and the joint of this run.
        plant: Name of the plant.
        task_stiffness: Of the posture task [1/s2].
        seed: Of all that is random: the root of the file, suite, experiment, a mark that no seed of identification
            carries, and a number within the experiment.
    """

    suite: str
    entry: str
    experiment: Experiment
    plant: str
    task_stiffness: float
    seed: tuple[int, ...]

    @property
    def label(self) -> str:
        """Human-readable."""
        return f"{self.suite}, {self.entry} on {self.plant} at {self.task_stiffness:g}/s2, seed {self.seed[-1]}"

    @property
    def seconds(self) -> float:
        """Simulated time expected [s]."""
        goals = _goals(self.experiment)
        if isinstance(goals, Sweeps):
            return goals.settle + goals.number * sum(goals.dwell) / 2
        return goals.settle + goals.period * goals.count


@dataclass(frozen=True, kw_only=True)
class EvaluationSuites:
    """All suites, with their experiments by name.

    Attributes:
        root: Of all seeds.
        suites: Experiments by name of the suite.
        experiments: By name.
        digest: Of the file and, through it, of all experiments; for results.
    """

    root: int
    suites: dict[str, tuple[SuiteEntry, ...]]
    experiments: dict[str, Experiment]
    digest: str

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the suites."""
        return tuple(self.suites)

    def runs(self, suite: str, *, fraction: float = 1.0) -> tuple[SuiteRun, ...]:
        """Return the episodes of a suite, in their order.

        Args:
            suite: Its name.
            fraction: Of the suite, 0..1: fewer goals in each episode, of sweeps fewer episodes. For a quick
                check only; the score is then not that of the suite.

        Raises:
            UnknownNameError: No such suite.
            ConfigError: The fraction is outside 0..1.
        """
        if suite not in self.suites:
            raise UnknownNameError("suite", suite, (*self.names, "all"))
        if not 0 < fraction <= 1:
            raise ConfigError(f"the fraction of a suite lies between 0 and 1, got {fraction:g}")
        runs = [run for entry in self.suites[suite] for run in self._runs(suite, entry)]
        if fraction == 1.0:
            return tuple(runs)
        whole = [run for run in runs if isinstance(_goals(run.experiment), Sweeps)]
        kept = {id(run) for run in whole[:: max(1, round(1 / fraction))]}
        shorter = ((run, _shorter(run, fraction)) for run in runs)
        return tuple(s if s is not None else run for run, s in shorter if s or id(run) in kept)

    def _runs(self, suite: str, entry: SuiteEntry) -> Iterator[SuiteRun]:
        experiment = self.experiments[entry.experiment]
        for name in entry.joints or (entry.name,):
            performed = experiment.with_goals(joints=(name,)) if entry.joints else experiment
            for number, stiffness in enumerate(entry.task_stiffness):
                for plant in entry.plants:
                    yield SuiteRun(
                        suite=suite,
                        entry=name,
                        experiment=replace(performed, stiffness=stiffness),
                        plant=plant,
                        task_stiffness=stiffness,
                        # The same motion on all plants, as far as pushes allow: results differ by the robot.
                        seed=(
                            self.root,
                            crc32(suite.encode()),
                            crc32(name.encode()),
                            _MARK,
                            number,
                        ),
                    )


def _shorter(run: SuiteRun, fraction: float) -> SuiteRun | None:
    """Return a run with fewer goals after the free motion it begins with; None where the motion has none."""
    motion = _goals(run.experiment)
    if isinstance(motion, Sweeps):
        return None
    random = (c.after for c in run.experiment.contacts if isinstance(c, RandomTouch))
    # These stay: without them no contact would remain.
    free = ceil(max(random, default=0.0) / motion.period - 1e-6)
    count = min(motion.count, free + max(1, round((motion.count - free) * fraction)))
    return replace(run, experiment=run.experiment.with_goals(count=count))


@with_lines
def load_evaluation(robot: RobotConfig, path: Path | str | None = None) -> EvaluationSuites:
    """Return the suites, by default those of the package; experiments lie in the folder next to the file.

    Raises:
        ConfigError: The file or an experiment is wrong, or was changed since it was frozen.
    """
    path = own_or_shipped(path, _FILE)
    file = parse(_File, read_yaml(path), str(path))
    changed = _changed(path, file)
    if changed:
        raise ConfigError(
            f"{path}: changed since it was frozen: {', '.join(changed)}; undo the change, or freeze it again with "
            f"'{_CURE}' and fit all models again"
        )
    experiments = {name: load_experiment(_path_of(path, name), robot) for name in _names_in(file)}
    for suite, entries in file.suites.items():
        for number, entry in enumerate(entries):
            _check(entry, experiments, robot, f"{path}: key 'suites.{suite}.{number}")
    return EvaluationSuites(
        root=file.root,
        suites=dict(file.suites),
        experiments=experiments,
        digest=content_hash([file.frozen.suites, file.frozen.experiments]),
    )


def freeze(path: Path | str | None = None) -> None:
    """Write the hashes of the suites and of their experiments into the file.

    Raises:
        ConfigError: The file cannot be read or written, or has no suites.
    """
    path = own_or_shipped(path, _FILE)
    data = read_yaml(path)
    data["frozen"] = {"suites": "", "experiments": {}}
    file = parse(_File, data, str(path))
    lines = ["frozen:", f"  suites: {frozen_part_hash(path)}", "  experiments:"]
    lines += [f"    {name}: {text_hash(_path_of(path, name))}" for name in _names_in(file)]
    write_frozen(path, lines)


def _check(
    entry: SuiteEntry, experiments: dict[str, Experiment], robot: RobotConfig, where: str
) -> None:
    goals = _goals(experiments[entry.experiment])
    for plant in entry.plants:
        if plant not in plant_names():
            raise ConfigError(f"{where}.plants': {UnknownNameError('plant', plant, plant_names())}")
    for joint in entry.joints:
        robot.joint_index(joint)
    if entry.joints and not isinstance(goals, Sweeps):
        raise ConfigError(f"{where}.joints': only sweeps take joints")


def _goals(experiment: Experiment) -> Setpoints | Holds | Sweeps:
    """Return the random goals of an experiment."""
    step = experiment.random_step
    if step is None:
        raise experiment.error("steps", "a suite performs random goals, and no step has any")
    return step.goals


def _names_in(file: _File) -> tuple[str, ...]:
    return tuple(sorted({e.experiment for suite in file.suites.values() for e in suite}))


def _path_of(path: Path, name: str) -> Path:
    return path.parent / FOLDER / f"{name}.yaml"


def _changed(path: Path, file: _File) -> list[str]:
    """Names of what is not as it was frozen."""
    frozen = file.frozen.experiments
    names = [path.name] if frozen_part_hash(path) != file.frozen.suites else []
    for name in _names_in(file):
        experiment = _path_of(path, name)
        if frozen.get(name) != text_hash(experiment):
            names.append(f"{FOLDER}/{name}.yaml")
    return names


def main() -> None:
    """Freeze the suites of the package, and read them once."""
    try:
        freeze()
        evaluation = load_evaluation(load_robot())
    except ConfigError as error:
        sys.exit(f"error: {error}")
    print(f"frozen: {', '.join(evaluation.names)} ({evaluation.digest})")


if __name__ == "__main__":
    main()
