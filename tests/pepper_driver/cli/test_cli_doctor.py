"""``pepper doctor``, as a user meets it."""

import json
import sys
from pathlib import Path

import pytest
import typer

from pepper_driver.backends.mock import Fault
from pepper_driver.cli.app import run
from pepper_driver.testing import aged, drained, pressed
from support.doctor import Patient, models_for, use


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """A person could answer; keys are not read all the same."""
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    monkeypatch.setattr(
        "pepper_driver.recording.terminal_keys.StopKey.__enter__", lambda self: self
    )


def table(text: str) -> dict[str, str]:
    """Outcome by name of the check."""
    rows = {}
    for line in text.splitlines():
        outcome, name = line[:15].strip(), line[16:32].strip()
        if outcome in ("ok", "warning", "FAILED", "unknown") and name:
            rows[name] = outcome
    return rows


def test_the_simulated_robot_is_well(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figures = tmp_path / "doctor.json"
    assert run(["doctor", "--yes", "--json", str(figures)]) == 0
    rows = table(capsys.readouterr().out)
    assert len(rows) == 23
    assert {name for name, outcome in rows.items() if outcome != "ok"} == {"diagnosis"}
    content = json.loads(figures.read_text())
    assert content["passed"] is True
    assert {result["name"]: result["status"] for result in content["results"]} == rows
    assert len(content["joints"]) == 14


def test_a_robot_without_models_is_not_moved(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["doctor", "mock", "--yes"]) == 1
    captured = capsys.readouterr()
    rows = table(captured.out)
    assert rows["models"] == "FAILED"
    assert rows["motion"] == "unknown"
    assert "not moved: a check failed" in captured.out
    assert "pepper identify" in " ".join(captured.out.split()).replace("'pepper", "pepper")


@pytest.mark.parametrize("sickness", [aged(0.2), drained(0.05), pressed("bumpers")])
def test_a_sick_robot_never_moves(
    sickness: Fault,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    patient = Patient(sickness)
    use(monkeypatch, patient)
    models = models_for("mock", tmp_path)
    assert run(["doctor", "mock", "--models", str(models), "--yes"]) == 1
    assert not patient.moved
    out = capsys.readouterr().out
    assert "FAILED" in table(out).values()
    assert "-> " in out


def test_no_motion_moves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    patient = Patient()
    use(monkeypatch, patient)
    models = models_for("mock", tmp_path)
    assert run(["doctor", "mock", "--models", str(models), "--no-motion"]) == 0
    assert not patient.moved
    assert "left out by --no-motion" in capsys.readouterr().out


def test_without_a_terminal_nothing_begins(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    patient = Patient()
    use(monkeypatch, patient)
    monkeypatch.setattr(sys.stdin, "isatty", lambda: False)
    assert run(["doctor", "mock"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "--yes" in line
    assert patient.calls == []


@pytest.mark.usefixtures("terminal")
@pytest.mark.parametrize("answer", [True, False])
def test_the_robot_moves_only_with_the_option(
    answer: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    patient = Patient()
    use(monkeypatch, patient)
    asked = []

    def confirm(question: str) -> bool:
        asked.append(question)
        assert not patient.moved
        return answer

    monkeypatch.setattr(typer, "confirm", confirm)
    code = run(["doctor", "mock", "--models", str(models_for("mock", tmp_path))])
    assert len(asked) == 1
    assert "emergency stop" in asked[0]
    assert patient.moved == answer
    assert code == (1 if answer else 0)  # perfect joints fit no model of real ones
    assert ("answered with no" in capsys.readouterr().out) != answer


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["mujocco"], "did you mean mujoco"),
        (["mujoco://?plant=worm"], "did you mean worn"),
        (["mujoco", "--json", "/dev/null/x.json"], "/dev/null/x.json"),
        (["mujoco", "--yess"], "--yess"),
    ],
)
def test_a_wrong_input_is_one_line_and_code_2(
    arguments: list[str], word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["doctor", "--no-motion", *arguments]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("pepper: ")
    assert word in line


def test_a_damaged_model_file_is_a_failed_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    models = tmp_path / "models.json"
    models.write_text("{")
    assert run(["doctor", "--models", str(models), "--yes"]) == 1
    captured = capsys.readouterr()
    assert table(captured.out)["models"] == "FAILED"
    assert captured.err == ""
