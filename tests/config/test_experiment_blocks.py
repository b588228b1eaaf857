"""Loops end, each case of a branch can be taken, and lengths are the sums of what is played."""

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from pepper_driver.config import (
    ConfigError,
    Experiment,
    load_experiment,
)
from pepper_driver.config.experiment import DAY, MAX_STEPS, check_experiment
from pepper_driver.config.loading import parse
from pepper_driver.config.steps import Holds, RandomStep
from support.examples import examples
from support.experiment_files import (
    BRANCH,
    HOLDS,
    LISTEN,
    PUSH,
    RANDOM,
    ROBOT,
    SETPOINTS,
    STAND,
    TURN,
    changed,
    experiment,
    load_data,
    refusal,
    write,
)
from support.yaml_values import ANYTHING, JARGON, WORDS, dump

# -- loops --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("times", "reason"),
    [
        (KeyError, "key 'steps.0.repeat.times' is missing"),
        (0, "key 'steps.0.repeat.times': must be 1 or more"),
        ("forever", "must be a whole number, got \"forever\""),
        (float("inf"), "key 'steps.0.repeat.times': must be a whole number, got inf"),
        (True, "must be a whole number, got true"),
        (None, "must be a whole number, got null"),
        (10**6, "must be 1000 or less"),
        (1000, "key 'steps': may take 5000 s, with all repetitions and timeouts, which is more than 3600 s"),
    ],
)  # fmt: skip
def test_every_loop_has_an_end(tmp_path: Path, times: object, reason: str) -> None:
    loop = {"repeat": {"times": 2, "until": {"limb": "head"}, "steps": [{"hold": 5.0}]}}
    data = changed(experiment(loop), "steps.0.repeat.times", times)
    assert reason in refusal(tmp_path, data)


def test_a_longer_time_is_allowed_by_who_writes_it(tmp_path: Path) -> None:
    data = experiment({"repeat": {"times": 1000, "steps": [{"hold": 5.0}]}})
    load_data(tmp_path, data | {"max_duration": 5000.0})
    said = refusal(tmp_path, data | {"max_duration": 4999.0})
    assert said.startswith(" line ")
    assert "key 'max_duration': may take 5000 s" in said
    assert "key 'max_duration': must be 86400 or less" in refusal(
        tmp_path, data | {"max_duration": DAY + 1}
    )


def test_a_nest_of_loops_is_counted_without_being_unrolled(tmp_path: Path) -> None:
    steps: list[dict[str, Any]] = [{"say": "again"}]
    for _ in range(5):
        steps = [{"repeat": {"times": 1000, "steps": steps}}]
    said = refusal(tmp_path, experiment(*steps))
    assert f"key 'steps': {1000**5} with all repetitions; at most {MAX_STEPS}" in said


def test_a_branch_counts_as_a_step_and_its_longest_case(tmp_path: Path) -> None:
    cases = [{"on": {"limb": "head"}, "steps": [{"say": "a"}, {"say": "b"}]}]
    step = {"branch": {"timeout": 0.1, "cases": cases, "otherwise": [{"say": "c"}]}}
    for times, count in ((6, None), (7, 7 * 1000 * (1 + 2))):
        inner = {"repeat": {"times": times, "steps": [step]}}
        data = experiment({"repeat": {"times": 1000, "steps": [inner]}})
        if count is None:
            load_data(tmp_path, data)
        else:
            assert f"key 'steps': {count} with all repetitions" in refusal(tmp_path, data)


# -- branches -----------------------------------------------------------------------------------------------------


def branch(*on: dict[str, Any], **more: Any) -> dict[str, Any]:
    cases = [{"on": trigger, "steps": [STAND]} for trigger in on]
    return experiment({"branch": {"timeout": 5.0, "cases": cases, **more}})


