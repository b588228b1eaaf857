"""YAML files into frozen dataclasses: every mistake becomes one line that names file, key and cure."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Hashable
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args, get_type_hints

import yaml
from pydantic import ConfigDict, TypeAdapter, ValidationError, WrapValidator

from pepper_driver.config.errors import ConfigError, UnknownNameError, suggestion
from pepper_driver.config.lines import with_lines

if TYPE_CHECKING:
    from yaml import SafeLoader
else:
    try:  # libyaml is seven times as fast; not every computer's PyYAML has it
        from yaml import CSafeLoader as SafeLoader
    except ImportError:
        from yaml import SafeLoader

STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
"""Pydantic settings of all configuration dataclasses: no unknown key, no silent conversion, no NaN."""

MAX_DEPTH = 100
"""Of lists and mappings in each other. libyaml crashes at some ten thousand."""

MOST_VALUES = 100_000
"""In one file, anchors repeated: a few lines of anchors in anchors can stand for more than any memory holds."""

T = TypeVar("T")


class _Loader(SafeLoader):
    """SafeLoader that refuses a key given twice, which YAML would silently overwrite."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[Hashable] = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise yaml.constructor.ConstructorError(
                    None, None, "a key must be a word or a number", key_node.start_mark
                )
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key '{key}' is given twice", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


# YAML 1.1 reads on, off, yes and no as booleans; here they are words.
_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag != "tag:yaml.org,2002:bool"]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF")
)
# It reads 1e-6 as text, because it wants a dot; people write it all the time.
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?[0-9][0-9_]*(\.[0-9_]*)?[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)


def package_file(*parts: str) -> Path:
    """Path of a file shipped in ``config/``."""
    return Path(str(files("pepper_driver.config").joinpath(*parts)))


def shipped_names(folder: str) -> tuple[str, ...]:
    """Names of the files shipped in a folder of this package."""
    return tuple(sorted(path.stem for path in package_file(folder).glob("*.yaml")))


def named_file(kind: str, name: str | Path, folder: str) -> Path:
    """The file that a name shipped in ``folder`` stands for, or the path given, which ends in ``.yaml``.

    Raises:
        UnknownNameError: No shipped file has this name.
    """
    if str(name).endswith((".yaml", ".yml")):
        return Path(name)
    if str(name) in shipped_names(folder):
        return package_file(folder, f"{name}.yaml")
    raise UnknownNameError(kind, str(name), shipped_names(folder))


def read_yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file.

    Raises:
        ConfigError: The file is missing, unreadable, no YAML, or not a mapping.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from error
    try:
        _check_depth(text)
        data = yaml.load(text, Loader=_Loader)
        count = _count(data, {})
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f" line {mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or "not valid YAML"
        raise ConfigError(f"{path}{where}: {problem}") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: holds {_kind(data)}, expected a mapping of keys to values")
    if count > MOST_VALUES:
        raise ConfigError(
            f"{path}: its anchors stand for {count:.0e} values, and {MOST_VALUES} is the most"
        )
    return data


