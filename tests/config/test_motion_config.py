"""A motion file is one that can be played, or one line says what is wrong with it."""

import copy
import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from pepper_driver.config import (
    ConfigError,
    Motion,
    MotionStep,
    UnknownNameError,
    check_motion,
    load_motion,
    load_robot,
    motion_names,
)
from pepper_driver.config.loading import package_file, read_yaml
from pepper_driver.config.motion_tasks import LookAtSpec, PositionSpec

ROBOT = load_robot()

REACH: dict[str, Any] = {"link": "l_wrist", "target": [0.3, 0.2, 0.8]}
TURN: dict[str, Any] = {"link": "r_wrist", "quaternion": [0.0, 0.0, 0.6, 0.8]}
MINE: dict[str, Any] = {
    "schema": 1,
    "name": "mine",
    "repeat": 2,
    "steps": [
        {"duration": 1.0, "posture": "Stand", "joints": {"HeadYaw": 0.2}, "hands": {"LHand": 0.5}},
        {
            "duration": 2.0,
            "until": "reached",
            "tolerance": 0.02,
            "timeout": 4.0,
            "hold": 0.5,
            "stiffness": 8.0,
            "position": [REACH, REACH | {"link": "r_wrist", "root": "torso", "keep": True}],
            "orientation": TURN | {"joints": ["right_arm", "HipRoll"]},
            "pose": {
                "link": "Hip",
                "point": [0.0, 0.0, 0.1],
                "position": [0.0, 0.0, 0.5],
                "quaternion": [0.0, 0.0, 0.0, 1.0],
                "weight": 10.0,
            },
            "look_at": {"link": "l_wrist"},
            "com": {"target": [0.0, 0.0, 0.6], "root": "base_link"},
            "base": {"x": 0.1, "heading": 1.0},
        },
        {"hold": 1.0, "base_velocity": {"vx": 0.2}, "look_at": {"point": [1.0, 0.0, 1.0]}},
    ],
}


def load_data(folder: Path, data: object) -> Motion:
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return load_motion(path, ROBOT)


@pytest.mark.parametrize("name", motion_names())
def test_the_shipped_motions_load_and_are_called_like_their_files(name: str) -> None:
    motion = load_motion(name, ROBOT)
    assert motion.name == name
    assert motion.description
    assert Path(motion.source).name == f"{name}.yaml"
    assert motion.longest < 20.0


def test_there_are_motions_to_learn_from() -> None:
    assert {"reach", "stretch", "wave"} <= set(motion_names())


def test_an_unknown_motion_lists_those_there_are() -> None:
    with pytest.raises(UnknownNameError, match="did you mean wave"):
        load_motion("wav", ROBOT)


def test_every_part_of_a_step_is_read(tmp_path: Path) -> None:
    motion = load_data(tmp_path, MINE)
    first, second, third = motion.steps
    assert first.joints == {"HeadYaw": 0.2}
    assert first.hands == {"LHand": 0.5}
    assert [(key, task.label) for key, task in second.tasks()] == [
        ("position.0", "position l_wrist"),
        ("position.1", "position r_wrist"),
        ("orientation", "orientation r_wrist"),
        ("pose", "pose Hip"),
        ("look_at", "look at"),
        ("com", "com"),
        ("base", "base"),
    ]
    assert [task.keep for _, task in second.tasks()] == [False, True] + 5 * [False]
    assert second.position[0] == PositionSpec(link="l_wrist", target=(0.3, 0.2, 0.8))
    assert second.orientation[0].joints == ("right_arm", "HipRoll")
    assert third.look_at == LookAtSpec(point=(1.0, 0.0, 1.0))
    assert third.base_velocity is not None
    assert third.base_velocity.vx == 0.2
    # 1 s; a timeout of 4 s and a hold of 0.5 s; a hold of 1 s.
    assert motion.longest == pytest.approx(2 * (1.0 + 4.5 + 1.0))


def test_a_motion_can_be_made_in_python() -> None:
    step = MotionStep(duration=1.0, position=(PositionSpec(link="l_wrist", target=(0.3, 0.2, 1)),))
    check_motion(Motion(schema=1, name="mine", steps=(step,)), ROBOT)
    lost = MotionStep(duration=1.0, position=(PositionSpec(link="wrist", target=(0.3, 0.2, 1)),))
    with pytest.raises(ConfigError, match=r"^mine: key 'steps\.1\.position\.link': unknown link"):
        check_motion(Motion(schema=1, name="mine", steps=(step, lost)), ROBOT)


