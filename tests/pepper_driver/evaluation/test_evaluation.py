"""From jobs to tables: hand-made episodes through the shipped observers."""

import json
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.config import UnknownNameError
from pepper_driver.config.evaluation import load_evaluation
from pepper_driver.evaluation.episodes import Episode
from pepper_driver.evaluation.evaluate import Job, evaluate, suite_jobs
from pepper_driver.evaluation.figures import write_figures
from pepper_driver.evaluation.observers_under_test import (
    ORACLE,
    ObserversUnderTest,
)
from pepper_driver.evaluation.report import page, table, write_report
from pepper_driver.evaluation.results import EvaluationResult
from pepper_driver.observer import AffineTree, ModelSet, shipped
from support.evaluation import CYCLE, JOINT, ROBOT, make_episode, push

SECONDS = 8.4
"""Of each episode, in whole cycles; the later push ends more than a second before."""
PAPER = ObserversUnderTest(modes=("paper-affine", "paper-cart"))
FIT_KINDS = ("estimation", "test")


def touched(suite: str, experiment: str, detected: int) -> Episode:
    """An episode with two pushes; the first ``detected`` of them move the joint by 6 degrees, the other way."""
    pushes = [push(2.0), push(6.0)]
    make = partial(make_episode, pushes, seconds=SECONDS, suite=suite, experiment=experiment)
    episode = make()
    error = np.zeros(len(episode.recording))
    for one in pushes[:detected]:
        error[
            (episode.recording.time > one.onset) & (episode.recording.time < one.release)
        ] = -0.105
    return make(error=error)


def swept(stiffness: float) -> Episode:
    """A free episode about a joint whose tracking error swings."""
    error = 0.01 * np.sin(np.arange(round(SECONDS / CYCLE)) * 0.05)
    return make_episode(
        seconds=SECONDS, suite="fit", experiment=JOINT, task_stiffness=stiffness, error=error
    )


def broken() -> Episode:
    raise RuntimeError("the file\nis missing")


def job(suite: str, make: Callable[[], Episode], pictured: str | None = None) -> Job:
    return Job(suite=suite, title=f"{suite}, an episode", make=make, pictured=pictured)


@pytest.fixture(scope="module")
def result() -> EvaluationResult:
    jobs = [
        job("paper", partial(touched, "paper", "LSRoll", 2), JOINT),
        job("paper", partial(touched, "paper", "RERoll", 1), "RElbowRoll"),
        job("paper", partial(touched, "paper", "RSRoll", 0), "RShoulderRoll"),
        job("paper-integral", partial(touched, "paper", "LSRoll", 1)),
        job("fit", partial(swept, 2.0)),
        job("fit", partial(swept, 9.0), JOINT),
        job("types", broken),
    ]
    return evaluate(jobs, PAPER, workers=1, digest="0123")


def test_counts_and_fits_reach_the_file(result: EvaluationResult) -> None:
    suites = result.as_json()["modes"]["paper-affine"]["suites"]
    assert suites["paper"]["table1"] == {
        "LSRoll": {"fp": 0, "fn": 0, "tp": 2},
        "RERoll": {"fp": 0, "fn": 1, "tp": 1},
        "RSRoll": {"fp": 0, "fn": 2, "tp": 0},
        "total": {"fp": 0, "fn": 3, "tp": 3},
    }
    assert suites["paper-integral"]["table1"]["total"] == {"fp": 0, "fn": 1, "tp": 1}
    assert suites["fit"]["table1"] == {}
    assert set(suites["fit"]["fit"]) == {JOINT}
    assert all(isinstance(suites["fit"]["fit"][JOINT][kind], float) for kind in FIT_KINDS)


def test_the_json_is_plain(result: EvaluationResult) -> None:
    content = json.loads(json.dumps(result.as_json(), allow_nan=False))
    assert set(content["modes"]) == {"paper-affine", "paper-cart"}
    assert (content["frozen"], content["plants"]) == ("0123", ["nominal"])
    assert content["hours"] == pytest.approx(6 * SECONDS / 3600.0)
    assert {"pepper-driver", "mujoco", "numpy", "pin"} <= set(content["versions"])


def test_a_episode_that_fails_costs_no_other(result: EvaluationResult) -> None:
    assert [(f.title, f.reason) for f in result.failures] == [
        ("types, an episode", "RuntimeError: the file is missing")
    ]
    assert len(result.episodes) == 6


def test_an_observer_takes_no_part_where_it_is_not_asked_for() -> None:
    modes = ObserversUnderTest(modes=(ORACLE, "paper-affine"))
    short = partial(make_episode, experiment=JOINT, seconds=0.03)
    jobs = [job(suite, partial(short, suite=suite)) for suite in ("fit", "types")]
    result = evaluate(jobs, modes, digest="0", workers=1)
    assert not result.failures
    assert {mode: set(suites) for mode, suites in result.modes.items()} == {
        ORACLE: {"fit"},
        "paper-affine": {"fit", "types"},
    }


def test_the_result_does_not_depend_on_the_workers() -> None:
    jobs = [job("paper", partial(touched, "paper", "LSRoll", n)) for n in range(3)]
    one, two = (evaluate(jobs, PAPER, digest="0", workers=n).as_json() for n in (1, 2))
    assert one == two


