"""The benchmarks run and say what they measure; how fast anything is, they do not test."""

from __future__ import annotations

import importlib.util
import json
import os
import runpy
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from stand_ins import patient_driver

CONTROLLER = Path(__file__).parents[1] / "benchmarks" / "controller.py"
PEERS = all(importlib.util.find_spec(name) for name in ("pink", "mink"))


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(CONTROLLER), *arguments], capture_output=True, text=True, check=False
    )


def test_the_controller_alone_is_measured(tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    result = run("--without-peers", "--ticks", "150", "--rounds", "2", "--json", str(figures))
    assert result.returncode == 0, result.stderr
    assert "ours" in result.stdout
    document = json.loads(figures.read_text())
    assert set(document["controller_us"]) == {"ours", "ours_with_bodies"}
    assert (
        0 < document["controller_us"]["ours"]["median"] <= document["controller_us"]["ours"]["p99"]
    )
    assert set(document["ratio"]) == {"ours_with_bodies"}
    assert document["ticks"] == 300
    assert 0 <= document["largest_error_mm"]["ours"] < 10
    assert document["cpu"]
    assert {"python", "numpy", "pin", "daqp"} <= set(document["versions"])


@pytest.mark.skipif(not PEERS, reason="needs the peers extra")
def test_the_peers_are_measured_beside_it(tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    result = run("--ticks", "150", "--rounds", "2", "--json", str(figures))
    assert result.returncode == 0, result.stderr
    document = json.loads(figures.read_text())
    assert set(document["controller_us"]) == {
        "ours",
        "ours_with_bodies",
        "pink",
        "mink",
    }
    assert {"pink", "mink"} <= set(document["ratio"])
    assert max(document["largest_error_mm"].values()) < 10


@pytest.mark.skipif(PEERS, reason="the peers are there")
def test_a_missing_peer_is_named_with_the_way_to_get_it() -> None:
    assert_refused("peers")


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--ticks", "many"], "--ticks"),
        (["--ticks", "0"], "--ticks"),
        (["--ticks", "-5", "--rounds", "-60"], "--ticks"),
        (["--ticks", "10", "--rounds", "2"], "--ticks"),
        (["--peers"], "--peers"),
        (["--json", "no/such/folder/figures.json"], "no/such/folder"),
        (["--json", str(CONTROLLER.parent)], "folder"),
    ],
)
def test_wrong_options_are_one_line(
    arguments: list[str],
    word: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", [str(CONTROLLER), "--without-peers", *arguments])
    with pytest.raises(SystemExit) as stopped:  # in this process: starting one takes a second
        runpy.run_path(str(CONTROLLER), run_name="__main__")
    shown = capsys.readouterr()
    assert (stopped.value.code, shown.out, shown.err.count("\n")) == (2, "", 1)
    assert word in shown.err


def test_a_wrong_option_leaves_no_traceback() -> None:
    assert_refused("--ticks", "--ticks", "many")


def assert_refused(word: str, *arguments: str) -> None:
    result = run(*arguments)
    assert (result.returncode, result.stdout, result.stderr.count("\n")) == (2, "", 1)
    assert word in result.stderr


def test_the_stand_in_is_measured(qi: object, tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    script = str(CONTROLLER.parent / "stand_in.py")
    result = subprocess.run(
        [sys.executable, script, "--seconds", "1", "--json", str(figures)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    document = json.loads(figures.read_text())
    for part in ("idle", "client"):
        assert 0 < document[part]["published_ms"]["median"] <= document[part]["published_ms"]["max"]
        assert 0 <= document[part]["robot_cpu"] < 2
    assert len(document["calls_ms"]) == 3


NAOQI = Path(__file__).parents[1] / "benchmarks" / "naoqi.py"


def test_the_way_over_naoqi_is_measured(
    qi: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    figures = tmp_path / "figures.json"
    monkeypatch.setattr(sys, "argv", [str(NAOQI), "--seconds", "1", "--json", str(figures)])
    with patient_driver(), pytest.raises(SystemExit) as ended:
        runpy.run_path(str(NAOQI), run_name="__main__")
    shown = capsys.readouterr()
    assert ended.value.code == 0, shown.err
    assert "missed" in shown.out
    document = json.loads(figures.read_text())
    assert document["simulated"] is True
    for run in ("bare", "whole"):
        part = document[run]
        assert part["ticks"] > 50
        assert 0.0 < part["tick_end_ms"]["median"] <= part["tick_end_ms"]["p99"]
        assert set(part["processors"]) == {"client", "NAOqi", "robot"}
    assert document["whole"]["dcm_off_by_rad"] >= 0.0
    for kind in ("against_direct", "other_noise"):
        assert document[kind]["error"]["median_deg"] > 0.0
    assert document["other_noise"]["error"]["median_deg"] < 2.0


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--seconds", "long"], "--seconds"),
        (["--seconds", "0"], "--seconds"),
        (["--network", "wif"], "wifi"),
        (["--json", "no/such/folder/figures.json"], "no/such/folder"),
    ],
)
def test_wrong_options_of_the_way_over_naoqi_are_one_line(
    qi: Any,
    arguments: list[str],
    word: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", [str(NAOQI), *arguments])
    with pytest.raises(SystemExit) as stopped:
        runpy.run_path(str(NAOQI), run_name="__main__")
    shown = capsys.readouterr()
    assert (stopped.value.code, shown.out, shown.err.count("\n")) == (2, "", 1)
    assert word in shown.err


SAME_TICKS = Path(__file__).parents[1] / "benchmarks" / "same_ticks.py"


def git(*arguments: str) -> str:
    command = ["git", "-C", str(SAME_TICKS.parent), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.fixture
def checkout() -> None:
    try:
        git("ls-files", "--error-unmatch", SAME_TICKS.name)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("needs a git checkout")


def benchmark(path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module at ``path``, until the end of the test."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, path.stem, module)  # dataclasses look for it there
    spec.loader.exec_module(module)
    return module


@pytest.mark.usefixtures("checkout")
def test_a_commit_has_the_same_ticks_as_itself(tmp_path: Path) -> None:
    pytest.importorskip("mcap_ros2")
    figures, temporary = tmp_path / "figures.json", tmp_path / "temporary"
    temporary.mkdir()
    arguments = ["--commit", "HEAD", "--to", "HEAD", "--plants", "cold", "--seconds", "1"]
    result = subprocess.run(
        [sys.executable, str(SAME_TICKS), *arguments, "--json", str(figures)],
        env={**os.environ, "TMPDIR": str(temporary)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    (run,) = json.loads(figures.read_text())["runs"]
    assert (run["name"], run["rows"], run["same"]) == ("cold", [83, 83], True)
    assert run["columns"] > 30
    assert not list(temporary.iterdir())
    assert str(temporary) not in git("worktree", "list")


ROWS = np.arange(6.0).reshape(3, 2)


@pytest.mark.parametrize(
    ("older", "newer", "place"),
    [
        (ROWS, ROWS.copy(), None),
        (np.array([0.0, np.nan]), np.array([0.0, -np.nan]), None),
        (np.array([True, False]), np.array([1, 0], dtype=np.int8), None),
        (np.array([0.5]), np.array([0.5], dtype=np.float32), None),
        (ROWS, np.where(ROWS == 3.0, np.nextafter(3.0, 4.0), ROWS), (1, 1)),
        (np.array([1.0, 0.0]), np.array([1.0, -0.0]), (1, 0)),
        (np.array([1.0, 2.0]), np.array([1.0, np.nan]), (1, 0)),
        (ROWS, ROWS[:2], (2, 0)),
        (ROWS, ROWS[:, :1], (0, 0)),
        (np.array(["begin", "end"]), np.array(["begin", "update"]), (1, 0)),
    ],
)
def test_columns_are_compared_bit_for_bit(
    older: NDArray[Any],
    newer: NDArray[Any],
    place: tuple[int, int] | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    module = benchmark(SAME_TICKS, monkeypatch)
    result = module.compare("run", {"a": older}, {"a": newer})
    assert result.same == (place is None)
    assert [(d.row, d.element) for d in result.differences] == ([] if place is None else [place])


def test_columns_of_one_side_differ_unless_they_are_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    module = benchmark(SAME_TICKS, monkeypatch)
    older, newer = {"sent": ROWS, "gone": ROWS}, {"command.position": ROWS, "come": ROWS}
    result = module.compare("run", older, newer)
    assert not result.same
    assert result.one_sided == [
        "gone: older side only",
        "sent: older side only",
        "come: newer side only",
        "command.position: newer side only",
    ]
    monkeypatch.setattr(module, "RENAMED", {"command.position": "sent"})
    monkeypatch.setattr(module, "ADDED", {"come"})
    monkeypatch.setattr(module, "REMOVED", {"gone"})
    result = module.compare("run", older, newer)
    assert (result.same, result.columns, result.one_sided) == (True, 1, [])
    assert not module.compare("run", older, {**newer, "command.position": -ROWS}).same


@pytest.mark.usefixtures("checkout")
@pytest.mark.parametrize(("changed", "code"), [(False, 0), (True, 1)])
def test_ticks_that_differ_are_exit_code_1(
    changed: bool, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = benchmark(SAME_TICKS, monkeypatch)

    def run_side(run: object, tree: Path, out: Path) -> dict[str, Any]:
        out.parent.mkdir(parents=True)
        rows = ROWS.copy()
        if changed and tree == module.ROOT:
            rows[2, 1] += 1e-15
        np.savez(out, position=rows)
        return {"ended": ""}

    monkeypatch.setattr(module, "run_side", run_side)
    monkeypatch.setattr(sys, "argv", ["same_ticks.py", "--commit", "HEAD", "--plants", "cold"])
    assert module.main() == code
    assert ("position (2, 1): 5.0, 5.000000000000001" in capsys.readouterr().out) == changed


@dataclass(frozen=True, kw_only=True)
class OldSample:
    position: NDArray[np.float64]
    answers: int | None = None


@dataclass(frozen=True, kw_only=True)
class OldTick:
    sample: OldSample
    time: float
    missing: str
    changed: NDArray[np.bool_] | None


@dataclass(frozen=True, kw_only=True)
class NewSample:
    encoders: NDArray[np.float64]
    late: bool = False


@dataclass(frozen=True, kw_only=True)
class NewTick:
    sample: NewSample
    time: float
    missing: str
    changed: NDArray[np.bool_] | None


def test_inputs_of_the_observer_are_rebuilt_with_other_classes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    side = benchmark(SAME_TICKS.with_name("same_ticks_side.py"), monkeypatch)
    ticks = [
        OldTick(
            sample=OldSample(position=row, answers=answers),
            time=float(row[0]),
            missing=missing,
            changed=row > 2,
        )
        for row, answers, missing in zip(ROWS, (None, 1, 2), ("", "late", ""), strict=True)
    ]
    ticks[1] = replace(ticks[1], changed=None)
    np.savez(tmp_path / "inputs.npz", **side.as_columns(map(side.leaves, ticks)))
    with np.load(tmp_path / "inputs.npz", allow_pickle=False) as file:
        arrays = dict(file)

    def rebuilt(renamed: dict[str, str], tick: type) -> list[Any]:
        inputs = side.Inputs(arrays, renamed)
        make = inputs.maker(tick)
        return [*(make(row) for row in range(len(inputs))), inputs.unused]

    *same, unused = rebuilt({}, OldTick)
    assert unused == []
    assert list(map(str, same)) == list(map(str, ticks))
    *new, unused = rebuilt({"sample.encoders": "sample.position"}, NewTick)
    assert unused == ["sample.answers"]
    for one, tick in zip(new, ticks, strict=True):
        assert one.sample.encoders.tolist() == tick.sample.position.tolist()
        assert (one.sample.late, one.time, one.missing) == (False, tick.time, tick.missing)
    with pytest.raises(side.SideError, match=r"sample\.encoders"):
        rebuilt({}, NewTick)


@pytest.mark.usefixtures("checkout")
@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ([], "--commit"),
        (["--commit", "no-such-commit"], "no-such-commit"),
        (["--commit", "HEAD", "--to", "no-such-commit"], "--to"),
        (["--commit", "HEAD", "--seconds", "0"], "--seconds"),
        (["--commit", "HEAD", "--plants", "nominal,wornn"], "wornn"),
        (["--commit", "HEAD", "--plants", "none"], "nothing to compare"),
        (["--commit", "HEAD", "--stand-in", str(SAME_TICKS)], "record-stand-in"),
        (["--commit", "HEAD", "--json", "no/such/folder/figures.json"], "no/such/folder"),
    ],
)
def test_wrong_options_of_the_comparison_are_one_line(
    arguments: list[str],
    word: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", [str(SAME_TICKS), *arguments])
    with pytest.raises(SystemExit) as stopped:
        runpy.run_path(str(SAME_TICKS), run_name="__main__")
    shown = capsys.readouterr()
    assert (stopped.value.code, shown.out, shown.err.count("\n")) == (2, "", 1)
    assert word in shown.err
