"""What the statistics of ticks say, of times that the tests make up."""

import logging
import math

import pytest
from pepper_driver.timing import STAGES, WAKING, StageTimes

MS = 1_000_000
CYCLE = 12 * MS


def marks(begin: int, **stages_ms: float) -> list[int]:
    """The clock around each stage; a stage that is not named takes no time."""
    times = [begin]
    for stage in STAGES:
        times.append(times[-1] + round(stages_ms.get(stage, 0.0) * MS))
    return times


def test_stages_and_the_tick_without_the_backend() -> None:
    times = StageTimes(0.012)
    for number in range(101):
        times.add(marks(number * CYCLE, backend=3, observer=0.1 * number, gate=1), age=0.001)
    statistics = times.statistics
    assert statistics.ticks == 101
    observer = statistics.stages["observer"]
    assert (observer.median, observer.p99, observer.largest) == pytest.approx((5e3, 9.9e3, 10e3))
    assert statistics.stages["backend"].median == pytest.approx(3e3)
    assert statistics.tick.median == pytest.approx(6e3)
    assert statistics.sample_age.median == pytest.approx(1.0)
    assert statistics.end is None
    assert statistics.summary == "101 ticks of 12 ms, as fast as they go"


def test_begin_and_end_are_counted_from_the_time_a_tick_was_to_begin() -> None:
    times = StageTimes(0.012)
    times.add(marks(5 * MS, backend=2), age=0.0, due=4 * MS)
    statistics = times.statistics
    assert statistics.begin is not None
    assert statistics.end is not None
    assert statistics.begin.median == pytest.approx(1.0)
    assert statistics.end.median == pytest.approx(3.0)
    assert statistics.late == {}


def test_the_longest_part_of_each_late_tick_is_named() -> None:
    times = StageTimes(0.012)
    times.add(marks(0, backend=20, observer=6), age=0.0, due=0)  # is late, costs two
    times.add(marks(3 * CYCLE, observer=1), age=0.0, due=3 * CYCLE, missed=2)
    times.add(marks(4 * CYCLE, backend=4, log=9), age=0.0, due=4 * CYCLE)
    times.add(marks(6 * CYCLE + 11 * MS, backend=2), age=0.0, due=6 * CYCLE, missed=1)
    times.add(marks(8 * CYCLE), age=0.0, due=8 * CYCLE, missed=1)
    times.add(marks(10 * CYCLE), age=0.0, due=10 * CYCLE, missed=1)  # overslept a whole cycle
    times.add(marks(11 * CYCLE + 5 * MS, gate=8), age=0.0, due=11 * CYCLE)
    statistics = times.statistics
    assert statistics.missed == 5
    assert statistics.late == {"backend": 1, "log": 1, "gate": 1, WAKING: 2}
    assert statistics.summary.startswith("7 ticks of 12 ms in real time, 5 missed; longest in late")
    assert "waking up (2), backend (1), log (1), gate (1)" in statistics.summary


def test_the_report_shows_every_stage() -> None:
    times = StageTimes(0.012)
    times.add(marks(0, **dict.fromkeys(STAGES, 0.1234)), age=0.0, due=0)
    lines = str(times.statistics).splitlines()
    assert lines[0] == "1 ticks of 12 ms in real time, none missed"
    shown = {line[:16].strip() for line in lines[2:]}
    assert shown == {
        *STAGES,
        "all but backend",
        "begins late by",
        "ends after",
        "age of samples",
    }
    assert all(line.split()[-4] == "123.4" for line in lines if line.startswith(STAGES))
    assert len({len(line) for line in lines[2:]}) == 1, "columns align"


def test_the_newest_are_kept_and_all_are_counted() -> None:
    times = StageTimes(0.012, capacity=10)
    for number in range(25):
        times.add(marks(0, gate=number), age=0.0)
    assert times.statistics.ticks == 25
    assert times.statistics.stages["gate"].median == pytest.approx(19.5e3)


def test_without_ticks_there_is_nothing_to_say() -> None:
    times = StageTimes(0.012)
    times.add(marks(0), age=0.0, due=0, missed=3)
    times.clear()
    statistics = times.statistics
    assert (statistics.ticks, statistics.missed, statistics.late) == (0, 0, {})
    assert math.isnan(statistics.tick.median)
    assert str(statistics)


def test_warnings_of_missed_ticks_are_few(caplog: pytest.LogCaptureFixture) -> None:
    times = StageTimes(0.012)
    with caplog.at_level(logging.WARNING):
        for number in range(1000):  # 24 s of nothing but late ticks
            times.add(marks(2 * number * CYCLE, gate=15), age=0.0, due=2 * number * CYCLE, missed=1)
    assert 3 <= len(caplog.records) <= 6
    assert "gate" in caplog.records[1].getMessage()