def changed(key: str, value: object) -> dict[str, Any]:
    """A copy of ``MINE`` with the value at a dotted key replaced; ``KeyError`` as a value removes it."""
    data = copy.deepcopy(MINE)
    *path, last = key.split(".")
    node: Any = data
    for part in path:
        node = node[int(part)] if isinstance(node, list) else node[part]
    if value is KeyError:
        del node[last]
    else:
        node[int(last) if isinstance(node, list) else last] = value
    return data


@pytest.mark.parametrize(
    ("key", "value", "where", "reason"),
    [
        ("schema", 2, "schema", "should be 1"),
        ("schema", KeyError, "schema", "missing"),
        ("steps", [], "steps", "at least 1"),
        ("repeat", 0, "repeat", "greater than or equal to 1"),
        ("steps.0.duration", -1.0, "steps.0.duration", "0.001"),
        ("steps.0.duration", 0.0, "steps.0.duration", "0.001"),
        ("steps.0.duration", 0.9e-3, "steps.0.duration", "0.001"),
        ("steps.0.duration", math.nan, "steps.0.duration", "finite"),
        ("steps.0.duration", 1e6, "steps.0.duration", "3600"),
        ("steps.0.duration", "1 s", "steps.0.duration", "number"),
        ("steps.0.duration", KeyError, "steps.0", "give 'duration', 'until: reached' or 'hold'"),
        ("steps.0.posture", "Stnd", "steps.0.posture", "did you mean Stand"),
        ("steps.0.joints", {"HeadYa": 0.1}, "steps.0.joints.HeadYa", "did you mean HeadYaw"),
        ("steps.0.joints.HeadYaw", 3.0, "steps.0.joints.HeadYaw", "3 rad lies outside -2.08567"),
        ("steps.0.joints.LHand", 1.2, "steps.0.joints.LHand", ": 1.2 lies outside 0 to 1"),
        ("steps.0.joints.HeadYaw", math.inf, "steps.0.joints.HeadYaw", "finite"),
        ("steps.0.hands", {"LHnd": 0.1}, "steps.0.hands.LHnd", "did you mean LHand"),
        ("steps.0.hands.LHand", 1.2, "steps.0.hands.LHand", "1.2 lies outside 0 to 1"),
        ("steps.0.timeout", 2.0, "steps.0", "belong to 'until: reached'"),
        ("steps.0.speed", 2.0, "steps.0.speed", "unknown key"),
        ("steps.0.durations", 2.0, "steps.0.durations", "did you mean duration"),
        ("steps.1.until", "arrived", "steps.1.until", "'reached'"),
        ("steps.1.timeout", KeyError, "steps.1", "needs a 'timeout'"),
        ("steps.1.timeout", 1.0, "steps.1", "'timeout' 1 s ends before 'duration', 2 s"),
        ("steps.1.tolerance", 0.0, "steps.1.tolerance", "greater than 0"),
        ("steps.1.stiffness", 0.0, "steps.1.stiffness", "greater than 0"),
        ("steps.2.until", "reached", "steps.2", "needs a 'timeout'"),
        ("steps.1.position.0.target", [0.1, 0.2], "steps.1.position.0.target.2", "missing"),
        ("steps.1.position.0.target.1", math.nan, "steps.1.position.0.target.1", "finite"),
        ("steps.1.position.0.target.1", 101.0, "steps.1.position.0.target.1", "100"),
        ("steps.1.position.1.link", "r_wris", "steps.1.position.1.link", "did you mean r_wrist"),
        ("steps.1.position.1.link", "l_wrist", "steps.1", "two tasks are called 'position l_wrist'"),
        ("steps.1.position.0.targt", [0, 0, 0], "steps.1.position.0.targt", "did you mean target"),
        ("steps.1.position", REACH | {"link": "l"}, "steps.1.position.link", "unknown link 'l'"),
        ("steps.1.position", REACH | {"target": 1.0}, "steps.1.position.target", "array"),
        ("steps.1.position", None, "steps.1.position", "null"),
        ("steps.1.position.1.root", "world", "steps.1.position.1.root", "unknown link"),
        ("steps.1.position.1.root", "r_wrist", "steps.1.position.1", "root of its own target"),
        ("steps.1.pose.root", "Hip", "steps.1.pose", "root of its own target"),
        ("steps.1.com.name", "posture", "steps.1", "cannot be called 'posture'"),
        ("steps.1.com.name", "", "steps.1.com.name", "at least 1"),
        ("steps.0.name", "a\nb", "steps.0.name", "pattern"),
        ("name", KeyError, "name", "missing"),
        ("steps.1.position.0.joints", ["left"], "steps.1.position.0.joints", "left_arm"),
        ("steps.1.position.0.joints", [], "steps.1.position.0.joints", "at least 1"),
        ("steps.1.position.0.weight", 0.0, "steps.1.position.0.weight", "greater than 0"),
        ("steps.1.orientation.quaternion", [0, 0, 1, 1], "steps.1.orientation", "length 1, got 1.414"),
        ("steps.1.orientation.quaternion", [0, 0, 0, 0], "steps.1.orientation", "length 1, got 0"),
        ("steps.1.pose.quaternion", [1.0, 0, 0, 1.0], "steps.1.pose", "length 1"),
        ("steps.1.pose.quaternion", KeyError, "steps.1.pose.quaternion", "missing"),
        ("steps.1.look_at.point", [1.0, 0.0, 1.0], "steps.1.look_at", "either 'point' or 'link'"),
        ("steps.1.look_at.link", "Head", "steps.1.look_at", "cannot look at itself"),
        ("steps.1.look_at.link", "hand", "steps.1.look_at.link", "unknown link"),
        ("steps.1.com.root", "torso", "steps.1.com.root", "base_link"),
        ("steps.1.base", {}, "steps.1.base", "'x', 'y' or 'heading'"),
        ("steps.1.base.heading", 7.0, "steps.1.base.heading", "6.28"),
        ("steps.1.base_velocity", {"vx": 0.1}, "steps.1", "not both"),
        ("steps.2.base_velocity.vx", 0.4, "steps.2.base_velocity.vx", "0.4 m/s lies outside -0.35"),
        ("steps.2.base_velocity.wz", -1.1, "steps.2.base_velocity.wz", "rad/s lies outside -1 to 1"),
        ("steps.2.base_velocity.vz", 0.1, "steps.2.base_velocity.vz", "unknown key"),
    ],
)  # fmt: skip
def test_a_wrong_motion_is_one_line_with_file_key_and_reason(
    tmp_path: Path, key: str, value: object, where: str, reason: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        load_data(tmp_path, changed(key, value))
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'mine.yaml'}")
    assert f"key '{where}'" in message
    assert reason in message
    assert "\n" not in message


