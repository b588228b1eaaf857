"""A scenario file is one that can be performed, or one line says what is wrong with it."""

import copy
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from pepper_driver.config import (
    ConfigError,
    Scenario,
    UnknownNameError,
    load_robot,
    load_scenario,
    scenario_names,
)
from pepper_driver.config.loading import package_file, read_yaml
from pepper_driver.config.scenario_contacts import Grab, RandomPushes
from pepper_driver.config.scenario_motion import Sweeps

ROBOT = load_robot()

HOLDS: dict[str, Any] = {
    "version": 1,
    "name": "mine",
    "description": "",
    "posture": "Stand",
    "stiffness": 20.0,
    "motion": {
        "kind": "holds",
        "joints": ["HeadYaw", "LElbowRoll"],
        "range": 0.5,
        "move": 2.0,
        "hold": 1.0,
        "count": 4,
    },
}
PUSH: dict[str, Any] = {
    "kind": "push",
    "joint": "LShoulderRoll",
    "link": "LBicep",
    "xyz": [0.16, 0.0, 0.0],
    "force": [0.0, 10.0, 0.0],
    "start": 1.0,
    "duration": 1.0,
}
GRAB: dict[str, Any] = {
    "kind": "grab",
    "joint": "LShoulderRoll",
    "link": "LBicep",
    "xyz": [0.16, 0.0, 0.0],
    "pull": [0.0, 0.02, 0.0],
    "start": 5.0,
}


def shipped(name: str) -> dict[str, Any]:
    return read_yaml(package_file("scenarios", f"{name}.yaml"))


def load_data(folder: Path, data: dict[str, Any]) -> Scenario:
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return load_scenario(path, ROBOT)


@pytest.mark.parametrize("name", scenario_names())
def test_the_shipped_scenarios_load_and_are_called_like_their_files(name: str) -> None:
    scenario = load_scenario(name, ROBOT)
    assert scenario.name == name
    assert scenario.description
    assert Path(scenario.source).name == f"{name}.yaml"


def test_there_are_scenarios_for_identification_demo_and_documentation() -> None:
    assert {"demo", "identify", "reach_and_push"} <= set(scenario_names())


def test_an_unknown_scenario_lists_those_there_are() -> None:
    with pytest.raises(UnknownNameError, match="did you mean demo"):
        load_scenario("dmo", ROBOT)


def test_the_estimation_runs_are_those_of_the_paper() -> None:
    scenario = load_scenario("identify", ROBOT)
    assert isinstance(scenario.motion, Sweeps)
    stiffness = scenario.motion.estimation_stiffness
    assert len(stiffness) == 7
    assert (min(stiffness), max(stiffness)) == (2.0, 5.0)
    assert scenario.stiffness == 9.0


def test_touched_joints_come_once_in_the_order_of_the_file() -> None:
    assert load_scenario("demo", ROBOT).touched_joints == ("LShoulderRoll", "RElbowRoll")
    assert load_scenario("reach_and_push", ROBOT).touched_joints == ("LShoulderRoll", "RElbowRoll")
    assert load_scenario("identify", ROBOT).touched_joints == ()


def changed(data: dict[str, Any], key: str, value: object) -> dict[str, Any]:
    """A copy with the value at a dotted key replaced; ``KeyError`` as a value removes it."""
    data = copy.deepcopy(data)
    *path, last = key.split(".")
    node: Any = data
    for part in path:
        node = node[int(part)] if isinstance(node, list) else node[part]
    if isinstance(node, list):
        node[int(last)] = value
    elif value is KeyError:
        del node[last]
    else:
        node[last] = value
    return data


