"""The command line, as a user meets it: exit codes, one-line errors, files whole or not at all."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from pepper_driver.cli.app import run
from pepper_driver.log import read_log
from support import ROOT
from support.waiting import wait_until


def test_help_and_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--help"]) == 0
    shown = capsys.readouterr().out
    assert all(command in shown for command in ("demo", "identify", "bench"))
    assert run(["--version"]) == 0
    assert capsys.readouterr().out.startswith("pepper-driver ")


def test_demo_writes_its_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, figures = tmp_path / "deep" / "out", tmp_path / "figures.json"
    assert run(["demo", "--out", str(out), "--seconds", "8", "--json", str(figures)]) == 0
    shown = capsys.readouterr().out
    assert "LShoulderRoll" in shown
    assert "after the true onset" in shown
    page = (ROOT / "docs" / "demo.md").read_text()
    assert page.split("```\n")[1] in shown, "the lines on the page are those of the default run"
    assert {p.name for p in out.iterdir()} == {"demo.mcap", "contacts.json", "contacts.png"}
    assert (out / "contacts.png").read_bytes().startswith(b"\x89PNG")
    counts = json.loads(figures.read_text())
    assert counts["pushes"] == 5, "two at random, three light ones at the end"
    assert counts["detected"] + counts["missed"] == counts["pushes"]
    assert set(counts["delay_ms"]) == {"median", "p90"}


def test_demo_without_the_plot_extra_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert run(["demo", "--out", str(tmp_path), "--seconds", "8"]) == 0
    assert 'pip install "pepper-driver[plot]"' in " ".join(capsys.readouterr().out.split())
    assert not (tmp_path / "contacts.png").exists()
    assert (tmp_path / "contacts.json").exists()


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["dmo"], "demo"),
        (["demo", "--seconds", "soon"], "seconds"),
        (["demo", "--seconds", "nan"], "seconds"),
        (["demo", "--seconds", "1"], "seconds"),
        (["demo", "--seed", "-1"], "seed"),
        (["demo", "--out", "/dev/null/x"], "/dev/null/x"),
        (["demo", "--json", "/dev/null/x.json"], "/dev/null/x.json"),
        (["identify", "--out", "x.json", "--backend", "mujocco"], "did you mean mujoco"),
        (["identify", "--out", "x.json", "--backend", "mujoco://?plant=worm"], "unknown plant"),
        (["identify", "--out", "x.json", "--joints", "LShoulderRol"], "LShoulderRoll"),
        (["identify", "--out", "x.json", "--joints", ""], "joint"),
        (["identify", "--out", "x.json", "--joints", "HeadYaw,HeadYaw"], "twice"),
        (["identify", "--out", "x.json", "--model-type", "oak"], "affine"),
        (["identify", "--out", "/dev/null/x.json"], "/dev/null/x.json"),
        (["identify", "--out", "x.json", "--experiment", "demo"], "sweeps"),
        (["demo", "--experiment", "dmo"], "did you mean demo"),
        (["demo", "--experiment", "identify"], "a demonstration needs some"),
        (["demo", "--experiment", "reach_and_push", "--seconds", "8"], "leave out seconds"),
        (["bench", "--seconds", "0"], "seconds"),
    ],
)
def test_a_wrong_input_is_one_line_and_code_2(
    arguments: list[str],
    word: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(arguments) == 2
    captured = capsys.readouterr()
    lines = captured.err.strip().splitlines()
    assert len(lines) == 1, captured.err
    assert lines[0].startswith("pepper: ")
    assert word in lines[0]
    assert list(tmp_path.iterdir()) == [], "nothing half-written"


@pytest.mark.parametrize("content", ["", "not json", '{"format": 1}', "\x80\x04K*.", "[1, 2]"])
def test_a_damaged_model_file_is_refused(
    content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    models, out = tmp_path / "models.json", tmp_path / "out"
    models.write_text(content)
    assert run(["demo", "--out", str(out), "--seconds", "8", "--models", str(models)]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert "models.json" in lines[0]
    assert not out.exists()


def test_an_unwritable_folder_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "taken").write_text("a file")
    assert run(["demo", "--out", str(tmp_path / "taken"), "--seconds", "8"]) == 2
    assert "taken" in capsys.readouterr().err
    assert (tmp_path / "taken").read_text() == "a file"


def test_ctrl_c_ends_the_demo_cleanly(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "pepper_driver",
            "demo",
            "--out",
            str(tmp_path),
            "--seconds",
            "3600",
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    assert process.stdout is not None
    for _ in range(2):
        assert "after the true onset" in process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert "interrupted" in errors
    log = read_log(tmp_path / "demo.mcap")
    assert log.complete
    assert len(log) > 300, "about five seconds lie between the first two"


@pytest.mark.parametrize("library", ["numpy", "mujoco"])
def test_ctrl_c_during_start_up_is_one_line(library: str) -> None:
    """While libraries are imported; before the interpreter has reached our code, its traceback is out of our hands."""
    process = subprocess.Popen(
        [sys.executable, "-m", "pepper_driver", "bench"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert wait_until(lambda: library in Path(f"/proc/{process.pid}/maps").read_text())
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    first, *rest = errors.splitlines()
    assert first == "pepper: interrupted"
    assert "pepper_driver/" not in "".join(rest), "a process of a library may miss its reader"


def test_a_reader_that_goes_away_leaves_no_traceback(tmp_path: Path) -> None:
    done = subprocess.run(
        f"{sys.executable} -m pepper_driver demo --out {tmp_path} --seconds 8 | head -1",
        shell=True,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "Shoulder" in done.stdout or "Elbow" in done.stdout
    assert "Traceback" not in done.stderr
    assert read_log(tmp_path / "demo.mcap").complete


def test_bench_writes_its_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bench.json"
    assert run(["bench", "--part", "loop", "--seconds", "2", "--json", str(path)]) == 0
    shown = capsys.readouterr().out
    figures = json.loads(path.read_text())
    for stage in ("read", "observer", "arbiter", "controller", "gate", "write", "log"):
        assert figures["stage_us"][stage]["p99"] >= figures["stage_us"][stage]["median"] > 0
    assert figures["tick_us"]["median"] < 12_000
    plant = figures["simulation"]["nominal"]
    assert 0 < plant["real_time_factor"] < plant["plant_alone_real_time_factor"]
    assert plant["loop_us"] > plant["plant_us"] > plant["physics_us"] > 0
    ratio = plant["loop_us"] / plant["physics_us"]
    assert figures["loop_over_physics"] == {"nominal": pytest.approx(ratio)}
    assert f"{ratio:.2f}" in shown
    ratio = plant["plant_us"] / plant["physics_us"]
    assert figures["plant_over_physics"] == {"nominal": pytest.approx(ratio)}
    assert f"{ratio:.2f}" in shown
    assert "import_s" not in figures, "one part alone"
    assert figures["cpu"]
    assert {"python", "mujoco", "numpy"} <= set(figures["versions"])


def test_bench_of_whole_ticks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bench.json"
    assert run(["bench", "--tick", "--seconds", "2", "--json", str(path)]) == 0
    assert "all but backend" in capsys.readouterr().out
    ticks = json.loads(path.read_text())["ticks"]
    assert ticks["ticks"] >= 200  # the loop thread ticks on around the run
    assert 0 < ticks["tick"]["median"] <= ticks["tick"]["p99"] <= ticks["tick"]["max"]
    assert ticks["stages"]["observer"]["median"] > 0
    assert ticks["stages"]["log"]["median"] > 0
    assert ticks["end"]["median"] > 0


@pytest.mark.whole
def test_bench_with_callbacks(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bench.json"
    assert run(["bench", "--callbacks", "--seconds", "2", "--json", str(path)]) == 0
    shown = capfd.readouterr()
    assert "Traceback" not in shown.err
    costs = json.loads(path.read_text())["callbacks"]
    assert len(costs) == 5
    assert costs["none"]["ratio"] == 1.0
    for kind, cost in costs.items():
        assert kind in shown.out
        assert cost["ticks"] >= 200  # the loop thread ticks on around the run
        assert cost["tick"] > 0


@pytest.mark.parametrize("words", ["--version", "--help", "dmo", "--hlp", ""])
def test_what_needs_no_robot_imports_none(words: str) -> None:
    """All commands together take a second to import."""
    heavy = ("numpy", "numba", "scipy", "mujoco", "pinocchio", "sklearn", "pepper_driver.config")
    code = (
        "import sys; from pepper_driver.cli.app import load_called, run;"
        f"assert not load_called({words.split()}); run({words.split()});"
        f"sys.exit(any(name in sys.modules for name in {heavy}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("option", ["--version", "--help"])
def test_the_program_itself_imports_no_numerics_for_what_needs_no_robot(option: str) -> None:
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "pepper_driver", option],
        capture_output=True,
        text=True,
        check=True,
    )
    imported = {line.split("|")[-1].strip() for line in done.stderr.splitlines()}
    assert "pepper_driver.cli.app" in imported
    assert not imported & {"numpy", "numba", "scipy", "mujoco", "pinocchio", "sklearn"}


def test_a_program_with_a_robot_imports_what_it_uses() -> None:
    """Not what compiles kernels, fits models, draws figures or works in parallel: that takes as long again."""
    unused = ("numba", "joblib", "sklearn", "matplotlib", "mujoco", "asyncio", "typer")
    code = (
        f"import sys; import pepper_driver.robot; print(*[n for n in {unused} if n in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_a_command_imports_no_other(tmp_path: Path) -> None:
    code = "import sys; from pepper_driver.cli.app import load_called; load_called(['log']);"
    check = "print(*sorted(n for n in sys.modules if n.startswith('pepper_driver.cli.')))"
    done = subprocess.run(
        [sys.executable, "-c", code + check], capture_output=True, text=True, check=True
    )
    modules = ("app", "console", "log")
    assert done.stdout.split() == [f"pepper_driver.cli.{name}" for name in modules]
