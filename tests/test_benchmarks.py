"""The benchmarks run and say what they measure; how fast anything is, they do not test."""

from __future__ import annotations

import importlib.util
import json
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
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
    reaction = document["whole"]["reaction_cycles"]
    assert reaction["ticks"] > 20
    assert 2 <= reaction["median"] <= reaction["p99"] < 50
    assert "request_lead_ms" in document["whole"]
    for kind in ("against_direct", "other_noise"):
        assert document[kind]["error"]["median_deg"] > 0.0
    assert document["other_noise"]["error"]["median_deg"] < 2.0


def test_the_reaction_is_counted_from_the_cycle_of_the_sample() -> None:
    """The command of tick k is computed from the sample of cycle k, and followed in cycle k + 4."""
    reaction = runpy.run_path(str(NAOQI))["reaction"]
    begin, count, moving = 7, 40, 30
    postures = 0.01 * np.minimum(np.arange(count), moving)[:, None] * np.ones(17)
    commands = np.full((count + 20, 17), -1.0)
    commands[begin + 4 : begin + 4 + count] = postures
    samples = [SimpleNamespace(tick=k, age=0.0, current=np.full(17, k)) for k in range(count)]
    samples[10].age = 0.024  # new, but of cycle 8
    samples[15] = SimpleNamespace(tick=15, age=0.012, current=samples[14].current)  # an old one
    commands[begin + 4 + 20] += 0.005  # this one was withheld
    recorder = SimpleNamespace(
        ticks=[SimpleNamespace(measurement=sample) for sample in samples], computed=list(postures)
    )
    found = reaction(recorder, commands, begin, 0.012)
    assert (found["median"], found["ticks"]) == (4, moving - 1 - 3)
    assert (found["late"], found["not_followed"]) == (1, 1)
    assert 4 < found["p99"] <= 6
    recorder.computed = [postures[0]] * count
    assert reaction(recorder, commands, begin, 0.012)["median"] is None


def test_cycles_are_matched_by_the_commands_that_fresh_samples_answer() -> None:
    script = runpy.run_path(str(NAOQI))
    rng = np.random.default_rng(1)
    cycle = np.delete(np.arange(100, 160), 33)  # the machine was too slow for one
    postures = np.cumsum(rng.uniform(0.01, 0.02, (60, 17)), axis=0)
    box = SimpleNamespace(cycle=cycle, position_command=postures[cycle - 100])
    ticks = [
        SimpleNamespace(
            measurement=SimpleNamespace(tick=k, age=0.0 if k % 5 else 0.012),
            sent=SimpleNamespace(position=postures[k - 80]),
        )
        for k in range(91, 130)
    ]
    begin, off_by = script["matched"](
        SimpleNamespace(ticks=ticks), script["commands_by_cycle"](box)
    )
    assert (begin, off_by) == (-80, 0.0)


def test_the_request_is_timed_to_the_beginning_of_its_tick() -> None:
    class Robot:
        def request(self) -> None:
            clock.now += 1_000_000

        def read(self) -> str:
            clock.now += 2_000_000
            return "sample"

    request_leads = runpy.run_path(str(NAOQI))["request_leads"]
    clock: Any = SimpleNamespace(now=0, perf_counter_ns=lambda: clock.now)
    request_leads.__wrapped__.__globals__["time"] = clock
    with request_leads(Robot) as leads:
        robot = Robot()
        for _ in range(2):
            robot.request()
            clock.now += 4_000_000
            assert robot.read() == "sample"
        robot.read()  # nobody asked
    assert leads == pytest.approx([5.0, 5.0])
    robot.request()
    robot.read()
    assert len(leads) == 2
    with request_leads(object) as none:
        assert none == []


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


CODE_LINES = Path(__file__).parents[1] / "benchmarks" / "code_lines.py"


def code_lines(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: str
) -> tuple[object, str, str]:
    """Exit status, standard output and error of the script, in this process."""
    monkeypatch.setattr(sys, "argv", [str(CODE_LINES), *arguments])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(CODE_LINES), run_name="__main__")
    return ended.value.code, *capsys.readouterr()


def test_lines_without_code_are_not_counted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "some.py"
    file.write_text('''"""Module
docstring."""

# a comment
LIMIT = 1  # counts
"""Of something."""

class Empty:
    """Docstring."""

    def run(self) -> str:
        """Docstring

        of three lines."""
        return (
            # a comment
            """text,

            which is no docstring"""
        )
''')
    status, shown, _ = code_lines(monkeypatch, capsys, str(file), str(file))
    assert (status, shown.split()[-3]) == (0, "16")  # 8 lines, twice


def test_facade_and_loop_are_compared_with_what_they_were(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script = runpy.run_path(str(CODE_LINES))
    status, shown, _ = code_lines(monkeypatch, capsys, "--facade")
    now = sum(script["code_lines"](CODE_LINES.parents[1] / name) for name in script["FACADE"])
    assert status == 0
    assert f"{now / script['BASELINE_TOTAL']:.3f}" in shown
    commit = script["BASELINE_COMMIT"]
    try:
        then = [script["code_lines"](CODE_LINES.parents[1] / f, commit) for f in script["BASELINE"]]
    except script["SourceError"] as error:
        pytest.skip(str(error))  # the sources without their history
    assert sum(then) == script["BASELINE_TOTAL"]


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ([], "--facade"),
        (["--facade", str(CODE_LINES)], "--facade"),
        (["no_such.py"], "no_such.py"),
        ([str(CODE_LINES.parent)], "benchmarks"),
        ([str(CODE_LINES.parents[1] / "README.md")], "not Python"),
        (["--commit", "no-such-commit", str(CODE_LINES)], "commit"),
        (["--commit", "HEAD", "/elsewhere.py"], "repository"),
    ],
)
def test_files_that_cannot_be_counted_are_one_line(
    arguments: list[str],
    word: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    status, shown, error = code_lines(monkeypatch, capsys, *arguments)
    assert (status, shown, error.count("\n")) == (2, "", 1)
    assert word in error