@pytest.mark.parametrize(
    ("name", "key", "value", "where", "reason"),
    [
        ("demo", "version", 2, "version", "should be 1"),
        ("demo", "version", KeyError, "version", "missing"),
        ("demo", "seed", -1, "seed", "greater than or equal to 0"),
        ("demo", "posture", "Stnd", "posture", "did you mean Stand"),
        ("demo", "posture", KeyError, "posture", "missing"),
        ("demo", "stiffness", 0.0, "stiffness", "greater than 0"),
        ("demo", "settle", -1.0, "settle", "greater than or equal to 0"),
        ("demo", "motion.kind", "setpoint", "motion", "did you mean setpoints"),
        ("demo", "motion.kind", KeyError, "motion", "no 'kind' (possible: holds"),
        ("demo", "motion.speed", 1.0, "motion.speed", "unknown key"),
        ("demo", "motion.joints", [], "motion.joints", "at least 1"),
        ("demo", "motion.joints.0", "LShoulderRol", "motion.joints", "did you mean LShoulderRoll"),
        ("demo", "motion.also_move.0", "x", "motion.also_move", "unknown joint"),
        ("demo", "motion.period", 6.0, "contacts.0.times.1", "beyond the next goal"),
        ("demo", "contacts.0.kind", "pushes", "contacts.0", "random_pushes"),
        ("demo", "contacts.0.times.0", -0.1, "contacts.0.times.0", "greater than or equal to 0"),
        ("demo", "contacts.0.times.0", 0.1, "contacts.0", "jitter"),
        ("demo", "contacts.0.times.0", 4.0, "contacts.0.times.1", "'contacts.0.times.0' may be"),
        ("demo", "contacts.0.degrees", [10.0, 3.0], "contacts.0", "'degrees': the lower bound"),
        ("demo", "contacts.0.duration", [2.0, 1.0], "contacts.0", "'duration': the lower bound"),
        ("demo", "contacts.0.joints.0", "HeadYaw", "contacts.0", "no entry for joint HeadYaw"),
        ("demo", "contacts.0.points.LShoulderRoll.link", "LBice", "contacts.0.points.LShoulderRoll.link", "LBicep"),
        ("demo", "motion.base", {"linear": 0.1, "angular": 0.4, "share": 0.5}, None, None),
        ("demo", "motion.base", {"linear": 0.5, "angular": 0.4, "share": 0.5}, "motion.base.linear", "0.35 m/s"),
        ("demo", "motion.base", {"linear": 0.1, "angular": 1.4, "share": 0.5}, "motion.base.angular", "1 rad/s"),
        ("demo", "motion.base", {"linear": 0.1, "angular": 0.4}, "motion.base.share", "missing"),
        ("demo", "motion.ranges", {"LElbowRoll": 0.1}, None, None),
        ("demo", "motion.ranges", {"KneePitch": 0.1}, "motion", "KneePitch is not among the joints"),
        ("demo", "contacts.0.rise", [0.04, 0.2], None, None),
        ("demo", "contacts.0.rise", [0.2, 0.04], "contacts.0", "'rise': the lower bound"),
        ("demo", "contacts.0.further_out", -0.1, "contacts.0.further_out", "greater than or equal to 0"),
        ("demo", "contacts.0.largest_force", 0.0, "contacts.0.largest_force", "greater than 0"),
        ("demo", "contacts.0.points.LShoulderRoll", [], "contacts.0.points.LShoulderRoll", "at least 1"),
        ("demo", "contacts.0.points.LShoulderRoll", 3, "contacts.0.points.LShoulderRoll", "valid array"),
        ("identify", "contacts", [PUSH], "contacts", "free motion"),
        ("identify", "motion.dwell", [3.0, 1.0], "motion", "'dwell': the lower bound"),
        ("identify", "motion.joints.1", "LShoulder", "motion.joints", "unknown joint"),
        ("reach_and_push", "motion.length", 12.0, "motion", "comes after 'length'"),
        ("reach_and_push", "motion.length", 12.5, None, None),
        ("reach_and_push", "motion.length", 10.0, "motion", "comes after 'length'"),
        ("reach_and_push", "motion.steps.1.time", 0.0, "motion", "must rise"),
        ("reach_and_push", "motion.steps.1.time", -1.0, "motion.steps.1.time", "greater than or equal to 0"),
        ("reach_and_push", "motion.steps.2.posture", "Sit", "motion.steps.2.posture", "unknown posture"),
        ("reach_and_push", "motion.steps.2.joints", {"HeadYaw": 0.1}, "motion.steps.2", "either"),
        ("reach_and_push", "motion.steps.0.joints", {}, "motion.steps.0", "either"),
        ("reach_and_push", "motion.steps.0.joints.HeadYa", 0.1, "motion.steps.0.joints", "HeadYaw"),
        ("reach_and_push", "motion.steps.0.joints.HeadYaw", 3.0, "motion.steps.0.joints.HeadYaw", "3 rad lies outside"),
        ("reach_and_push", "contacts.0.link", "LBice", "contacts.0.link", "did you mean LBicep"),
        ("reach_and_push", "contacts.0.joint", "LBicep", "contacts.0.joint", "unknown joint"),
        ("reach_and_push", "contacts.0.start", -0.5, "contacts.0.start", "greater than or equal to 0"),
        ("reach_and_push", "contacts.0.force", [0.0, 0.0, 0.0], "contacts.0", "longer than 0"),
        ("reach_and_push", "contacts.0.force", [0.0, 1001.0, 0.0], "contacts.0", "1000 N at most"),
        ("reach_and_push", "contacts.0.force", KeyError, "contacts.0.force", "missing"),
        ("reach_and_push", "contacts.0.frame", "torso", "contacts.0.frame", "'world'"),
        ("reach_and_push", "contacts.1.direction", 0, "contacts.1.direction", "-1"),
        ("reach_and_push", "contacts.1.force", [0.0, 1.0, 0.0], "contacts.1.force", "unknown key"),
        ("reach_and_push", "contacts.1.start", 15.5, "contacts.1", "after the motion"),
        ("reach_and_push", "contacts.2.pull", [0.0, 1.1, 0.0], "contacts.2", "1 m at most"),
        ("reach_and_push", "contacts.0.link", "LForeArm", None, None),
        ("reach_and_push", "contacts.1.link", "LBicep", None, None),
        ("reach_and_push", "contacts.0.duration", 8.0, None, None),
    ],
)  # fmt: skip
def test_a_wrong_scenario_is_one_line_with_file_key_and_reason(
    tmp_path: Path, name: str, key: str, value: object, where: str | None, reason: str | None
) -> None:
    data = changed(shipped(name), key, value)
    if where is None or reason is None:
        load_data(tmp_path, data)
        return
    with pytest.raises(ConfigError) as caught:
        load_data(tmp_path, data)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'mine.yaml'}")
    assert f"key '{where}'" in message
    assert reason in message
    assert "\n" not in message


