"""When ticks begin, by a clock that the tests turn."""

import gc
import sys
from itertools import pairwise
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pepper_driver.pacing import Pacer, RealTimePacer

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
    pacer = RealTimePacer(0.012, clock=clock, sleep=clock.sleep)
    with pacer.running():
        return pacer


def started(pacer: Pacer) -> int:
    assert pacer.due is not None
    return pacer.due


def test_the_first_tick_begins_at_once() -> None:
    clock = FakeClock()
    pacer = make_pacer(clock)
    clock.work(40 * MS)  # whatever came between: nobody ticked yet
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


def test_short_runs_keep_the_beat_and_pauses_between_them_miss_nothing() -> None:
    clock = FakeClock(0)
    pacer = make_pacer(clock)
    for _ in range(3):
        pacer.wait()
        clock.work(MS)
    clock.work(4 * MS)
    with pacer.running():
        assert pacer.wait() == 0
    assert started(pacer) == clock.now == 36 * MS
    clock.work(100 * MS)
    with pacer.running():
        assert pacer.wait() == 0
    assert started(pacer) == clock.now == 136 * MS


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


@settings(max_examples=10)
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
    with pacer.running():
        assert gc.isenabled()
        assert sys.getswitchinterval() == interval
        assert pacer.wait() == 0
        assert pacer.due is None


def following(clock: FakeClock, beat: float, drift: float = 0.0) -> RealTimePacer:
    """Of a robot whose cycles are best met ``beat`` [ms] after whole cycles of a clock that is faster by ``drift``."""

    def off_beat(due: int) -> float:
        cycle = CYCLE / (1.0 + drift)
        late = (beat * MS - due) % cycle
        return (late - cycle if late > cycle / 2 else late) * 1e-9

    pacer = RealTimePacer(0.012, off_beat=off_beat, clock=clock, sleep=clock.sleep)
    with pacer.running():
        return pacer


@pytest.mark.parametrize("beat", [0.0, 1.0, 4.9, 5.1, 11.9])
def test_the_first_tick_is_put_where_the_robots_cycle_wants_it(beat: float) -> None:
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
    pacer = RealTimePacer(
        0.012,
        off_beat=lambda due: ((beat[0] * MS - due + CYCLE / 2) % CYCLE - CYCLE / 2) * 1e-9,
        clock=clock,
        sleep=clock.sleep,
    )
    with pacer.running():
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


@pytest.mark.parametrize("off", [-2e-6, 0.0, 2e-6])
def test_short_runs_one_after_the_other_keep_a_robots_beat(off: float) -> None:
    """To be a little late for it is no reason to wait for the next."""
    clock = FakeClock()
    pacer = RealTimePacer(0.012, off_beat=lambda _: off, clock=clock, sleep=clock.sleep)
    begins = []
    for _ in range(20):
        with pacer.running():
            for _ in range(3):
                assert pacer.wait() == 0
                begins.append(started(pacer))
                clock.work(MS)
    assert {b - a for a, b in pairwise(begins)} == {CYCLE + round(off * 1e9)}