@pytest.mark.parametrize(
    ("data", "case", "reason"),
    [
        (branch({"lasting": 5.0}), 0, "no touch lasts 5 s within 5 s"),
        (branch({"lasting": 4.99}), None, ""),
        (branch({"limb": "left_arm"}, {"link": "LBicep"}), 1, "'cases.0', before it, takes all its touches"),
        (branch({}, {"kind": "collision", "min_torque": 9.0}), 1, "'cases.0', before it"),
        (branch({"limb": "head"}, {"limb": "left_arm"}, {"limb": "head"}), 2, "'cases.0', before it"),
        (branch({"link": "LBicep"}, {"limb": "left_arm"}), None, ""),
        (branch({"min_torque": 3.0}, {}), None, ""),
        (branch({"lasting": 1.0}, {}), 0, "'cases.1' takes its touches before they have lasted 1 s"),
        (branch({"lasting": 1.0}, {}, deciding=0.9), 0, "'cases.1' takes its touches before they"),
        (branch({"lasting": 1.0}, {}, deciding=1.0), None, ""),
        (branch({"lasting": 0.4}, {"lasting": 0.1}), None, ""),  # 0.4 - 0.1 is more than 0.3 for a computer
        (branch({"lasting": 1.0}, {"lasting": 0.8}), None, ""),
        (branch({"lasting": 1.0, "limb": "head"}, {"limb": "left_arm"}), None, ""),
        (branch({"touches": 2, "within": 2.0}, {}), None, ""),
    ],
)  # fmt: skip
def test_every_case_of_a_branch_can_be_taken(
    tmp_path: Path, data: dict[str, Any], case: int | None, reason: str
) -> None:
    if case is None:
        load_data(tmp_path, data)
        return
    said = refusal(tmp_path, data)
    assert f"key 'steps.0.branch.cases.{case}': can never be chosen: {reason}" in said


@pytest.mark.parametrize(
    ("key", "value", "where", "reason"),
    [
        ("timeout", KeyError, "branch.timeout", "is missing"),
        ("timeout", 0.0, "branch.timeout", "must be 0.001 or more"),
        ("deciding", -0.1, "branch.deciding", "must be 0 or more"),
        ("cases", [], "branch.cases", "needs at least one case"),
        ("cases", {}, "branch.cases", "must be a list, got a mapping"),
        ("cases.0.on", KeyError, "branch.cases.0.on", "is missing"),
        ("cases.0.steps", KeyError, "branch.cases.0.steps", "is missing"),
        ("cases.0.then", [], "branch.cases.0.then", "unknown key"),
        ("cases.0.steps.0.joints.HeadYaw", 9.0, "branch.cases.0.steps.0.joints.HeadYaw", "9 rad"),
        ("otherwise.0", {"posture": "Sit", "hold": 1.0}, "branch.otherwise.0.posture", "unknown posture"),
        ("otherwise.0", 3, "branch.otherwise.0", "a step is a mapping of keys to values"),
        ("otherwis", [], "branch.otherwis", "did you mean otherwise"),
    ],
)  # fmt: skip
def test_a_wrong_branch(tmp_path: Path, key: str, value: object, where: str, reason: str) -> None:
    said = refusal(tmp_path, changed(experiment(BRANCH), f"steps.0.branch.{key}", value))
    assert f"key 'steps.0.{where}'" in said
    assert reason in said


# -- lengths ------------------------------------------------------------------------------------------------------


def test_the_longest_time_is_that_of_all_repetitions_and_of_the_longest_case(
    tmp_path: Path,
) -> None:
    loaded = load_data(
        tmp_path,
        experiment(
            STAND, {"say": "hello"}, {"repeat": {"times": 3, "steps": [TURN, LISTEN]}}, BRANCH
        ),
    )
    # 1 s; nothing; three times 0.75 s and a wait of 3 s; a wait of 5 s, then 0.75 s, nothing, or 2 s.
    assert loaded.max_length == pytest.approx(1.0 + 3 * 3.75 + 5.0 + 2.0)
    assert [key for key, _ in loaded.walk()] == [
        "steps.0",
        "steps.1",
        "steps.2",
        "steps.2.repeat.steps.0",
        "steps.2.repeat.steps.1",
        "steps.3",
        "steps.3.branch.cases.0.steps.0",
        "steps.3.branch.otherwise.0",
    ]


