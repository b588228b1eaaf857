"""Experiments are planned to the last segment before anything moves."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import ConfigError, Experiment, load_experiment
from pepper_driver.config.experiment import FOLDERS
from pepper_driver.config.loading import shipped_names
from pepper_driver.config.steps import RepeatStep
from pepper_driver.experiments.plan import Plan, experiment_uri, plan_experiment
from support.experiments import CYCLE, ROBOT, STAND, YAW, listen, make_experiment, with_played

DEMO = load_experiment("demo", ROBOT)


def plan(experiment: Experiment, **options: Any) -> Plan:
    return plan_experiment(experiment, ROBOT, MockBackend(ROBOT), **options)


@pytest.mark.parametrize(
    ("uri", "plant", "world", "expected"),
    [
        ("mujoco", None, None, "mujoco"),
        ("mujoco", "nominal", None, "mujoco://?plant=nominal"),
        ("mujoco://?seed=3", "nominal", "empty", "mujoco://?seed=3&plant=nominal&world=empty"),
        ("mujoco://?plant=other", "nominal", None, "mujoco://?plant=other"),
        ("naoqi://10.0.0.1", "nominal", "empty", "naoqi://10.0.0.1"),
    ],
)
def test_a_uri_keeps_what_it_says_itself(
    uri: str, plant: str | None, world: str | None, expected: str
) -> None:
    assert experiment_uri(uri, replace(DEMO, plant=plant, world=world)) == expected


@pytest.mark.parametrize("name", [name for folder in FOLDERS for name in shipped_names(folder)])
def test_all_that_is_shipped_can_be_planned(name: str) -> None:
    experiment = replace(load_experiment(name, ROBOT), contacts=())
    planned = plan(experiment)
    longest = sum(segment.ticks for segment in planned.segments) * CYCLE
    assert longest < 1.5 * experiment.max_length
    if not any(isinstance(step, RepeatStep) for _, step in experiment.walk()):  # else once each
        assert longest > 0.5 * experiment.max_length
    assert planned.at_begin == []


def test_segments_are_those_of_the_file_in_its_order() -> None:
    goals = {"joints": ["HeadYaw"], "range": 0.5, "settle": 1.2, "count": 2, "period": 2.4}
    loop = {"repeat": {"times": 5, "steps": [{"name": "round", "hold": 1.2}]}}
    cases = [{"on": {}, "steps": [{"name": "touched", "hold": 1.2}]}]
    branch = {"branch": {"timeout": 1.2, "cases": cases, "otherwise": [{"hold": 0.6}]}}
    experiment = make_experiment(
        STAND, loop, branch, {"name": "goals", "setpoints": goals}, {"say": "end"}
    )
    planned = plan(experiment)
    assert [(s.key, s.number, s.name) for s in planned.segments] == [
        ("steps.0", 0, "stand"),
        ("steps.1.repeat.steps.0", 1, "round"),
        ("steps.2.branch", 2, "branch"),
        ("steps.2.branch.cases.0.steps.0", 3, "touched"),
        ("steps.2.branch.otherwise.0", 4, "4"),
        ("steps.3", 5, "goals"),
        ("steps.3", 5, "goals"),
        ("steps.3", 5, "goals"),
        ("steps.4", 6, "6"),
    ]
    starts = [round(segment.start, 2) for segment in planned.segments]
    assert starts == [0.0, 0.1, 6.1, 7.3, 7.3, 8.5, 9.7, 12.1, 14.5]
    assert [s.is_timed for s in planned.segments] == [True] * 3 + [False] * 6


def test_a_loop_takes_all_its_rounds_and_may_end_early_by_touch() -> None:
    loop: dict[str, Any] = {"times": 3, "steps": [{"hold": 1.2}]}
    cases: list[tuple[dict[str, Any], bool]] = [({}, True), ({"until": {}}, False)]
    for until, timed in cases:
        experiment = make_experiment(STAND, {"repeat": loop | until}, {"name": "end", "hold": 1.2})
        end = plan(experiment).segments[-1]
        assert end.start == pytest.approx(0.1 + 3 * 1.2, abs=CYCLE)
        assert end.is_timed == timed


def test_rounds_of_random_goals_follow_each_other() -> None:
    goals = {"joints": ["HeadYaw"], "range": 0.5, "settle": 1.2, "count": 1, "period": 2.4}
    loop = {"repeat": {"times": 2, "steps": [{"setpoints": goals}, {"name": "rest", "hold": 0.6}]}}
    outer = {"repeat": {"times": 2, "steps": [loop]}}
    planned = plan(make_experiment(outer))
    rounds = planned.rounds["steps.0.repeat.steps.0.repeat.steps.0"]
    assert [played[0].start for played in rounds] == pytest.approx([0.0, 4.2, 8.4, 12.6])
    assert len({played[1].posture[YAW] for played in rounds}) == 4
    assert {segment.number for played in rounds for segment in played} == {0}
    rest = planned.rounds["steps.0.repeat.steps.0.repeat.steps.1"]
    assert len(rest) == 1, "it is the same in all rounds"


def test_steps_of_a_reaction_are_planned_from_anywhere() -> None:
    part = make_experiment({"joints": {"HeadYaw": 0.3}, "duration": 1.2}, {"hold": 0.6})
    experiment = make_experiment(STAND, reactions=[{"say": "Oh!"}, {"play": "p"}])
    planned = plan(with_played(experiment, p=part))
    assert list(planned.rounds) == ["steps.0", "reactions.1.play.0", "reactions.1.play.1"]
    posture = planned.segments[-1].posture
    assert np.flatnonzero(np.isfinite(posture)).tolist() == [YAW]


def test_it_may_be_said_where_the_robot_stands() -> None:
    experiment = make_experiment({"joints": {"HeadYaw": 0.3}, "duration": 1.2})
    start = ROBOT.posture("StandZero")
    (segment,) = plan(experiment, start=start).segments
    start[YAW] = 0.3
    np.testing.assert_array_equal(segment.posture, start)


def test_contacts_on_a_robot_that_cannot_be_pushed_are_refused() -> None:
    with pytest.raises(ConfigError, match="'mock' cannot; leave them out with"):
        plan(DEMO)


def test_a_seed_is_that_of_the_experiment_or_of_the_caller() -> None:
    free = replace(DEMO, contacts=(), seed=3)
    goals = [s.posture.tolist() for s in plan(free).segments]
    assert goals == [s.posture.tolist() for s in plan(replace(free, seed=0), seed=3).segments]
    assert goals != [s.posture.tolist() for s in plan(free, seed=[3, 1]).segments]


def test_a_wait_takes_its_timeout_at_most() -> None:
    _, wait, after = plan(make_experiment(STAND, listen(timeout=2.4), {"hold": 0.6})).segments
    assert wait.ticks == 200
    assert after.start == pytest.approx(2.5, abs=CYCLE)
