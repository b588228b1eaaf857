"""Lines of YAML files for error messages: found when there is an error, from the key that the message names."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec, TypeVar

import yaml

from pepper_driver.config.errors import ConfigError

if TYPE_CHECKING:
    from yaml import SafeLoader as SafeLoader
else:
    try:  # libyaml is seven times as fast; not every computer's PyYAML has it
        from yaml import CSafeLoader as SafeLoader
    except ImportError:
        from yaml import SafeLoader

P = ParamSpec("P")
T = TypeVar("T")

_PROBLEM = re.compile(r"(?P<file>[^\n]+?\.ya?ml): (?:unknown )?key '(?P<key>[^']+)'")


def with_lines(loader: Callable[P, T]) -> Callable[P, T]:
    """Have the errors of a loader say in which line the key stands: ``arm.yaml line 7: key 'steps.1.posture': ...``."""

    @wraps(loader)
    def load(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return loader(*args, **kwargs)
        except ConfigError as error:
            error.args = (located(str(error)),)
            raise

    return load


def located(message: str) -> str:
    """Return a message that begins with ``FILE: key 'KEY'``, with the line after the file; any other as it is."""
    found = _PROBLEM.match(message)
    if found is None:
        return message
    line = _line_of(Path(found["file"]), found["key"].split("."))
    if line is None:
        return message
    return f"{found['file']} line {line}{message[found.end('file') :]}"


def _line_of(path: Path, key: list[str]) -> int | None:
    """Return the line of a key, from 1; of a missing key, that of the mapping that should have it."""
    try:
        node = yaml.compose(path.read_text(encoding="utf-8"), Loader=SafeLoader)
    except (OSError, ValueError, RecursionError, yaml.YAMLError):
        return None  # removed meanwhile
    line = None
    for part in key:
        child = _child(node, part)
        if child is None:
            break
        line, node = child
    return line


def _child(node: yaml.Node | None, part: str) -> tuple[int, yaml.Node] | None:
    """Line and value of a key of a mapping, or of an entry of a list."""
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value == part:
                return key.start_mark.line + 1, value
    elif isinstance(node, yaml.SequenceNode) and part.isdigit() and int(part) < len(node.value):
        value = node.value[int(part)]
        return value.start_mark.line + 1, value
    return None
