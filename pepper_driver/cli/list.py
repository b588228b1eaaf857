"""``pepper list``: names that can be used, each with what it is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Annotated

import typer
from rich.table import Table

from pepper_driver.cli.console import make_console
from pepper_driver.config import RobotConfig, UnknownNameError, load_robot
from pepper_driver.config.evaluation import load_evaluation
from pepper_driver.config.loading import package_file, read_yaml, shipped_names
from pepper_driver.reflexes.declared import reflex_kinds

Rows = Iterator[tuple[str, str]]


def _files(folder: str) -> Callable[[RobotConfig], Rows]:
    """Rows of the files in a folder, by their names and descriptions."""

    def rows(robot: RobotConfig) -> Rows:
        for name in shipped_names(folder):
            yield name, str(read_yaml(package_file(folder, f"{name}.yaml")).get("description", ""))

    return rows


def _suites(robot: RobotConfig) -> Rows:
    evaluation = load_evaluation(robot)
    for suite, entries in evaluation.suites.items():
        yield suite, ", ".join(entry.name for entry in entries)


def _limbs(robot: RobotConfig) -> Rows:
    for limb in robot.limbs:
        yield limb, ", ".join(link for link in robot.links if robot.limb_of_link(link) == limb)


def _joints(robot: RobotConfig) -> Rows:
    for joint in robot.joints:
        unit = "" if joint.name in robot.hands.joints else " rad"
        yield joint.name, f"{robot.limb_of(joint.name)}, {joint.lower:g} to {joint.upper:g}{unit}"


def _links(robot: RobotConfig) -> Rows:
    carried = {joint.child: joint.name for joint in robot.joints}
    for link in robot.links:
        by = f", carried by {carried[link]}" if link in carried else ""
        yield link, robot.limb_of_link(link) + by


_KINDS: dict[str, Callable[[RobotConfig], Rows]] = {
    "motions": _files("motions"),
    "experiments": _files("experiments"),
    "plants": _files("plants"),
    "worlds": _files("worlds"),
    "suites": _suites,
    "reflexes": lambda robot: iter(reflex_kinds().items()),
    "postures": lambda robot: ((name, "") for name in robot.postures),
    "limbs": _limbs,
    "joints": _joints,
    "links": _links,
}


def list_command(
    kind: Annotated[
        str | None, typer.Argument(metavar="KIND", help=f"One of {', '.join(_KINDS)}; else all.")
    ] = None,
) -> None:
    """List motions, experiments, plants, suites, reflexes, limbs and the like that can be named."""
    if kind is not None and kind not in _KINDS:
        raise UnknownNameError("kind", kind, tuple(_KINDS))
    console, robot = make_console(), load_robot()
    for name in [kind] if kind else _KINDS:
        table = Table(title=name, title_justify="left", show_header=False, box=None)
        for row in _KINDS[name](robot):
            table.add_row(*row)
        console.print(table)
