"""An experiment file is one that can be performed, or one line says what is wrong with it, and where."""

import copy
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from pepper_driver.config import ConfigError, Experiment, load_experiment, load_robot
from pepper_driver.config.experiment import DAY, MOST_STEPS
from pepper_driver.config.experiment_steps import ContactWait, WaitStep, count, longest
from pepper_driver.config.loading import parse

ROBOT = load_robot()
PUSH: dict[str, Any] = {
    "kind": "push",
    "step": "listen",
    "joint": "LShoulderRoll",
    "link": "LBicep",
    "xyz": [0.16, 0.0, 0.0],
    "force": [0.0, 20.0, 0.0],
    "start": 0.5,
    "duration": 1.0,
}
STAND: dict[str, Any] = {"name": "stand", "posture": "Stand", "duration": 1.0}
LISTEN: dict[str, Any] = {
    "name": "listen",
    "wait": {"for": "contact", "link": "LBicep", "timeout": 3.0},
}
TURN: dict[str, Any] = {"joints": {"HeadYaw": 0.2}, "duration": 0.5, "hold": 0.25}
MINE: dict[str, Any] = {
    "schema": 1,
    "name": "mine",
    "pushes": [PUSH],
    "steps": [
        STAND,
        {"say": "hello"},
        {"repeat": {"times": 2, "steps": [TURN, LISTEN, {"wait": {"seconds": 0.5}}]}},
        {"leds": {"colour": [0, 1, 0]}},
    ],
}


def make(*steps: dict[str, Any], **more: Any) -> Experiment:
    return parse(
        Experiment, {"schema": 1, "name": "mine", "steps": list(steps), **more}, "mine.yaml"
    )


def load_data(folder: Path, data: dict[str, Any]) -> Experiment:
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return load_experiment(path, ROBOT)


def changed(key: str, value: object) -> dict[str, Any]:
    """MINE with another value at a dotted key; KeyError removes it."""
    data = copy.deepcopy(MINE)
    node: Any = data
    *path, last = (int(part) if part.isdigit() else part for part in key.split("."))
    for part in path:
        node = node[part]
    if value is KeyError:
        del node[last]
    else:
        node[last] = value
    return data


def test_steps_are_played_in_order_with_their_repetitions(tmp_path: Path) -> None:
    experiment = load_data(tmp_path, MINE)
    block = [f"steps.2.repeat.steps.{number}" for number in range(3)]
    assert [key for key, _ in experiment.played] == [
        "steps.0",
        "steps.1",
        *block,
        *block,
        "steps.3",
    ]
    assert experiment.order == (0, 1, 2, 3, 4, 2, 3, 4, 5)
    assert experiment.length == pytest.approx(1.0 + 2 * (0.75 + 3.0 + 0.5), abs=1e-4)
    assert experiment.starts[5] == pytest.approx(1.0 + 4.25, abs=1e-4)
    listen = experiment.written["steps.2.repeat.steps.1"]
    assert isinstance(listen, WaitStep)
    assert isinstance(listen.wait, ContactWait)
    assert experiment.motion.steps[3].longest == 3.0


@pytest.mark.parametrize(
    ("key", "value", "where", "reason"),
    [
        ("schema", 2, "schema", "should be 1"),
        ("steps", [], "steps", "at least 1"),
        ("steps.0", {"sya": "hello"}, "steps.0.sya", "did you mean say"),
        ("steps.0", "stand", "steps.0", "a mapping of keys to values"),
        ("steps.0", {"name": "empty"}, "steps.0", "a step takes time"),
        ("steps.0.posture", "Stnd", "steps.0.posture", "did you mean Stand"),
        ("steps.0.joints", {"HeadYaw": 9.0}, "steps.0.joints.HeadYaw", "9 rad lies outside"),
        ("steps.0.wait", {"seconds": 1.0}, "steps.0.", "unknown key"),
        ("steps.1.say", "", "steps.1.say", "at least 1"),
        ("steps.2.repeat.times", KeyError, "steps.2.repeat.times", "is missing"),
        ("steps.2.repeat.times", 0, "steps.2.repeat.times", "1"),
        ("steps.2.repeat.times", "forever", "steps.2.repeat.times", "integer"),
        ("steps.2.repeat.times", float("inf"), "steps.2.repeat.times", "integer"),
        ("steps.2.repeat.times", 10**6, "steps.2.repeat.times", "1000"),
        ("steps.2.repeat.times", 1000, "steps", "more than 3600 s; set 'longest'"),
        ("steps.2.repeat.steps", [], "steps.2.repeat.steps", "at least 1"),
        ("steps.2.repeat.steps.0.joints.HeadYa", 1.0, "steps.2.repeat.steps.0.joints.HeadYa", "did you mean HeadYaw"),
        ("steps.2.repeat.steps.1.wait.timeout", KeyError, "steps.2.repeat.steps.1.wait.timeout", "is missing"),
        ("steps.2.repeat.steps.1.wait.for", "godot", "steps.2.repeat.steps.1.wait.for", "'contact'"),
        ("steps.2.repeat.steps.1.wait.link", "LBice", "steps.2.repeat.steps.1.wait.link", "did you mean LBicep"),
        ("steps.2.repeat.steps.1.wait.joint", "x", "steps.2.repeat.steps.1.wait.joint", "unknown joint"),
        ("steps.2.repeat.steps.1.wait.kind", "rebound", "steps.2.repeat.steps.1.wait.kind", "collision"),
        ("steps.2.repeat.steps.2.wait.timeout", 1.0, "steps.2.repeat.steps.2.wait.timeout", "unknown key"),
        ("steps.2.repeat.steps.2.wait", 3.0, "steps.2.repeat.steps.2.wait", "a wait says"),
        ("steps.3.leds.colour", [0, 1, 2], "steps.3.leds.colour.2", "1"),
        ("longest", 0, "longest", "greater than 0"),
        ("longest", 2 * DAY, "longest", "less than or equal"),
        ("longest", 5.0, "longest", "more than 5 s"),
        ("observer", {"mod": "paper"}, "observer.mod", "did you mean mode"),
        ("reflexes", [3], "reflexes.0", "an object"),
        ("pushes.0.kind", "shove", "pushes.0", "unknown kind 'shove'"),
        ("pushes.0.link", "LBice", "pushes.0.link", "did you mean LBicep"),
        ("pushes.0.joint", "LShoulder", "pushes.0.joint", "did you mean LShoulder"),
        ("pushes.0.step", "liste", "pushes.0.step", "did you mean listen"),
        ("pushes.0.duration", 3.0, "pushes.0", "after step 'listen', which is over at 3 s"),
        ("pushes.0.step", KeyError, "pushes.0", "unknown"),
        ("pushes.0.force", [0.0, 0.0, 0.0], "pushes.0", "longer than 0"),
        ("steps.0", TURN, "pushes.0", "known posture"),
        ("steps.0.name", "listen", "pushes.0.step", "2 steps are called 'listen'"),
    ],
)  # fmt: skip
def test_a_wrong_experiment_is_one_line_with_line_key_and_reason(
    tmp_path: Path, key: str, value: object, where: str, reason: str
) -> None:
    if (key, value) == ("pushes.0.step", KeyError):
        data = changed(key, value)
        data["pushes"][0]["start"] = 8.0
        reason, where = "'steps.2.repeat.steps.1' lasts as long as it takes", "pushes.0"
    else:
        data = changed(key, value)
    with pytest.raises(ConfigError) as caught:
        load_data(tmp_path, data)
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    assert f"key '{where}" in message
    assert reason in message
    if key != "schema":
        assert f"{tmp_path / 'mine.yaml'} line " in message


