"""``pepper move``, as a user meets it."""

import json
import re
import time
from pathlib import Path

import pytest

from pepper_driver.cli.app import run
from pepper_driver.config import load_motion, load_robot, motion_names
from pepper_driver.log import read_log

SHORT = """
schema: 1
name: short
steps:
  - {name: look, duration: 0.6, look_at: {point: [1.0, 0.3, 1.0]}, hands: {LHand: 1.0}}
  - {name: far, until: reached, timeout: 0.36, position: {link: l_wrist, target: [3, 0, 1], joints: [left_arm]}}
  - {name: back, duration: 0.6, posture: Stand, base_velocity: {wz: 0.1}}
"""


@pytest.mark.parametrize("name", motion_names())
def test_a_dry_run_prints_the_plan_and_writes_nothing(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.mcap"
    assert run(["move", name, "--dry-run", "--log", str(log)]) == 0
    lines = capsys.readouterr().out.splitlines()
    steps = load_motion(name, load_robot()).steps
    count = "1 step" if len(steps) == 1 else f"{len(steps)} steps"
    assert lines[0].startswith(f"{name}: {count}, ")
    assert [line.split(":")[0] for line in lines[1:]] == [
        f"step {number} {step.name}" for number, step in enumerate(steps)
    ]
    assert not log.exists()


def test_the_plan_names_every_part(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "short.yaml"
    path.write_text(SHORT)
    assert run(["move", str(path), "--dry-run"]) == 0
    assert capsys.readouterr().out.splitlines()[1:] == [
        "step 0 look: 0.60 s; LHand to 1; look at 1 0.3 1 m",
        "step 1 far: until reached, 0.36 s at most; position l_wrist to 3 0 1 m",
        "step 2 back: 0.60 s; posture Stand; base at 0 0 m/s, 0.1 rad/s",
    ]


def test_the_plan_of_one_step_and_of_a_hand_among_the_joints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "one.yaml"
    path.write_text(
        "schema: 1\nname: one\nsteps: [{duration: 1.0, joints: {LHand: 0.5, HeadYaw: 0.2}}]\n"
    )
    assert run(["move", str(path), "--dry-run"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "one: 1 step, 1.0 s at most",
        "step 0: 1.00 s; LHand to 0.5; HeadYaw to 0.2 rad",
    ]


def test_a_motion_is_played_logged_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, log, figures = (tmp_path / name for name in ("short.yaml", "run.mcap", "figures.json"))
    path.write_text(SHORT)
    code = run(["move", str(path), "--log", str(log), "--json", str(figures)])
    assert code == 1  # one step was not reached
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("step 0 look: 0.60 s: posture off by ")
    assert lines[1].startswith("step 1 far: 0.36 s, NOT reached: position l_wrist off by ")
    assert lines[2].startswith("step 2 back: 0.60 s: posture off by ")
    content = json.loads(figures.read_text())
    assert [step["reached"] for step in content["steps"]] == [None, False, None]
    assert read_log(log).complete
    assert len(read_log(log)) == 130


def test_in_real_time_the_ticks_are_accounted_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "one.yaml"
    path.write_text("schema: 1\nname: one\nsteps: [{duration: 0.3, joints: {HeadYaw: 0.1}}]\n")
    begin = time.monotonic()
    assert run(["move", str(path), "--real-time"]) == 0
    assert time.monotonic() - begin >= 0.28
    # It ticks from the start to the end, a little longer than the motion.
    ticks = re.search(r"(\d+) ticks of 12 ms in real time, ", capsys.readouterr().out)
    assert ticks is not None
    assert 25 <= int(ticks[1]) < 100


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["move"], "NAME_OR_FILE"),
        (["move", "wav"], "did you mean wave"),
        (["move", "gone.yaml"], "gone.yaml"),
        (["move", "/dev/null/x.yaml"], "/dev/null/x.yaml"),
        (["move", "wave", "--backend", "mujocco"], "did you mean mujoco"),
        (["move", "wave", "--dry-run", "--backend", "mujoco://?plant=worm"], "unknown plant"),
        (["move", "wave", "--json", "/dev/null/x.json"], "/dev/null/x.json"),
        (["move", "wave", "--log", "/dev/null/x.mcap"], "/dev/null/x.mcap"),
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
    assert word.lower() in lines[0].lower()
    assert "step 0" not in captured.out
    assert list(tmp_path.iterdir()) == [], "nothing half-written"


def test_a_wrong_motion_names_file_and_key(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "short.yaml"
    path.write_text(SHORT.replace("link: l_wrist", "link: l_wris"))
    assert run(["move", str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "short.yaml line 6: key 'steps.1.position.link'" in line
    assert "did you mean l_wrist" in line
