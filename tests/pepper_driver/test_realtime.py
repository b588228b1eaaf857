"""Ticks in real time: when they begin, by a clock that the tests turn; what keeps them punctual; their statistics."""

from __future__ import annotations

import gc
import logging
import math
import os
import sys
import threading
from collections.abc import Iterator
from itertools import pairwise
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver import realtime as module
from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import load_robot
from pepper_driver.config.clock import Clock
from pepper_driver.realtime import (
    MAX_FROZEN_BY_PYTHON,
    STAGES,
    SWITCH_INTERVAL,
    TICK_PRIORITY,
    WAKING,
    Pacer,
    RealTimePacer,
    StageTimes,
    priority_obstacle,
    realtime_process,
    realtime_thread,
)
from support.examples import examples

ROBOT = load_robot()
CYCLE = 12_000_000  # ns
MS = 1_000_000


class FakeClock:
    """Time passes only by ``work`` and by sleeping, which may end late."""

    def __init__(self, start: int = 5 * MS) -> None:
        self.now = start
        self.oversleep: list[int] = []
        self.slept: list[float] = []

    def __call__(self) -> int:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.slept.append(seconds)
        self.now += round(seconds * 1e9) + (self.oversleep.pop(0) if self.oversleep else 0)

    def work(self, ns: int) -> None:
        self.now += ns


def make_pacer(clock: FakeClock) -> RealTimePacer:
    return RealTimePacer(0.012, MockBackend(), clock=Clock(clock, clock.sleep))


def started(pacer: Pacer) -> int:
    assert pacer.due is not None
    return pacer.due


def test_the_first_tick_begins_at_once() -> None:
    clock = FakeClock()
    pacer = make_pacer(clock)
    clock.work(40 * MS)  # whatever came between: no tick yet
    assert pacer.wait() == 0
    assert clock.slept == []
    assert started(pacer) == clock.now == 45 * MS


@pytest.mark.parametrize(
    ("work_ms", "missed", "next_ms"),
    [(0, 0, 12), (3, 0, 12), (12, 0, 12), (12.001, 1, 24), (24, 1, 24), (30, 2, 36), (47, 3, 48)],
)
def test_a_tick_that_takes_too_long_costs_those_that_were_to_begin_meanwhile(
    work_ms: float, missed: int, next_ms: int
) -> None:
    clock = FakeClock(0)
    pacer = make_pacer(clock)
    pacer.wait()
    clock.work(round(work_ms * MS))
    assert pacer.wait() == missed
    assert started(pacer) == clock.now == next_ms * MS


