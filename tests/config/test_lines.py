"""Errors in YAML files say in which line."""

from pathlib import Path

import pytest

from pepper_driver.config import ConfigError, load_experiment, load_robot
from pepper_driver.config.lines import located
from pepper_driver.config.loading import read_yaml

FILE = """# a comment
schema: 2
name: mine
steps:
  - {duration: 1.0, posture: Stand}
  - name: second
    duration: 2.0
    joints:
      HeadYaw: 0.1
"""


@pytest.mark.parametrize(
    ("key", "line"),
    [
        ("name", 3),
        ("steps", 4),
        ("steps.0", 5),
        ("steps.0.posture", 5),
        ("steps.1", 6),
        ("steps.1.duration", 7),
        ("steps.1.joints.HeadYaw", 9),
        ("steps.1.joints.HeadPitch", 8),  # missing: where it should be
        ("steps.7", 4),
    ],
)
def test_the_line_of_a_key(tmp_path: Path, key: str, line: int) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(FILE)
    message = located(f"{path}: key '{key}': is wrong")
    assert message == f"{path} line {line}: key '{key}': is wrong"
    assert located(message) == message


@pytest.mark.parametrize(
    "message",
    [
        "mine: key 'a': is wrong",
        "gone.yaml: key 'a': is wrong",
        "{path}: key 'a': is missing",
        "no",
    ],
)
def test_what_has_no_line_stays_as_it_is(tmp_path: Path, message: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(FILE)
    message = message.format(path=path)
    assert located(message) == message


def test_a_loader_says_the_line(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(FILE.replace("HeadYaw: 0.1", "HeadYaw: 9.0"))
    with pytest.raises(
        ConfigError, match=r"mine\.yaml line 9: key 'steps\.1\.joints\.HeadYaw': 9 rad"
    ):
        load_experiment(path, load_robot())


def test_on_and_off_are_words(tmp_path: Path) -> None:
    path = tmp_path / "words.yaml"
    path.write_text("on: off\nyes: no\nreally: true\nnever: False\nday: 2026-01-31\n")
    words = {"on": "off", "yes": "no", "really": True, "never": False, "day": "2026-01-31"}
    assert read_yaml(path) == words


@pytest.mark.parametrize(
    "text",
    [
        "? [a, [b]]\n: 1\n",
        "? {a: 1}\n: 2\n",
        "{[a]: 1}",
        "!!set {a: }",
        "!!binary YQ==: 1",
        "!!timestamp 2026-01-31: 1",
        "true: 1",
        "~: 1",
        ": 1",
    ],
)
def test_a_key_is_a_word(tmp_path: Path, text: str) -> None:
    path = tmp_path / "keys.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"keys\.yaml"):
        read_yaml(path)
