"""The writer: bytes in the file, ring, disk errors, open errors."""

from __future__ import annotations

import errno
import json
import logging
import os
import struct
import threading
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from mcap.reader import make_reader

from pepper_driver.backends.log_records import with_checksum
from pepper_driver.config import PepperError
from pepper_driver.config.errors import printable
from pepper_driver.log import LogError, LogWriter, read_log, writer
from pepper_driver.log.schema import unobserved
from pepper_driver.loop import TickRecord
from pepper_driver.observer.interface import Contact, JointState
from support.full_disk import limit_disk
from support.log_samples import ROBOT, N, Samples, flatten, same_bits
from support.waiting import PATIENCE

RUN = {"backend": "mujoco://?seed=3", "seed": "3", "ümläut": "ß\n2"}
ROS_TYPES = {"float64": (8, "d"), "int64": (8, "q"), "bool": (1, "?"), "int8": (1, "b")}


def decode_cdr(definition: str, data: bytes) -> dict[str, tuple[str, tuple[float, ...]]]:
    """A CDR message by the rules: 4 bytes of header, each value aligned to its size after them."""
    assert data[:4] == b"\x00\x01\x00\x00"
    values, position = {}, 0
    for line in definition.splitlines():
        kind, name = line.split("#")[0].split()
        base, _, count = kind.rstrip("]").partition("[")
        size, code = ROS_TYPES[base]
        position += -position % size
        n = int(count or 1)
        values[name] = base, struct.unpack_from(f"<{n}{code}", data, 4 + position)
        position += n * size
    assert len(data) == 4 + position
    return values


def decoded_as(decoded: tuple[str, tuple[float, ...]], given: object) -> bool:
    """Return True if the values decoded are those given, in type and bits."""
    kind, values = decoded
    array = np.atleast_1d(np.asarray(given))
    return array.dtype.name == kind and same_bits(np.array(values, dtype=array.dtype), array)


def test_messages_decode_by_their_own_definition(tmp_path: Path) -> None:
    samples = Samples(1)
    acting = samples.true_contact()
    truth = replace(samples.truth(), contacts=(acting,))
    tick, contact = samples.tick(1000), samples.contact(4)
    observation = samples.observation(contact)
    with LogWriter(tmp_path / "a.mcap", ROBOT, RUN) as log:
        log.append(TickRecord(tick=tick, observation=observation, truth=truth))
    with (tmp_path / "a.mcap").open("rb") as stream:
        messages = {c.topic: (s, c, m) for s, c, m in make_reader(stream).iter_messages()}
    # Its random angles are no numbers of a transform: those are in test_ros_messages.py.
    assert set(messages) - {"/tf", "/joint_states"} == {
        "/tick",
        "/truth",
        "/contact",
        "/force",
        "/robot_description",
        "/tf_static",
    }

    schema, channel, message = messages["/tick"]
    assert schema is not None
    assert (schema.name, schema.encoding, channel.message_encoding) == (
        "pepper_driver/msg/Tick",
        "ros2msg",
        "cdr",
    )
    assert message.log_time == message.publish_time == 12_000_000_000
    decoded = decode_cdr(schema.data.decode(), message.data)
    expected = flatten(tick, observation)
    assert set(decoded) == set(expected)
    for name, value in expected.items():
        assert decoded_as(decoded[name], value), name

    schema, channel, message = messages["/truth"]
    assert schema is not None
    assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
    decoded = decode_cdr(schema.data.decode(), message.data)
    assert decoded.pop("time") == ("float64", (12.0,))
    assert set(decoded) == {field.name for field in fields(truth)} - {"contacts"}
    for name in decoded:
        assert decoded_as(decoded[name], getattr(truth, name)), name

    schema, channel, message = messages["/contact"]
    assert schema is not None
    assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
    values: dict[str, Any] = json.loads(message.data)
    for name, value in values.items():
        values[name] = tuple(value) if isinstance(value, list) else value
    assert Contact(**values) == contact
    assert set(json.loads(schema.data)["properties"]) == set(Contact.__slots__)

    schema, channel, message = messages["/force"]
    assert schema is not None
    assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
    force = json.loads(message.data)
    assert (force["time"], force["kind"], force["link"]) == (12.0, acting.kind, acting.link)
    assert force.get("object") == acting.object
    assert [force[axis] for axis in "xyz"] == acting.point.tolist()
    assert [force[f"force_{axis}"] for axis in "xyz"] == acting.force.tolist()
    assert force["peak"] == acting.peak


def test_metadata_record_holds_what_the_caller_gave(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "a.mcap", ROBOT, RUN):
        pass
    with (tmp_path / "a.mcap").open("rb") as stream:
        records = {m.name: m.metadata for m in make_reader(stream).iter_metadata()}
    assert records["run"] == with_checksum(RUN)
    assert json.loads(records["layout"]["joint_names"]) == list(ROBOT.joint_names)


