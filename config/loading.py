"""YAML files into frozen dataclasses: every mistake becomes one line that names file, key and remedy."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Hashable, Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

import yaml
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError, WrapValidator

from pepper_driver.config.arguments import as_path
from pepper_driver.config.errors import ConfigError, UnknownNameError, reason, suggestion
from pepper_driver.config.lines import SafeLoader, with_lines
from pepper_driver.config.mistakes import (
    as_written,
    explain,
    kind_of_value,
    refuse_hidden,
    with_known_keys,
)

STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)
"""Pydantic settings of all configuration dataclasses: no unknown key, no silent conversion, no NaN.

Validators are built when a class is first used: to build all of them at the start would take a tenth of a second.
"""

MAX_DEPTH = 100
"""Of lists and mappings in each other. libyaml crashes at some ten thousand."""

TOO_DEEP = f"nested deeper than {MAX_DEPTH} levels"

MAX_VALUES = 100_000
"""In one file, anchors repeated: a few lines of anchors in anchors can stand for more than any memory holds."""

T = TypeVar("T")

_validator: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)
"""Of a type; to make one takes longer than to use it."""


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
            if not isinstance(key, str | int | float) or isinstance(key, bool):
                raise yaml.constructor.ConstructorError(
                    None, None, "a key must be a word or a number", key_node.start_mark
                )
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key '{key}' is given twice", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


# YAML 1.1 reads on, off, yes and no as booleans, and 2026-01-31 as a date; here they are words.
_NOT_READ = {"tag:yaml.org,2002:bool", "tag:yaml.org,2002:timestamp"}
_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag not in _NOT_READ]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF")
)
# YAML 1.1 reads 1e-6 as text, because it requires a dot; users write it without.
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?[0-9][0-9_]*(\.[0-9_]*)?[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)


def package_file(*parts: str) -> Path:
    """Path of a file shipped in ``config/``."""
    return Path(str(files("pepper_driver.config").joinpath(*parts)))


def own_or_shipped(path: Path | str | None, name: str) -> Path:
    """Path of a user's file, or, if None, of the file of this name that is shipped in ``config/``."""
    return package_file(name) if path is None else as_path("path", path)


def shipped_names(folder: str) -> tuple[str, ...]:
    """Names of the files shipped in a folder of this package."""
    return tuple(sorted(path.stem for path in package_file(folder).glob("*.yaml")))


def named_file(kind: str, name: str | Path, folder: str) -> Path:
    """Return the file that a name shipped in ``folder`` stands for, or the path given, which ends in ``.yaml``.

    Raises:
        UnknownNameError: No shipped file has this name.
    """
    if str(name).endswith((".yaml", ".yml")):
        return Path(name)
    if str(name) in shipped_names(folder):
        return package_file(folder, f"{name}.yaml")
    given = str(name) if isinstance(name, Path) else name
    raise UnknownNameError(kind, given, (*shipped_names(folder), "FILE.yaml"))


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping in a YAML file.

    Raises:
        ConfigError: The file is missing, unreadable, no YAML, or not a mapping.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read ({reason(error)})") from error
    try:
        _check_depth(text)
        data = yaml.load(text, Loader=_Loader)
        count = _count(data, {})
    except yaml.reader.ReaderError as error:
        line = 1 + text.count("\n", 0, error.position)
        raise ConfigError(
            f"{path} line {line}: holds a control character, which YAML forbids"
        ) from error
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f" line {mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or "not valid YAML"
        if "nesting depth" in problem:  # of libyaml, which reads ahead
            problem = TOO_DEEP
        raise ConfigError(f"{path}{where}: {problem}") from error
    if not isinstance(data, dict):
        raise ConfigError(
            f"{path}: holds {kind_of_value(data)}, expected a mapping of keys to values"
        )
    if count > MAX_VALUES:
        raise ConfigError(
            f"{path}: its anchors stand for {count:.0e} values, and {MAX_VALUES} is the most"
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
                raise yaml.MarkedYAMLError(problem=TOO_DEEP, problem_mark=mark)
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


def parse(
    cls: type[T], data: dict[str, Any], source: str, hidden: Mapping[str, object] | None = None
) -> T:
    """Return ``data`` as an instance of the configuration dataclass ``cls``.

    Args:
        cls: A pydantic dataclass made with ``STRICT``.
        data: A mapping as read from YAML.
        source: Name of the file, for the message.
        hidden: Values of fields that files do not have.

    Raises:
        ConfigError: Unknown or missing key, wrong type, value out of range.
    """
    try:
        # Through JSON: there pydantic's strict mode accepts lists as tuples, and no other conversion.
        text = json.dumps({**data, **(hidden or {})}, default=_refuse)
    except TypeError as error:
        raise ConfigError(f"{source}: {error}") from error
    except (ValueError, RecursionError) as error:
        problem = "a list or mapping holds itself, or a number has too many digits"
        raise ConfigError(f"{source}: {problem}") from error
    try:
        refuse_hidden(cls, data)
        made: T = _validator(cls).validate_json(text, strict=True)
        return made
    except ValidationError as error:
        raise ConfigError(f"{source}: {explain(error, cls)}") from error
    except RecursionError as error:
        raise ConfigError(f"{source}: nested too deeply") from error


def by_kind(union: object) -> WrapValidator:
    """Return a validator that makes of a mapping the dataclass of ``union`` that its key ``kind`` names."""
    classes = {get_args(get_type_hints(cls)["kind"])[0]: cls for cls in get_args(union)}

    def build(value: object, _: object) -> object:
        if isinstance(value, tuple(classes.values())):
            return value
        if not isinstance(value, dict):
            raise ValueError("must be a mapping of keys to values")
        kind = value.get("kind")
        if kind is None:
            raise ValueError(f"no 'kind'{suggestion('', classes)}")
        if not isinstance(kind, str):
            raise ValueError(f"'kind' must be a text, got {as_written(kind)}")
        if kind not in classes:
            raise ValueError(f"unknown kind '{kind}'{suggestion(kind, classes)}")
        return parse_part(classes[kind], value)

    return WrapValidator(build)


def parse_part(
    cls: Any,  # noqa: ANN401 any type of pydantic
    value: object,
    hidden: Mapping[str, object] | None = None,
) -> Any:  # noqa: ANN401 an instance of it
    """Parse a part in a validator: through JSON, where strict mode takes lists for tuples."""
    refuse_hidden(cls, value)
    if hidden and isinstance(value, dict):
        value = {**value, **hidden}
    try:
        return _validator(cls).validate_json(json.dumps(value), strict=True)
    except ValidationError as error:
        raise with_known_keys(error, cls) from error


def one_or_more(cls: Any) -> WrapValidator:  # noqa: ANN401 a class, of which mypy makes no tuple[cls, ...]
    """One mapping, or a list of up to 100, becomes a tuple; errors carry a number only where there is a list."""
    several = Annotated[tuple[cls, ...], Field(min_length=1, max_length=100)]

    def build(value: object, _: object) -> object:
        if isinstance(value, tuple):
            return value
        if isinstance(value, list):
            return parse_part(several, value)
        return (parse_part(cls, value),)

    return WrapValidator(build)


@with_lines
def load(cls: type[T], path: Path) -> T:
    """Read a YAML file into the configuration dataclass ``cls``; see :func:`parse` and :func:`read_yaml`."""
    return parse(cls, read_yaml(path), str(path))


def _refuse(value: object) -> None:
    raise TypeError(f"holds {kind_of_value(value)}, which no setting takes")
