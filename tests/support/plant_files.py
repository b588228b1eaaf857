"""Plants as files of a test: the nominal one with a change, and variants of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import yaml

from pepper_driver.config import load_robot
from pepper_driver.config.loading import package_file, read_yaml

ROBOT = load_robot()
Tree = dict[str, Any]
Change = Callable[[Tree], object]


def nominal() -> Tree:
    return read_yaml(package_file("plants", "nominal.yaml"))


def save(folder: Path, data: Tree, name: str = "mine.yaml") -> str:
    path = folder / name
    path.write_text(yaml.safe_dump(data, sort_keys=False, allow_unicode=True))
    return str(path)


def changed(folder: Path, change: Change) -> str:
    """The nominal plant with one change, as a file."""
    data = nominal()
    change(data)
    return save(folder, data)


def variant(folder: Path, **keys: Any) -> str:
    """A plant that says only how it differs from the nominal one, as a file."""
    return save(folder, {"name": "mine", "description": "", "extends": "nominal", **keys})


def drive_of(data: Tree, joint: str) -> Tree:
    return next(entry for entry in data["actuators"] if joint in entry["joints"])


def put(*path: str | int, value: object) -> Change:
    """Set one value deep in a tree."""

    def change(data: Any) -> None:
        for part in path[:-1]:
            data = data[part]
        data[path[-1]] = value

    return change


def numbers(tree: object, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Paths of all numbers in a tree."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield from numbers(value, (*path, key))
    elif isinstance(tree, list):
        for index, value in enumerate(tree):
            yield from numbers(value, (*path, index))
    elif isinstance(tree, int | float) and not isinstance(tree, bool):
        yield path


FLEXIBLE = {"joint": "HipRoll", "axis": [1, 0, 0], "stiffness": 1.0, "damping": 0, "inertia": 0.1}
