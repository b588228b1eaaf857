"""The sample that a tick gets."""

from typing import cast

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.naoqi.memory_keys import Values
from pepper_driver.backends.naoqi.timing import JitterBuffer

SOONER_OR_LATER = 20
"""[ticks] between two new counts, at least on average."""


def sample(cycle: int) -> Values:
    return cast("Values", cycle)


def play(arrivals: list[list[int]], elapsed: list[float] | None = None) -> list[tuple[int, int]]:
    """(cycle, cycle of the sample) of each tick, before which samples of these cycles arrive."""
    buffer, newest, found = JitterBuffer(12.0, sample(0)), 0, []
    for tick, cycles in enumerate(arrivals):
        for cycle in cycles:
            buffer.add(cycle, sample(cycle))
            newest = cycle
        # Ticks begin 19 ms after the cycle that they are of.
        buffer.step(12.0 if elapsed is None else elapsed[tick], 12.0 * (tick + 1 - newest) + 19.0)
        assert buffer.late == buffer.cycle - cast("int", buffer.sample)
        found.append((buffer.cycle, cast("int", buffer.sample)))
    return found


def test_regular_samples_are_each_of_their_tick() -> None:
    assert play([[n] for n in range(1, 50)]) == [(n, n) for n in range(1, 50)]


def test_an_early_sample_waits_and_a_missing_one_is_reported() -> None:
    arrivals = [[1], [2], [4], [], [5], [6]]
    assert play(arrivals) == [(1, 1), (2, 2), (3, 2), (4, 4), (5, 5), (6, 6)]


def test_cycles_go_on_while_nothing_comes() -> None:
    assert play([[1], [2], [], [], [], [6]]) == [(1, 1), (2, 2), (3, 2), (4, 2), (5, 2), (6, 6)]


def test_a_missed_tick_counts_and_a_late_one_does_not() -> None:
    assert [c for c, _ in play([[1], [2], [4], [5]], [12.0, 12.0, 24.0, 12.0])] == [1, 2, 4, 5]
    assert [c for c, _ in play([[1], [2], [3], [4]], [12.0, 19.0, 5.0, 12.0])] == [1, 2, 3, 4]


def test_what_comes_late_or_early_for_long_is_usual() -> None:
    late = play([[n] for n in range(1, 20)] + [[n] for n in range(18, 118)])
    assert late[-1][0] == late[-1][1]
    assert late[25][0] - late[25][1] == 0 or late[25][0] - late[25][1] == 2
    early = play([[n] for n in range(1, 20)] + [[n] for n in range(22, 50)])
    assert early[-1] == (49, 49)


def test_ticks_without_pauses_do_not_run_ahead_of_the_robot() -> None:
    buffer = JitterBuffer(12.0, sample(0))
    for _ in range(100):
        buffer.step(0.01, 5.0)
        assert buffer.late <= 1


@given(delays=st.lists(st.sampled_from([0, 0, 0, 0, 0, 0, 0, -1, 1, 2, 6, None]), max_size=300))
def test_on_a_bad_way_samples_are_of_their_tick_or_before_and_time_goes_on(
    delays: list[int | None],
) -> None:
    """The sample of each cycle comes with its tick, one before, some later, or never."""
    arrivals: list[list[int]] = [[] for _ in delays]
    for cycle, delay in enumerate(delays, start=1):
        if delay is not None and 0 <= cycle - 1 + delay < len(arrivals):
            arrivals[cycle - 1 + delay].append(cycle)
    newest = 0
    for tick, cycles in enumerate(arrivals):
        arrivals[tick] = [max(cycles)] if cycles and max(cycles) > newest else []
        newest = max([newest, *cycles])
    found = play(arrivals)
    assert all(of <= cycle for cycle, of in found)
    cycles_ = np.array([cycle for cycle, _ in found])
    on_time = np.arange(1, len(found) + 1)
    assert (np.abs(cycles_ - on_time) <= 6).all()
    assert np.count_nonzero(np.diff(cycles_) < 1) <= 1 + len(found) / SOONER_OR_LATER
    assert np.count_nonzero(np.diff(cycles_) > 1) <= 1 + len(found) / SOONER_OR_LATER