def test_pushes_without_a_step_count_from_the_beginning(tmp_path: Path) -> None:
    data = changed("pushes.0.step", KeyError)
    data["pushes"][0] |= {"start": 1.2, "duration": 0.3}
    experiment = load_data(tmp_path, data)
    assert experiment.step_of(experiment.pushes[0]) == 2
    data["pushes"][0]["start"] = 40.0
    with pytest.raises(ConfigError, match="ends after the experiment"):
        load_data(tmp_path, data)


def test_two_hands_on_one_link_are_refused(tmp_path: Path) -> None:
    data = changed("pushes", [PUSH, PUSH | {"start": 1.4}])
    with pytest.raises(ConfigError, match=r"key 'pushes\.1': a hand on LBicep at 1\.4 s"):
        load_data(tmp_path, data)
    load_data(tmp_path, changed("pushes", [PUSH, PUSH | {"start": 1.6}]))


def test_without_an_observer_nobody_feels_anything(tmp_path: Path) -> None:
    for more, where in (({}, "wait.for"), ({"reflexes": [{"do": "hold"}]}, "reflexes|wait.for")):
        with pytest.raises(ConfigError, match=rf"({where})': nobody feels"):
            load_data(tmp_path, {**MINE, "observer": None, **more})
    load_data(tmp_path, {**MINE, "observer": None, "pushes": [], "steps": [STAND]})


def test_a_nest_of_loops_is_counted_before_it_is_unrolled(tmp_path: Path) -> None:
    steps: list[dict[str, Any]] = [{"say": "again"}]
    for _ in range(5):
        steps = [{"repeat": {"times": 1000, "steps": steps}}]
    with pytest.raises(ConfigError, match=f"at most {MOST_STEPS}|more than 3600 s"):
        load_data(tmp_path, {"schema": 1, "name": "nest", "steps": steps})


def test_a_file_that_holds_itself_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("schema: 1\nname: x\nsteps: &a [{repeat: {times: 2, steps: *a}}]\n")
    with pytest.raises(ConfigError, match=r"mine\.yaml: "):
        load_experiment(path, ROBOT)


def test_a_deep_file_is_refused_or_loaded_without_a_traceback(tmp_path: Path) -> None:
    for depth in (20, 60, 100, 400):
        path = tmp_path / "mine.yaml"
        inner = "{say: deep}"
        for _ in range(depth):
            inner = f"{{repeat: {{times: 1, steps: [{inner}]}}}}"
        path.write_text(f"schema: 1\nname: x\nsteps: [{inner}]\n")
        try:
            assert len(load_experiment(path, ROBOT).order) == 1
        except ConfigError as error:
            assert "mine.yaml" in str(error)


STEPS = st.recursive(
    st.just({"say": "x"}) | st.floats(0.01, 5.0).map(lambda s: {"wait": {"seconds": s}}),
    lambda inner: st.builds(
        lambda times, steps: {"repeat": {"times": times, "steps": steps}},
        st.integers(1, 4),
        st.lists(inner, min_size=1, max_size=3),
    ),
    max_leaves=6,
)


@settings(max_examples=60)
@given(st.lists(STEPS, min_size=1, max_size=4))
def test_count_and_length_are_those_of_the_steps_played(steps: list[dict[str, Any]]) -> None:
    experiment = make(*steps)
    assert count(experiment.steps) == len(experiment.played) == len(experiment.order)
    by_step = [experiment.motion.steps[number].longest for number in experiment.order]
    assert longest(experiment.steps) == pytest.approx(sum(by_step))
    written = tuple(experiment.written.values())
    assert [written[number] for number in experiment.order] == [s for _, s in experiment.played]
