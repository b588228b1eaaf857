"""The reader: the same bits as appended, from files whole, cut short and killed. Damaged ones: test_log_damage."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

from pepper_driver.backends.fields import TICK_FIELDS
from pepper_driver.backends.log_file import LAYOUT_VERSION
from pepper_driver.backends.log_records import with_checksum
from pepper_driver.config import UnknownNameError
from pepper_driver.log import LogError, LogWriter, RunLog, read_log
from pepper_driver.log.reader import begins_as_log
from pepper_driver.log.schema import layout_metadata
from pepper_driver.log.topics import FORCES
from pepper_driver.log.writer import McapFile
from pepper_driver.loop import TickRecord
from support import ROOT
from support.examples import examples
from support.log_samples import ROBOT, Samples, Written, flatten, same_bits


def attempt(path: Path) -> RunLog | LogError:
    """Read a log; return its content, or its error of one line."""
    try:
        return read_log(path)
    except LogError as error:
        if "\n" in str(error):
            raise
        return error


def test_same_bits_come_back(tmp_path: Path) -> None:
    written = Written(tmp_path / "a.mcap", 100)
    read = read_log(written.path)
    assert read.complete
    assert not read.missing
    assert read.metadata == {"seed": "0"}
    assert read.joint_names == ROBOT.joint_names
    assert read.chains == ROBOT.chains
    assert read.hand_joints == ROBOT.hands.joints
    assert set(read.fields) == set(written.rows[0]) == {f.name for f in TICK_FIELDS}
    assert read.truth is not None
    assert len(read) == len(read.truth["time"]) == 100
    assert len(read.contacts) == len(written.contacts) > 0
    assert same_bits(read.truth["time"], read["time"])
    written.check(read)


@examples(
    10,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
@given(seed=st.integers(0, 2**32), count=st.integers(0, 60))
def test_same_bits_come_back_for_any_run(tmp_path: Path, seed: int, count: int) -> None:
    written = Written(tmp_path / "a.mcap", count, seed)
    read = read_log(written.path)
    assert (read.complete, len(read), len(read.contacts)) == (True, count, len(written.contacts))
    written.check(read)


def test_ring_may_wrap(tmp_path: Path) -> None:
    samples = Samples(8)
    with LogWriter(tmp_path / "a.mcap", ROBOT, {}, capacity=7, lossless=True) as log:
        for number in range(50):
            contacts = [samples.contact(number)] if number % 5 == 0 else []
            log.append(
                TickRecord(tick=samples.tick(number), observation=samples.observation(*contacts))
            )
    read = read_log(tmp_path / "a.mcap")
    assert read["tick"].tolist() == list(range(50))
    assert read.truth is None
    assert [contact.id for contact in read.contacts] == list(range(0, 50, 5))


def test_truth_of_some_ticks_only(tmp_path: Path) -> None:
    samples = Samples(9)
    with LogWriter(tmp_path / "a.mcap", ROBOT, {}, capacity=3, lossless=True) as log:
        for number in range(9):
            log.append(
                TickRecord(tick=samples.tick(number), truth=samples.truth() if number % 2 else None)
            )
    read = read_log(tmp_path / "a.mcap")
    assert len(read) == 9
    assert read.truth is not None
    np.testing.assert_allclose(read.truth["time"], [0.012, 0.036, 0.060, 0.084])


def test_a_log_from_before_true_forces_is_read(tmp_path: Path) -> None:
    """The topic came last, so the channels of the others have the same numbers without it."""
    written = Written(tmp_path / "a.mcap", 30)
    layout = layout_metadata(ROBOT)
    *older, last = json.loads(layout["topics"])
    assert last == FORCES.topic
    layout["topics"] = json.dumps(older)
    old = McapFile(tmp_path / "old.mcap", layout, {})
    with written.path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            if channel.topic in older:
                old.write_row(channel.topic, 1e-9 * message.log_time, message.data)
    old.finish()
    read = read_log(tmp_path / "old.mcap")
    assert (read.complete, len(read), read.forces) == (True, 30, None)
    assert read.truth is not None
    assert read_log(written.path).forces == written.forces != []


def test_unknown_field_names_close_ones(tmp_path: Path) -> None:
    read = read_log(Written(tmp_path / "a.mcap", 1).path)
    with pytest.raises(UnknownNameError, match="did you mean position"):
        read["positon"]


def test_cut_anywhere_reads_up_to_the_cut(tmp_path: Path) -> None:
    written = Written(tmp_path / "a.mcap", 150)
    whole = written.path.read_bytes()
    cut = tmp_path / "cut.mcap"
    random = np.random.default_rng(1)
    points = {
        *range(60),
        *random.integers(0, len(whole), 120),
        *(len(whole) - n for n in range(1, 60)),
    }
    rows, header = 0, True
    for point in sorted(int(p) for p in points):
        cut.write_bytes(whole[:point])
        read = attempt(cut)
        if isinstance(read, LogError):
            assert header, f"nothing read from a cut at {point}, though an earlier one could be"
            continue
        header = False
        assert not read.complete
        assert "cut short" in read.missing
        assert read.metadata == {"seed": "0"}
        assert len(read) >= rows
        # What is lost is one chunk, a quarter of a second.
        rows = len(read)
        assert rows >= 150 * point / len(whole) - 60
        if point % 10 == 0:
            written.check(read)
    assert rows == 150


def test_zeros_after_the_cut(tmp_path: Path) -> None:
    written = Written(tmp_path / "a.mcap", 100)
    whole = written.path.read_bytes()
    end = len(whole) // 2
    written.path.write_bytes(whole[:end])
    before = read_log(written.path)
    for position in range(end, end + 3):
        written.path.write_bytes(whole[:position] + bytes(5000))
        read = read_log(written.path)
        assert not read.complete
        assert len(read) == len(before)


def test_zeros_at_a_boundary(tmp_path: Path) -> None:
    written = Written(tmp_path / "a.mcap", 5)
    whole = written.path.read_bytes()
    end = whole.rindex(b"\x0f" + (4).to_bytes(8, "little"))  # the record that ends the data
    written.path.write_bytes(whole[:end] + bytes(5000))
    read = read_log(written.path)
    assert not read.complete
    assert len(read) == 5
    written.check(read)


def test_anything_after_the_footer_is_incomplete(tmp_path: Path) -> None:
    written = Written(tmp_path / "a.mcap", 5)
    written.path.write_bytes(written.path.read_bytes() + b"x")
    assert not read_log(written.path).complete


KILLED = """
import os, signal, sys, threading, time
from pathlib import Path
sys.path.insert(0, {tests!r})
from support.log_samples import ROBOT, Samples
from pepper_driver.log import LogWriter
from pepper_driver.loop import TickRecord
samples = Samples(0)
log = LogWriter(Path({path!r}), ROBOT, {{"seed": "0"}}, lossless=True)
for number in range(200):
    log.append(TickRecord(tick=samples.tick(number), observation=samples.observation()))
