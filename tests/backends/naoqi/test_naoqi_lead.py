"""The time by which commands are sent ahead, and ways that are too slow."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.backends.naoqi.timing import RoundTrips, SlowLinkError, measure
from pepper_driver.config import load_naoqi_settings

TIMING = load_naoqi_settings().timing


class Way:
    """Calls, each with a newly drawn time."""

    def __init__(self, draw: Callable[[], float]) -> None:
        self._draw, self.now, self.calls = draw, 0.0, 0

    def ask(self) -> int:
        self.calls += 1
        self.now += self._draw()
        return round(self.now)

    def clock(self) -> int:
        return round(self.now * 1e6)

    def measure(self) -> RoundTrips:
        return measure(self.ask, TIMING, "naoqi://here", clock=self.clock)[0]


RNG = np.random.default_rng(0)


def test_a_cable_needs_two_cycles() -> None:
    way = Way(lambda: 0.4 + RNG.exponential(0.2))
    trips = way.measure()
    assert 0.4 < 1e3 * trips.median < 0.8
    assert trips.lead(TIMING) == 0.024
    assert 1e-3 * way.now == pytest.approx(TIMING.burst, abs=0.05)


def test_the_lead_is_the_jitter_and_a_cycle() -> None:
    trips = Way(lambda: 2.0 + RNG.uniform(0.0, 16.0)).measure()
    assert trips.jitter == pytest.approx(0.0155, abs=0.0015)
    assert trips.lead(TIMING) == pytest.approx(trips.jitter + 0.012)


def test_rare_stalls_of_a_wireless_way_are_borne() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        times = 3.0 + rng.exponential(2.0, 1000) + 60.0 * (rng.random(1000) < 0.003)
        trips = Way(iter(times.tolist()).__next__).measure()
        assert trips.lead(TIMING) < TIMING.max_lead_time


def test_a_way_too_slow_is_refused_with_the_remedy() -> None:
    with pytest.raises(SlowLinkError, match=r"takes 2\d ms or more.*at most 20 ms.*cable"):
        Way(lambda: 21.0 + RNG.uniform(0.0, 3.0)).measure()


def test_a_way_that_varies_too_much_is_refused_where_a_slow_call_is_allowed() -> None:
    patient = replace(TIMING, max_round_trip=1.0)
    way = Way(lambda: 1.0 + RNG.uniform(0.0, 70.0))
    with pytest.raises(SlowLinkError, match=r"vary by \d+ ms.*at most 60 ms.*cable"):
        measure(way.ask, patient, "naoqi://here", clock=way.clock)


def test_one_bad_moment_is_no_reason_to_refuse() -> None:
    way = Way(iter([*[100.0] * 4, *[0.5] * 5000]).__next__)
    assert way.measure().p99 < 0.001


def test_it_does_not_measure_for_ever() -> None:
    way = Way(lambda: 500.0)
    with pytest.raises(SlowLinkError):
        way.measure()
    assert way.calls <= 3 * 6
