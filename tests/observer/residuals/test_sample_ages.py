"""Ages of samples over NAOqi, as the observer counts them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.naoqi.dcm_channel import sample_age
from pepper_driver.observer.residuals.prediction import MAX_LATE_TICKS

CYCLE = 0.012

PHASE = st.floats(0.0072, 0.0145) | st.floats(0.019, 0.024)
"""[s] from the cycle of a sample to the tick: of one requested before the tick, and of one asked for in the last."""


@given(late=st.integers(0, MAX_LATE_TICKS), phase=PHASE)
def test_as_long_as_the_observer_counts_ages_are_whole_cycles(late: int, phase: float) -> None:
    since = phase + late * CYCLE
    age = sample_age(late, since=since, unacknowledged_time=0.0, watched=3600.0, cycle=CYCLE)
    assert age / CYCLE == pytest.approx(late)
