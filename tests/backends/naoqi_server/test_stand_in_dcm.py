"""The DCM of the stand-in against NAOqi's documentation: its two examples, its rules, its clock that rolls over."""

import random
import time
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends import BackendError
from pepper_driver.backends.naoqi_server.dcm import (
    BUFFER,
    SPAN,
    UPDATE_TYPES,
    BufferFullError,
    Dcm,
    DcmClock,
    TimedCommand,
    UpdateType,
    unwrapped,
    wrapped,
)

KEY, OTHER = "HeadYaw/Position/Actuator/Value", "HeadPitch/Position/Actuator/Value"

values = st.floats(-10.0, 10.0).map(lambda value: round(value, 3))
commands = st.lists(st.tuples(values, st.integers(-50, 400)), max_size=6)
orders = st.lists(
    st.tuples(st.integers(0, 30), st.sampled_from(UPDATE_TYPES), commands), max_size=8
)
Order = tuple[int, UpdateType, Sequence[TimedCommand]]


def played(given_orders: Sequence[Order], *, origin: int = 0, cycle: int = 12) -> list[float]:
    """Values sent to one actuator in 30 cycles from ``origin`` on; orders (cycle, type, commands) come before one."""
    dcm = Dcm({KEY: 0.0}, origin)
    sent = []
    for number in range(1, 31):
        now = origin + number * cycle
        for when, update, its in given_orders:
            if when == number:
                dated = [(value, wrapped(origin + date)) for value, date in its]
                dcm.order([KEY], update, [dated], now - cycle // 2)
        sent.append(dcm.advance(now)[0])
    return sent


def test_first_example_of_the_documentation() -> None:
    """ "DCM advanced": a command (10 ms, 10) is over when (80 ms, 40) arrives; cycles of 10 ms."""
    sent = played([(1, "Merge", [(10.0, 10)]), (3, "Merge", [(40.0, 80)])], cycle=10)
    assert sent[:2] == [10.0, 10.0]
    assert sent[2:8] == [15.0, 20.0, 25.0, 30.0, 35.0, 40.0]
    assert set(sent[8:]) == {40.0}


def test_second_example_of_the_documentation() -> None:
    its = [(10.0, 15), (30.0, 25), (20.0, 45), (0.0, 65)]
    sent = played([(1, "ClearAll", its)], cycle=10)
    assert sent[0] == pytest.approx(6.67, abs=0.005)
    assert sent[1:6] == [20.0, 27.5, 22.5, 15.0, 5.0]
    assert set(sent[6:]) == {0.0}


def documented(its: Sequence[TimedCommand], cycle: int) -> list[float]:
    """The algorithm that "DCM advanced" prints, for commands that come before the first cycle."""
    waiting = sorted((date, value) for value, date in its)
    sent = last_value = 0.0
    last_time = last_cycle = 0
    shown = []
    for now in range(cycle, 31 * cycle, cycle):
        going = True
        while going and waiting:
            date, value = waiting[0]
            going = date < now
            if date <= now:
                sent = last_value = value
                last_time = date
                waiting.pop(0)
            else:
                start, begin = (sent, last_cycle)
                if last_cycle < last_time:
                    start, begin = (last_value, last_time)
                sent = (value - start) * (now - begin) / (date - begin) + start
        last_cycle = now
        shown.append(sent)
    return shown


@given(by_date=st.dictionaries(st.integers(-50, 400), values, max_size=12))
def test_it_is_the_algorithm_of_the_documentation(by_date: dict[int, float]) -> None:
    its = [(value, date) for date, value in by_date.items()]
    assert played([(1, "Merge", its)]) == pytest.approx(documented(its, 12), abs=1e-9)


@pytest.mark.parametrize("origin", [2**31 - 100, 2**32 - 100, -(2**31) - 1, 5 * 2**31 - 180])
@given(given_orders=orders)
def test_the_clock_rolls_over_without_a_trace(origin: int, given_orders: Sequence[Order]) -> None:
    assert played(given_orders, origin=origin) == played(given_orders)


@given(given_orders=orders)
def test_nothing_beyond_what_was_ordered_is_sent(given_orders: Sequence[Order]) -> None:
    commanded = [0.0] + [value for _, _, its in given_orders for value, _ in its]
    for value in played(given_orders):
        assert min(commanded) - 1e-9 <= value <= max(commanded) + 1e-9


@given(its=commands.filter(bool), update=st.sampled_from(UPDATE_TYPES))
def test_the_last_value_is_kept(its: list[TimedCommand], update: UpdateType) -> None:
    latest = max(date for _, date in its)
    last = [value for value, date in its if date == latest][-1]
    sent = played([(1, update, its)], cycle=20)
    assert sent[latest // 20 + 1 :] == [last] * len(sent[latest // 20 + 1 :])


@given(its=commands)
def test_a_command_is_reached_exactly_where_a_cycle_falls_on_it(its: list[TimedCommand]) -> None:
    sent = played([(1, "Merge", its)])
    by_date = {date: value for value, date in its}
    for number, value in enumerate(sent, 1):
        if number * 12 in by_date:
            assert value == by_date[number * 12]


@given(its=commands, shuffle=st.randoms())
def test_the_order_within_a_request_does_not_matter(
    its: list[TimedCommand], shuffle: random.Random
) -> None:
    its = [(value, date) for date, value in {date: value for value, date in its}.items()]
    shuffled = list(its)
    shuffle.shuffle(shuffled)
    assert played([(1, "Merge", shuffled)]) == played([(1, "Merge", its)])


def test_what_each_update_type_leaves() -> None:
    """Commands at 100, 200 and 300 wait; new ones come at 150 and 250."""
    old, new = [(1.0, 100), (2.0, 200), (3.0, 300)], [(8.0, 150), (9.0, 250)]
    expected = {
        "Merge": {100: 1.0, 150: 8.0, 200: 2.0, 250: 9.0, 300: 3.0},
        "ClearAll": {150: 8.0, 250: 9.0},
        "ClearAfter": {100: 1.0, 150: 8.0, 250: 9.0},  # deleted: after the first new one
        "ClearBefore": {150: 8.0, 250: 9.0, 300: 3.0},  # deleted: before the last new one
    }
    for update in UPDATE_TYPES:
        dcm = Dcm({KEY: 0.0}, 0)
        dcm.order([KEY], "Merge", [old], 0)
        dcm.order([KEY], update, [new[::-1]], 0)
        assert dcm.actuators[KEY].waiting == expected[update]


def test_orders_without_commands() -> None:
    for update in UPDATE_TYPES:
        dcm = Dcm({KEY: 0.0}, 0)
        dcm.order([KEY], "Merge", [[(1.0, 100)]], 0)
        half = dcm.advance(50)
        dcm.order([KEY], update, [[]], 50)
        expected = [0.5] if update == "ClearAll" else [1.0]  # stops, and keeps what was sent
        assert (half, dcm.advance(200)) == ([0.5], expected)


def test_of_two_commands_at_one_date_the_later_order_counts() -> None:
    for update in UPDATE_TYPES:
        dcm = Dcm({KEY: 0.0}, 0)
        dcm.order([KEY], "Merge", [[(1.0, 100)]], 0)
        dcm.order([KEY], update, [[(5.0, 100), (2.0, 100)]], 0)
        assert dcm.actuators[KEY].waiting == {100: 2.0}


def test_a_command_of_the_past_is_applied_at_the_next_cycle() -> None:
    dcm = Dcm({KEY: 0.0}, 0)
    dcm.advance(1000)
    dcm.order([KEY], "Merge", [[(3.0, 500), (4.0, 600)]], 1001)
    assert [dcm.advance(1012), dcm.advance(1024)] == [[4.0], [4.0]]


def test_actuators_that_step() -> None:
    dcm = Dcm({KEY: 0.0, OTHER: 0.0}, 0, steps={KEY})
    dcm.order([KEY, OTHER], "Merge", [[(1.0, 30)], [(1.0, 30)]], 0)
    assert [dcm.advance(date) for date in (10, 20, 30, 40)] == [
        [0.0, pytest.approx(1 / 3)],
        [0.0, pytest.approx(2 / 3)],
        [1.0, 1.0],
        [1.0, 1.0],
    ]


def test_a_full_buffer_refuses_the_whole_request() -> None:
    dcm = Dcm({KEY: 0.0, OTHER: 0.0}, 0)
    dcm.order([KEY], "Merge", [[(1.0, 1000 + n) for n in range(BUFFER)]], 0)
    with pytest.raises(BufferFullError, match=rf"513 commands .* {KEY}, .* 512"):
        dcm.order([OTHER, KEY], "Merge", [[(1.0, 10)], [(1.0, 10)]], 0)
    assert dcm.actuators[OTHER].waiting == {}
    assert len(dcm.actuators[KEY].waiting) == BUFFER
    dcm.order([KEY], "Merge", [[(2.0, 1000)]], 0)  # in the place of another
    dcm.order([KEY], "ClearAll", [[(1.0, 10)]], 0)
    assert dcm.actuators[KEY].waiting == {10: 1.0}


def test_what_no_board_would_take_is_refused() -> None:
    dcm = Dcm({KEY: 0.0}, 0)
    for keys, value in (([KEY, "Tail"], 1.0), ([KEY], float("nan")), ([KEY], float("inf"))):
        with pytest.raises(BackendError, match=keys[-1]):
            dcm.order(keys, "Merge", [[(value, 10)]] * len(keys), 0)
    assert dcm.actuators[KEY].waiting == {}


def test_an_actuator_twice_in_a_request_takes_both() -> None:
    dcm = Dcm({KEY: 0.0}, 0)
    dcm.order([KEY, KEY], "Merge", [[(1.0, 10)], [(2.0, 20)]], 0)
    assert dcm.actuators[KEY].waiting == {10: 1.0, 20: 2.0}


@given(count=st.integers(-(2**40), 2**40), away=st.integers(-(2**31), 2**31 - 1))
def test_the_clock_shows_32_bits(count: int, away: int) -> None:
    assert -(2**31) <= wrapped(count) < 2**31
    assert (wrapped(count) - count) % SPAN == 0
    assert unwrapped(wrapped(count + away), count) == count + away


def test_the_clock_goes_on_from_its_origin() -> None:
    before = time.monotonic_ns()
    clock = DcmClock(begin=before, origin=2**31 - 1)
    assert clock.shown in (2**31 - 1, *range(-(2**31), -(2**31) + 1000))
    assert clock.count - 2**31 + 1 <= (time.monotonic_ns() - before) // 1_000_000