while log._tail < 200:
    time.sleep(0.01)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_killed_process_loses_less_than_a_second(tmp_path: Path) -> None:
    path = tmp_path / "killed.mcap"
    code = KILLED.format(tests=str(ROOT / "tests"), path=str(path))
    result = subprocess.run([sys.executable, "-c", code], check=False)
    assert result.returncode == -signal.SIGKILL
    read = read_log(path)
    assert not read.complete
    assert len(read) > 200 - 83
    samples = Samples(0)
    for row in range(len(read)):
        given = flatten(samples.tick(row), samples.observation(), row)
        assert all(same_bits(read[name][row], given[name]) for name in given)


PACED = """
import sys, time
from pathlib import Path
sys.path.insert(0, {tests!r})
from support.log_samples import ROBOT, Samples
from pepper_driver.log import LogWriter
from pepper_driver.loop import TickRecord
samples = Samples(0)
log = LogWriter(Path({path!r}), ROBOT, {{}})
for number in range(10**6):
    log.append(TickRecord(tick=samples.tick(number), observation=samples.observation()))
    print(number, flush=True)
    time.sleep(0.012)
"""


def test_killed_in_real_time_loses_less_than_a_second(tmp_path: Path) -> None:
    path = tmp_path / "killed.mcap"
    code = PACED.format(tests=str(ROOT / "tests"), path=str(path))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        while int(child.stdout.readline()) < 150:
            pass
        child.kill()
        last = max([150, *(int(line) for line in child.stdout if line.endswith("\n"))])
    read = read_log(path)
    assert not read.complete
    assert last - 83 < len(read) <= last + 2


def test_forgotten_close_is_readable(tmp_path: Path) -> None:
    path = tmp_path / "open.mcap"
    code = (
        "from pathlib import Path\n"
        "from pepper_driver.config import load_robot\n"
        "from pepper_driver.log import LogWriter\n"
        f"log = LogWriter(Path({str(path)!r}), load_robot(), {{}})\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
    read = read_log(path)
    assert (read.complete, len(read)) == (False, 0)


def message(path: Path) -> str:
    with pytest.raises(LogError) as caught:
        read_log(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    return text


def test_missing_and_foreign_files(tmp_path: Path) -> None:
    assert "there is no such file" in message(tmp_path / "none.mcap")
    assert "it is a folder" in message(tmp_path)
    path = tmp_path / "a.mcap"
    path.write_bytes(b"")
    assert "is empty" in message(path)
    path.write_text("time,position\n0,1\n")
    assert "not an MCAP file" in message(path)
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.finish()  # type: ignore[no-untyped-call]
    assert "not a log of this package" in message(path)


def test_another_layout_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pepper_driver.log.schema.LAYOUT_VERSION", "9")
    written = Written(tmp_path / "a.mcap", 1)
    monkeypatch.undo()
    assert (
        f"in layout 9; this version reads {LAYOUT_VERSION}: read it with the version that wrote it"
        in message(written.path)
    )


def test_row_of_wrong_length_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, ROBOT, {}):
        pass
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_metadata("run", {})
        writer.add_metadata("layout", with_checksum(layout_metadata(ROBOT)))
        channel = writer.register_channel("/tick", "cdr", writer.register_schema("x", "", b""))
        writer.add_message(channel, 0, b"\x00\x01\x00\x00" + bytes(8), 0)
        writer.finish()  # type: ignore[no-untyped-call]
    assert "not a row" in message(path)


def test_the_begin_of_a_log_is_known(tmp_path: Path) -> None:
    log_file, other = tmp_path / "run.mcap", tmp_path / "other"
    Written(log_file, 20)
    other.write_bytes(log_file.read_bytes()[:200])
    assert begins_as_log(log_file)
    assert not begins_as_log(other)
    assert not begins_as_log(tmp_path / "none")
    assert not begins_as_log(tmp_path)


def test_only_some_fields_are_kept(tmp_path: Path) -> None:
    log_file = tmp_path / "run.mcap"
    Written(log_file, 20)
    whole, part = read_log(log_file), read_log(log_file, names=("time", "position", "base"))
    assert set(part.fields) == {"time", "position"}
    np.testing.assert_array_equal(part["position"], whole["position"])
    assert whole.truth is not None
    assert part.truth is not None
    np.testing.assert_array_equal(part.truth["base"], whole.truth["base"])
    assert part.contacts == whole.contacts
    assert set(part.elements) == {"position", "truth.position", "truth.base"}