def test_nothing_to_reach_is_refused(tmp_path: Path) -> None:
    step = {"until": "reached", "timeout": 1.0}
    with pytest.raises(ConfigError, match="needs a task or a posture"):
        load_data(tmp_path, MINE | {"steps": [step]})
    load_data(tmp_path, MINE | {"steps": [step | {"hands": {"LHand": 0.0}}]})


@st.composite
def damaged(draw: st.DrawFn) -> dict[str, Any]:
    """A good motion with one value anywhere replaced by something else, or one key renamed or removed."""
    shipped = [read_yaml(package_file("motions", f"{name}.yaml")) for name in motion_names()]
    data: dict[str, Any] = copy.deepcopy(draw(st.sampled_from([MINE, *shipped])))
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
            | st.lists(st.floats(), max_size=8)
            | st.just(REACH)
        )
    elif action == "remove":
        del node[key]
    else:
        node[draw(st.text(st.characters(exclude_categories=["C"]), min_size=1))] = node.pop(key)
    return data


@settings(max_examples=200)
@given(data=damaged())
def test_a_damaged_motion_loads_or_says_one_line(
    tmp_path_factory: pytest.TempPathFactory, data: dict[str, Any]
) -> None:
    folder = tmp_path_factory.mktemp("motion")
    try:
        motion = load_data(folder, data)
    except ConfigError as error:
        assert str(error).startswith(f"{folder / 'mine.yaml'}")
        assert len(str(error).splitlines()) == 1
    else:
        assert 0.0 < motion.longest < math.inf
        for step in motion.steps:
            assert all(math.isfinite(x) for task in step.position for x in task.target)
            assert all(
                joint.lower <= step.joints.get(joint.name, 0.5 * (joint.lower + joint.upper))
                for joint in ROBOT.joints
            )
