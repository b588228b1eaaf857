"""Logs in other formats: every bit is there, files are whole or not there, nothing is lost by accident."""

from __future__ import annotations

import csv
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver.config import MissingExtraError, UnknownNameError
from pepper_driver.config.files import OutputError
from pepper_driver.log import Label, LogEvent, LogWriter, RunLog, export, read_log
from pepper_driver.log.export import export_log
from pepper_driver.loop import TickRecord
from support.log_samples import ROBOT, Samples, same_bits

RUN = {"backend": "mujoco", "ümläut": "ß\n2"}
TICKS = 20
EVENTS = [
    LogEvent(time=0.1, kind="reflex", name="Hold", phase="begin", joints=("HeadYaw", "HeadPitch")),
    LogEvent(time=0.2, kind="fault", text='old, "stale"\nsample'),
]


@pytest.fixture
def log(tmp_path: Path) -> RunLog:
    samples = Samples(3)
    path = tmp_path / "run.mcap"
    with LogWriter(path, ROBOT, RUN, lossless=True) as writer:
        for number in range(TICKS):
            contacts = [samples.contact(number)] if number % 4 == 0 else []
            observation = samples.observation(*contacts)
            writer.append(
                TickRecord(
                    tick=samples.tick(number), observation=observation, truth=samples.truth()
                )
            )
        writer.append(
            TickRecord(
                tick=samples.tick(TICKS), labels=[Label(time=1.0, phase="onset", source="key")]
            )
        )
        for event in EVENTS:
            writer.note(event)
    return read_log(path)


def columns(fields: dict[str, Any], elements: dict[str, tuple[str, ...]], prefix: str) -> Any:
    """Name and array of each column that there should be."""
    for name, array in fields.items():
        if array.ndim == 1:
            yield name, array
        else:
            for place, element in enumerate(elements[prefix + name]):
                yield f"{name}.{element}", array[:, place]


def expected(log: RunLog) -> tuple[dict[str, Any], dict[str, Any]]:
    assert log.truth is not None
    ticks = dict(columns(log.fields, log.elements, ""))
    return ticks, dict(columns(log.truth, log.elements, "truth."))


def test_columns_are_named_by_what_they_are(log: RunLog) -> None:
    ticks, truth = expected(log)
    assert {
        "position.LShoulderRoll",
        "wheel_speed.WheelB",
        "reference_base_twist.wz",
        "imu_attitude.pitch",
        "state.RHand",
        "tick_end",
    } <= set(ticks)
    assert {"time", "contact_torque.HeadYaw", "base.yaw", "tilt.roll"} <= set(truth)
    assert len(ticks) == 10 + 17 * 17 + 2 * 3 + 3 + 3 * 3 + 5 + 3 + 1


