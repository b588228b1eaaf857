"""The evaluation is frozen: what was changed since is refused, and its seeds are its own."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.config import ConfigError, UnknownNameError, load_robot
from pepper_driver.config.contact_specs import RandomPushes
from pepper_driver.config.evaluation import (
    FOLDER,
    EvaluationSuites,
    SuiteRun,
    freeze,
    load_evaluation,
)
from pepper_driver.config.loading import package_file
from pepper_driver.config.steps import Setpoints, Sweeps

ROBOT = load_robot()
SUITES = ["paper", "fit", "mirror", "types"]


@pytest.fixture(scope="module")
def evaluation() -> EvaluationSuites:
    return load_evaluation(ROBOT)


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the suites that may be changed."""
    shutil.copytree(package_file(FOLDER), tmp_path / FOLDER)
    shutil.copy(package_file("evaluation.yaml"), tmp_path)
    return tmp_path / "evaluation.yaml"


def test_the_suites_are_as_they_were_frozen(evaluation: EvaluationSuites) -> None:
    assert list(evaluation.names) == SUITES
    assert set(evaluation.experiments) == {
        path.stem for path in package_file(FOLDER).glob("*.yaml")
    }, "an experiment that no suite uses is not frozen"


@pytest.mark.parametrize("name", ["paper-RERoll", "sweeps"])
def test_a_changed_experiment_is_refused_until_it_is_frozen_again(copy: Path, name: str) -> None:
    before = load_evaluation(ROBOT, copy).digest
    experiment = copy.parent / FOLDER / f"{name}.yaml"
    experiment.write_text(experiment.read_text().replace("[1/s2] of", "[1/s2], of"))
    with pytest.raises(
        ConfigError, match=rf"changed since it was frozen: \w+/{name}\.yaml; .*freeze"
    ):
        load_evaluation(ROBOT, copy)
    freeze(copy)
    assert load_evaluation(ROBOT, copy).digest != before


def test_changed_suites_are_refused_until_they_are_frozen_again(copy: Path) -> None:
    copy.write_text(copy.read_text().replace("[2.0, 3.0, 4.0, 5.0, 9.0]", "[2.0, 9.0]"))
    with pytest.raises(ConfigError, match=r"changed since it was frozen: evaluation\.yaml;"):
        load_evaluation(ROBOT, copy)
    freeze(copy)
    assert len(load_evaluation(ROBOT, copy).runs("fit")) == 2 * len(ROBOT.joint_names)


def test_line_ends_of_another_system_are_no_change(copy: Path) -> None:
    for path in (copy, *(copy.parent / FOLDER).glob("*.yaml")):
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    load_evaluation(ROBOT, copy)


def test_to_freeze_what_is_frozen_changes_nothing(copy: Path) -> None:
    text = copy.read_text()
    freeze(copy)
    assert copy.read_text() == text


def frozen_again(path: Path) -> EvaluationSuites:
    freeze(path)
    return load_evaluation(ROBOT, path)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("plants: [swaying,", "plants: [swayin,", "did you mean swaying"),
        ("experiment: sweeps", "experiment: sweps", "sweps.yaml: cannot be read"),
        ("[8.0]}", "[8.0], goals: 10}", "unknown key"),
        ("[8.0]}", "[8.0], joints: [HeadYaw]}", "only sweeps take joints"),
        ("root: 20261121", "root: 0", "must be 1 or more"),
    ],
)  # fmt: skip
def test_wrong_suites_are_one_line(copy: Path, old: str, new: str, reason: str) -> None:
    copy.write_text(copy.read_text().replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        frozen_again(copy)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_two_episodes_share_a_seed_and_none_has_one_of_identification(
    evaluation: EvaluationSuites,
) -> None:
    runs = [run for suite in evaluation.names for run in evaluation.runs(suite)]
    pools = [tuple(np.random.SeedSequence(run.seed).generate_state(4)) for run in runs]
    assert len({(pool, run.plant) for pool, run in zip(pools, runs, strict=True)}) == len(runs)
    learned = {
        tuple(np.random.SeedSequence((root, joint, run)).generate_state(4))
        for root in (0, 1, evaluation.root)
        for joint in range(17)
        for run in range(10)
    }
    assert not learned & set(pools)
    assert all(len(run.seed) > 3 and run.seed[3] for run in runs)


def goals_of(run: SuiteRun) -> Setpoints | Sweeps:
    """The random goals of a run."""
    step = run.experiment.random_step
    assert step is not None
    assert isinstance(step.goals, Setpoints | Sweeps)
    return step.goals


def count_of(run: SuiteRun) -> int:
    """Contacts of a run, as many of each kind."""
    motion = goals_of(run)
    assert isinstance(motion, Setpoints)
    count = 0
    for contact in run.experiment.contacts:
        assert isinstance(contact, RandomPushes)
        count += sum(n * motion.period >= contact.after - 1e-6 for n in range(motion.count)) * len(
            contact.times
        )
    return count


def test_table_1_has_the_contacts_of_the_paper(evaluation: EvaluationSuites) -> None:
    rows = {}
    for run in evaluation.runs("paper"):
        (contact,) = run.experiment.contacts
        assert isinstance(goals_of(run), Setpoints)
        assert isinstance(contact, RandomPushes)
        assert contact.degrees == (2.5, 12.0)
        key = (run.entry, run.plant)
        rows[key] = (contact.joints, run.task_stiffness, count_of(run))
    for plant in ("swaying", "swaying-integral"):
        assert rows[("LSRoll", plant)] == (("LShoulderRoll",), 8.0, 20)
        assert rows[("RERoll", plant)] == (("RElbowRoll",), 12.0, 22)
        assert rows[("RSRoll", plant)] == (("RShoulderRoll",), 8.0, 21)
    assert len(rows) == 6


def test_the_fit_suite_moves_every_joint_at_the_stiffness_of_estimation_and_test(
    evaluation: EvaluationSuites,
) -> None:
    done = {(run.entry, run.task_stiffness) for run in evaluation.runs("fit")}
    assert done == {(name, k) for name in ROBOT.joint_names for k in (2.0, 3.0, 4.0, 5.0, 9.0)}
    for run in evaluation.runs("fit"):
        motion = goals_of(run)
        assert isinstance(motion, Sweeps)
        assert motion.joints == (run.entry,)
        assert run.experiment.stiffness == run.task_stiffness


def test_a_fraction_of_a_suite_is_shorter(evaluation: EvaluationSuites) -> None:
    for suite in evaluation.names:
        whole, part = evaluation.runs(suite), evaluation.runs(suite, fraction=0.1)
        assert 0.05 < sum(r.seconds for r in part) / sum(r.seconds for r in whole) < 0.5
        assert {r.seed for r in part} <= {r.seed for r in whole}
        assert all(count_of(run) > 0 for run in part if run.experiment.contacts)
    assert len(evaluation.runs("paper", fraction=0.1)) == len(evaluation.runs("paper"))
    for fraction in (0.0, -1.0, 1.1, float("nan")):
        with pytest.raises(ConfigError, match="fraction of a suite"):
            evaluation.runs("paper", fraction=fraction)


def test_an_unknown_suite_lists_those_there_are(evaluation: EvaluationSuites) -> None:
    with pytest.raises(UnknownNameError, match="did you mean paper"):
        evaluation.runs("papr")