def test_a_late_tick_shifts_no_other() -> None:
    clock = FakeClock(0)
    pacer = make_pacer(clock)
    clock.oversleep = [MS // 2, 3 * MS, 0]
    begun = []
    for _ in range(4):
        pacer.wait()
        begun.append((started(pacer) // MS, clock.now / MS))
        clock.work(2 * MS)
    assert begun == [(0, 0), (12, 12.5), (24, 27), (36, 36)]


@pytest.mark.parametrize(
    ("oversleep_ms", "missed", "due_ms"), [(11.9, 0, 12), (12, 1, 24), (30, 2, 36)]
)
def test_who_wakes_up_a_whole_cycle_late_has_missed_ticks(
    oversleep_ms: float, missed: int, due_ms: int
) -> None:
    """The tick that is under way by then begins at once."""
    clock = FakeClock(0)
    pacer = make_pacer(clock)
    pacer.wait()
    clock.oversleep = [round(oversleep_ms * MS)]
    assert pacer.wait() == missed
    assert started(pacer) == due_ms * MS
    assert clock.now == 12 * MS + round(oversleep_ms * MS)


@given(
    st.lists(st.tuples(st.integers(0, 40 * MS), st.integers(0, 15 * MS)), min_size=1, max_size=300)
)
def test_the_times_never_drift(durations: list[tuple[int, int]]) -> None:
    clock = FakeClock(7)
    pacer = make_pacer(clock)
    pacer.wait()
    first, index = started(pacer), 0
    for work, oversleep in durations:
        clock.work(work)
        clock.oversleep = [oversleep]
        before = clock.now
        missed = pacer.wait()
        index += 1 + missed
        clock.oversleep = []
        assert started(pacer) == first + index * CYCLE
        assert started(pacer) <= clock.now < started(pacer) + CYCLE
        if missed and oversleep < CYCLE:
            assert started(pacer) - CYCLE < before, "no more are missed than had to be"


@examples(10)
@given(st.integers(0, 2**32))
def test_ten_thousand_ticks_end_where_they_should(seed: int) -> None:
    clock, random = FakeClock(0), Random(seed)
    pacer = make_pacer(clock)
    missed = 0
    for _ in range(10_000):
        missed += pacer.wait()
        clock.work(random.randrange(25 * MS))
    assert started(pacer) == (9_999 + missed) * CYCLE
    assert missed > 0


def test_no_pacing_waits_for_nothing_and_changes_nothing() -> None:
    pacer = Pacer()
    interval = sys.getswitchinterval()
    assert pacer.wait() == 0
    assert pacer.due is None
    assert not pacer.paced
    assert gc.isenabled()
    assert sys.getswitchinterval() == interval


def following(clock: FakeClock, beat: float, drift: float = 0.0) -> RealTimePacer:
    """Pacer of a robot whose cycles are best met ``beat`` [ms] after those of a clock that is faster by ``drift``."""

    class Robot(MockBackend):
        def phase_error(self, due: int) -> float:
            cycle = CYCLE / (1.0 + drift)
            late = (beat * MS - due) % cycle
            return (late - cycle if late > cycle / 2 else late) * 1e-9

    return RealTimePacer(0.012, Robot(), clock=Clock(clock, clock.sleep))


@pytest.mark.parametrize("beat", [0.0, 1.0, 4.9, 5.1, 11.9])
def test_the_first_tick_is_put_where_the_robots_cycle_needs_it(beat: float) -> None:
    clock = FakeClock(start=5 * MS)
    pacer = following(clock, beat)
    for tick in range(20):
        assert pacer.wait() == 0
        begin = started(pacer)
        assert begin % CYCLE == pytest.approx(beat * MS, abs=2)
        assert 0 <= begin - 5 * MS - tick * CYCLE <= CYCLE
        clock.work(2 * MS)


@pytest.mark.parametrize("drift", [100e-6, -100e-6])
def test_ticks_follow_a_robot_whose_clock_runs_apart(drift: float) -> None:
    clock = FakeClock()
    pacer = following(clock, 3.0, drift)
    cycle = CYCLE / (1.0 + drift)
    for _ in range(100_000):  # twenty minutes: 10 cycles apart in the end
        assert pacer.wait() == 0
        off = (started(pacer) - 3 * MS) % cycle
        assert min(off, cycle - off) < 0.01 * MS
        clock.work(MS)


def test_a_robot_whose_cycles_jump_is_followed_slowly() -> None:
    clock = FakeClock()
    beat = [3.0]

    class Robot(MockBackend):
        def phase_error(self, due: int) -> float:
            return ((beat[0] * MS - due + CYCLE / 2) % CYCLE - CYCLE / 2) * 1e-9

    pacer = RealTimePacer(0.012, Robot(), clock=Clock(clock, clock.sleep))
    pacer.wait()
    beat[0] = 8.0
    begins = [started(pacer)]
    for _ in range(100):
        assert pacer.wait() == 0
        begins.append(started(pacer))
    steps = [b - a for a, b in pairwise(begins)]
    assert all(CYCLE <= step <= CYCLE + 0.06 * MS for step in steps)
    assert begins[-1] % CYCLE == pytest.approx(8 * MS, abs=10)


def test_a_tick_that_was_missed_shifts_none_where_ticks_follow_a_robot() -> None:
    clock = FakeClock()
    pacer = following(clock, 3.0)
    pacer.wait()
    clock.work(30 * MS)
    assert pacer.wait() == 2
    assert started(pacer) % CYCLE == 3 * MS


# -- requests for samples ---------------------------------------------------------------------------------------


class Requested(MockBackend):
    """Notes when its pacer requests a sample, and takes its time for that."""

    def __init__(self, clock: FakeClock, lead_ms: float, takes_ms: float = 0.0) -> None:
        super().__init__()
        self.time, self.lead, self.takes = clock, lead_ms * 1e-3, round(takes_ms * MS)
        self.at: list[int] = []
        self.pacer = RealTimePacer(0.012, self, clock=Clock(clock, clock.sleep))

    @property
    def request_lead(self) -> float:
        return self.lead

    def request(self) -> None:
        self.at.append(self.time.now)
        self.time.work(self.takes)

    def tick(self, work_ms: float = 1.0) -> tuple[int, int]:
        """A tick that works so long; returns when it was due, and the ticks missed before it."""
        missed = self.pacer.wait()
        due = started(self.pacer)
        self.time.work(round(work_ms * MS))
        return due, missed


@pytest.mark.parametrize("lead_ms", [0.5, 3.0, 5.4, 11.9])
def test_each_sample_is_requested_once_and_that_long_before_its_tick(lead_ms: float) -> None:
    clock = FakeClock()
    robot = Requested(clock, lead_ms)
    dues = [robot.tick(work_ms=0.05)[0] for _ in range(20)]
    # The first tick begins at once: it reads what open has read.
    assert robot.at == [due - round(lead_ms * MS) for due in dues[1:]]
    assert {b - a for a, b in pairwise(dues)} == {CYCLE}


def test_without_a_lead_nothing_is_requested() -> None:
    clock = FakeClock()
    robot = Requested(clock, 0.0)
    for _ in range(20):
        robot.tick()
    assert robot.at == []
    assert len(clock.slept) == 19, "it sleeps once for each tick"


def test_a_request_that_takes_its_time_shifts_no_tick() -> None:
    robot = Requested(FakeClock(), lead_ms=3.0, takes_ms=2.0)
    assert {b[0] - a[0] for a, b in pairwise([robot.tick() for _ in range(20)])} == {CYCLE}
    assert len(robot.at) == 19
    robot.takes = 4 * MS
    for _ in range(5):
        _, missed = robot.tick()
        assert missed == 0
        assert robot.time.now - started(robot.pacer) == 2 * MS, "a little late, and not shifted"


def test_a_tick_that_ends_within_the_lead_requests_at_once() -> None:
    robot = Requested(FakeClock(0), lead_ms=5.0)
    robot.tick(work_ms=9.0)
    due, missed = robot.tick()
    assert (due, missed, robot.at) == (CYCLE, 0, [9 * MS])


def test_a_late_tick_begins_without_a_request() -> None:
    """To ask for its sample would only make it later: it takes the newest one, and read asks for the next."""
    robot = Requested(FakeClock(0), lead_ms=5.0)
    robot.tick(work_ms=12.0)
    assert robot.tick(work_ms=1.0) == (CYCLE, 0)
    assert robot.at == []
    assert robot.tick() == (2 * CYCLE, 0)
    assert robot.at == [2 * CYCLE - 5 * MS]


def test_a_request_is_for_the_tick_that_comes_not_for_one_that_was_missed() -> None:
    robot = Requested(FakeClock(0), lead_ms=4.0)
    robot.tick(work_ms=30.0)
    due, missed = robot.tick()
    assert (due, missed, robot.at) == (3 * CYCLE, 2, [3 * CYCLE - 4 * MS])


@pytest.mark.parametrize(
    ("oversleep_ms", "missed", "late_ms"), [(1.0, 0, 0.0), (6.0, 0, 1.0), (20.0, 1, 3.0)]
)
def test_who_wakes_up_late_to_request_requests_once(
    oversleep_ms: float, missed: int, late_ms: float
) -> None:
    clock = FakeClock(0)
    robot = Requested(clock, lead_ms=5.0)
    robot.tick()
    clock.oversleep = [round(oversleep_ms * MS)]
    assert robot.pacer.wait() == missed
    assert robot.at == [7 * MS + round(oversleep_ms * MS)]
    assert clock.now - started(robot.pacer) == pytest.approx(late_ms * MS)


@given(
    st.lists(
        st.tuples(
            st.integers(0, 30 * MS), st.lists(st.integers(0, 15 * MS), min_size=2, max_size=2)
        ),
        min_size=1,
        max_size=100,
    ),
    st.floats(0.1, 5.4),
)
def test_requests_come_at_most_once_a_tick_and_before_it(
    durations: list[tuple[int, list[int]]], lead_ms: float
) -> None:
    """However long ticks take and however late threads wake up; and the ticks stay where they were."""
    clock = FakeClock(7)
    robot = Requested(clock, lead_ms)
    first, index, requests = robot.tick(0.0)[0], 0, 0
    for work, oversleep in durations:
        clock.work(work)
        clock.oversleep = list(oversleep)
        before = clock.now
        index += 1 + robot.pacer.wait()
        due = started(robot.pacer)
        assert due == first + index * CYCLE
        asked = robot.at[requests:]
        requests = len(robot.at)
        assert len(asked) <= 1
        assert all(before <= at <= clock.now for at in asked)
        if before < due - round(lead_ms * MS):
            assert asked, "there was time"
        if not any(oversleep):
            assert asked in ([], [max(before, due - round(lead_ms * MS))])


def test_the_lead_may_change_from_tick_to_tick() -> None:
    """It is measured again with each connection; none until then."""
    robot = Requested(FakeClock(0), lead_ms=0.0)
    robot.tick()
    robot.tick()
    robot.lead = 0.003
    assert robot.tick()[0] == 2 * CYCLE
    robot.lead = 0.001
    assert robot.tick()[0] == 3 * CYCLE
    assert robot.at == [2 * CYCLE - 3 * MS, 3 * CYCLE - MS]


def test_the_pacer_of_a_robot_follows_it_and_requests_its_samples() -> None:
    class Robot(MockBackend):
        request_lead = 0.003

        def request(self) -> None:
            self.calls.append("request")

        def phase_error(self, due: int) -> float:
            self.calls.append("phase")
            return 0.0

    robot = Robot()
    pacer = RealTimePacer(ROBOT.cycle, robot)
    for _ in range(3):
        pacer.wait()
    assert set(robot.calls) == {"request", "phase"}


# -- what keeps them punctual ---------------------------------------------------------------------------------

LINUX = hasattr(os, "sched_setscheduler")
State = tuple[bool, bool, float]


def state() -> State:
    """State that all threads share."""
    frozen = gc.get_freeze_count() > MAX_FROZEN_BY_PYTHON
    return gc.isenabled(), frozen, round(sys.getswitchinterval(), 6)


@pytest.fixture(autouse=True)
def untouched() -> Iterator[None]:
    before = state()
    scheduler = os.sched_getscheduler(0) if LINUX else None
    yield
    assert state() == before
    if LINUX:
        assert os.sched_getscheduler(0) == scheduler


class Scheduler:
    """In place of the system's: knows what was asked for, and may refuse."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, permitted: bool = True) -> None:
        self.permitted, self.now, self.priority = permitted, os.SCHED_OTHER, 0
        self.asked: list[int] = []
        monkeypatch.setattr(os, "sched_getscheduler", lambda _: self.now)
        monkeypatch.setattr(os, "sched_getparam", lambda _: os.sched_param(self.priority))
        monkeypatch.setattr(os, "sched_setscheduler", self.set)
        monkeypatch.setattr(module, "_logged", set())

    def set(self, thread: int, policy: int, param: os.sched_param) -> None:
        assert thread == 0
        self.asked.append(policy)
        flagged = bool(self.now & os.SCHED_RESET_ON_FORK)
        if not self.permitted or (flagged and not policy & os.SCHED_RESET_ON_FORK):
            raise PermissionError  # as without root: the flag stays
        self.now, self.priority = policy, param.sched_priority


def test_inside_nothing_is_collected_and_threads_switch_quickly() -> None:
    with realtime_process():
        assert not gc.isenabled()
        assert gc.get_freeze_count() > MAX_FROZEN_BY_PYTHON
        assert sys.getswitchinterval() == pytest.approx(SWITCH_INTERVAL)


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_all_is_put_back_whatever_happens(error: type[BaseException]) -> None:
    with pytest.raises(error), realtime_process(), realtime_thread():
        raise error


def test_garbage_of_the_run_is_collected_afterwards() -> None:
    class Loop:
        """Refers to itself."""

        def __init__(self) -> None:
            self.me = self

        def __del__(self) -> None:
            ended.append(1)

    ended: list[int] = []
    with realtime_process():
        Loop()
        assert not ended
    assert ended


def test_what_the_user_has_set_stays() -> None:
    interval = sys.getswitchinterval()
    gc.disable()
    gc.freeze()
    sys.setswitchinterval(1e-5)
    try:
        frozen = gc.get_freeze_count()
        with realtime_process():
            assert sys.getswitchinterval() == pytest.approx(1e-5)
        assert not gc.isenabled()
        assert gc.get_freeze_count() >= frozen
    finally:
        gc.enable()
        gc.unfreeze()
        sys.setswitchinterval(interval)


def test_what_python_itself_has_frozen_keeps_nothing_else_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(gc, "get_freeze_count", lambda: 375)  # as Python 3.12.1 starts
    with realtime_process():
        pass


def test_blocks_of_several_threads_overlap() -> None:
    inside, leave = threading.Event(), threading.Event()

    def other() -> None:
        with realtime_process():
            inside.set()
            leave.wait(10)

    thread = threading.Thread(target=other)
    with realtime_process():
        thread.start()
        assert inside.wait(10)
    assert not gc.isenabled(), "the other one still runs"
    leave.set()
    thread.join(10)


def test_blocks_may_be_nested() -> None:
    with realtime_process():
        with realtime_process():
            pass
        assert not gc.isenabled()


@pytest.mark.skipif(not LINUX, reason="no such scheduler")
def test_the_thread_gets_priority_and_its_children_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        scheduler = Scheduler(patch)
        with realtime_thread():
            assert scheduler.now == os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            assert scheduler.priority == TICK_PRIORITY
        assert scheduler.now & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER
        assert scheduler.priority == 0


@pytest.mark.skipif(not LINUX, reason="no such scheduler")
def test_priority_given_from_outside_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        scheduler = Scheduler(patch)
        scheduler.now, scheduler.priority = os.SCHED_RR, 70
        with realtime_thread():
            pass
        assert (scheduler.now, scheduler.priority, scheduler.asked) == (os.SCHED_RR, 70, [])


@pytest.mark.skipif(not LINUX, reason="no such scheduler")
def test_a_refusal_is_logged_once_with_the_cure(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with monkeypatch.context() as patch, caplog.at_level(logging.WARNING):
        Scheduler(patch, permitted=False)
        for _ in range(3):
            with realtime_thread():
                pass
    (record,) = caplog.records
    assert "rtprio" in record.getMessage()
    assert "limits.d" in record.getMessage()


@pytest.mark.skipif(not LINUX, reason="no such scheduler")
def test_the_system_takes_the_priority_back() -> None:
    """For real, where it is permitted; the fixture looks at what is left."""
    seen: list[int] = []
    with realtime_thread():
        policy = os.sched_getscheduler(0)
        thread = threading.Thread(target=lambda: seen.append(os.sched_getscheduler(0)))
        thread.start()
        thread.join()
    assert policy in (os.SCHED_OTHER, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK)
    assert seen == [os.SCHED_OTHER]


@pytest.mark.skipif(not LINUX, reason="no schedulers")
@pytest.mark.parametrize("permitted", [True, False])
def test_what_stands_in_the_way_of_priority_can_be_asked_for(
    permitted: bool, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    scheduler = Scheduler(monkeypatch, permitted)
    obstacle = priority_obstacle()
    assert obstacle == "" if permitted else "not permitted" in obstacle
    assert scheduler.now & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER
    assert caplog.records == [], "who asks says it"
    monkeypatch.undo()


# -- how punctual they were -----------------------------------------------------------------------------------


def marks(begin: int, **stages_ms: float) -> list[int]:
    """The clock around each stage; a stage that is not named takes no time."""
    times = [begin]
    for stage in STAGES:
        times.append(times[-1] + round(stages_ms.get(stage, 0.0) * MS))
    return times


def test_stages_and_the_tick_without_the_backend() -> None:
    times = StageTimes(0.012)
    for number in range(101):
        times.add(marks(number * CYCLE, read=3, observer=0.1 * number, gate=1, write=2), age=0.001)
    statistics = times.statistics
    assert statistics.ticks == 101
    observer = statistics.stages["observer"]
    assert (observer.median, observer.p99, observer.max) == pytest.approx((5e3, 9.9e3, 10e3))
    assert statistics.stages["read"].median == pytest.approx(3e3)
    assert statistics.tick.median == pytest.approx(6e3)
    assert statistics.sample_age.median == pytest.approx(1.0)
    assert statistics.end is None
    assert statistics.summary == "101 ticks of 12 ms, unpaced"


def test_begin_and_end_are_counted_from_the_time_a_tick_was_to_begin() -> None:
    times = StageTimes(0.012)
    times.add(marks(5 * MS, read=2), age=0.0, due=4 * MS)
    statistics = times.statistics
    assert statistics.begin is not None
    assert statistics.end is not None
    assert statistics.begin.median == pytest.approx(1.0)
    assert statistics.end.median == pytest.approx(3.0)
    assert statistics.late == {}


def test_the_longest_part_of_each_late_tick_is_named() -> None:
    times = StageTimes(0.012)
    times.add(marks(0, read=20, observer=6), age=0.0, due=0)  # is late, costs two
    times.add(marks(3 * CYCLE, observer=1), age=0.0, due=3 * CYCLE, missed=2)
    times.add(marks(4 * CYCLE, write=4, log=9), age=0.0, due=4 * CYCLE)
    times.add(marks(6 * CYCLE + 11 * MS, read=2), age=0.0, due=6 * CYCLE, missed=1)
    times.add(marks(8 * CYCLE), age=0.0, due=8 * CYCLE, missed=1)
    times.add(marks(10 * CYCLE), age=0.0, due=10 * CYCLE, missed=1)  # overslept a whole cycle
    times.add(marks(11 * CYCLE + 5 * MS, gate=8), age=0.0, due=11 * CYCLE)
    statistics = times.statistics
    assert statistics.missed == 5
    assert statistics.late == {"read": 1, "log": 1, "gate": 1, WAKING: 2}
    assert statistics.summary.startswith("7 ticks of 12 ms in real time, 5 missed; longest in late")
    assert "waking up (2), read (1), log (1), gate (1)" in statistics.summary


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
