"""Every mistake in a file is one line that names file and key; nothing else ever comes out of loading."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config import ConfigError, PlantConfig
from pepper_driver.config.loading import package_file, parse, read_yaml
from support.examples import examples


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


@examples(150)
@given(damaged())
def test_a_damaged_plant_loads_or_says_one_line(data: dict[str, Any]) -> None:
    try:
        plant = parse(PlantConfig, data, "plant.yaml")
    except ConfigError as error:
        assert str(error).startswith("plant.yaml: ")
        assert "\n" not in str(error).replace("\\n", "")
    else:
        assert plant.physics.timestep > 0


@pytest.mark.parametrize(
    ("opening", "closing"), [("[", "]"), ("{a: ", "}"), ("- ", ""), ("? ", "")]
)
def test_what_is_nested_too_deep_is_one_error(tmp_path: Path, opening: str, closing: str) -> None:
    path = tmp_path / "deep.yaml"
    for levels, problem in ((150, "nested deeper than 100 levels$"), (200_000, "")):
        path.write_text(f"a:\n {opening * levels}1{closing * levels}", encoding="utf-8")
        with pytest.raises(ConfigError, match=rf"deep\.yaml line 2: {problem}"):
            read_yaml(path)


@examples(150)
@given(st.text())
def test_any_text_is_yaml_or_one_error(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.mktemp("yaml") / "any.yaml"
    path.write_text(text, encoding="utf-8", errors="replace")
    try:
        assert isinstance(read_yaml(path), dict)
    except ConfigError as error:
        assert str(path) in str(error)


def test_anchors_in_anchors_are_refused_before_they_fill_the_memory(tmp_path: Path) -> None:
    path = tmp_path / "bomb.yaml"
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    for k in range(1, 30):
        lines.append(f"a{k}: &a{k} [" + ", ".join([f"*a{k - 1}"] * 10) + "]")
    path.write_text("\n".join(lines))
    with pytest.raises(ConfigError, match="anchors stand for"):
        read_yaml(path)
    path.write_text("\n".join(lines[:3]))
    assert len(read_yaml(path)["a2"]) == 10


def test_one_that_holds_itself_is_one_error(tmp_path: Path) -> None:
    path = tmp_path / "loop.yaml"
    path.write_text("a: &a [1, *a]\n")
    with pytest.raises(ConfigError):
        parse(PlantConfig, read_yaml(path), str(path))
