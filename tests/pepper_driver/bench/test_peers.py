"""The controller compared with those of other projects: all do the same task, or their times say nothing."""

import importlib.util
import json
import sys
from pathlib import Path

import pytest

from pepper_driver.bench import peers
from pepper_driver.bench.peers import run_peer_bench
from pepper_driver.cli.app import run

PEERS = all(importlib.util.find_spec(name) for name in ("pink", "mink"))


def test_our_controller_alone_is_measured() -> None:
    fractions: list[float] = []
    result = run_peer_bench(6.0, peers=False, on_progress=fractions.append)
    assert result.ticks == 600
    assert fractions == [0.5, 1.0]
    assert set(result.times) == {"ours", "ours_with_bodies"}
    ours = result.times["ours"]
    assert 0 < ours.median <= ours.p99
    assert ours.ratio == 1.0
    assert ours.turns == (1.0, 1.0)
    assert 0 <= ours.error < 0.01
    assert all(times.reached for times in result.times.values())
    figures = result.as_json()
    assert set(figures["ratio"]) == {"ours_with_bodies"}
    assert figures["cpu"]
    assert {"python", "numpy", "pin", "daqp"} <= set(figures["versions"])


@pytest.mark.skipif(not PEERS, reason="needs the peers extra")
def test_the_peers_are_measured_next_to_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "figures.json"
    assert run(["bench", "--peers", "--seconds", "4", "--json", str(path)]) == 0
    shown = capsys.readouterr().out
    figures = json.loads(path.read_text())
    assert set(figures["controller_us"]) == {"ours", "ours_with_bodies", "pink", "mink"}
    assert {"pink", "mink"} <= set(figures["ratio"])
    assert max(figures["largest_error_mm"].values()) < 10
    assert {"mink", "pin-pink"} <= set(figures["versions"])
    assert all(name in shown for name in figures["controller_us"])


@pytest.mark.skipif(not PEERS, reason="needs the peers extra")
def test_times_of_a_controller_that_does_not_work_are_a_failure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(peers.Mink, "aim", lambda self, poses: None)
    assert run(["bench", "--peers", "--seconds", "2"]) == 1
    assert "failed: mink: " in capsys.readouterr().out


def test_a_missing_peer_is_named_with_the_way_to_get_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "mink", None)
    monkeypatch.setitem(sys.modules, "pink", None)
    assert run(["bench", "--peers"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith('needs an optional part: pip install "pepper-driver[peers]"')
