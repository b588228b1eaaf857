"""Plants that say only how they differ from another: ``extends``, ``factors``, ``joints``, ``randomise``."""

from __future__ import annotations

import copy
import math
import operator
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterable
from dataclasses import field, fields
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.arguments import is_number
from pepper_driver.config.errors import ConfigError, UnknownNameError, suggestion
from pepper_driver.config.loading import STRICT, read_yaml
from pepper_driver.config.mistakes import as_written
from pepper_driver.config.parts import NonNegative, Positive
from pepper_driver.config.plant_parts import Actuator
from pepper_driver.config.robot import RobotConfig

Tree = dict[str, Any]


Factors = dict[str, tuple[Positive, Positive]]
Values = dict[str, tuple[float, float]]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class DayDifferences:
    """Parameters of one robot that are drawn again for each day; see :class:`Randomisation`.

    ``factors`` are on the values of the first day, which is that of the draw itself.
    """

    factors: Factors
    values: Values


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Randomisation:
    """Parameters that are drawn again for each robot.

    Attributes:
        factors: On values of the actuators by dotted key, log-uniform between two bounds, each joint its own.
        values: Other values by dotted key, uniform between two bounds.
        model_error: Smallest and largest fraction by which each link's mass differs, up or down, and its centre of
            mass, in any direction, as a fraction of its distance from the joint.
        offsets: Added to values of the actuators by dotted key, uniform between two bounds, each joint its own.
        integers: Other whole numbers by dotted key, from the first to the last with equal probability.
        days: What differs between the days of one robot; None where each draw is the same robot on another day.
    """

    factors: Factors
    values: Values
    model_error: tuple[NonNegative, Annotated[float, Field(lt=1)]]
    offsets: Values = field(default_factory=dict)
    integers: dict[str, tuple[int, int]] = field(default_factory=dict)
    days: DayDifferences | None = None


def resolve(
    path: Path, find: Callable[[str], Path], robot: RobotConfig, draw: int = 0
) -> tuple[Tree, tuple[Path, ...]]:
    """Return the complete mapping of a plant file: what it extends, changed as it says.

    Args:
        path: The file.
        find: The file of a plant by name or path; a relative path begins at the extending file.
        robot: Whose joints the file names.
        draw: Of a plant that is drawn: it chooses where the plant extends one of several.

    Returns:
        The mapping, and the files that it extends, nearest first.

    Raises:
        ConfigError: A file cannot be read, or names a joint, key or plant that does not exist.
    """
    return _resolve(path, find, robot, draw, ())


def _resolve(
    path: Path,
    find: Callable[[str], Path],
    robot: RobotConfig,
    draw: int,
    seen: tuple[Path, ...],
) -> tuple[Tree, tuple[Path, ...]]:
    data = read_yaml(path)
    if "extends" not in data:
        return data, ()
    source = str(path)
    if path.resolve() in seen:
        raise ConfigError(f"{source}: key 'extends': the plant extends itself")
    parent_path = _parent(path, data, find, draw)
    plant, further = _resolve(parent_path, find, robot, draw, (*seen, path.resolve()))
    factors = _mapping(data.pop("factors", {}), f"{source}: key 'factors'")
    joints = _mapping(data.pop("joints", {}), f"{source}: key 'joints'")
    if "actuators" in data:
        raise ConfigError(
            f"{source}: key 'actuators': a plant that extends another gives 'factors' and 'joints'"
        )
    plant["actuators"] = _one_joint_each(plant.get("actuators"), f"{parent_path}: key 'actuators'")
    for key, factor in factors.items():
        where = f"{source}: key 'factors.{key}'"
        _change(plant["actuators"], str(key), factor, robot, where, operator.mul)
    for joint, changes in joints.items():
        where = f"{source}: key 'joints.{joint}'"
        drive = _drive(plant["actuators"], joint, where)
        for key in _mapping(changes, where):
            if key not in (known := [field.name for field in fields(Actuator)]):
                raise ConfigError(
                    f"{source}: unknown key 'joints.{joint}.{key}'{suggestion(key, known)}"
                )
        _merge(drive, changes)
    _merge(plant, data)
    return plant, (parent_path, *further)


