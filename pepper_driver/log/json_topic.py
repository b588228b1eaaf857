"""Topics whose messages are JSON: one frozen dataclass each, with a schema that Foxglove takes."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Generic, TypeVar

import numpy as np

Property = Mapping[str, object]
"""JSON schema of one field. Foxglove refuses a message with any field of more than one type."""

T = TypeVar("T")


class JsonTopic(Generic[T]):
    """Messages of one dataclass. A value of None or not finite is left out: JSON in a browser knows no NaN.

    Attributes:
        types: ``string``, ``number``, ``integer`` or ``array`` (of text) by field.

    Args:
        topic: Name of the topic.
        kind: The dataclass; its values are text, numbers, or tuples of text.
        properties: Schema of each of its fields.
        optional: Fields that may be None; numbers that are not finite come back as None there, as NaN elsewhere.
    """

    def __init__(
        self,
        topic: str,
        kind: type[T],
        properties: Mapping[str, Property],
        *,
        optional: frozenset[str] = frozenset(),
    ) -> None:
        self.topic = topic
        self.name = kind.__name__
        self.types = {name: str(schema["type"]) for name, schema in properties.items()}
        self._kind = kind
        self._names = tuple(field.name for field in fields(kind))  # type: ignore[arg-type]
        self._properties = properties
        self._optional = optional

    @property
    def schema(self) -> str:
        """JSON schema of a message."""
        numbers = {name for name, kind in self.types.items() if kind == "number"}
        return json.dumps(
            {
                "title": f"pepper_driver.{self.name}",
                "type": "object",
                "properties": self._properties,
                "required": [n for n in self._names if n not in self._optional | numbers],
            }
        )

    def encode(self, item: T) -> bytes:
        """A message; floats keep every bit.

        Raises:
            TypeError: A value that is neither text nor number.
        """
        values = {name: _plain(getattr(item, name)) for name in self._names}
        present = {
            name: value
            for name, value in values.items()
            if value is not None and not (isinstance(value, float) and not math.isfinite(value))
        }
        return json.dumps(present, allow_nan=False).encode()

    def decode(self, message: bytes) -> T:
        """The item of a message.

        Raises:
            TypeError: A value is missing or unknown.
            ValueError: No JSON.
        """
        values: dict[str, Any] = dict.fromkeys(self._optional)
        for name, kind in self.types.items():
            if kind == "number" and name not in self._optional:
                values[name] = math.nan
        for name, value in json.loads(message).items():
            values[name] = tuple(value) if isinstance(value, list) else value
        return self._kind(**values)


def _plain(value: object) -> object:
    """NumPy scalars, which observers easily let through, as Python's; arrays have no place here."""
    if isinstance(value, np.generic):
        return value.item()
    if value is None or isinstance(value, str | int | float):
        return value
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    raise TypeError(f"{value!r} is neither text nor number")
