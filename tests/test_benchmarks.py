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
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.identification import IdentifiedRobot
from support import ROOT
from support.fusion import fusion_set
from support.observer import recording
from support.stand_ins import patient_driver


@pytest.mark.whole
def test_the_stand_in_is_measured(qi: object, tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    script = str(ROOT / "benchmarks" / "stand_in.py")
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


NAOQI = ROOT / "benchmarks" / "naoqi.py"


@pytest.mark.whole
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
        robot.read()  # no request came before
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


CODE_LINES = ROOT / "benchmarks" / "code_lines.py"


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


SAME_TICKS = ROOT / "benchmarks" / "same_ticks.py"


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


@pytest.mark.whole
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
    older, newer = {"sent": ROWS, "old": ROWS}, {"command.position": ROWS, "come": ROWS}
    result = module.compare("run", older, newer)
    assert not result.same
    assert result.one_sided == [
        "old: older side only",
        "sent: older side only",
        "come: newer side only",
        "command.position: newer side only",
    ]
    monkeypatch.setattr(module, "RENAMED", {"command.position": "sent"})
    monkeypatch.setattr(module, "ADDED", {"come"})
    monkeypatch.setattr(module, "REMOVED", {"old"})
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


@pytest.mark.usefixtures("checkout")
@pytest.mark.parametrize(
    ("nudged_row", "newer_row", "result", "code"),
    [(50, 60, "chaotic", 0), (50, 30, "DIFFERENT", 1), (None, 60, "DIFFERENT", 1)],
)
def test_a_run_is_chaotic_where_the_older_side_parts_from_itself_as_early(
    nudged_row: int | None,
    newer_row: int,
    result: str,
    code: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    module = benchmark(SAME_TICKS, monkeypatch)

    def run_side(run: Any, tree: Path, out: Path) -> dict[str, Any]:
        out.parent.mkdir(parents=True, exist_ok=True)
        position = np.zeros((100, 17))
        row = nudged_row if run.nudge else newer_row if tree == module.ROOT else None
        if row is not None:
            position[row:, 3] = np.radians(2.0)
        np.savez(out, position=position, time=module.CYCLE * np.arange(100))
        return {"ended": ""}

    monkeypatch.setattr(module, "run_side", run_side)
    arguments = ["same_ticks.py", "--commit", "HEAD", "--plants", "cold", "--close"]
    monkeypatch.setattr(sys, "argv", arguments)
    assert module.main() == code
    shown = capsys.readouterr().out
    assert f"parts at {newer_row * module.CYCLE:.2f} s; older side from itself" in shown
    assert result in shown


@dataclass(frozen=True, kw_only=True)
class OldSample:
    position: FloatArray
    answers: int | None = None


@dataclass(frozen=True, kw_only=True)
class OldTick:
    sample: OldSample
    time: float
    missing: str
    changed: BoolArray | None


@dataclass(frozen=True, kw_only=True)
class NewSample:
    encoders: FloatArray
    late: bool = False


@dataclass(frozen=True, kw_only=True)
class NewTick:
    sample: NewSample
    time: float
    missing: str
    changed: BoolArray | None


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


ATTENTIVE = ROOT / "benchmarks" / "attentive.py"


TOUCH = ATTENTIVE.with_name("touch_the_arm.py")


def scripted(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *given: str
) -> tuple[object, str, str]:
    """Exit status, standard output and error of a script, in this process."""
    monkeypatch.setattr(sys, "argv", [str(path), *given])
    monkeypatch.syspath_prepend(path.parent)
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(path), run_name="__main__")
    return ended.value.code, *capsys.readouterr()


def test_motions_are_made_once_and_shown_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A second of one robot: what is measured is tested, not how much."""
    path = tmp_path / "attentive.json"
    options = ["--draws", "0", "--waves", "glide", "--slides", "1", "--seconds", "1", "--sizes"]
    options += ["--json", str(path)]
    status, out, err = scripted(ATTENTIVE, monkeypatch, capsys, *options)
    assert (status, err.count("\n")) == (0, 2)
    runs = json.loads(path.read_text())["runs"]
    assert list(runs) == ["random 0 motion off", "random 0 motion glide 1 deg 2.5 s"]
    still, moving = runs.values()
    assert still["law"] == moving["law"]
    assert len(still["joints"]) == len(still["sliding"]) == len(still["heat"]) == 10
    # Targets of boards drift a little, also at rest.
    assert np.mean(still["sliding"]) < 0.1 < 0.5 < np.mean(moving["sliding"])
    assert np.mean(moving["travel"]) > 5.0 * np.mean(still["travel"])
    assert 0.0 < still["hand"] < moving["hand"]
    status, again, err = scripted(ATTENTIVE, monkeypatch, capsys, *options)
    assert (status, again, err) == (0, out, "")
    for cell in ("│ none ", "│ glide 1 deg 2.5 s ", "│ arms ", "│ head ", "│ LShoulderPitch "):
        assert cell in out


def test_a_touch_shows_on_one_joint(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [
        "--no-motion",
        "--joint",
        "--draws",
        "0",
        "--waves",
        "sine",
        "glide",
        "--slides",
        "1",
    ]
    status, out, err = scripted(ATTENTIVE, monkeypatch, capsys, *options)
    assert (status, err.count("\n")) == (0, 2)
    rows = [line.split("│") for line in out.splitlines() if " deg 2.5 s" in line]
    assert [row[1].split()[0] for row in rows] == ["sine", "glide"]
    sine, glide = ([float(cell) for cell in row[2:-1]] for row in rows)
    assert glide[0] > sine[0], "it slides for longer"
    assert glide[4] < sine[4], "and the last touches show earlier"


def test_touches_of_own_models_give_n90(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    models = tmp_path / "own.json"
    fusion_set().save(models)

    def identified(uri: str, draws: list[int], *_: object, **more: Any) -> tuple[object, ...]:
        robots = [
            IdentifiedRobot(
                draw=draw,
                name=f"random-{draw}",
                state="identified" if draw == 0 else "failed",
                file=models if draw == 0 else None,
                reason="" if draw == 0 else "it broke",
                report={},
            )
            for draw in draws
        ]
        for robot in robots:
            more["progress"](robot, 0, 0)
        return tuple(robots)

    monkeypatch.setattr("pepper_driver.identification.identify_population", identified)
    options = ["--no-motion", "--touch", "--touches", "1", "--draws", "0-1"]
    options += ["--waves", "glide", "--slides", "1", "--folder", str(tmp_path)]
    options += ["--json", str(tmp_path / "touch.json")]
    status, out, err = scripted(ATTENTIVE, monkeypatch, capsys, *options)
    assert status == 0
    assert "random-1: left out, it broke" in err
    [run] = json.loads((tmp_path / "touch.json").read_text())["runs"].values()
    # A touch of each of the two takes.
    assert [len(run[name]["touches"]) for name in ("fusion", "momentum")] == [2, 2]
    assert all(force > 0.0 for place, force, detected in run["fusion"]["touches"])
    assert "│ fusion " in out
    assert " of 1 " in out or " of 2 " in out


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--draws", "0-x"], "0-x"),
        (["--draws", "100"], "100"),
        (["--waves", "square"], "square"),
        (["--seconds", "-1"], "--seconds"),
        (["--seconds", "nan"], "--seconds"),
        (["--slides", "1", "7"], "--slides"),
        (["--periods", "0"], "--periods"),
        (["--touches", "0"], "--touches"),
        (["--jobs", "0"], "--jobs"),
        (["--json", str(ATTENTIVE)], "holds no results"),
        (["--json", "no/such/folder/figures.json"], "no/such/folder"),
    ],
)
def test_wrong_options_of_the_attentive_robot_are_one_line(
    arguments: list[str],
    word: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    status, out, err = scripted(ATTENTIVE, monkeypatch, capsys, *arguments)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert word in err


@pytest.mark.whole
def test_pushes_on_the_moving_arm_are_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One round of the experiment: what is measured is tested, not how much."""
    monkeypatch.syspath_prepend(TOUCH.parent)
    module = benchmark(TOUCH, monkeypatch)
    short, path = tmp_path / "short.yaml", tmp_path / "touch.json"
    short.write_text(module.FILE.read_text().replace("times: 10", "times: 1"))
    monkeypatch.setattr(module, "FILE", short)
    options = ["--plants", "integral", "--runs", "1", "--min-force", "4", "--json", str(path)]
    monkeypatch.setattr(sys, "argv", [str(TOUCH), *options])
    assert module.main() == 0
    [(name, run)] = json.loads(path.read_text())["runs"].items()
    assert name == "development integral 4 N 0"
    assert run["untouched"] == {
        "seconds": pytest.approx(17.0, abs=0.1),
        "sentences": 0,
    } | dict.fromkeys(("reflexes", "contacts"), 0)
    assert run["pushes"]
    for push in run["pushes"]:
        assert push["force"] in module.FORCES
        assert push["way"] in module.WAYS
        assert module.BEGIN <= push["onset"] < 15.0
        assert np.isfinite([push["moved"], push["gave_way"]]).all()


def test_pushes_on_the_moving_arm_are_counted_by_plant_force_and_direction(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "touch.json"
    push = {"force": 12.0, "way": "inwards", "told": 0.12, "follow_hand": 0.1, "retract": None}
    push |= {"reported": 14.2, "moved": 0.2, "gave_way": 0.003, "saturated": False, "felt_on": 0.2}
    strong = push | {
        "felt_on": 60.0,
        "force": 20.0,
        "retract": 0.2,
        "reported": 21.0,
        "moved": 0.005,
    }
    missed = push | {"way": "up", "told": None, "follow_hand": None, "reported": None, "moved": 0.0}
    untouched = {"seconds": 120.0, "sentences": 1, "reflexes": 2, "contacts": 3}
    run = {"pushes": [push, strong, missed], "left_out": [[25.0, "forward"]], "tilt": 0.01}
    run |= {"other_sentences": 4, "untouched": untouched}
    names = [f"test nominal 18 N {number}" for number in range(2)]
    path.write_text(json.dumps({"runs": dict.fromkeys(names, run)}))
    options = ["--seeds", "test", "--plants", "nominal", "--runs", "2", "--json", str(path)]
    status, out, err = scripted(TOUCH, monkeypatch, capsys, *options)
    assert (status, err) == (0, "")
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in out.splitlines()]
    by_force = {row[1]: row[2:] for row in rows if len(row) == 11}
    half, all_, none = "2 of 4 [0.07-0.93]", "2 of 2 [0.16-1.00]", "0 of 2 [0.00-0.84]"
    assert by_force["12 N"] == [half, half, half, "0 of 4 [0.00-0.60]", "120", "100", "3", "0", "0"]
    assert by_force["20 N"] == [all_, all_, none, all_, "120", "5", "3", "0", "2"]
    by_way = {row[1]: row[2:] for row in rows if len(row) == 8}
    assert by_way["inwards"][2] == "2 / 0 of 2; 14 (14-14)"
    assert by_way["inwards"][4] == "2 / 2 of 2; 21 (21-21)"
    assert by_way["up"][2] == "0 / 0 of 2"
    [last] = (row for row in rows if len(row) == 9)
    # One event in four minutes, by Poisson: below 4.74 in them.
    assert last == ["nominal", "4.0", "2", "4", "6", "94.4", "8", "2", "0.6"]


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--plants", "cold"], "cold"),
        (["--runs", "0"], "--runs"),
        (["--min-force", "-1"], "--min-force"),
        (["--min-force", "nan"], "--min-force"),
        (["--jobs", "0"], "--jobs"),
        (["--seeds", "mine"], "--seeds"),
        (["--json", str(TOUCH)], "holds no results"),
    ],
)
def test_wrong_options_of_the_touched_arm_are_one_line(
    arguments: list[str],
    word: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    status, out, err = scripted(TOUCH, monkeypatch, capsys, *arguments)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert word in err


MEASURE = ROOT / "benchmarks" / "measure_robots.py"


def fact(name: str, measured: float | None, true: float | None, joint: str = "") -> dict[str, Any]:
    return {"fact": name, "joint": joint, "measured": measured, "true": true}


def test_measured_facts_are_counted_by_their_bounds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "robots.json"
    fine = [fact("delay", 5, 5), fact("lost", 0.01, 0.012), fact("friction", 0.5, 0.4, "HeadYaw")]
    poor = [
        fact("delay", 4, 5),
        fact("friction", 0.2, 0.4, "HeadYaw"),
        fact("friction", None, 1.0, "LWristYaw"),
    ]
    poor += [fact("speed", 2.1, 2.0, "LElbowYaw"), fact("speed", None, 2.0, "LElbowRoll")]
    unlimited = [fact("speed", 1.9, None, "LElbowYaw"), fact("speed", None, None, "LElbowRoll")]
    runs = {
        "random-3": {"facts": fine},
        "random-4": {"facts": poor},
        "nominal": {"facts": unlimited},
    }
    path.write_text(json.dumps({"runs": runs}))
    options = ["--plants", "random", "nominal", "--draws", "3-4", "--json", str(path)]
    status, out, err = scripted(MEASURE, monkeypatch, capsys, *options)
    assert (status, err) == (0, "")
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in out.splitlines()]
    by_fact = {row[0]: row[1:] for row in rows if len(row) == 10}
    # Bound; robots, joints, not measured, found in vain; median and worst error; 1 of 2 by Clopper and Pearson.
    half = "1 of 2 [0.01-0.99]"
    assert by_fact["delay"] == ["0.5", "2", "2", "0", "0", "0.5", "1", half, "random-4  (4, not 5)"]
    assert by_fact["friction"][1:7] == ["2", "2", "0", "0", "37.5 %", "50.0 %"]
    assert by_fact["friction"][7:] == [half, "random-4 HeadYaw (0.2, not 0.4)"]
    assert by_fact["friction of wrists"][1:] == ["1", "1", "1", "0", *"----"]
    assert by_fact["speed"][1:6] == ["1", "2", "1", "1", "5.0 %"]
    assert by_fact["lost"][5] == "0.002"
    assert by_fact["torque scale"][1:] == ["0", "0", "0", "0", *"----"]


