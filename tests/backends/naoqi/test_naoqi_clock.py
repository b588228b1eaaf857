"""The DCM's clock as the client knows it: roll-over, drift, jitter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.naoqi.timing import SPAN, DcmClockEstimate, TimeReply, dated, shown

COUNT = st.integers(-(2**40), 2**40)


@given(date=COUNT)
def test_what_the_clock_shows_has_32_bits_and_the_same_residue(date: int) -> None:
    assert -(2**31) <= shown(date) < 2**31
    assert (shown(date) - date) % SPAN == 0


@given(date=COUNT, error=st.integers(-(2**31) + 2, 2**31 - 2))
def test_a_date_is_found_again_from_anywhere_near(date: int, error: int) -> None:
    assert dated(shown(date), date + error) == date


def test_the_roll_over() -> None:
    assert [shown(2**31 + ms) for ms in (-1, 0, 1)] == [2**31 - 1, -(2**31), -(2**31) + 1]
    assert dated(-(2**31), 2**31 - 3.7) == 2**31


def reply(here: float, way: float, back: float, true: float) -> TimeReply:
    """Asked at ``here`` [ms], read by the robot after ``way`` as ``true`` [ms], received after ``back`` more."""
    return TimeReply(
        asked=round(here * 1e6),
        received=round((here + way + back) * 1e6),
        shown=shown(int(np.floor(true))),
    )


@pytest.mark.parametrize("drift", [100e-6, -100e-6, 0.0])
@pytest.mark.parametrize("origin", [0, 2**31 - 1_800_000, -5])
@pytest.mark.parametrize(("jitter", "worst"), [(0.1, 1.0), (1.0, 2.0), (5.0, 5.0)])
def test_an_hour_of_drift_and_jitter(
    drift: float, origin: int, jitter: float, worst: float
) -> None:
    """A question a second; half of the hour in, the clock rolls over."""
    rng = np.random.default_rng(0)
    ways = 0.2 + rng.exponential(jitter, (3600, 2))

    def true(here: float) -> float:
        return origin + here * (1.0 + drift)

    clock, errors = None, []
    for second, (way, back) in enumerate(ways):
        here = 1000.0 * second
        answer = reply(here, way, back, true(here + way))
        if clock is None:
            clock = DcmClockEstimate(answer)
        else:
            clock.add(answer)
        later = here + 999.0
        errors.append(clock.now(round(later * 1e6)) - true(later))
    assert clock is not None
    # Counted from what it showed first: whole turns more or less do not matter.
    assert np.abs(errors).max() < worst
    assert clock.date(shown(int(true(later)) - 15), round(later * 1e6)) == int(true(later)) - 15


def test_a_quick_answer_counts_more_than_a_slow_one_and_a_new_one_more_than_an_old_one() -> None:
    clock = DcmClockEstimate(reply(0.0, 0.1, 0.1, 500.0))
    clock.add(reply(1000.0, 30.0, 0.1, 1530.0 + 25.0))
    assert clock.now(1_100_000_000) == pytest.approx(1600.0, abs=1.0)
    for second in range(2, 20):
        clock.add(reply(1000.0 * second, 1.0, 1.0, 503.0 + 1000.0 * second))
    assert clock.now(30_000_000_000) == pytest.approx(30_502.0, abs=1.0)
