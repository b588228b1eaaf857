"""Goals and contacts of the frozen suites, and of identification, are those that were recorded long before.

The digests were made with an earlier planner and another form of file; each is of all segments of one episode. Those of
the experiments of the paper were renewed when rounding errors in them, which differ between processors, became zeros.
Some are of the first goals of an episode only. ``make test-all`` plans every episode, which takes minutes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends import make_backend
from pepper_driver.config import Experiment, load_experiment, load_robot
from pepper_driver.config.evaluation import SuiteRun, load_evaluation
from pepper_driver.evaluation.episodes import episode_uri
from pepper_driver.experiments.plan import plan_experiment
from pepper_driver.experiments.segments import PlannedContact, Segment
from pepper_driver.identification.runs import plan_runs, sweeps_of
from support import ROOT

ROBOT = load_robot()
FACTS = ROOT / "tests" / "facts" / "planned_episodes.json"
RECORDED: dict[str, dict[str, Any]] = json.loads(FACTS.read_text())
ROUNDING = 1e-12
WHOLE, FIRST_GOALS = RECORDED["whole"], RECORDED["first_goals"]


# -- the canonical form -----------------------------------------------------------------------------------------------


def number(value: float) -> str:
    """Seven digits; what is zero but for rounding, which differs between processors, is zero without a sign."""
    if abs(value) < ROUNDING:
        value = 0.0
    return (
        "nan" if np.isnan(value) else f"{value + 0.0:.6e}".replace("-0.000000e+00", "0.000000e+00")
    )


def numbers(values: Any) -> list[str]:
    return [number(float(value)) for value in np.asarray(values, dtype=float).ravel()]


def contact_facts(contact: PlannedContact) -> list[Any]:
    planned = contact.planned
    return [
        number(contact.delay),
        number(contact.duration),
        None if contact.rise is None else number(contact.rise),
        contact.moving,
        planned.joint,
        planned.link,
        numbers(planned.point),
        numbers(planned.force),
        planned.frame,
        numbers(planned.torques),
        number(planned.torque),
        number(planned.degrees),
        number(planned.load),
        number(planned.tipping),
        contact.grab is not None,
    ]


def segment_facts(segment: Segment, settled: float) -> list[Any]:
    """Times count from when the first goal was set."""
    twist = segment.step.base_velocity
    contacts = sorted(segment.contacts, key=lambda contact: contact.delay)
    return [
        number(segment.start - settled),
        segment.ticks,
        numbers(segment.posture),
        number(segment.stiffness),
        numbers((0.0, 0.0, 0.0) if twist is None else (twist.vx, twist.vy, twist.wz)),
        [contact_facts(contact) for contact in contacts],
    ]


def digest(experiment: Experiment, uri: str, seed: Sequence[int]) -> str:
    backend = make_backend(uri, ROBOT)
    segments = plan_experiment(experiment, ROBOT, backend, seed=list(seed)).segments
    settled = (round(segments[0].start / ROBOT.cycle) + segments[0].ticks) * ROBOT.cycle
    facts = [segment_facts(segment, settled) for segment in segments]
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:16]


# -- episodes ---------------------------------------------------------------------------------------------------------


@cache
def suites() -> dict[str, SuiteRun]:
    """The runs of all suites, by name."""
    evaluation = load_evaluation(ROBOT)
    runs = [run for suite in evaluation.names for run in evaluation.runs(suite)]
    return {
        f"{run.suite}/{run.entry}/{run.plant}/{run.task_stiffness:g}/{run.seed[-1]}": run
        for run in runs
    }


def test_all_episodes_are_known() -> None:
    recorded = {name for name in WHOLE if not name.startswith("identify/")}
    assert recorded == set(suites())
    shown = {suites()[name].experiment.name for name in FIRST_GOALS}
    assert {*shown, "sweeps"} == {run.experiment.name for run in suites().values()}


def test_identification() -> None:
    sweeps, body = load_experiment("identify", ROBOT), load_experiment("calibration_motion", ROBOT)
    runs = plan_runs(ROBOT, sweeps_of(sweeps).joints, sweeps, calibration=body)
    planned = {f"identify/{run.name}": digest(run.experiment, "mujoco", run.seed) for run in runs}
    assert planned == {name: text for name, text in WHOLE.items() if name.startswith("identify/")}


def test_sweeps_of_the_suites() -> None:
    mirrored = {name: run for name, run in suites().items() if run.suite == "mirror"}
    assert len(mirrored) == 12
    planned = {
        name: digest(run.experiment, episode_uri(run), run.seed) for name, run in mirrored.items()
    }
    assert planned == {name: WHOLE[name] for name in mirrored}


@pytest.mark.parametrize("name", FIRST_GOALS)
def test_the_first_goals_of_each_experiment(name: str) -> None:
    run, recorded = suites()[name], FIRST_GOALS[name]
    experiment = run.experiment.with_goals(count=recorded["goals"])
    assert digest(experiment, episode_uri(run), run.seed) == recorded["digest"]


@pytest.mark.whole
@pytest.mark.parametrize("name", [name for name in WHOLE if not name.startswith("identify/")])
def test_whole_episodes(name: str) -> None:
    run = suites()[name]
    assert digest(run.experiment, episode_uri(run), run.seed) == WHOLE[name]
