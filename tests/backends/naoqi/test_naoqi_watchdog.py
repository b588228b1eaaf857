"""Age of what is known of the robot."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.naoqi.dcm_channel import sample_age

CYCLE = 0.012
HOUR = 3600.0


@pytest.mark.parametrize(
    ("late", "since", "unacknowledged_time", "watched", "age"),
    [
        (0, 0.019, 0.0, HOUR, 0.0),
        (2, 0.043, 0.0, HOUR, 0.024),
        (4, 0.067, 0.0, HOUR, 0.048),
        (5, 0.079, 0.0, HOUR, 0.079),
        (0, 0.019, 0.024, HOUR, 0.0),
        (0, 0.019, 0.090, HOUR, 0.090),
        (9, 0.127, 0.090, HOUR, 0.127),
        (9, 0.127, 0.090, 0.0, 0.012),
        (9, 0.127, 0.090, 0.024, 0.036),
    ],
)
def test_ages(
    late: int, since: float, unacknowledged_time: float, watched: float, age: float
) -> None:
    found = sample_age(
        late, since=since, unacknowledged_time=unacknowledged_time, watched=watched, cycle=CYCLE
    )
    assert found == pytest.approx(age)


REQUESTED = st.floats(0.0072, 0.0145)
"""[s] from the cycle of a sample that was requested before its tick to the tick."""

UNREQUESTED = st.floats(0.019, 0.024)
"""The same of one that was asked for in the tick before."""


@given(phase=REQUESTED | UNREQUESTED)
def test_a_robot_that_falls_silent_is_held_first_and_stopped_100_ms_after_its_last_sample(
    phase: float,
) -> None:
    """The gate looks once a cycle; the last sample was taken in tick 0."""
    ages = [
        sample_age(
            tick, since=CYCLE * tick + phase, unacknowledged_time=0.0, watched=HOUR, cycle=CYCLE
        )
        for tick in range(12)
    ]
    held = next(tick for tick, age in enumerate(ages) if age > 0.080)
    stopped = next(tick for tick, age in enumerate(ages) if age > 0.100)
    assert held < stopped
    assert 0.070 < stopped * CYCLE <= 0.100
