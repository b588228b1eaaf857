"""Start-up and memory: of new processes, and nothing of the process that measures."""

import sys

import numpy as np
import pytest

from pepper_driver.bench import startup
from pepper_driver.bench.startup import StartupError, run_startup_bench


def test_the_memory_is_not_that_of_the_process_that_measures(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(startup, "RUNS", 1)
    ballast = np.ones(80_000_000)  # 640 MB
    fractions: list[float] = []
    result = run_startup_bench(on_progress=fractions.append)
    assert fractions == [1.0]
    assert 50.0 < result.memory_mb < 1e-6 * ballast.nbytes
    assert 0.01 < result.cli_help_s < result.import_s, "help needs no numerics"
    assert 0.0 < result.start_s < 60.0


def test_a_process_that_fails_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(startup, "_PROGRAM", "raise OSError('no room')")
    with pytest.raises(StartupError, match="no room"):
        run_startup_bench()
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with pytest.raises(StartupError, match="/nowhere/python"):
        run_startup_bench()