def test_a_hand_can_not_come_where_another_is(tmp_path: Path) -> None:
    data = HOLDS | {"contacts": [PUSH, GRAB | {"start": 1.9}]}
    with pytest.raises(ConfigError, match=r"key 'contacts\.1': a hand on LBicep at 1\.9 s"):
        load_data(tmp_path, data)
    load_data(tmp_path, HOLDS | {"contacts": [PUSH, GRAB | {"start": 2.0}]})
    load_data(tmp_path, HOLDS | {"contacts": [PUSH, GRAB | {"start": 1.9, "link": "LForeArm"}]})


def test_random_pushes_keep_away_from_stated_hands(tmp_path: Path) -> None:
    """Those of the third goal are at 3 x 7.968 + 0.25 s, give or take the jitter."""
    data = shipped("demo")
    for start, fits in ((16.1, False), (17.7, True)):
        stated = PUSH | {"start": start, "duration": 0.1}
        both = data | {"contacts": [*data["contacts"], stated]}
        if fits:
            load_data(tmp_path, both)
        else:
            with pytest.raises(ConfigError, match="a hand on LBicep"):
                load_data(tmp_path, both)


@given(
    spans=st.lists(
        st.tuples(
            st.integers(0, 90), st.integers(1, 30), st.sampled_from(["LBicep", "LForeArm", "Head"])
        ),
        min_size=1,
        max_size=5,
    )
)
@settings(max_examples=100)
def test_hands_on_one_link_never_overlap(
    tmp_path_factory: pytest.TempPathFactory, spans: list[tuple[int, int, str]]
) -> None:
    contacts = [
        PUSH | {"link": link, "start": start / 8, "duration": length / 8}
        for start, length, link in spans
    ]
    inside = all(start + length <= 96 for start, length, _ in spans)
    apart = all(
        a[2] != b[2] or a[0] + a[1] <= b[0] or b[0] + b[1] <= a[0]
        for i, a in enumerate(spans)
        for b in spans[:i]
    )
    try:
        load_data(tmp_path_factory.mktemp("scenario"), HOLDS | {"contacts": contacts})
    except ConfigError as error:
        assert not (inside and apart), error
    else:
        assert inside
        assert apart


@pytest.mark.parametrize("link", [0.001, 0.05, 0.5])
def test_a_grab_pulls_with_its_spring_and_no_more_than_its_strength(link: float) -> None:
    grab = Grab(**(GRAB | {"xyz": (0.0, 0.0, 0.0), "pull": (0.6 * link, 0.0, -0.8 * link)}))
    size = min(1000.0 * link, 100.0)
    assert grab.largest == pytest.approx((0.6 * size, 0.0, -0.8 * size))
    assert grab.duration == pytest.approx(1.6)


