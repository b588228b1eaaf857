"""Commands and the cycles of the robot that they are for; the command that a sample answers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.naoqi.timing import RECOVERY_COMMANDS, CommandScheduler, Cycles

LEAD = 24.0


def test_dates_and_numbers() -> None:
    cycles = Cycles(12.0, 1000)
    assert [cycles.number(date) for date in (994, 1000, 1005, 1007, 1120)] == [0, 0, 0, 1, 10]
    assert [cycles.date(number) for number in (0, 1, 100)] == [1000, 1012, 2200]
    assert cycles.since(1012.0) == 0.0
    assert cycles.since(1011.5) == 11.5
    assert cycles.see(1012) == 1
    assert cycles.date(0) == 1000, "dates on the grid leave it where it is"


@pytest.mark.parametrize("length", [11.95, 12.0, 12.05])
def test_the_grid_follows_a_robot_whose_cycle_is_not_quite_that_long(length: float) -> None:
    rng = np.random.default_rng(0)
    cycles = Cycles(12.0, 0)
    for number in range(20_000):
        date = round(number * length + rng.uniform(-1.0, 1.0))
        assert cycles.see(date) == number
        assert abs(cycles.date(number) - number * length) < 3.0


def numbers(ticks: list[float], cycles: Cycles, scheduler: CommandScheduler) -> list[int | None]:
    return [scheduler.next(tick) for tick in ticks]


def test_every_tick_has_its_own_cycle() -> None:
    cycles = Cycles(12.0, 0)
    given_ = numbers(
        [8.7 + 12.0 * n for n in range(1000)], cycles, CommandScheduler(cycles, LEAD, 3)
    )
    assert given_ == list(range(3, 1003))  # 27 ms ahead: the first that are 24 ms away


@pytest.mark.parametrize("phase", [0.0, 3.0, 6.1, 8.7, 11.9])
def test_the_phase_at_which_commands_begin_does_not_stay(phase: float) -> None:
    """A tick of ramps, then those of the loop, which follow the robot."""
    cycles = Cycles(12.0, 0)
    scheduler = CommandScheduler(cycles, LEAD, 3)
    given_ = numbers([phase, *(8.7 + 12.0 * n for n in range(1, 1000))], cycles, scheduler)
    assert given_[-1] == 999 + 3
    assert sum(number is None for number in given_) <= 1


def test_ticks_late_by_less_than_most_of_a_cycle_change_nothing() -> None:
    rng = np.random.default_rng(0)
    cycles = Cycles(12.0, 0)
    ticks = [7.0 + 12.0 * n + rng.uniform(0.0, 8.0) for n in range(300)]
    ticks[0] = 7.0
    assert numbers(ticks, cycles, CommandScheduler(cycles, LEAD, 3)) == list(range(3, 303))


def test_a_tick_that_comes_very_late_costs_a_cycle_for_some_seconds() -> None:
    cycles = Cycles(12.0, 0)
    ticks = [7.0 + 12.0 * n + (9.0 if n == 50 else 0.0) for n in range(1000)]
    given_ = numbers(ticks, cycles, CommandScheduler(cycles, LEAD, 3))
    assert given_[:50] == list(range(3, 53))
    left_out = 51 + RECOVERY_COMMANDS - 1
    assert given_[50:left_out] == list(range(54, 54 + left_out - 50))
    assert given_[left_out] is None
    assert given_[left_out + 1 :] == list(range(left_out + 1 + 3, 1003))


def test_ticks_that_often_come_late_keep_the_cycle() -> None:
    cycles = Cycles(12.0, 0)
    ticks = [7.0 + 12.0 * n + (9.0 if n % 100 == 50 else 0.0) for n in range(5000)]
    given_ = numbers(ticks, cycles, CommandScheduler(cycles, LEAD, 3))
    assert given_[50:] == list(range(54, 5004))


@given(
    drift=st.floats(-1e-3, 1e-3),
    lead=st.floats(24.0, 60.0),
    phase=st.floats(0.0, 12.0),
    missed=st.sets(st.integers(5, 290), max_size=20),
)
def test_the_lead_is_kept_whatever_drifts_and_is_missed(
    drift: float, lead: float, phase: float, missed: set[int]
) -> None:
    cycles = Cycles(12.0, 0)
    scheduler = CommandScheduler(cycles, lead, 3)
    last = None
    for tick in range(300):
        if tick in missed:
            continue
        now = phase + 12.0 * tick * (1.0 + drift)
        number = scheduler.next(now)
        if number is None:
            assert last is not None
            assert 12.0 * last - now >= lead, "the one before is not too early for the next either"
            continue
        assert lead - 3.0 <= 12.0 * number - now <= lead + 24.0
        assert last is None or number > last, "no two commands for one cycle"
        last = number


def test_commands_left_out_are_rare_and_nothing_else_jumps() -> None:
    """The computer's clock is faster by 100 ppm: in an hour it is thirty cycles ahead."""
    cycles = Cycles(12.0, 0)
    ticks = [12.0 * n * (1 - 1e-4) for n in range(300_000)]
    given_ = numbers(ticks, cycles, CommandScheduler(cycles, 24, 3))
    assert sum(number is None for number in given_) == pytest.approx(30, abs=1)
    kept = [number for number in given_ if number is not None]
    assert set(np.diff(kept).tolist()) == {1}


def test_a_sample_answers_the_command_that_was_to_be_reached_the_delay_before() -> None:
    cycles = Cycles(12.0, 0)
    scheduler = CommandScheduler(cycles, LEAD, 3)
    for step, cycle in enumerate(range(10, 20)):
        scheduler.note_command(step, cycle, sent=cycle not in (13, 14, 17))
    answered = [scheduler.answers(10, sample) for sample in range(12, 24)]
    # Of two in a row that were not sent the DCM knows nothing; a single one lies on its straight line.
    assert answered == [None, 10, 9, 8, 8, 8, 5, 4, 3, 2, 1, 1]
    scheduler.refused(12)
    assert scheduler.answers(10, 15) == 9, "what the robot refused it does not answer"


def test_only_the_last_seconds_commands_are_remembered() -> None:
    cycles = Cycles(12.0, 0)
    scheduler = CommandScheduler(cycles, LEAD, 3)
    for step in range(1000):
        scheduler.note_command(step, step, sent=True)
    assert scheduler.answers(1000, 900 + 3) == 100
    assert scheduler.answers(1000, 100) is None
