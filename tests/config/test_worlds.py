"""Worlds from files: shipped ones load, every mistake is one line that names file and key."""

from pathlib import Path

import pytest

from pepper_driver.config import ConfigError, UnknownNameError, load_world, world_names

GOOD = """
name: mine
description: one ball
objects:
  ball: {shape: sphere, size: [0.1], mass: 0.4, position: [1.0, 0.0, 0.5], velocity: [-1.0, 0.0, 0.0], start: 1.0}
"""


def test_the_shipped_worlds_load() -> None:
    assert set(world_names()) == {"ball", "empty", "table"}
    for name in world_names():
        assert load_world(name).name == name
    assert load_world("empty").objects == {}


def test_a_file_of_ones_own_loads(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(GOOD)
    world = load_world(str(path))
    assert world.source == str(path)
    assert world.objects["ball"].velocity == (-1.0, 0.0, 0.0)
    assert world.objects["ball"].orientation == (0.0, 0.0, 0.0)


def test_an_unknown_world_suggests_a_known_one() -> None:
    with pytest.raises(UnknownNameError, match="did you mean table"):
        load_world("tabel")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("shape: sphere", "shape: cone", "objects.ball.shape"),
        ("size: [0.1]", "size: [0.1, 0.2]", "radius"),
        ("size: [0.1]", "size: []", "objects.ball.size"),
        ("size: [0.1]", "size: [-0.1]", "objects.ball.size"),
        ("mass: 0.4", "mass: 0.0", "objects.ball.mass"),
        ("mass: 0.4", "mass: null", "fixed"),
        ("mass: 0.4, ", "", "objects.ball.mass"),
        ("start: 1.0", "start: -1.0", "objects.ball.start"),
        ("start: 1.0", "stat: 1.0", "did you mean start"),
        ("start: 1.0", "softness: 0.001", "objects.ball.softness"),
        ("position: [1.0, 0.0, 0.5]", "position: [1.0, 0.0]", "objects.ball.position"),
        ("position: [1.0, 0.0, 0.5]", "position: [1.0, 0.0, .nan]", "objects.ball.position"),
        ("objects:\n", "objects:\n  ball: {}\n", "given twice"),
        ("description: one ball", "", "description"),
    ],
)
def test_a_wrong_world_is_named_with_its_key(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = tmp_path / "broken.yaml"
    assert old in GOOD
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        load_world(str(path))
    text = str(caught.value)
    assert "broken.yaml" in text
    assert message in text
    assert "\n" not in text