def _parent(path: Path, data: Tree, find: Callable[[str], Path], draw: int) -> Path:
    """Take the key ``extends`` out of a mapping; return the file of the plant, of several that of the draw."""
    where = f"{path}: key 'extends'"
    given = data.pop("extends")
    names = given if isinstance(given, list) else [given]
    if not names or not all(isinstance(name, str) for name in names):
        expected = "expected the name of a plant, or a list of names"
        raise ConfigError(f"{where}: {expected}, got {as_written(given)}")
    if isinstance(given, list) and not isinstance(data.get("randomise"), dict):
        raise ConfigError(
            f"{where}: of several plants each draw extends one, and nothing is drawn here (no key 'randomise')"
        )
    paths = []
    for name in names:
        try:
            found = find(name)
        except UnknownNameError as error:
            raise ConfigError(f"{where}: {error}") from error
        inside = not found.is_absolute() and not found.exists()
        paths.append(path.parent / found if inside else found)
    return paths[draw % len(paths)]


def randomise(
    data: Tree,
    drawing: Randomisation,
    robot: RobotConfig,
    source: str,
    *,
    draw: int,
    day: int = 0,
) -> None:
    """Change a complete mapping in place into the ``draw``-th robot, on a day of its own."""
    # The order of draws below must stay: another one makes other robots of the same number, with other hashes.
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([draw, 0x9E1])))
    data["actuators"] = _one_joint_each(data.get("actuators"), f"{source}: key 'actuators'")
    where = f"{source}: key 'randomise"
    _draw_factors(data, drawing.factors, robot, rng, where)
    _draw_values(data, drawing.values, rng, where)
    smallest, largest = _ordered(drawing.model_error, f"{where}.model_error'")
    body = data.setdefault("body", {})
    for link, com in _centres_of_mass(robot).items():
        fraction = rng.uniform(smallest, largest) * rng.choice([-1.0, 1.0])
        direction = rng.standard_normal(3)
        size = rng.uniform(smallest, largest) * float(np.linalg.norm(com))
        if largest > 0.0:
            masses = body.setdefault("masses", {})
            known = masses.get(link, 1.0)
            # A value that is no number is refused when the whole is checked.
            masses[link] = known * (1.0 + float(fraction)) if is_number(known) else known
            shift = size * direction / np.linalg.norm(direction)
            body.setdefault("coms", {})[link] = [float(x) for x in shift]
    for key, bounds in drawing.offsets.items():
        lower, upper = _ordered(bounds, f"{where}.offsets.{key}'")
        added = {name: float(rng.uniform(lower, upper)) for name in robot.joint_names}
        _change(data["actuators"], key, added, robot, f"{where}.offsets.{key}'", operator.add)
    for key, (first, last) in drawing.integers.items():
        holder, part = _place(data, key, f"{where}.integers.{key}'")
        _ordered((first, last), f"{where}.integers.{key}'")
        # Python's own integers: there is no largest one.
        holder[part] = first + int(rng.uniform() * (last - first + 1))
    data["name"] = f"{data.get('name')}-{draw}"
    if drawing.days is not None and day > 0:
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([draw, day, 0xDA7])))
        _draw_factors(data, drawing.days.factors, robot, rng, f"{where}.days")
        _draw_values(data, drawing.days.values, rng, f"{where}.days")
        data["name"] += f"-day-{day}"


def _draw_factors(
    data: Tree, factors: Factors, robot: RobotConfig, rng: np.random.Generator, where: str
) -> None:
    for key, bounds in factors.items():
        # Log-uniform: half and twice a value are then as likely.
        logs = np.log(_ordered(bounds, f"{where}.factors.{key}'"))
        drawn = {name: float(np.exp(rng.uniform(*logs))) for name in robot.joint_names}
        _change(data["actuators"], key, drawn, robot, f"{where}.factors.{key}'", operator.mul)


def _draw_values(data: Tree, values: Values, rng: np.random.Generator, where: str) -> None:
    for key, bounds in values.items():
        holder, last = _place(data, key, f"{where}.values.{key}'")
        lower, upper = _ordered(bounds, f"{where}.values.{key}'")
        holder[last] = lower + float(rng.uniform()) * (upper - lower)


