"""A log as tables: columns by name, one value a cell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepper_driver.log.contacts import CONTACTS
from pepper_driver.log.event import EVENTS
from pepper_driver.log.json_topic import JsonTopic
from pepper_driver.log.label import LABELS
from pepper_driver.log.reader import LogData

Column = NDArray[Any] | list[Any]
"""An array of numbers or truth values; a list of text, numbers, tuples of text, None."""

Table = Mapping[str, Column]


def tick_table(log: LogData) -> Table:
    """``time``, ``position.LShoulderRoll``, ...: each value of each tick in a column of its own."""
    return _columns(log.fields, log.elements, "")


def truth_table(log: LogData) -> Table | None:
    """The same of the ground truth; None where there is none."""
    return None if log.truth is None else _columns(log.truth, log.elements, "truth.")


def item_tables(log: LogData) -> dict[str, tuple[JsonTopic[Any], Table]]:
    """``contacts`` and ``events``, and ``labels`` where there are any, with the topics that say what is in them."""
    lists: dict[str, tuple[JsonTopic[Any], Sequence[Any]]] = {
        "contacts": (CONTACTS, log.contacts),
        "events": (EVENTS, log.events),
    }
    if log.labels:
        lists["labels"] = (LABELS, log.labels)
    return {
        name: (topic, {key: [getattr(item, key) for item in items] for key in topic.types})
        for name, (topic, items) in lists.items()
    }


def _columns(
    fields: Mapping[str, NDArray[Any]], elements: Mapping[str, tuple[str, ...]], prefix: str
) -> Table:
    table: dict[str, Column] = {}
    for name, array in fields.items():
        if array.ndim == 1:
            table[name] = array
        else:
            for place, element in enumerate(elements[prefix + name]):
                table[f"{name}.{element}"] = np.ascontiguousarray(array[:, place])
    return table
