"""Robot-hours in a core-hour: time of a robot over processor time."""

import os

import pytest

from pepper_driver.bench import throughput
from pepper_driver.bench.throughput import run_throughput_bench


@pytest.mark.whole
def test_both_are_faster_than_a_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(throughput, "RUNS", 1)
    figures = run_throughput_bench().as_json()["robot_hours_per_core_hour"]
    assert set(figures) == {"identify", "evaluate"}
    assert min(figures.values()) > 1.0


def test_the_best_of_the_runs_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of 60 s of a robot that take 20, 10, 30, 15 and 12 s of a processor; waiting does not count."""
    clock = iter(
        [0, 20, 20, 40, 40, 50, 50, 60, 60, 90, 90, 120, 120, 135, 135, 150, 150, 162, 162, 174]
    )
    monkeypatch.setattr(throughput, "_identify", lambda: 60.0)
    monkeypatch.setattr(throughput, "_evaluate", lambda: 90.0)
    monkeypatch.setattr(os, "times", lambda: (float(next(clock)), 0.0, 0.0, 0.0, 1e9))
    fractions: list[float] = []
    result = run_throughput_bench(on_progress=fractions.append)
    assert (result.identify, result.evaluate) == (6.0, 9.0)
    assert fractions == pytest.approx([tenth / 10 for tenth in range(1, 11)])
