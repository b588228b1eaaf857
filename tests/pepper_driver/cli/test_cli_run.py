"""``pepper run``, as a user meets it."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from pepper_driver.callbacks.events import PushEvent
from pepper_driver.cli.app import run
from pepper_driver.cli.run import event_text
from pepper_driver.config import load_experiment, load_robot
from pepper_driver.config.loading import shipped_names
from pepper_driver.log import read_log
from pepper_driver.observer import KnownPush, shipped
from support.events import contact
from support.experiments import EXAMPLES, STAND, TURN, fake, listen, write

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
SHORT = """
schema: 2
name: short
steps:
  - {name: look, duration: 0.6, look_at: {point: [1.0, 0.3, 1.0]}, hands: {LHand: 1.0}}
  - {name: far, until: reached, timeout: 0.36, position: {link: l_wrist, target: [3, 0, 1], joints: [left_arm]}}
  - {name: back, duration: 0.6, posture: Stand, base_velocity: {wz: 0.1}}
"""


def lines_of(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return capsys.readouterr().out.splitlines()


# -- the plan ---------------------------------------------------------------------------------------------------------


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
    experiment = load_experiment(path, load_robot())
    for word in ("stand", "posture Stand", "on contact", "reflex", "priority"):
        assert word in text
    assert ("pushed with" in text) == bool(experiment.contacts)
    assert not log.exists()
    plan = json.loads(figures.read_text())
    assert plan["contacts"] == len(experiment.contacts)
    assert plan["reflexes"]
    assert plan["steps"][0] == {"key": "steps.0", "name": "stand", "from": 0.0}


@pytest.mark.parametrize("name", shipped_names("motions"))
def test_a_dry_run_of_a_motion_has_a_line_for_each_step(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["run", name, "--dry-run"]) == 0
    lines = lines_of(capsys)
    experiment = load_experiment(name, load_robot())
    assert lines[0].startswith(f"{name}: ")
    names = [re.match(r" +\d+\.\d\d s  (.+?): ", line) for line in lines[1:]]
    assert [match and match[1] for match in names] == [step.name for step in experiment.steps]


def test_the_plan_names_every_part(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "short.yaml"
    path.write_text(SHORT)
    assert run(["run", str(path), "--dry-run"]) == 0
    assert lines_of(capsys) == [
        "short: at most 1.6 s",
        "     0.00 s  look: 0.60 s; LHand to 1; look at 1 0.3 1 m",
        "     0.60 s  far: until reached, 0.36 s at most; position l_wrist to 3 0 1 m",
        "     0.96 s  back: 0.60 s; posture Stand; base at 0 0 m/s, 0.1 rad/s",
    ]


def test_the_plan_of_blocks_and_reactions(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path, {"name": "nod", "joints": {"HeadPitch": 0.0}, "duration": 0.6}, file="nod")
    loop = {"repeat": {"times": 3, "until": {"limb": "head"}, "steps": [{"play": "nod.yaml"}]}}
    cases = [{"on": {"min_torque": 5, "lasting": 0.5}, "steps": [{"say": "Ouch!"}]}]
    branch = {"name": "which", "branch": {"timeout": 1.2, "cases": cases, "otherwise": [STAND]}}
    hands = {"joints": {"LHand": 0.5, "HeadYaw": 0.2}, "hold": 0.6}
    reactions = [{"on": {"limb": "head"}, "say": "Oh!", "play": "nod.yaml"}, {"do": "hold"}]
    path = write(tmp_path, loop, branch, hands, reactions=reactions)
    assert run(["run", str(path), "--dry-run"]) == 0
    assert lines_of(capsys) == [
        "mine: at most 3.7 s",
        "  3 times, or until contact on head:",
        "    play nod.yaml:",
        "         0.00 s  nod: 0.60 s; HeadPitch to 0 rad",
        "     1.80 s  which: at most 1.20 s; wait for a contact, or continue",
        "  after contact, 5 N m and more, lasting 0.5 s:",
        "       3.00 s  2: no time; say: Ouch!",
        "  otherwise:",
        "       3.00 s  stand: 0.10 s; posture Stand",
        "     3.10 s  4: hold 0.60 s; LHand to 0.5; HeadYaw to 0.2 rad",
        "  on contact on head: say: Oh!; play nod.yaml",
        "  on contact: hold",
        "  reflex hold: priority 20, then resume",
    ]


# -- a run ------------------------------------------------------------------------------------------------------------


def test_what_happens_is_printed_as_it_happens(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, observer = fake(monkeypatch)
    observer.at = {
        20: (contact(1, torque=-1.26),),
        30: (contact(1, phase="end", intensity_deg=4.0),),
    }
    path = write(
        tmp_path,
        STAND,
        {"name": "say", "say": "Touch me."},
        listen(),
        TURN,
        reactions=[{"do": "hold", "release_delay": 0.1}],
        contacts=[PUSH],
    )
    log, figures = tmp_path / "run.mcap", tmp_path / "figures.json"
    options = ["--no-contacts", "--log", str(log), "--json", str(figures)]
    assert run(["run", str(path), *options]) == 0
    lines = lines_of(capsys)
    reported = [line.split(" s  ")[1] for line in lines if " s  " in line]
    assert reported == [
        "step stand",
        "step say",
        "say: Touch me.",
        "step listen",
        "contact LForeArm: begin, LElbowRoll +1, 3.0 deg, 1.3 N m",
        "reflex hold: begin, has 17 joints",
        "contact LForeArm: end, LElbowRoll +1, 4.0 deg",
        "reflex hold: end, has 17 joints",
        "step turn",
    ]
    assert "contacts: LForeArm 1" in lines
    assert "reflexes: hold 1" in lines
    content = json.loads(figures.read_text())
    assert content["completed"] is True
    assert content["waits"] == [{"step": "listen", "detected": True}]
    assert read_log(log).complete


def test_a_push_is_reported_with_the_time_at_which_it_begins() -> None:
    push = KnownPush(
        joint="LElbowRoll",
        link="LForeArm",
        direction=1,
        force=20.0,
        torque=2.0,
        degrees=2.0,
        onset=4.3,
        release=5.1,
        moving=False,
    )
    reported = PushEvent(link="LForeArm", text="pushed with 20.0 N", time=4.0, push=push)
    assert event_text(reported) == "push  LForeArm: from 4.30 s pushed with 20.0 N"
    spared = PushEvent(link="LForeArm", text="left out: it is held", time=4.0, push=None)
    assert event_text(spared) == "push  LForeArm: left out: it is held"


def test_what_steps_with_tasks_reached_is_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, log, figures = (tmp_path / name for name in ("short.yaml", "run.mcap", "figures.json"))
    path.write_text(SHORT)
    assert run(["run", str(path), "--log", str(log), "--json", str(figures)]) == 1
    reported = [line.split(" s  ")[1] for line in lines_of(capsys) if " s  " in line]
    assert [text.split(":")[0] for text in reported] == [
        "step look",
        "step look",
        "step far",
        "step far",
        "step back",
    ]
    assert reported[1].startswith("step look: 0.60 s: posture off by ")
    assert reported[3].startswith("step far: 0.36 s, NOT reached: position l_wrist off by ")
    content = json.loads(figures.read_text())
    assert [step["reached"] for step in content["steps"]] == [None, False, None]
    assert read_log(log).complete
    assert len(read_log(log)) == 130


def test_a_contact_that_only_the_wheels_detect_has_no_degrees() -> None:
    event = contact(joint=None, link="base_link", intensity_deg=0.0)
    assert event_text(event) == "contact base_link: begin, trunk +1, -"


def test_a_run_that_stops_early_has_code_1(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fake(monkeypatch)
    path = write(tmp_path, STAND, listen(on_timeout="stop"), TURN)
    assert run(["run", str(path)]) == 1
    assert "mine: stopped: wait 'listen' timed out" in capsys.readouterr().out
    far = {"position": {"link": "l_wrist", "target": [3, 0, 1], "joints": ["left_arm"]}}
    path = write(tmp_path, STAND, {**far, "until": "reached", "timeout": 0.3})
    assert run(["run", str(path)]) == 1
    assert "not every step reached its targets" in capsys.readouterr().out


def test_models_of_the_command_line_come_before_those_of_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    models, worn = shipped("fusion")["nominal"], "mujoco://?plant=worn"
    path = write(tmp_path, STAND, observer={"mode": "fusion", "models": "gone.json"})
    assert run(["run", str(path), "--dry-run"]) == 2
    assert "gone.json" in capsys.readouterr().err
    arguments = ["run", str(path), "--dry-run", "--models", str(models)]
    assert run(arguments) == 0
    assert run([*arguments, "--backend", worn]) == 0
    assert run([*arguments, "--backend", "mock"]) == 2
    assert "identified on another robot than 'mock'" in capsys.readouterr().err
    path = write(tmp_path, STAND, observer=None)  # they make one
    assert run(["run", str(path), "--dry-run", "--models", str(models), "--backend", "mock"]) == 2
    assert "identified on another robot than 'mock'" in capsys.readouterr().err


def test_a_table_says_which_pushes_were_detected(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The second is too light to be detected."""
    strong = PUSH | {"step": "rest", "force": [0.0, 20.0, 0.0], "start": 0.6, "duration": 1.0}
    light = PUSH | {"step": "rest", "link": "RForeArm", "joint": "RElbowRoll"}
    light |= {"xyz": [0.14, 0.0, 0.0], "force": [0.5, 0.0, 0.0], "start": 3.0}
    steps = [{"posture": "Stand", "hold": 1.2}, {"name": "rest", "hold": 4.2}]
    path = write(tmp_path, *steps, contacts=[strong, light])
    assert run(["run", str(path), "--backend", "mujoco://?plant=integral"]) == 0
    lines = lines_of(capsys)
    assert "1 of 2 pushes detected, 0 false contacts" in lines
    rows = [line for line in lines if " N " in line and ("LBicep" in line or "RForeArm" in line)]
    detected = next(row for row in rows if row.count("LBicep") == 3)
    assert re.search(r"20\.0 N +│? *\d+ ms", detected)
    assert any("0.5 N" in row and row.rstrip(" │┃|").endswith("-") for row in rows)


