"""A long run of the plant, made short: what it says of it is so."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pepper_driver.backends import make_backend
from pepper_driver.backends.mujoco_.simulation import MujocoTruth
from pepper_driver.bench.soak import GOAL_PERIOD, run_soak
from pepper_driver.cli.app import app


def test_the_shipped_plant_stays_finite_and_quiet() -> None:
    fractions: list[float] = []
    result = run_soak("mujoco", 4 * GOAL_PERIOD, seed=3, on_progress=fractions.append)
    assert result.finite
    assert not result.fallen
    assert result.seconds == pytest.approx(4 * GOAL_PERIOD, abs=0.02)
    # Arms of a few kilograms at no more than a few radians per second: some joules, never tens.
    assert all(0.001 < energy < 10.0 for energy in result.largest_energy)
    assert fractions == sorted(fractions)
    assert len(fractions) >= 4
    plant = make_backend("mujoco").plant.config
    assert plant is not None
    start = plant.battery.charge
    assert 0.99 * start < result.charge < start


def test_the_energy_is_that_of_the_bodies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each quarter reports its own largest value."""
    values = iter(range(10_000))
    monkeypatch.setattr(MujocoTruth, "kinetic_energy", property(lambda self: float(next(values))))
    ticks = round(GOAL_PERIOD / 0.012)
    largest = run_soak("mujoco://?plant=nominal", GOAL_PERIOD, seed=3).largest_energy
    assert largest == tuple(float(-(-ticks * quarter // 4) - 1) for quarter in (1, 2, 3, 4))


def test_equal_seeds_give_equal_runs() -> None:
    first, again, other = (run_soak("mujoco", GOAL_PERIOD, seed=seed) for seed in (1, 1, 2))
    assert first.largest_energy == again.largest_energy != other.largest_energy


def test_the_command_writes_what_it_measured(tmp_path: Path) -> None:
    out = tmp_path / "soak.json"
    result = CliRunner().invoke(app, ["bench", "--soak", "60", "--json", str(out)])
    assert result.exit_code == 0, result.output
    assert "all finite, stands" in " ".join(result.output.split())
    soak = json.loads(out.read_text())["soak"]
    assert soak["finite"] is True
    assert len(soak["largest_energy"]) == 4