def test_no_observation_is_blind(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "a.mcap", ROBOT, {}) as log:
        log.append(TickRecord(tick=Samples().tick(0)))
    read = read_log(tmp_path / "a.mcap")
    assert (read["state"] == JointState.BLIND).all()
    for name in ("expected", "residual", "threshold", "torque", "torque_std"):
        assert np.isnan(read[name]).all()
    assert unobserved(ROBOT).contacts == ()


@pytest.mark.parametrize("time", [-1.0, np.nan, np.inf, 1e30])
def test_time_that_is_no_stamp_is_kept_in_the_row(tmp_path: Path, time: float) -> None:
    samples = Samples()
    tick = samples.tick(0)
    object.__setattr__(tick.measurement, "time", time)
    with LogWriter(tmp_path / "a.mcap", ROBOT, {}) as log:
        log.append(TickRecord(tick=tick))
        log.append(TickRecord(tick=samples.tick(1)))
    assert same_bits(read_log(tmp_path / "a.mcap")["time"], np.array([time, 0.012]))


class Gate:
    """A file that lets nothing through until opened."""

    def __init__(self, path: Path) -> None:
        self._stream = path.open("wb")
        self.opened = threading.Event()
        self.reached = threading.Event()
        self.closed_to_rows = False

    def write(self, data: bytes) -> int:
        if self.closed_to_rows:
            self.reached.set()
            self.opened.wait()
        return self._stream.write(data)

    def flush(self) -> None:
        self.write(b"")
        self._stream.flush()

    def tell(self) -> int:
        return self._stream.tell()

    def close(self) -> None:
        self._stream.close()


@pytest.fixture
def gate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Gate:
    gate = Gate(tmp_path / "gated.mcap")
    monkeypatch.setattr(writer, "open_file", lambda path: gate)
    return gate


