"""A log in the formats that other tools take: Parquet, CSV, NumPy's NPZ."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config import MissingExtraError, UnknownNameError
from pepper_driver.config.arguments import as_path, checked_arguments
from pepper_driver.config.files import OutputError, make_folder, replacing
from pepper_driver.log.reader import (
    RunLog,
    Table,
    TableColumn,
    item_tables,
    tick_table,
    truth_table,
)
from pepper_driver.log.topics import JsonTopic

Format = Literal["parquet", "csv", "npz"]
FORMATS: tuple[Format, ...] = get_args(Format)

Write = Callable[[Path], None]


@checked_arguments
def export_log(log: RunLog, path: Path | str, to: str, *, force: bool = False) -> tuple[Path, ...]:
    """Write a log in another format: all its files, or none.

    Ticks go to ``path``; ground truth, its forces, contacts, events and labels to files next to it, as
    ``run.contacts.csv`` for ``run.csv``. An NPZ file holds everything. Metadata is kept in the schema of Parquet files,
    next to CSV files in ``run.metadata.json``, in NPZ files as text.

    Args:
        log: What was recorded.
        path: File for the ticks; must end in ``.parquet``, ``.csv`` or ``.npz``, as ``to`` says. Its folder is made.
        to: ``parquet``, ``csv`` or ``npz``.
        force: Replace files that are there.

    Returns:
        The files written.

    Raises:
        UnknownNameError: No such format.
        MissingExtraError: pyarrow is not installed.
        OutputError: A file cannot be written, or is there already.
    """
    path = as_path("path", path)
    files = _files(log, path, to)
    for file in files:
        if file.exists() and not force:
            raise OutputError(f"{file}: is there already; --force replaces it, --out names another")
    make_folder(path.parent)
    with ExitStack() as stack:  # all are put in place at the end, or none
        for file, write in files.items():
            write(stack.enter_context(replacing(file)))
    return tuple(files)


def _files(log: RunLog, path: Path, to: str) -> dict[Path, Write]:
    """Return the files of an export, and what writes each."""
    if to not in FORMATS:
        raise UnknownNameError("format", to, FORMATS)
    if path.suffix.lower() != f".{to}":
        raise OutputError(f"{path}: a file of format {to} must end in .{to}")
    if to == "npz":
        return {path: lambda part: _write_npz(log, part)}
    tables: dict[str, tuple[JsonTopic[Any] | None, Table]] = {"": (None, tick_table(log))}
    if (truth := truth_table(log)) is not None:
        tables["truth"] = (None, truth)
    tables |= item_tables(log)
    write = _parquet_writer(log.metadata) if to == "parquet" else _write_csv
    files = {
        _sibling(path, name): _bound(write, topic, table) for name, (topic, table) in tables.items()
    }
    if to == "csv":
        files[_sibling(path, "metadata").with_suffix(".json")] = lambda part: _write_metadata(
            log, part
        )
    return files


def _bound(
    write: Callable[[Path, JsonTopic[Any] | None, Table], None],
    topic: JsonTopic[Any] | None,
    table: Table,
) -> Write:
    # A function of its own: a lambda in the comprehension would see the last table only.
    return lambda part: write(part, topic, table)


def _sibling(path: Path, name: str) -> Path:
    return path.with_name(f"{path.stem}.{name}{path.suffix}") if name else path


def _parquet_writer(
    metadata: Mapping[str, str],
) -> Callable[[Path, JsonTopic[Any] | None, Table], None]:
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise MissingExtraError("export to Parquet", "export") from error
    kinds = {
        "string": pa.string(),
        "number": pa.float64(),
        "integer": pa.int64(),
        "boolean": pa.bool_(),
        "array": pa.list_(pa.string()),
        "numbers": pa.list_(pa.float64()),
    }

    def write(part: Path, topic: JsonTopic[Any] | None, table: Table) -> None:
        schema = None
        if topic is not None:  # an empty column, or one of None, does not say what it is for
            schema = pa.schema([(name, kinds[kind]) for name, kind in topic.types.items()])
        arrow = pa.table(dict(table), schema=schema).replace_schema_metadata(dict(metadata))
        parquet.write_table(arrow, part, compression="zstd")

    return write


def _write_csv(part: Path, topic: JsonTopic[Any] | None, table: Table) -> None:
    """Floats with all their digits, truth values as 0 and 1, None as nothing, joints and vectors with blanks."""
    with part.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(table)
        writer.writerows(zip(*(_cells(column) for column in table.values()), strict=True))


def _cells(column: TableColumn) -> list[Any]:
    if isinstance(column, np.ndarray):
        listed: list[Any] = (
            column.astype(np.int8) if column.dtype == np.bool_ else column
        ).tolist()
        return listed
    return [_cell(value) for value in column]


def _cell(value: object) -> object:
    if isinstance(value, tuple):
        return " ".join(map(str, value))
    return int(value) if isinstance(value, bool) else value


def _write_metadata(log: RunLog, part: Path) -> None:
    part.write_text(json.dumps(log.metadata, indent=2) + "\n", encoding="utf-8")


def _write_npz(log: RunLog, part: Path) -> None:
    """Arrays as they are in ``RunLog``; text as text, never as objects, which would have to be unpickled."""
    arrays: dict[str, Any] = dict(log.fields)
    if log.truth is not None:
        arrays |= {f"truth.{name}": array for name, array in log.truth.items()}
    for name, elements in log.elements.items():
        arrays[f"names.{name}"] = np.array(elements, dtype=np.str_)
    for name, (topic, table) in item_tables(log).items():
        for key, kind in topic.types.items():
            arrays[f"{name}.{key}"] = _array(table[key], kind)
    arrays["metadata"] = np.array(json.dumps(log.metadata))
    with part.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


def _array(column: TableColumn, kind: str) -> NDArray[Any]:
    """Text, or numbers and truth values as float64; None is no text or NaN. Vectors are rows."""
    if kind == "numbers":
        width = max((len(cell) for cell in column if cell is not None), default=0)
        rows = [(np.nan,) * width if cell is None else cell for cell in column]
        return np.array(rows, dtype=np.float64).reshape(len(rows), width)
    if kind in ("number", "integer", "boolean"):
        return np.array([np.nan if cell is None else cell for cell in column], dtype=np.float64)
    return np.array(["" if cell is None else cell for cell in _cells(column)], dtype=np.str_)