@pytest.mark.parametrize(
    ("step", "is_open"),
    [
        (STAND, False),
        (TURN, False),
        ({"holds": HOLDS}, False),
        ({"repeat": {"times": 3, "steps": [STAND]}}, False),
        ({"repeat": {"times": 3, "steps": [STAND], "until": {}}}, True),
        ({"repeat": {"times": 3, "steps": [LISTEN]}}, True),
        (LISTEN, True),
        (BRANCH, True),
        (STAND | {"until": "reached", "timeout": 2.0}, True),
    ],
)
def test_what_may_end_early_is_open(tmp_path: Path, step: dict[str, Any], is_open: bool) -> None:
    assert load_data(tmp_path, experiment(TURN, step)).is_open is is_open


def tree(data: dict[str, Any]) -> tuple[float, int]:
    """Longest time [s] and number of steps played, from the data of a step."""
    if "repeat" in data:
        inner = [tree(step) for step in data["repeat"]["steps"]]
        times = data["repeat"]["times"]
        return times * sum(t for t, _ in inner), times * sum(n for _, n in inner)
    if "branch" in data:
        branch = data["branch"]
        blocks = [case["steps"] for case in branch["cases"]] + [branch["otherwise"]]
        bodies = [[tree(step) for step in block] for block in blocks]
        longest = max(sum(t for t, _ in body) for body in bodies)
        return branch["timeout"] + longest, 1 + max(sum(n for _, n in body) for body in bodies)
    if "holds" in data:
        goals = data["holds"]
        return 2.0 + goals["count"] * (goals["move"] + goals["hold"]), 1 + goals["count"]
    wait = data.get("wait", {"timeout": 0.0})["timeout"]
    return data.get("duration", 0.0) + data.get("hold", 0.0) + wait, 1


SECONDS = st.integers(1, 40).map(lambda eighths: eighths / 8)
LEAVES = (
    st.just({"say": "x"})
    | SECONDS.map(lambda s: {"hold": s})
    | SECONDS.map(lambda s: {"posture": "Stand", "duration": s, "hold": 0.5})
    | SECONDS.map(lambda s: {"wait": {"timeout": s}})
    | st.just({"holds": HOLDS})
)
TREES = st.recursive(
    LEAVES,
    lambda inner: (
        st.builds(
            lambda times, steps: {"repeat": {"times": times, "steps": steps}},
            st.integers(1, 4),
            st.lists(inner, min_size=1, max_size=3),
        )
        | st.builds(
            lambda timeout, steps, otherwise: {
                "branch": {
                    "timeout": timeout,
                    "cases": [{"on": {"limb": "head"}, "steps": steps}],
                    "otherwise": otherwise,
                }
            },
            SECONDS,
            st.lists(inner, max_size=3),
            st.lists(inner, max_size=2),
        )
    ),
    max_leaves=8,
)
BLOCKS = st.lists(TREES, min_size=1, max_size=4)
FEW = examples(
    60,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)


@FEW
@given(steps=BLOCKS)
def test_the_length_is_that_of_the_steps_played(
    tmp_path: Path, steps: list[dict[str, Any]]
) -> None:
    inner = [tree(step) for step in steps]
    length, count = sum(t for t, _ in inner), sum(n for _, n in inner)
    try:
        loaded = load_data(tmp_path, experiment(*steps))
    except ConfigError as error:
        assert length > 3600.0 or count > MAX_STEPS, error
    else:
        assert loaded.max_length == pytest.approx(length)
        assert length <= 3600.0
        assert count <= MAX_STEPS
        keys = [key for key, _ in loaded.walk()]
        assert len(set(keys)) == len(keys)


# -- random goals -------------------------------------------------------------------------------------------------


def goals_of(loaded: Experiment) -> list[Any]:
    return [step.goals for _, step in loaded.walk() if isinstance(step, RandomStep)]