def test_in_real_time_the_ticks_are_accounted_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "one.yaml"
    path.write_text("schema: 2\nname: one\nsteps: [{duration: 0.3, joints: {HeadYaw: 0.1}}]\n")
    begin = time.monotonic()
    assert run(["run", str(path), "--real-time"]) == 0
    assert time.monotonic() - begin >= 0.28
    # It ticks from the start to the end, a little longer than the steps.
    ticks = re.search(r"(\d+) ticks of 12 ms in real time, ", capsys.readouterr().out)
    assert ticks is not None
    assert 25 <= int(ticks[1]) < 100


# -- wrong input ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ([], "NAME_OR_FILE"),
        (["gone.yaml"], "gone.yaml: cannot be read"),
        (["wav"], "did you mean wave"),
        (["/dev/null/x.yaml"], "/dev/null/x.yaml"),
        (["{mine}", "--backend", "mujocco"], "did you mean mujoco"),
        (["{mine}", "--dry-run", "--backend", "mujoco://?plant=worm"], "unknown plant"),
        (["{mine}", "--log", "/dev/null/x.mcap"], "/dev/null/x.mcap"),
        (["{mine}", "--json", "/dev/null/x.json"], "/dev/null/x.json"),
        (["{mine}", "--seed", "-1"], "--seed"),
        (["{wrong}"], "wrong.yaml line 5: key 'steps.0.posture': unknown posture 'Stnd'"),
        (["{task}"], "task.yaml line 6: key 'steps.1.position.link': unknown link 'l_wris'"),
        (["{old}"], "old.yaml line 1: key 'schema': a file of an old form, 'schema: 1'"),
        (["{pushed}", "--backend", "mock"], "leave them out with 'pepper run --no-contacts'"),
    ],
)
def test_a_wrong_input_is_one_line_and_code_2(
    arguments: list[str],
    word: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder = tmp_path / "files"
    folder.mkdir()
    mine = write(folder, STAND)
    texts = {
        "wrong": mine.read_text().replace("posture: Stand", "posture: Stnd"),
        "task": SHORT.replace("link: l_wrist", "link: l_wris"),
        "old": mine.read_text().replace("schema: 2", "schema: 1"),
    }
    rest = {"name": "listen", "hold": 1.2}
    files = {
        "mine": mine,
        "pushed": write(folder, STAND, rest, contacts=[PUSH], file="pushed", observer=None),
    }
    for name, text in texts.items():
        files[name] = folder / f"{name}.yaml"
        files[name].write_text(text)
    empty = tmp_path / "empty"
    empty.mkdir()
    monkeypatch.chdir(empty)
    assert run(["run", *(argument.format(**files) for argument in arguments)]) == 2
    captured = capsys.readouterr()
    (line,) = captured.err.strip().splitlines()
    assert line.startswith("pepper: ")
    assert word.lower() in line.lower()
    assert "step stand" not in captured.out
    assert list(empty.iterdir()) == [], "nothing half-written"


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
    path = write(tmp_path, STAND, {"name": "wait", "hold": 600.0}, observer=None)
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