def test_full_ring_drops_and_counts(
    gate: Gate, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    samples = Samples(3)
    log = LogWriter(tmp_path / "gated.mcap", ROBOT, {}, capacity=5)
    gate.closed_to_rows = True
    log.append(TickRecord(tick=samples.tick(0)))
    gate.reached.wait()  # the writer hangs with row 0, which still takes up its place
    for number in range(1, 12):
        log.append(TickRecord(tick=samples.tick(number)))
    assert log.dropped == 7
    gate.opened.set()
    with caplog.at_level(logging.WARNING, "pepper_driver"):
        log.close()
    assert "7 rows are missing" in caplog.text
    read = read_log(tmp_path / "gated.mcap")
    assert read.complete
    assert read["tick"].tolist() == [0, 1, 2, 3, 4]


def test_lossless_waits_for_room(
    gate: Gate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    samples = Samples(4)
    log = LogWriter(tmp_path / "gated.mcap", ROBOT, {}, capacity=3, lossless=True)
    gate.closed_to_rows = True
    log.append(TickRecord(tick=samples.tick(0)))
    gate.reached.wait()
    wait, waits, appended = log._room.wait, threading.Semaphore(0), list[int]()

    def wait_for_room(timeout: float) -> bool:
        waits.release()
        return wait(timeout)

    monkeypatch.setattr(log._room, "wait", wait_for_room)

    def produce() -> None:
        for number in range(1, 200):
            log.append(TickRecord(tick=samples.tick(number)))
            appended.append(number)

    thread = threading.Thread(target=produce)
    thread.start()
    for _ in range(3):
        assert waits.acquire(timeout=PATIENCE)
        assert appended == [1, 2], "two of three places were free"
    gate.opened.set()
    thread.join()
    log.close()
    assert log.dropped == 0
    assert read_log(tmp_path / "gated.mcap")["tick"].tolist() == list(range(200))


@pytest.mark.parametrize("lossless", [False, True])
def test_disk_error_surfaces_at_close_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lossless: bool
) -> None:
    limit_disk(monkeypatch, 300_000)
    samples = Samples(5)
    path = tmp_path / "a.mcap"
    # Without waiting, the ring takes all rows, so that enough of them reach the disk on any machine.
    log = LogWriter(path, ROBOT, RUN, capacity=16 if lossless else 1024, lossless=lossless)
    for number in range(600):
        log.append(TickRecord(tick=samples.tick(number)))
    with pytest.raises(LogError, match="the disk is full") as caught:
        log.close()
    assert isinstance(caught.value, PepperError)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    assert not [t for t in threading.enumerate() if t.name == "pepper_driver.log"]
    log.append(TickRecord(tick=samples.tick(600)))
    log.close()  # raised once
    read = read_log(path)
    assert not read.complete
    assert len(read) > 0
    if lossless:
        assert read["tick"].tolist() == list(range(len(read)))
    # Exact but for the chunk that could not be written.
    missing = 601 - len(read)
    assert missing - 64 <= log.dropped <= missing


def test_disk_error_while_finishing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with LogWriter(tmp_path / "whole.mcap", ROBOT, RUN):
        pass
    limit_disk(monkeypatch, (tmp_path / "whole.mcap").stat().st_size - 10, errno.EIO)
    log = LogWriter(tmp_path / "a.mcap", ROBOT, RUN)
    with pytest.raises(LogError, match="Input/output error"):
        log.close()
    assert not read_log(tmp_path / "a.mcap").complete


def test_error_of_the_block_is_not_hidden_by_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit_disk(monkeypatch, 50_000)

    samples = Samples(10)

    def fill(then: type[Exception] | None) -> None:
        with LogWriter(tmp_path / "a.mcap", ROBOT, RUN, lossless=True) as log:
            for number in range(100):
                log.append(TickRecord(tick=samples.tick(number)))
            if then is not None:
                raise then

    with pytest.raises(LogError):
        fill(None)
    with pytest.raises(ZeroDivisionError):
        fill(ZeroDivisionError)


def test_wrong_row_is_dropped_and_explained(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    samples = Samples(6)
    bad = samples.tick(1)
    object.__setattr__(bad.measurement, "position", np.zeros(N - 1))
    with LogWriter(tmp_path / "a.mcap", ROBOT, {}) as log:
        log.append(TickRecord(tick=samples.tick(0)))
        log.append(TickRecord(tick=bad))
        log.append(TickRecord(tick=cast("object", None)))  # type: ignore[arg-type]
        log.append(TickRecord(tick=samples.tick(2)))
    assert log.dropped == 2
    assert "2 rows are missing (" in caplog.text
    assert read_log(tmp_path / "a.mcap")["tick"].tolist() == [0, 2]


def test_contact_that_is_no_json_is_dropped(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    samples = Samples(7)
    bad, numpy_like, good = (samples.contact(i) for i in (2, 4, 6))
    object.__setattr__(bad, "torque", np.zeros(3))
    object.__setattr__(numpy_like, "direction", np.int8(1))
    object.__setattr__(numpy_like, "intensity_deg", np.float64(2.5))
    with LogWriter(tmp_path / "a.mcap", ROBOT, {}) as log:
        log.append(
            TickRecord(tick=samples.tick(0), observation=samples.observation(bad, numpy_like, good))
        )
    assert log.dropped == 1
    assert "is neither text nor number" in caplog.text
    assert read_log(tmp_path / "a.mcap").contacts == [numpy_like, good]


def test_close_again_and_append_after_close(tmp_path: Path) -> None:
    log = LogWriter(tmp_path / "a.mcap", ROBOT, {}, lossless=True)
    log.close()
    size = log.path.stat().st_size
    log.close()
    log.append(TickRecord(tick=Samples().tick(0)))
    assert log.dropped == 1
    assert log.path.stat().st_size == size


def test_folders_are_made_and_a_file_replaced(tmp_path: Path) -> None:
    path = tmp_path / "runs" / "today" / "a.mcap"
    for run in ("one", "two"):
        with LogWriter(path, ROBOT, {"run": run}):
            pass
    assert read_log(path).metadata == {"run": "two"}


def one_line(error: LogError, path: Path) -> bool:
    return "\n" not in str(error) and printable(str(path)) in str(error)


def test_open_refuses_what_is_no_file(tmp_path: Path) -> None:
    threads = threading.active_count()
    (tmp_path / "plain").write_text("x")
    os.mkfifo(tmp_path / "pipe")
    for path in (
        tmp_path,
        tmp_path / "plain" / "a.mcap",
        tmp_path / "plain" / "deeper" / "a.mcap",
        tmp_path / "pipe",
        tmp_path / "nul\0.mcap",
        tmp_path / ("x" * 300),
    ):
        with pytest.raises(LogError, match="cannot be") as caught:
            LogWriter(path, ROBOT, {})
        assert one_line(caught.value, path)
    assert (tmp_path / "plain").read_text() == "x"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["pipe", "plain"]
    assert threading.active_count() == threads


@pytest.mark.parametrize("place", ["folder", "file"])
def test_open_without_permission(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    path = tmp_path / "logs" / "a.mcap"

    def refuse(*args: object, **options: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    if place == "folder":
        monkeypatch.setattr(Path, "mkdir", refuse)
    else:
        monkeypatch.setattr(writer, "open_file", refuse)
    with pytest.raises(LogError, match="no permission") as caught:
        LogWriter(path, ROBOT, {})
    assert one_line(caught.value, path)


def test_failed_open_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limit_disk(monkeypatch, 1000)
    with pytest.raises(LogError, match="the disk is full") as caught:
        LogWriter(tmp_path / "a.mcap", ROBOT, RUN)
    assert one_line(caught.value, tmp_path / "a.mcap")
    with pytest.raises(LogError):
        LogWriter(tmp_path / "b.mcap", ROBOT, {"bad": "\ud800"})
    assert list(tmp_path.iterdir()) == []


def test_ring_needs_room(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="capacity 0"):
        LogWriter(tmp_path / "a.mcap", ROBOT, {}, capacity=0)
    assert list(tmp_path.iterdir()) == []