def test_goals_are_changed_wherever_their_step_is(tmp_path: Path) -> None:
    write(tmp_path, "holds.yaml", {"holds": HOLDS})
    holds, points = {"name": "mine", "holds": HOLDS}, {"setpoints": SETPOINTS}
    cases = [{"on": {"limb": "head"}, "steps": [holds]}]
    for step in (
        holds,
        {"repeat": {"times": 2, "steps": [STAND, holds]}},
        {"branch": {"timeout": 1.0, "cases": cases, "otherwise": []}},
        {"branch": {"timeout": 1.0, "cases": [{"on": {}, "steps": []}], "otherwise": [holds]}},
        {"play": "holds.yaml"},
    ):
        loaded = load_data(tmp_path, experiment(STAND, step, points))
        other = loaded.with_goals(count=9, joints=("HeadYaw",))
        first, second = goals_of(other)
        assert isinstance(first, Holds)
        assert (first.count, first.joints, first.move) == (9, ("HeadYaw",), 2.0)
        assert second == goals_of(loaded)[1]
        assert goals_of(loaded)[0].count == 4
        names = [step.name for _, step in other.walk()]
        assert names == [step.name for _, step in loaded.walk()]
        assert other.steps[0] is loaded.steps[0]


def test_the_demonstration_may_take_an_hour() -> None:
    demo = load_experiment("demo", ROBOT)
    (goals, *_) = goals_of(demo)
    check_experiment(demo.with_goals(count=math.ceil(3600.0 / goals.period)), ROBOT)


def test_without_random_goals_there_are_none_to_change(tmp_path: Path) -> None:
    loaded = load_data(tmp_path, experiment(STAND))
    assert loaded.random_step is None
    with pytest.raises(ConfigError, match=r"mine\.yaml: key 'steps': no step has random goals"):
        loaded.with_goals(count=3)


def test_a_wrong_change_of_goals_is_refused(tmp_path: Path) -> None:
    loaded = load_data(tmp_path, experiment({"holds": HOLDS}))
    with pytest.raises(ConfigError, match=r"mine\.yaml: key 'count': must be 1 or more, got 0$"):
        loaded.with_goals(count=0)


# -- whatever is in a file ----------------------------------------------------------------------------------------

KEYS = st.sampled_from(
    [
        *("schema", "name", "steps", "reactions", "contacts", "observer", "seed", "max_duration"),
        *("repeat", "times", "until", "branch", "cases", "on", "otherwise", "timeout", "deciding"),
        *("play", "wait", "hold", "duration", "posture", "joints", "hands", "say", "leds", "cue"),
        *("setpoints", "holds", "sweeps", "range", "count", "period", "move", "do", "lasting"),
        *("touches", "within", "limb", "link", "joint", "position", "look_at", "base", "kind"),
        *("points", "degrees", "force", "xyz", "start", "step", "source", "reflex"),
    ]
)
GOOD = st.sampled_from(
    [STAND, TURN, LISTEN, BRANCH, PUSH, RANDOM, {"holds": HOLDS}, {"setpoints": SETPOINTS}, {}]
)
LANGUAGE = st.recursive(
    ANYTHING | GOOD,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(KEYS, inner, max_size=5)
        | st.builds(
            lambda step, more: {**step, **more}, GOOD, st.dictionaries(KEYS, inner, max_size=2)
        )
    ),
    max_leaves=12,
)


@examples(
    150,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
@given(
    steps=LANGUAGE | st.lists(TREES | LANGUAGE, min_size=1, max_size=3),
    more=st.dictionaries(KEYS | WORDS, LANGUAGE, max_size=3),
)
def test_any_tree_loads_or_is_one_line(tmp_path: Path, steps: Any, more: dict[str, Any]) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(dump({"schema": 2, "name": "mine", "steps": steps, **more}), encoding="utf-8")
    try:
        loaded = load_experiment(path, ROBOT)
    except ConfigError as error:
        said = str(error)
        assert said.startswith(str(path))
        assert len(said.splitlines()) == 1
        assert not JARGON.search(said), said
    else:
        assert 0.0 <= loaded.max_length <= loaded.max_duration
        assert set(loaded.touched_joints) <= set(ROBOT.joint_names)


def test_it_is_parsed_as_any_other_part_of_the_configuration() -> None:
    loaded = parse(Experiment, experiment(STAND), "mine.yaml")
    assert loaded.source == ""
    assert str(loaded.error("steps.0", "is wrong")) == "mine: key 'steps.0': is wrong"
