"""``pepper log`` and ``pepper plot``, as a user meets them."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import pytest

from pepper_driver import Pepper
from pepper_driver.cli.app import run
from pepper_driver.config import load_robot
from pepper_driver.log import LogEvent, LogWriter, read_log
from pepper_driver.loop import TickRecord
from support import ROOT
from support.log_samples import Samples

PAGE = ROOT / "docs" / "log.md"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A second of a simulated robot that is stopped at its end."""
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    with Pepper("mujoco://?seed=4", log=path) as pepper:
        pepper.set_posture({"LShoulderRoll": 0.5})
        pepper.run(1.0)
    return path


def test_info_prints_and_writes_the_figures(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "figures.json"
    assert run(["log", "info", str(log), "--json", str(figures)]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith(f"{log}: pepper, 1.0 s, 83 ticks\n")
    for text in ("mujoco://?seed=4", "missed: 0 ticks", "sample age", "contacts: none"):
        assert text in shown
    read = json.loads(figures.read_text())
    assert read["ticks"] == 83
    assert (read["missed"], read["dropped_commands"], read["faults"]) == (0, 0, 0)
    assert set(read["sample_age_ms"]) == {"median", "p99", "max"}
    assert read["metadata"] == read_log(log).metadata


def test_info_of_a_stopped_run_that_was_cut_short(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, samples = tmp_path / "a.mcap", Samples(1)
    with LogWriter(path, load_robot(), {}) as writer:
        writer.note(LogEvent(time=0.5, kind="fault", name="stale", text="the sample is old"))
        for number in range(80):
            writer.append(TickRecord(tick=samples.tick(number), tick_end=0.002, missed=3))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 3 // 4])
    assert run(["log", "info", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "ticks, cut short" in shown.splitlines()[0]
    assert "missed: 3 ticks" in shown
    assert "stopped at 0.50 s: stale: the sample is old" in shown
    assert "tick end" in shown


def test_info_of_a_log_without_ticks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with LogWriter(tmp_path / "a.mcap", load_robot(), {}):
        pass
    assert run(["log", "info", str(tmp_path / "a.mcap")]) == 0
    assert "0 ticks" in capsys.readouterr().out


def test_a_log_of_another_robot_is_read_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its joints have other names, in another order: nothing here asks the robot of this installation."""
    robot, samples = load_robot(), Samples(2)
    joints = tuple(replace(joint, name=f"My{joint.name}") for joint in reversed(robot.joints))
    other = replace(robot, name="salt", joints=joints)
    path = tmp_path / "a.mcap"
    with LogWriter(path, other, {}) as writer:
        writer.append(TickRecord(tick=samples.tick(1)))
    assert run(["log", "info", str(path)]) == 0
    assert ": salt, " in capsys.readouterr().out
    assert run(["log", "export", str(path), "--format", "csv"]) == 0
    assert "position.MyRHand," in (tmp_path / "a.csv").read_text()
    assert run(["plot", str(path), "--joint", "RHand"]) == 2
    assert "did you mean MyRHand" in capsys.readouterr().err


def test_export_goes_next_to_the_log_once(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["log", "export", str(log), "--format", "csv"]) == 0
    files = [Path(line) for line in capsys.readouterr().out.splitlines()]
    assert files[0] == log.with_suffix(".csv")
    assert all(file.exists() for file in files)
    assert run(["log", "export", str(log), "--format", "csv"]) == 2
    assert "--force" in capsys.readouterr().err
    assert run(["log", "export", str(log), "--format", "csv", "--force"]) == 0
    assert (
        run(["log", "export", str(log), "--format", "npz", "--out", str(tmp_path / "x.npz")]) == 0
    )
    assert (tmp_path / "x.npz").exists()


def test_plot_draws_what_was_asked_for(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["plot", str(log)]) == 0
    assert capsys.readouterr().out == f"figure: {log.with_suffix('.png')}\n"
    assert log.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    out = tmp_path / "new" / "two.svg"
    asked = ["--joint", "HeadYaw", "--joint", "LHand", "--from", "1.2", "--to", "1.5"]
    assert run(["plot", str(log), "--out", str(out), *asked]) == 0
    drawn = out.read_text()
    assert "HeadYaw" in drawn
    assert "LHand" in drawn
    assert "LShoulderRoll" not in drawn


def test_each_command_says_what_a_damaged_log_misses(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    path, repaired = tmp_path / "damaged.mcap", tmp_path / "repaired.mcap"
    data = bytearray(log.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    missing = read_log(path).missing
    assert re.fullmatch(r"1 chunk is missing: \d+\.\d\d to \d+\.\d\d s", missing)
    assert run(["log", "repair", str(path), str(repaired)]) == 0
    assert capsys.readouterr().out == f"{repaired}: {missing}\n"
    for command in (
        ["log", "info", "LOG", "--json", str(tmp_path / "f.json")],
        ["log", "export", "LOG", "--format", "npz"],
        ["plot", "LOG"],
        ["replay", "LOG"],
    ):
        for file in (path, repaired):
            caplog.clear()
            assert run([str(file) if word == "LOG" else word for word in command]) in (0, 1)
            assert caplog.messages == [f"{file}: {missing}"], command
    assert f"{repaired}: pepper, 1.0 s" in capsys.readouterr().out
    figures = json.loads((tmp_path / "f.json").read_text())
    assert figures["missing"] == missing
    assert [gap["chunks"] for gap in figures["gaps"]] == [1]


def test_plot_says_that_a_log_is_cut_short(
    log: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(log.read_bytes()[:-5000])
    assert run(["plot", str(path)]) == 0
    assert len(caplog.messages) == 1
    assert "cut short after" in caplog.text


@pytest.mark.parametrize("language", ["sh", "python"])
def test_the_page_on_logs_says_what_works(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, language: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("run.mcap").write_bytes(log.read_bytes())
    blocks = re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert blocks
    for block in blocks:
        if language == "sh":
            for line in block.splitlines():
                command, *arguments = shlex.split(line, comments=True)
                if "parquet" in arguments:
                    pytest.importorskip("pyarrow")
                assert (command, run(arguments)) == ("pepper", 0)
        elif "pandas" not in block:
            exec(compile(block, "log.md", "exec"), {})


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["plot", "LOG", "--joint", "LSholderRoll"], "did you mean LShoulderRoll"),
        (["plot", "LOG", "--from", "3", "--to", "2"], "from 3 s to 2 s is no stretch of time"),
        (["plot", "LOG", "--from", "100"], "the log holds no tick there: it goes from 1.01 s"),
        (["plot", "LOG", "--out", "a.gif"], "unknown figure format 'gif'"),
        (["plot", "TEXT"], "is not an MCAP file"),
        (["plot", "EMPTY"], "the log holds no tick"),
        (["log", "info", "TEXT"], "is not an MCAP file"),
        (["log", "info", "none.mcap"], "there is no such file"),
        (["log", "info", "LOG", "--json", "none/f.json"], "cannot be written"),
        (
            ["log", "export", "LOG", "--format", "xls"],
            "'--format': must be parquet, csv or npz, got 'xls'",
        ),
        (["log", "export", "LOG", "--format", "npz", "--out", "a.csv"], "must end in .npz"),
        (["log", "export", "LOG"], "--format"),
        (["log", "repair", "TEXT", "new.mcap"], "is not an MCAP file"),
        (["log", "repair", "LOG", "text"], "is there already; --force replaces it"),
        (["log", "repair", "LOG", "LOG"], "is the log itself"),
        (["log", "exprot", "LOG"], "exprot"),
    ],
)
def test_wrong_input_is_one_line(
    log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    why: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("text").write_text("time,position\n0,1\n")
    with LogWriter(Path("empty.mcap"), load_robot(), {}):
        pass
    before = sorted(tmp_path.iterdir())
    stand_ins = {"LOG": str(log), "TEXT": "text", "EMPTY": "empty.mcap"}
    assert run([stand_ins.get(argument, argument) for argument in arguments]) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("pepper: ")
    assert captured.err.count("\n") == 1
    assert why in captured.err
    assert sorted(tmp_path.iterdir()) == before
