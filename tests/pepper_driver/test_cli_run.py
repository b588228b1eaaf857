"""``pepper run``, as a user meets it."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from event_cases import contact
from experiment_cases import EXAMPLES, STAND, TURN, fake, listen, write

from pepper_driver.cli.app import run
from pepper_driver.log import read_log

PUSH: dict[str, Any] = {
    "kind": "push",
    "step": "listen",
    "joint": "LShoulderRoll",
    "link": "LBicep",
    "xyz": [0.16, 0.0, 0.0],
    "force": [0.0, 10.0, 0.0],
    "start": 0.05,
    "duration": 0.3,
}


def lines_of(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return capsys.readouterr().out.splitlines()


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_a_dry_run_prints_the_plan_and_moves_nothing(
    path: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("pepper_driver.robot.Pepper.start", lambda _: pytest.fail("activated"))
    log, figures = tmp_path / "run.mcap", tmp_path / "plan.json"
    assert run(["run", str(path), "--dry-run", "--log", str(log), "--json", str(figures)]) == 0
    text = "\n".join(lines_of(capsys))
    for word in ("steps", "reflexes", "pushes", "stand", "priority", "pushed with"):
        assert word in text
    assert not log.exists()
    plan = json.loads(figures.read_text())
    assert plan["pushes"] >= 1
    assert plan["reflexes"]
    assert plan["steps"][0] == {"key": "steps.0", "name": "stand", "from": 0.0}


def test_what_happens_is_printed_as_it_happens(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, observer = fake(monkeypatch)
    observer.at = {20: (contact(1),), 30: (contact(1, phase="end", intensity=4.0),)}
    path = write(
        tmp_path,
        STAND,
        {"say": "Touch me."},
        listen(),
        TURN,
        reflexes=[{"do": "hold", "pause": 0.1}],
        pushes=[PUSH],
    )
    log, figures = tmp_path / "run.mcap", tmp_path / "figures.json"
    assert run(["run", str(path), "--log", str(log), "--json", str(figures)]) == 0
    lines = lines_of(capsys)
    assert lines[0].startswith("pushes are left out: only a simulated robot")
    told = [line.split(" s  ")[1] for line in lines[1:] if " s  " in line]
    assert told == [
        "step stand",
        "step say",
        "say: Touch me.",
        "step listen",
        "contact LForeArm: begin, LElbowRoll +1, 3.0 deg",
        "reflex hold: begin",
        "contact LForeArm: end, LElbowRoll +1, 4.0 deg",
        "reflex hold: end",
        "step turn",
    ]
    assert "contacts: LForeArm 1" in lines
    assert "reflexes: hold 1" in lines
    content = json.loads(figures.read_text())
    assert content["completed"] is True
    assert content["waits"] == [{"step": "listen", "heard": True}]
    assert content["pushes_skipped"]
    assert read_log(log).complete


def test_a_run_that_stops_early_has_code_1(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fake(monkeypatch)
    path = write(tmp_path, STAND, listen(otherwise="stop"), TURN)
    assert run(["run", str(path)]) == 1
    assert "mine: stopped: nobody came in 'listen'" in capsys.readouterr().out
    far = {"position": {"link": "l_wrist", "target": [3, 0, 1], "joints": ["left_arm"]}}
    path = write(tmp_path, STAND, {**far, "until": "reached", "timeout": 0.3})
    assert run(["run", str(path)]) == 1
    assert "not every step reached its targets" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ([], "FILE"),
        (["gone.yaml"], "gone.yaml: cannot be read"),
        (["{mine}", "--backend", "mujocco"], "did you mean mujoco"),
        (["{mine}", "--log", "/dev/null/x.mcap"], "/dev/null/x.mcap"),
        (["{mine}", "--json", "/dev/null/x.json"], "/dev/null/x.json"),
        (["{wrong}"], "wrong.yaml line 5: key 'steps.0.posture': unknown posture 'Stnd'"),
    ],
)
def test_a_wrong_input_is_one_line_and_code_2(
    arguments: list[str], word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine, wrong = write(tmp_path, STAND), tmp_path / "wrong.yaml"
    wrong.write_text(mine.read_text().replace("posture: Stand", "posture: Stnd"))
    given = [argument.format(mine=mine, wrong=wrong) for argument in arguments]
    assert run(["run", *given]) == 2
    captured = capsys.readouterr()
    (line,) = captured.err.strip().splitlines()
    assert line.startswith("pepper: ")
    assert word in line
    assert "step stand" not in captured.out


@pytest.mark.parametrize(
    ("number", "code", "word"),
    [
        (signal.SIGINT, 130, "interrupted"),
        (signal.SIGTERM, 143, "terminated"),
        (signal.SIGHUP, 129, "hung up"),
    ],
)
def test_ctrl_c_and_signals_stop_the_robot_and_keep_the_log(
    tmp_path: Path, number: int, code: int, word: str
) -> None:
    path = write(tmp_path, STAND, {"wait": {"seconds": 600.0}}, observer=None)
    log = tmp_path / "run.mcap"
    command = [sys.executable, "-m", "pepper_driver", "run", str(path), "--log", str(log)]
    process = subprocess.Popen(
        [*command, "--real-time"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        for line in process.stdout:
            if "step wait" in line:
                break
        os.kill(process.pid, number)
        _, errors = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == code
    *missed, last = errors.splitlines()
    assert last == f"pepper: {word}; log: {log}"
    assert all("missed so far" in line for line in missed), errors  # on a busy machine
    assert read_log(log).complete
