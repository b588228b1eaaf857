"""The frozen suites of the judge of touch: splits of a population, states of robots, places, and rows of touches.

``python -m pepper_driver.config.touch_suites`` freezes them again after a change that is meant.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.errors import ConfigError, UnknownNameError
from pepper_driver.config.frozen import frozen_part_hash, write_frozen
from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import STRICT, own_or_shipped, parse, read_yaml
from pepper_driver.config.parts import NonNegative, Positive, Vector3, check_bounds
from pepper_driver.config.robot import RobotConfig, load_robot

_FILE = "touch_suites.yaml"
_CURE = "python -m pepper_driver.config.touch_suites"

Split = Literal["development", "test"]
Act = Literal[
    "push",
    "taps",
    "grip",
    "pull",
    "follow",
    "handshake",
    "lead",
    "hug",
    "weight",
    "pair",
    "both",
    "before",
    "table",
]
"""Kinds of touches that :mod:`pepper_driver.evaluation.touch.people` makes."""

EVEN = "even"
"""The row of N90."""

Count = Annotated[int, Field(ge=1, le=1000)]
Names = tuple[str, ...] | Literal["all"]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SplitSpec:
    """Robots of a split.

    Attributes:
        first: First draw.
        robots: Number of draws, if none are asked for.
        free: Time in which no one touches each robot [s].
    """

    first: Annotated[int, Field(ge=0)]
    robots: Count
    free: Positive


@dataclass(frozen=True, kw_only=True, config=STRICT)
class FreeStates:
    """States of the time without touch: half of it standing, half moving, and in each the states in equal parts."""

    standing: Annotated[tuple[str, ...], Field(min_length=1)]
    moving: Annotated[tuple[str, ...], Field(min_length=1)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class PlacePoint:
    """A point ``xyz`` [m] of a link, and the direction out of it there, both in the link's frame."""

    link: str
    xyz: Vector3
    outward: Vector3

    @property
    def mirrored(self) -> PlacePoint:
        """The same point of the right side; of a link in the middle itself."""
        names = {"l": "r", "L": "R"}
        link = names.get(self.link[0], self.link[0]) + self.link[1:]
        flip = (1.0, -1.0, 1.0)
        x, y, z = (a * b for a, b in zip(self.xyz, flip, strict=True))
        u, v, w = (a * b for a, b in zip(self.outward, flip, strict=True))
        return replace(self, link=link, xyz=(x, y, z), outward=(u, v, w))


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Place:
    """A part of the robot that people touch; ``axis`` in the frame of its links."""

    axis: Vector3
    points: Annotated[tuple[PlacePoint, ...], Field(min_length=1)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Row:
    """Touches that are one row of the results.

    Attributes:
        name: As it is called.
        act: Kind of touch.
        states: ``all``: each robot makes the touches in each of the states of the suites. Names: each robot makes those
            of a place in one of these states, the robots in turn.
        places, forces: Each combination is one touch. Without forces, each of ``stiffness`` is one.
        direction: ``outer``: even over the outer half-space, without those along the axis; ``axis``: along it.
        duration: [s]
        rise: [s]
        stiffness: Of hands [N/m].
    """

    name: str
    act: Act
    states: Names
    places: Names
    forces: tuple[Positive, ...] | Literal["all"] = ()
    direction: Literal["outer", "axis"] = "outer"
    duration: Positive
    rise: Positive = 0.1
    stiffness: tuple[Positive, ...] = ()


@dataclass(frozen=True, kw_only=True, config=STRICT)
class PlannedAct:
    """One touch that is to be made: a row at one place, with one force [N] or stiffness of a hand [N/m]."""

    row: Row
    place: str
    force: float | None = None
    stiffness: float | None = None


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TouchSuites:
    """The suites: ``touch_suites.yaml``, which explains its keys.

    Attributes:
        frozen: SHA-256 of the file without this key.
    """

    version: Literal[1]
    root: Annotated[int, Field(ge=1)]
    population: str
    splits: dict[Split, SplitSpec]
    free: FreeStates
    touches_per_take: Count
    lead: NonNegative
    pause: tuple[Positive, Positive]
    max_tipping: Annotated[float, Field(gt=0, le=1)]
    along_axis: Annotated[float, Field(gt=0, lt=90)]
    forces: Annotated[tuple[Positive, ...], Field(min_length=2)]
    states: Annotated[tuple[str, ...], Field(min_length=1)]
    places: dict[str, Place]
    rows: Annotated[tuple[Row, ...], Field(min_length=1)]
    frozen: str = ""

    def __post_init__(self) -> None:
        check_bounds("pause", self.pause)
        if missing := [name for name in get_args(Split) if name not in self.splits]:
            raise ValueError(f"'splits' has no '{missing[0]}'")

    @property
    def digest(self) -> str:
        """Short form of the hash, for results."""
        return self.frozen[:16]

    @property
    def all_states(self) -> tuple[str, ...]:
        """Names of all states, those of single rows too."""
        of_rows = (s for row in self.rows if row.states != "all" for s in row.states)
        return tuple(dict.fromkeys((*self.states, *of_rows)))

    def acts(self, state: str, draw: int) -> tuple[PlannedAct, ...]:
        """Return every touch of a robot in a state, in the order of the file."""
        return tuple(act for row in self.rows for act in self._acts(row, state, draw))

    def _acts(self, row: Row, state: str, draw: int) -> Iterator[PlannedAct]:
        forces = self.forces if row.forces == "all" else row.forces
        for number, place in enumerate(self.places if row.places == "all" else row.places):
            if row.states == "all":
                if state not in self.states:
                    return
            # Draws take the laws of the boards in turn: two robots, one of each law, are in the same state.
            elif state != row.states[(draw // 2 + number) % len(row.states)]:
                continue
            if forces:
                yield from (PlannedAct(row=row, place=place, force=force) for force in forces)
            else:
                hands = row.stiffness or (None,)
                yield from (PlannedAct(row=row, place=place, stiffness=hand) for hand in hands)


@with_lines
def load_touch_suites(robot: RobotConfig, path: Path | str | None = None) -> TouchSuites:
    """Return the suites, by default those of the package.

    Raises:
        ConfigError: A value is wrong, or the file was changed after it was frozen.
    """
    path = own_or_shipped(path, _FILE)
    suites = parse(TouchSuites, read_yaml(path), str(path))
    for name, place in suites.places.items():
        for number, point in enumerate(place.points):
            for link in (point.link, point.mirrored.link):
                if link not in robot.links:
                    error = UnknownNameError("link", link, robot.links)
                    raise ConfigError(f"{path}: key 'places.{name}.points.{number}.link': {error}")
    for number, row in enumerate(suites.rows):
        for name in row.places if row.places != "all" else ():
            if name not in suites.places:
                error = UnknownNameError("place", name, tuple(suites.places))
                raise ConfigError(f"{path}: key 'rows.{number}.places': {error}")
    if suites.frozen != frozen_part_hash(path):
        raise ConfigError(
            f"{path}: changed since it was frozen; undo the change, or freeze it again with '{_CURE}': what was judged "
            "by it before is then no longer comparable"
        )
    return suites


def main() -> None:
    """Freeze the suites of the package, and read them once."""
    path = own_or_shipped(None, _FILE)
    try:
        write_frozen(path, [f"frozen: {frozen_part_hash(path)}"])
        suites = load_touch_suites(load_robot())
    except ConfigError as error:
        sys.exit(f"error: {error}")
    print(f"frozen: {len(suites.rows)} rows in {len(suites.all_states)} states ({suites.digest})")


if __name__ == "__main__":
    main()