def test_the_report(result: EvaluationResult, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    path = tmp_path / "docs" / "results.md"
    write_report(result, path, ROBOT, "pepper evaluate --suite all --report docs/results.md")
    text = path.read_text()
    first = text.splitlines()[0]
    assert "simulated" in first
    assert "pepper evaluate --suite all" in first
    for part in ("| LSRoll |", "| published | 2 / 2 / 18 |", "Run of 20", "mujoco", "nominal"):
        assert part in text
    assert "| paper-affine | 0 / 0 / 2 | 0 / 1 / 1 | 0 / 2 / 0 | 0 / 3 / 3 |" in text
    assert (
        "| paper-affine | 0 / 1 / 1 | - | - | 0 / 1 / 1 |" in text.split("Boards with an inte")[1]
    )
    assert "types, an episode: RuntimeError" in text
    assert "None" not in text
    pictures = sorted(p.name for p in (tmp_path / "docs" / "results").iterdir())
    assert pictures == ["figure2.png", "figure3.png", "figure4.png"]
    assert set(pictures) == set(write_figures(result, tmp_path / "docs" / "results", ROBOT))
    for name in pictures:
        assert f"(results/{name})" in text
        assert (tmp_path / "docs" / "results" / name).stat().st_size < 150_000


def test_pictures_of_an_earlier_run_are_removed(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    for name in ("figure3.png", "mine.png"):
        (tmp_path / name).write_bytes(b"old")
    small = evaluate([job("fit", partial(swept, 9.0), JOINT)], PAPER, workers=1, digest="0")
    assert list(write_figures(small, tmp_path, ROBOT)) == ["figure2.png"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["figure2.png", "mine.png"]


def test_a_page_of_little() -> None:
    """A suite about models of other joints has a table without the fit of their own."""
    alone = replace(swept(9.0), suite="mirror")
    small = evaluate([job("mirror", partial(copy, alone))], PAPER, workers=1, digest="0123")
    text = page(small, {}, "pepper evaluate")
    assert "Suite `mirror`" in text
    assert f"| {JOINT} | - / " in text
    assert "## Table I" not in text
    assert "## Not evaluated" not in text
    assert "None" not in text


def test_markdown_tables() -> None:
    assert table(("a", "b"), [("x", "1")]) == "| a | b |\n| --- | ---: |\n| x | 1 |"
    assert table(("a",), []) == ""


def test_suites_become_episodes_and_boards_are_not_pooled() -> None:
    frozen = load_evaluation(ROBOT)
    jobs = suite_jobs(frozen, ["paper", "fit"], ROBOT)
    assert len(jobs) == len(frozen.runs("paper")) + len(frozen.runs("fit"))
    by_suite = {suite: [j for j in jobs if j.suite == suite] for suite in {j.suite for j in jobs}}
    assert set(by_suite) == {"paper", "paper-integral", "fit"}
    assert all("integral" in job.title for job in by_suite["paper-integral"])
    assert not any("integral" in job.title for job in by_suite["paper"])
    # One picture for each experiment of the paper and one of a test run, none of the other boards.
    pictured = [(job.suite, job.pictured) for job in jobs if job.pictured]
    paper = [("paper", joint) for joint in ("LShoulderRoll", "RElbowRoll", "RShoulderRoll")]
    assert pictured == [*paper, ("fit", "LShoulderRoll")]
    quick = suite_jobs(frozen, ["paper"], ROBOT, quick=True)
    assert len(quick) == len(by_suite["paper"]) + len(by_suite["paper-integral"])
    with pytest.raises(UnknownNameError, match="unknown suite 'papr'"):
        suite_jobs(frozen, ["papr"], ROBOT)


def test_what_transferred_models_lose() -> None:
    def fit(suite: str, joint: str, noise: float) -> Episode:
        episode = swept(9.0)
        run, index = episode.recording, ROBOT.joint_index(joint)
        error = run.tracking_error(ROBOT.joint_index(JOINT))
        model = ModelSet.load(shipped("affine")["nominal"]).models[JOINT]
        assert isinstance(model, AffineTree)
        sent = np.zeros_like(run.sent_position)
        sent[:, index] = model.predict(np.zeros((1, 3)))[0] + noise * error
        return replace(
            episode, suite=suite, experiment=joint, recording=replace(run, sent_position=sent)
        )

    jobs = [
        job("fit", partial(fit, "fit", JOINT, 1.0)),
        job("types", partial(fit, "types", JOINT, 1.0)),
    ]
    result = evaluate(jobs, PAPER, workers=1, digest="0")
    own = result.modes["paper-affine"]["fit"].fit[JOINT].test
    other = result.modes["paper-affine"]["types"].fit[JOINT].test
    assert own is not None
    assert other is not None
    assert result.fit_loss("paper-affine") == {"types": {JOINT: own - other}}
    metrics = result.modes["paper-affine"]
    mirrored = replace(metrics["types"], fit={"RShoulderRoll": metrics["types"].fit[JOINT]})
    turned = replace(result, modes={"paper-affine": {"fit": metrics["fit"], "mirror": mirrored}})
    assert turned.fit_loss("paper-affine") == {"mirror": {"RShoulderRoll": own - other}}
    assert result.as_json()["modes"]["paper-affine"]["fit_loss"] == result.fit_loss("paper-affine")
