"""Damaged logs: whatever happens to a file, all chunks that are intact come back, and what is missing is said.

Where its chunks are, and what is in them, is taken from the mcap package's own index and reader.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from pepper_driver.backends.log_file import Gap
from pepper_driver.config import PepperError
from pepper_driver.config.files import OutputError
from pepper_driver.log import LogError, RunLog, read_log
from pepper_driver.log.repair import repair_log
from support.examples import examples
from support.log_samples import Written, same_bits

TICKS = 120
ANYTHING = examples(
    25,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)


@dataclass(frozen=True)
class Place:
    """A chunk of a file: its bytes, the steps of its ticks, and the time stamps of its messages [s]."""

    begin: int
    end: int
    steps: frozenset[int]
    times: tuple[float, ...]


@dataclass(frozen=True)
class Whole:
    """An intact log."""

    path: Path
    data: bytes
    log: RunLog
    places: tuple[Place, ...]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Whole:
    path = tmp_path_factory.mktemp("log") / "whole.mcap"
    Written(path, TICKS)
    log = read_log(path)
    return Whole(path, path.read_bytes(), log, tuple(places(path, log)))


def places(path: Path, log: RunLog) -> list[Place]:
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    with path.open("rb") as stream:
        chunks = [
            breakup_chunk(record)
            for record in StreamReader(stream, emit_chunks=True).records
            if isinstance(record, Chunk)
        ]
    topics = {r.id: r.topic for r in chunks[0] if isinstance(r, Channel)}
    first, found = 0, []
    for index, records in zip(summary.chunk_indexes, chunks, strict=True):
        messages = [record for record in records if isinstance(record, Message)]
        count = sum(topics[message.channel_id] == "/tick" for message in messages)
        found.append(
            Place(
                index.chunk_start_offset,
                index.chunk_start_offset + index.chunk_length,
                frozenset(log["step"][first : first + count].tolist()),
                tuple(1e-9 * message.log_time for message in messages),
            )
        )
        first += count
    assert len(found) >= 5
    assert first == TICKS
    return found


def check(read: RunLog, whole: Whole, intact: list[Place]) -> None:
    """All of the intact chunks is there, bit for bit, and nothing else."""
    steps = set().union(*(place.steps for place in intact))
    rows = [row for row, step in enumerate(whole.log["step"].tolist()) if step in steps]
    for name, column in whole.log.fields.items():
        assert same_bits(read[name], column[rows]), name
    assert set(read.contacts) <= set(whole.log.contacts)
    # A tick's contacts may be at the begin of the next chunk.
    between = {c.time for c in whole.log.contacts} & set(whole.log["time"][rows[:-1]].tolist())
    near = {time for place in intact for time in (place.times[0], place.times[-1])}
    assert {c.time for c in read.contacts} >= {
        t for t in between if all(abs(t - n) > 1e-6 for n in near)
    }


def attempt(path: Path) -> RunLog | LogError:
    """Read a log; return its content, or its error of one line."""
    try:
        return read_log(path)
    except LogError as error:
        assert "\n" not in str(error)
        assert str(error).startswith(f"{path}: ")
        return error


def damage(data: bytes, hits: list[tuple[int, int]], cut: int) -> tuple[bytes, set[int]]:
    """Some bytes changed, and the end cut off; and which were changed."""
    limited = bytearray(data)
    for position, mask in hits:
        limited[position % len(data)] ^= mask
    return bytes(limited[:cut]), {i for i, byte in enumerate(limited) if byte != data[i]}


HITS = st.lists(st.tuples(st.integers(0, 2**40), st.integers(1, 255)), max_size=12)


@ANYTHING
@given(
    hits=HITS, burst=st.tuples(st.integers(0, 2**40), st.integers(0, 3000)), keep=st.floats(0, 1)
)
@pytest.mark.parametrize("cuts", [False, True])
def test_intact_chunks_come_back_whatever_is_damaged(
    whole: Whole,
    tmp_path: Path,
    hits: list[tuple[int, int]],
    burst: tuple[int, int],
    keep: float,
    cuts: bool,
) -> None:
    cut = round(keep * len(whole.data)) if cuts else len(whole.data)
    hits = hits + [(burst[0] + i, 0x55) for i in range(burst[1])]
    data, limited = damage(whole.data, hits, cut)
    intact = [p for p in whole.places if p.end <= cut and limited.isdisjoint(range(p.begin, p.end))]
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    read = attempt(path)
    if isinstance(read, LogError):
        assert not intact
        return
    check(read, whole, intact)
    assert not (read.complete and cut < len(whole.data))
    if len(intact) < len(whole.places):
        assert read.missing
    for gap in read.gaps:
        lost = [p for p in whole.places if p not in intact and inside(p, gap)]
        assert 1 <= gap.chunks <= len(lost)
        assert gap.messages == sum(len(p.times) for p in lost)


def inside(place: Place, gap: Gap) -> bool:
    start = -1.0 if gap.start is None else gap.start
    return start <= place.times[0] and place.times[-1] <= gap.stop


@settings(ANYTHING, max_examples=25)
@given(hits=HITS, keep=st.floats(0, 1), cuts=st.booleans())
def test_a_repaired_log_holds_the_same(
    whole: Whole, tmp_path: Path, hits: list[tuple[int, int]], keep: float, cuts: bool
) -> None:
    path, out = tmp_path / "damaged.mcap", tmp_path / "repaired.mcap"
    cut = round(keep * len(whole.data)) if cuts else len(whole.data)
    path.write_bytes(damage(whole.data, hits, cut)[0])
    read = attempt(path)
    if isinstance(read, LogError):
        with pytest.raises(LogError):
            repair_log(path, out, force=True)
        return
    repair_log(path, out, force=True)
    repaired = read_log(out)
    for name, column in read.fields.items():
        assert same_bits(repaired[name], column), name
    assert repaired.contacts == read.contacts
    assert repaired.complete == read.complete
    assert [(g.start, g.stop, g.messages) for g in repaired.gaps] == [
        (g.start, g.stop, g.messages) for g in read.gaps
    ]
    assert repaired.metadata.get("repaired", "") == read.missing
    with out.open("rb") as stream:  # with index and checksums, for every other program
        messages = list(make_reader(stream, validate_crcs=True).iter_messages())
    count = sum(channel.topic == "/tick" for _, channel, _ in messages)
    assert count == len(read)


def test_a_log_cut_before_its_first_tick_can_be_repaired(whole: Whole, tmp_path: Path) -> None:
    path, out = tmp_path / "a.mcap", tmp_path / "b.mcap"
    path.write_bytes(whole.data[: whole.places[0].begin])
    repair_log(path, out)
    for log in (read_log(path), read_log(out)):
        assert (len(log), log.complete, log.gaps) == (0, False, ())
        assert log.missing == "cut short before its first tick"


def test_a_gap_says_which_seconds(
    whole: Whole, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    second, fourth = whole.places[1], whole.places[3]
    data = bytearray(whole.data)
    for place in (second, fourth):
        data[(place.begin + place.end) // 2] ^= 1
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    read = read_log(path)
    assert read.complete
    gaps = [
        f"{before.times[-1]:.2f} to {after.times[0]:.2f} s"
        for before, after in (
            (whole.places[0], whole.places[2]),
            (whole.places[2], whole.places[4]),
        )
    ]
    assert read.missing == f"2 chunks are missing: {', '.join(gaps)}"
    assert caplog.messages == [f"{path}: {read.missing}"]


def test_a_damaged_end_is_a_log_cut_short(whole: Whole, tmp_path: Path) -> None:
    last, before = whole.places[-1], whole.places[-2]
    data = bytearray(whole.data)
    data[last.begin] ^= 1  # not even known as a chunk
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    read = read_log(path)
    assert (read.complete, read.gaps) == (False, ())
    assert read.missing == f"cut short after {before.times[-1]:.2f} s"


def test_a_log_without_head_or_end_is_read(whole: Whole, tmp_path: Path) -> None:
    """Only chunks are left: rows are read as this version writes them."""
    intact = list(whole.places[:-1])  # the second copy of the metadata stands before the last
    path = tmp_path / "a.mcap"
    path.write_bytes(bytes(1000) + whole.data[intact[0].begin : intact[-1].end])
    read = read_log(path)
    check(read, whole, intact)
    assert read.metadata == {}
    assert "its layout is damaged" in read.missing
    assert "what it says of its run is damaged" in read.missing


def test_the_second_copy_of_the_metadata_counts(whole: Whole, tmp_path: Path) -> None:
    data = bytearray(whole.data)
    data[: whole.places[0].begin] = bytes(whole.places[0].begin)
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    read = read_log(path)
    assert read.complete
    assert not read.missing
    assert read.metadata == whole.log.metadata


def test_nothing_intact_is_refused(whole: Whole, tmp_path: Path) -> None:
    data = bytearray(whole.data)
    for place in whole.places:
        data[(place.begin + place.end) // 2] ^= 1
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    with pytest.raises(LogError, match="none of its chunks is intact"):
        read_log(path)


def test_no_log_is_written_over_by_its_repair(whole: Whole, tmp_path: Path) -> None:
    path, other = tmp_path / "a.mcap", tmp_path / "b.mcap"
    path.write_bytes(whole.data)
    other.write_text("mine")
    for out, said in ((path, "is the log itself"), (other, "is there already; --force")):
        with pytest.raises(OutputError, match=said) as caught:
            repair_log(path, out)
        assert isinstance(caught.value, PepperError)
    assert path.read_bytes() == whole.data
    assert other.read_text() == "mine"
    assert np.isfinite(read_log(path)["time"]).all()
    repair_log(path, tmp_path / "new" / "c.mcap")
    assert "repaired" not in read_log(tmp_path / "new" / "c.mcap").metadata
