"""Experiment files as tests write them: a good one, changes to it, and what loading says of a bad one."""

import copy
from pathlib import Path
from typing import Any

import pytest

from pepper_driver.config import ConfigError, Experiment, load_experiment, load_robot
from pepper_driver.config.loading import package_file, read_yaml
from support.yaml_values import JARGON, dump

ROBOT = load_robot()

STAND: dict[str, Any] = {"name": "stand", "posture": "Stand", "duration": 1.0}
TURN: dict[str, Any] = {"joints": {"HeadYaw": 0.2}, "duration": 0.5, "hold": 0.25}
LISTEN: dict[str, Any] = {"name": "listen", "wait": {"link": "LBicep", "timeout": 3.0}}
PUSH: dict[str, Any] = {
    "kind": "push",
    "joint": "LShoulderRoll",
    "link": "LBicep",
    "xyz": [0.16, 0.0, 0.0],
    "force": [0.0, 10.0, 0.0],
    "start": 0.5,
    "duration": 0.5,
}
HOLDS: dict[str, Any] = {
    "joints": ["HeadYaw", "LElbowRoll"],
    "range": 0.5,
    "move": 2.0,
    "hold": 1.0,
    "count": 4,
}
SETPOINTS: dict[str, Any] = {"joints": ["LShoulderRoll"], "range": 0.5, "period": 6.0, "count": 4}
RANDOM: dict[str, Any] = {
    "kind": "random_pushes",
    "times": [0.5, 3.0],
    "jitter": 0.4,
    "duration": [0.5, 1.0],
    "joints": ["LShoulderRoll"],
    "degrees": [2.0, 6.0],
    "points": {"LShoulderRoll": {"link": "LBicep", "xyz": [0.16, 0.0, 0.0]}},
}

BRANCH: dict[str, Any] = {
    "branch": {
        "timeout": 5.0,
        "cases": [
            {"on": {"limb": "left_arm", "min_torque": 3.0}, "steps": [TURN]},
            {"on": {"limb": "left_arm"}, "steps": []},
        ],
        "otherwise": [{"hold": 2.0}],
    }
}


def experiment(*steps: dict[str, Any], **more: Any) -> dict[str, Any]:
    """The data of a file with these steps."""
    return {"schema": 2, "name": "mine", **more, "steps": list(steps)}


def shipped(folder: str, name: str) -> dict[str, Any]:
    return read_yaml(package_file(folder, f"{name}.yaml"))


def changed(data: dict[str, Any], key: str, value: object) -> dict[str, Any]:
    """A copy with another value at a dotted key, which may be new; ``KeyError`` as a value removes it."""
    data = copy.deepcopy(data)
    node: Any = data
    *path, last = (int(part) if part.isdigit() else part for part in key.split("."))
    for part in path:
        node = node[part]
    if value is KeyError:
        del node[last]
    else:
        node[last] = value
    return data


def load_data(folder: Path, data: object) -> Experiment:
    """Load a file ``mine.yaml`` with these data, or of this text."""
    path = folder / "mine.yaml"
    path.write_text(data if isinstance(data, str) else dump(data), encoding="utf-8")
    return load_experiment(path, ROBOT)


def refusal(folder: Path, data: object) -> str:
    """Return the refusal of a bad file, after its path: one line, in words for people."""
    with pytest.raises(ConfigError) as caught:
        load_data(folder, data)
    message = str(caught.value)
    start = str(folder / "mine.yaml")
    assert message.startswith(start), message
    said = message.removeprefix(start)
    assert len(message.splitlines()) == 1, message
    assert not JARGON.search(said), message
    return said


def write(folder: Path, name: str, *steps: dict[str, Any], **more: Any) -> None:
    """Write a file that others may play."""
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(dump(experiment(*steps, **more)))