def _ordered(bounds: tuple[float, float], where: str) -> tuple[float, float]:
    if bounds[0] > bounds[1]:
        raise ConfigError(
            f"{where}: the lower bound {bounds[0]:g} is above the upper, {bounds[1]:g}"
        )
    return bounds


def _mapping(value: object, where: str) -> Tree:
    if not isinstance(value, dict):
        raise ConfigError(f"{where}: expected a mapping of keys to values")
    return value


def _one_joint_each(actuators: object, where: str) -> list[Tree]:
    """Return a copy of each drive for every joint it stands for, so that joints can differ."""
    if not isinstance(actuators, list) or not all(
        isinstance(entry, dict) and isinstance(entry.get("joints"), list) for entry in actuators
    ):
        raise ConfigError(f"{where}: expected a list of drives, each with 'joints'")
    return [
        {**copy.deepcopy(entry), "joints": [name]}
        for entry in actuators
        for name in entry["joints"]
    ]


def _drive(actuators: list[Tree], joint: object, where: str) -> Tree:
    for entry in actuators:
        if entry["joints"] == [joint]:
            return entry
    known = [entry["joints"][0] for entry in actuators]
    raise ConfigError(f"{where}: unknown joint '{joint}'{suggestion(str(joint), known)}")


def _change(
    actuators: list[Tree],
    key: str,
    by: object,
    robot: RobotConfig,
    where: str,
    operation: Callable[[float, float], float],
) -> None:
    """Multiply one value of the drives, or add to it: by one number for all joints, or by joint."""
    by_joint = by if isinstance(by, dict) else dict.fromkeys(robot.joint_names, by)
    for joint, number in by_joint.items():
        if not (is_number(number) and math.isfinite(number)):
            raise ConfigError(
                f"{where}: expected a finite number, or numbers by joint, got {as_written(number)}"
            )
        holder, last = _place(_drive(actuators, joint, where), key, where)
        try:
            holder[last] = operation(float(holder[last]), float(number))
        # Integers in YAML may be larger than any float.
        except OverflowError as error:
            raise ConfigError(f"{where}: the number is beyond all measure") from error


def _place(tree: Tree, key: str, where: str) -> tuple[Any, Any]:
    """Return the mapping or list that holds the number of a dotted key, and its last part; lists are counted from 0."""
    *path, last = key.split(".")
    holder: Any = tree
    for part in path:
        holder = _child(holder, part)
    if isinstance(_child(holder, last), int | float):
        return holder, int(last) if isinstance(holder, list) else last
    raise ConfigError(f"{where}: no number has this key{suggestion(key, _numbers(tree))}")


def _child(holder: object, part: str) -> object:
    if isinstance(holder, dict):
        value = holder.get(part)
    elif isinstance(holder, list) and part.isdecimal() and int(part) < len(holder):
        value = holder[int(part)]
    else:
        return None
    # bool is an int in Python, and cannot be scaled.
    return None if isinstance(value, bool) else value


def _numbers(tree: object, prefix: str = "") -> list[str]:
    """Dotted keys of all numbers."""
    if isinstance(tree, int | float) and not isinstance(tree, bool):
        return [prefix.removesuffix(".")]
    items: Iterable[tuple[object, object]] = ()
    if isinstance(tree, dict):
        items = tree.items()
    elif isinstance(tree, list):
        items = enumerate(tree)
    return [key for name, value in items for key in _numbers(value, f"{prefix}{name}.")]


def _merge(into: Tree, changes: Tree) -> None:
    for key, value in changes.items():
        if isinstance(value, dict) and isinstance(into.get(key), dict):
            _merge(into[key], value)
        else:
            into[key] = value


def _centres_of_mass(robot: RobotConfig) -> dict[str, np.ndarray]:
    """(3,) centre of mass in the link's frame [m], of every link that weighs more than a gram."""
    centres = {}
    for link in ElementTree.parse(robot.urdf).getroot().iter("link"):
        mass, origin = link.find("inertial/mass"), link.find("inertial/origin")
        if mass is None or float(mass.attrib["value"]) < 1e-3:
            continue
        xyz = "0 0 0" if origin is None else origin.get("xyz", "0 0 0")
        centres[link.attrib["name"]] = np.array([float(x) for x in xyz.split()])
    return centres