def test_parquet_comes_back_bit_for_bit(log: RunLog, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    out = tmp_path / "new" / "run.parquet"
    written = export_log(log, out, "parquet")
    names = ("", ".truth", ".contacts", ".events", ".labels", ".forces")
    assert written == tuple(out.with_name(f"run{name}.parquet") for name in names)
    assert sorted(out.parent.iterdir()) == sorted(written)
    for path, columns in zip(written, expected(log), strict=False):
        table = parquet.read_table(path)
        assert table.column_names == list(columns)
        for name, column in columns.items():
            assert same_bits(table[name].to_numpy(), column), name
    for path in written:
        metadata = parquet.read_schema(path).metadata
        assert {key.decode(): text.decode() for key, text in metadata.items()} == RUN
    contacts = parquet.read_table(written[2])
    assert contacts["joint"].to_pylist() == [c.joint for c in log.contacts]
    assert contacts["torque"].to_pylist() == [c.torque for c in log.contacts]
    forces = [None if c.force is None else list(c.force) for c in log.contacts]
    assert contacts["force"].to_pylist() == forces
    assert any(forces)
    assert contacts["scale_known"].to_pylist() == [c.scale_known for c in log.contacts]
    forces = parquet.read_table(written[5]).to_pylist()
    assert log.forces
    assert forces == [asdict(force) for force in log.forces]
    events = parquet.read_table(written[3]).to_pylist()
    assert [e["joints"] for e in events] == [list(e.joints) for e in EVENTS]
    assert [e["text"] for e in events] == [e.text for e in EVENTS]
    assert [e["contact_id"] for e in events] == [None, None]


def test_csv_keeps_every_digit(log: RunLog, tmp_path: Path) -> None:
    written = export_log(log, tmp_path / "run.csv", "csv")
    assert [path.name for path in written] == [
        "run.csv",
        "run.truth.csv",
        "run.contacts.csv",
        "run.events.csv",
        "run.labels.csv",
        "run.forces.csv",
        "run.metadata.json",
    ]
    for path, columns in zip(written, expected(log), strict=False):
        with path.open(newline="", encoding="utf-8") as stream:
            header, *rows = csv.reader(stream)
        assert header == list(columns)
        for name, cells in zip(header, zip(*rows, strict=True), strict=True):
            kind = columns[name].dtype
            read = np.array([float(cell) for cell in cells]).astype(kind)
            if kind == np.float64:  # text knows but one NaN
                read = np.where(np.isnan(columns[name]), columns[name], read)
            assert same_bits(read, columns[name]), name
    with written[2].open(newline="", encoding="utf-8") as stream:
        contacts = list(csv.DictReader(stream))
    for row, contact in zip(contacts, log.contacts, strict=True):
        assert tuple(map(float, row["force"].split())) == (contact.force or ())
        known = "" if contact.scale_known is None else str(int(contact.scale_known))
        assert row["scale_known"] == known
    with written[3].open(newline="", encoding="utf-8") as stream:
        events = list(csv.DictReader(stream))
    assert [event["joints"] for event in events] == ["HeadYaw HeadPitch", ""]
    assert [event["text"] for event in events] == [event.text for event in EVENTS]
    assert json.loads(written[-1].read_text(encoding="utf-8")) == RUN


def test_npz_holds_everything_and_no_objects(log: RunLog, tmp_path: Path) -> None:
    assert export_log(log, tmp_path / "run.npz", "npz") == (tmp_path / "run.npz",)
    with np.load(tmp_path / "run.npz", allow_pickle=False) as archive:
        read = dict(archive)
    for name, array in log.fields.items():
        assert same_bits(read[name], array), name
    assert log.truth is not None
    for name, array in log.truth.items():
        assert same_bits(read[f"truth.{name}"], array), name
    assert tuple(read["names.position"]) == ROBOT.joint_names
    assert read["contacts.joint"].tolist() == [c.joint or "" for c in log.contacts]
    assert np.isnan(read["contacts.torque"]).tolist() == [c.torque is None for c in log.contacts]
    for row, scale, contact in zip(
        read["contacts.force"], read["contacts.scale_known"], log.contacts, strict=True
    ):
        assert np.isnan(row).all() if contact.force is None else tuple(row) == contact.force
        assert np.isnan(scale) if contact.scale_known is None else scale == contact.scale_known
    assert read["events.text"].tolist() == [event.text for event in EVENTS]
    assert json.loads(str(read["metadata"])) == RUN


@pytest.mark.parametrize("to", ["parquet", "csv", "npz"])
def test_an_empty_log_has_columns_but_no_rows(tmp_path: Path, to: str) -> None:
    if to == "parquet":
        pytest.importorskip("pyarrow")
    with LogWriter(tmp_path / "empty.mcap", ROBOT, {}):
        pass
    written = export_log(read_log(tmp_path / "empty.mcap"), tmp_path / f"empty.{to}", to)
    assert written[0].exists()
    if to == "csv":
        (header,) = written[0].read_text().splitlines()
        assert header.startswith("time,battery,age,")
        assert "time,kind,name" in written[2].read_text()


def test_nothing_is_replaced_without_force(log: RunLog, tmp_path: Path) -> None:
    (tmp_path / "run.events.csv").write_text("mine")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(OutputError, match=r"run\.events\.csv: is there already; --force"):
        export_log(log, tmp_path / "run.csv", "csv")
    assert sorted(tmp_path.iterdir()) == before
    assert (tmp_path / "run.events.csv").read_text() == "mine"
    export_log(log, tmp_path / "run.csv", "csv", force=True)
    assert (tmp_path / "run.events.csv").read_text() != "mine"


def test_a_failure_leaves_nothing_half_done(
    log: RunLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full at the third of six files."""
    write, files = export._write_csv, 0

    def fail_at_third(part: Path, *rest: Any) -> None:
        nonlocal files
        files += 1
        write(part, *rest)
        if files == 3:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(export, "_write_csv", fail_at_third)
    (tmp_path / "run.csv").write_text("old")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(OutputError) as caught:
        export_log(log, tmp_path / "run.csv", "csv", force=True)
    where = tmp_path / "run.contacts.csv"
    assert str(caught.value) == f"{where}: cannot be written (the disk is full)"
    assert sorted(tmp_path.iterdir()) == before
    assert (tmp_path / "run.csv").read_text() == "old"


def test_wrong_names_are_refused(log: RunLog, tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"unknown format 'parket' \(did you mean parquet"):
        export_log(log, tmp_path / "run.parket", "parket")
    with pytest.raises(OutputError, match=r"run\.csv: a file of format npz must end in \.npz"):
        export_log(log, tmp_path / "run.csv", "npz")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be made"):
        export_log(log, tmp_path / "file" / "run.npz", "npz")


def test_pyarrow_is_optional(log: RunLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingExtraError, match=r"pepper-driver\[export\]"):
        export_log(log, tmp_path / "run.parquet", "parquet")
    assert not (tmp_path / "run.parquet").exists()
    export_log(log, tmp_path / "run.csv", "csv")