@st.composite
def damaged(draw: st.DrawFn) -> dict[str, Any]:
    """A good scenario with one value anywhere replaced by something else, or one key renamed or removed."""
    good = st.sampled_from([shipped(name) for name in scenario_names()])
    data = copy.deepcopy(draw(good | st.just(HOLDS | {"contacts": [PUSH, GRAB]})))
    node: Any = data
    while True:
        key = draw(st.sampled_from(list(node) if isinstance(node, dict) else range(len(node))))
        child = node[key]
        if isinstance(child, dict | list) and child and draw(st.booleans()):
            node = child
            continue
        break
    action = draw(st.sampled_from(["replace", "remove", "rename"]))
    if action == "replace" or not isinstance(node, dict):
        node[key] = draw(
            st.none()
            | st.booleans()
            | st.integers(-(10**6), 10**6)
            | st.floats()
            | st.text(st.characters(exclude_categories=["C"]))
            | st.lists(st.integers())
            | st.just(PUSH)
        )
    elif action == "remove":
        del node[key]
    else:
        node[draw(st.text(st.characters(exclude_categories=["C"]), min_size=1))] = node.pop(key)
    return data


@settings(max_examples=200)
@given(data=damaged())
def test_a_damaged_scenario_loads_or_says_one_line(
    tmp_path_factory: pytest.TempPathFactory, data: dict[str, Any]
) -> None:
    folder = tmp_path_factory.mktemp("scenario")
    try:
        scenario = load_data(folder, data)
    except ConfigError as error:
        assert str(error).startswith(f"{folder / 'mine.yaml'}")
        assert len(str(error).splitlines()) == 1
    else:
        assert scenario.version == 1
        assert set(scenario.touched_joints) <= set(ROBOT.joint_names)


FORCES: dict[str, Any] = {
    "kind": "random_forces",
    "times": [0.5],
    "newtons": [5.0, 20.0],
    "duration": [0.3, 1.0],
    "points": [
        {"link": "torso", "xyz": [0.0, 0.0, 0.2]},
        {"link": "Tibia", "xyz": [0.0, 0.1, 0.0]},
    ],
}


def test_a_joint_may_be_pushed_in_several_places(tmp_path: Path) -> None:
    places = [{"link": link, "xyz": [0.1, 0.0, 0.0]} for link in ("LBicep", "LForeArm")]
    data = changed(shipped("demo"), "contacts.0.points.LShoulderRoll", places)
    (one,), (several,) = (load_data(tmp_path, d).contacts for d in (shipped("demo"), data))
    assert isinstance(one, RandomPushes)
    assert isinstance(several, RandomPushes)
    assert [p.link for p in one.points["LShoulderRoll"]] == ["LBicep"]
    assert [p.link for p in several.points["LShoulderRoll"]] == ["LBicep", "LForeArm"]
    assert several.links == ("LBicep", "LForeArm", "RForeArm")


def test_random_forces_act_on_trunk_and_base_only(tmp_path: Path) -> None:
    data = shipped("demo")
    scenario = load_data(tmp_path, data | {"contacts": [FORCES]})
    assert scenario.touched_joints == ()
    for link, joint in (("LForeArm", "LElbowRoll"), ("Head", "HeadPitch")):
        wrong = changed(FORCES, "points.1.link", link)
        with pytest.raises(
            ConfigError, match=rf"key 'contacts\.0\.points': {link} is carried by {joint}"
        ):
            load_data(tmp_path, data | {"contacts": [wrong]})
    with pytest.raises(ConfigError, match="'newtons': the lower bound"):
        load_data(tmp_path, data | {"contacts": [changed(FORCES, "newtons", [20.0, 5.0])]})


def test_two_random_pushes_at_once_need_different_links(tmp_path: Path) -> None:
    data = shipped("demo")
    (both,) = data["contacts"]
    left, right = both | {"joints": ["LShoulderRoll"]}, both | {"joints": ["RElbowRoll"]}
    load_data(tmp_path, data | {"contacts": [left, right]})
    with pytest.raises(ConfigError, match="a hand on LBicep"):
        load_data(tmp_path, data | {"contacts": [left, left]})