def _check_depth(text: str) -> None:
    """Refuse what is nested too deep; events come without recursion."""
    depth = 0
    for event in yaml.parse(text, Loader=SafeLoader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > MAX_DEPTH:
                mark: Any = event.start_mark
                problem = f"nested deeper than {MAX_DEPTH} levels"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1


def _count(value: object, known: dict[int, int]) -> int:
    """Values in a document as it is written out; ``known`` are those of its mappings and lists."""
    if not isinstance(value, dict | list):
        return 1
    if id(value) not in known:
        known[id(value)] = 0  # of one that holds itself; JSON refuses that later
        inner = value.values() if isinstance(value, dict) else value
        known[id(value)] = 1 + sum(_count(part, known) for part in inner)
    return known[id(value)]


def parse(cls: type[T], data: dict[str, Any], source: str) -> T:
    """``data`` as an instance of the configuration dataclass ``cls``.

    Args:
        cls: A pydantic dataclass made with ``STRICT``.
        data: A mapping as read from YAML.
        source: Name of the file, for the message.

    Raises:
        ConfigError: Unknown or missing key, wrong type, value out of range.
    """
    try:
        # Through JSON: there pydantic's strict mode takes lists for tuples, and nothing else for anything else.
        text = json.dumps(data, default=_refuse)
    except (TypeError, ValueError, RecursionError) as error:
        raise ConfigError(f"{source}: {error}") from error
    try:
        return TypeAdapter(cls).validate_json(text, strict=True)
    except ValidationError as error:
        raise ConfigError(f"{source}: {_explain(error, cls, data)}") from error
    except RecursionError as error:
        raise ConfigError(f"{source}: nested too deeply") from error


def by_kind(union: object) -> WrapValidator:
    """A mapping becomes the one dataclass of ``union`` that its key ``kind`` names; errors are those of that class."""
    classes = {get_args(get_type_hints(cls)["kind"])[0]: cls for cls in get_args(union)}

    def build(value: object, _: object) -> object:
        if isinstance(value, tuple(classes.values())):
            return value
        kind = value.get("kind") if isinstance(value, dict) else None
        if not isinstance(kind, str) or kind not in classes:
            problem = "no 'kind'" if kind is None else f"unknown kind '{kind}'"
            raise ValueError(f"{problem}{suggestion(str(kind), classes)}")
        # Through JSON, as in :func:`parse`: there strict mode takes lists for tuples.
        return TypeAdapter(classes[kind]).validate_json(json.dumps(value), strict=True)

    return WrapValidator(build)


@with_lines
def load(cls: type[T], path: Path) -> T:
    """Read a YAML file into the configuration dataclass ``cls``; see :func:`parse` and :func:`read_yaml`."""
    return parse(cls, read_yaml(path), str(path))


def _refuse(value: object) -> None:
    raise TypeError(f"{value!r} is {_kind(value)}, which no setting takes")


def _explain(error: ValidationError, cls: type[Any], data: dict[str, Any]) -> str:
    """The first problem in one line, and how many more there are."""
    problems = error.errors()
    # An unknown key explains a missing one more often than the other way round.
    problems.sort(key=lambda p: p["type"] != "unexpected_keyword_argument")
    first = problems[0]
    location = [part for part in first["loc"] if not str(part).startswith("function-")]
    key = ".".join(str(part) for part in location) or "top level"
    if first["type"] == "unexpected_keyword_argument":
        name, beside = str(location[-1]), first["loc"][:-1]
        missing = [
            str(p["loc"][-1])
            for p in problems
            if p["type"] == "missing" and p["loc"][:-1] == beside
        ]
        # What another kind of the same thing calls a key is no help here.
        known = missing or sorted(_field_names(cls) - {name})
        message = f"unknown key '{key}'{suggestion(name, known)}"
    elif first["type"] == "missing":
        message = f"key '{key}' is missing"
    else:
        message = f"key '{key}': {first['msg'].removeprefix('Value error, ')}"
        value = first.get("input")
        if isinstance(value, str | int | float | bool) or value is None:
            message += f", got {_shown(value)}"
    if len(problems) > 1:
        message += f" (and {len(problems) - 1} more)"
    return " ".join(message.split())  # a key may hold anything, a line break too


def _field_names(cls: type[Any]) -> set[str]:
    """Names of the fields of a dataclass and of the dataclasses in it."""
    schema = TypeAdapter(cls).json_schema()
    names = set(schema.get("properties", {}))
    for part in schema.get("$defs", {}).values():
        names |= set(part.get("properties", {}))
    return names


def _shown(value: object) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return json.dumps(value)


def _kind(value: object) -> str:
    names = {dict: "a mapping", list: "a list", str: "text", type(None): "nothing"}
    return names.get(type(value), f"a {type(value).__name__}")