@pytest.mark.parametrize("ticks", [-4, 0, 2])
def test_samples_are_paired_with_other_commands(
    ticks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(MEASURE.parent)
    module = benchmark(MEASURE, monkeypatch)
    count = 40
    run = recording(np.zeros((count, 3)), np.arange(float(count)))
    later = module.paired_later(run, ticks)
    assert len(later) == count - abs(ticks)
    np.testing.assert_allclose(later.time / run.cycle - later.sent_position[:, 0], ticks, atol=1e-6)


@pytest.mark.whole
def test_a_simulated_robot_is_measured_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "robots.json"
    options = ["--plants", "recorded", "--json", str(path)]
    assert scripted(MEASURE, monkeypatch, capsys, *options)[0] == 0
    facts = json.loads(path.read_text())["runs"]["recorded"]["facts"]
    [delay] = (one for one in facts if one["fact"] == "delay")
    assert (delay["measured"], delay["true"]) == (6, 6)  # though samples are paired as if it were 3
    scales = [one for one in facts if one["fact"] == "torque scale"]
    assert len(scales) == 4
    for one in scales:
        assert one["measured"] == pytest.approx(one["true"], rel=0.1)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--plants", "randon"], "did you mean random"),
        (["--draws", "0-100"], "held out"),
        (["--draws", "x"], "expected numbers"),
        (["--workers", "0"], "--workers"),
        (["--json", str(MEASURE)], "holds no results"),
    ],
)
def test_wrong_options_of_the_measured_robots_are_one_line(
    arguments: list[str],
    word: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    status, out, err = scripted(MEASURE, monkeypatch, capsys, *arguments)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert word in err


@pytest.mark.whole
def test_the_costs_of_a_cluster_follow_from_what_is_measured(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="comes with the extra 'cluster'")
    figures = tmp_path / "figures.json"
    script = str(ROOT / "benchmarks" / "cluster.py")
    options = ["--jobs", "50", "--repeats", "1", "--robots", "10", "--json", str(figures)]
    result = subprocess.run(
        [sys.executable, script, *options], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    document = json.loads(figures.read_text())
    for name, hours in (("evaluate", 300.0), ("identify", 18.167)):
        cost = document[name]
        assert cost["robot_hours"] == pytest.approx(hours, rel=1e-3)
        assert 1 < cost["robot_hours_per_core_hour"] < 200
        assert cost["core_hours"] == pytest.approx(
            hours / cost["robot_hours_per_core_hour"], rel=1e-3
        )
        assert cost["jobs"] * cost["job_seconds"] / 3600 == pytest.approx(hours, rel=1e-3)
        slowest = max(cost["scheduler_s"], cost["command_s"])
        assert 1e-5 < slowest < 0.1
        assert cost["carrying_hours"] == pytest.approx(cost["jobs"] * slowest / 3600)
        fed = cost["job_seconds"] / cost["robot_hours_per_core_hour"] / slowest
        assert cost["cores_one_scheduler_feeds"] == pytest.approx(fed)
        assert 1e2 < cost["job_bytes"] < 1e7


@pytest.mark.whole
def test_a_hunt_finds_what_fails_now_and_then_and_continues_where_it_was(tmp_path: Path) -> None:
    count = tmp_path / "count"
    (tmp_path / "test_planted.py").write_text(
        "from pathlib import Path\n"
        f"COUNT = Path({str(count)!r})\n"
        "def test_every_third():\n"
        "    runs = int(COUNT.read_text()) if COUNT.exists() else 0\n"
        "    COUNT.write_text(str(runs + 1))\n"
        "    assert runs % 3 != 1\n"
    )
    out = tmp_path / "flakes.json"
    command = [
        sys.executable,
        str(ROOT / "benchmarks" / "flakes.py"),
        str(tmp_path / "test_planted.py"),
        f"--out={out}",
        "--workers=1",
        "--scale=0.3",
        "--rounds=suite alone",
    ]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 1, found.stderr
    assert "test_every_third" in found.stdout
    assert [len(run["failures"]) for run in json.loads(out.read_text())] == [0, 1, 0]
    assert subprocess.run(command, capture_output=True, check=False).returncode == 1
    assert count.read_text() == "3", "the runs are kept"


def test_mutants_that_survive_are_listed_and_tried_again_when_tests_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("cosmic_ray", reason="comes with the extra 'mutation'")
    spec = importlib.util.spec_from_file_location("mutation", ROOT / "benchmarks" / "mutation.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "mutation", module)
    spec.loader.exec_module(module)
    project, out = tmp_path / "project", tmp_path / "out.json"
    project.mkdir()
    (project / "conftest.py").write_text(
        "from hypothesis import settings\nsettings.register_profile('mutation')\n"
    )
    (project / "gate.py").write_text(
        "def at_most(value: int | float, count: int = 3) -> float:\n"
        "    if value >= count:\n        value = count\n    return value\n"
    )
    tests = project / "test_gate.py"
    tests.write_text("from gate import at_most\ndef test_it():\n    assert at_most(9) == 3\n")
    monkeypatch.setattr(module, "ROOT", project)
    monkeypatch.setattr(
        module, "SUBJECTS", (module.Subject("gate", (("gate.py", ()),), ("test_gate.py",)),)
    )
    monkeypatch.setattr(sys, "argv", ["mutation.py", f"--out={out}", "--workers=1"])

    assert module.main() == 1
    shown = capsys.readouterr().out
    outcomes = {entry["mutant"]: entry["outcome"] for entry in json.loads(out.read_text())}
    # >= for > and for <, not, a number one larger and one smaller, and the only statement that may go.
    assert len(outcomes) == 6
    survived = [mutant for mutant, outcome in outcomes.items() if outcome == "passed"]
    assert survived == ["gate.py:ReplaceComparisonOperator_GtE_Gt:0"]
    assert "gate.py:ReplaceComparisonOperator_GtE_Gt:0 line 2\n-    if value >= count:" in shown

    tests.write_text(tests.read_text() + "    assert type(at_most(3.0)) is int\n")
    judged: list[str] = []
    judge = module.judge

    def noted(copies: Path, subject: object, mutant: Any, timeout: float) -> Any:
        judged.append(mutant.key)
        return judge(copies, subject, mutant, timeout)

    monkeypatch.setattr(module, "judge", noted)
    assert module.main() == 0
    assert judged == survived
