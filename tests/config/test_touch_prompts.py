"""Touches that a person is asked for."""

from pathlib import Path

import pytest

from pepper_driver.config import ConfigError, UnknownNameError, load_robot
from pepper_driver.config.touch_prompts import SHIPPED, load_touch_prompts

ROBOT = load_robot()
TEXT = """version: 1
rest: 1.0
time: 4.0
touches:
  - {say: "My head.", link: Head}
  - {say: "My hand.", link: l_wrist, force: 8.0}
"""


@pytest.mark.parametrize("name", SHIPPED)
def test_the_shipped_ones_are_thirty_and_take_less_than_five_minutes(name: str) -> None:
    prompts = load_touch_prompts(ROBOT, name)
    assert len(prompts.touches) == 30
    assert prompts.seconds < 300.0
    links = {touch.link for touch in prompts.touches}
    assert {"l_wrist", "r_wrist", "LForeArm", "RBicep", "Head", "torso"} <= links
    assert len({touch.say for touch in prompts.touches}) == 30
    pulled = sum(touch.force is not None for touch in prompts.touches)
    assert pulled == (14 if name == "scale" else 0)


def test_prompts_of_no_such_name_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="did you mean scale"):
        load_touch_prompts(ROBOT, "scales")


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("link: Head", "link: Haed", "key 'touches.0.link': unknown link 'Haed'.*Head"),
        ("force: 8.0", "force: -8.0", "touches.1.force"),
        ("time: 4.0", "time: 0.1", "time"),
        ("rest: 1.0", "rest: .nan", "rest"),
        ('say: "My head."', 'say: ""', "touches.0.say"),
        ("version: 1", "version: 3", "version"),
        ("touches:", "touches: []\nx:", "touches|x"),
    ],
)
def test_a_wrong_file_is_refused(tmp_path: Path, old: str, new: str, text: str) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(TEXT)
    assert load_touch_prompts(ROBOT, path).seconds == 10.0
    path.write_text(TEXT.replace(old, new))
    with pytest.raises(ConfigError, match=f"own.yaml.*({text})"):
        load_touch_prompts(ROBOT, path)
