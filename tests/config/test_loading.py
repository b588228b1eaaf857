"""Every mistake in a file is one line that names file and key; nothing else ever comes out of loading."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pepper_driver.config import ConfigError, PlantConfig, load_plant, load_robot, plant_hash
from pepper_driver.config.errors import UnknownNameError
from pepper_driver.config.loading import package_file, parse, read_yaml


def nominal() -> dict[str, Any]:
    return read_yaml(package_file("plants", "nominal.yaml"))


@st.composite
def damaged(draw: st.DrawFn) -> dict[str, Any]:
    """The nominal plant with one value anywhere replaced by something else, or one key renamed or removed."""
    data = nominal()
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
            | st.integers()
            | st.floats()
            | st.text()
            | st.lists(st.integers())
        )
    elif action == "remove":
        del node[key]
    else:
        node[draw(st.text(min_size=1))] = node.pop(key)
    return data


@settings(max_examples=150, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(damaged())
def test_a_damaged_plant_loads_or_says_one_line(data: dict[str, Any]) -> None:
    try:
        plant = parse(PlantConfig, data, "plant.yaml")
    except ConfigError as error:
        assert str(error).startswith("plant.yaml: ")
        assert "\n" not in str(error).replace("\\n", "")
    else:
        assert plant.physics.timestep > 0


@settings(max_examples=150, deadline=None)
@given(st.text())
def test_any_text_is_yaml_or_one_error(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.mktemp("yaml") / "any.yaml"
    path.write_text(text, encoding="utf-8", errors="replace")
    try:
        assert isinstance(read_yaml(path), dict)
    except ConfigError as error:
        assert str(path) in str(error)


def write(tmp_path: Path, old: str, new: str) -> str:
    text = package_file("plants", "nominal.yaml").read_text()
    assert old in text
    path = tmp_path / "mine.yaml"
    path.write_text(text.replace(old, new, 1))
    return str(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("timestep: 0.001", "timestep: 0.0007", "does not divide the cycle"),
        ("[HipRoll]\n", "[HipRol]\n", "did you mean HipRoll"),
        ("[HipRoll]\n", "[HipRoll, KneePitch]\n", "already has an actuator"),
        ("- joints: [HeadYaw]", "- joints: []", "no entry for joint HeadYaw"),
        ("half_gap: 0.0008", "half_gap: 0.6", "wider than the joint's range"),
        ("brakes: [KneePitch", "brakes: [KneePich", "did you mean KneePitch"),
        ("gear_stiffness: 20000.0", "gear_stiffness: -2", "greater than 0"),
        ("base: fixed", "base: flying", "key 'base'"),
    ],
)
def test_a_wrong_plant_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(ConfigError, match=r"mine\.yaml") as caught:
        load_plant(write(tmp_path, old, new), load_robot())
    assert message in str(caught.value)


def test_an_unknown_plant_lists_those_there_are() -> None:
    with pytest.raises(UnknownNameError, match="nominal"):
        load_plant("nominl", load_robot())


def test_numbers_without_a_dot_are_numbers(tmp_path: Path) -> None:
    path = write(tmp_path, "timestep: 0.001", "timestep: 1e-3")
    assert load_plant(path, load_robot()).physics.timestep == 0.001


def test_the_hash_follows_the_physics_and_not_the_prose(tmp_path: Path) -> None:
    robot = load_robot()
    shipped = plant_hash(load_plant("nominal", robot), robot)
    renamed = load_plant(write(tmp_path, "name: nominal", "name: other"), robot)
    assert plant_hash(renamed, robot) == shipped
    changed = load_plant(write(tmp_path, "kp: 63.0", "kp: 63.5"), robot)
    assert plant_hash(changed, robot) != shipped
