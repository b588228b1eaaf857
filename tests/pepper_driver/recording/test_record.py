"""Labelled runs, in simulation: sensors that answer to pushes, keys, Ctrl-C; ``pepper record`` as a user meets it."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pepper_driver import FaultError, FaultReason
from pepper_driver.cli.app import run
from pepper_driver.config import load_experiment, load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.signals import describe_interrupt
from pepper_driver.log import Label, read_log
from pepper_driver.recording.labels import LabelError, pushes_of, recording_of
from pepper_driver.recording.record import record_labelled
from pepper_driver.recording.terminal_keys import NoTerminalError, SpaceBar
from pepper_driver.replay import compare, load_run, replay
from pepper_driver.robot import Pepper
from support.jitter import Jittery
from support.waiting import wait_until

ROBOT = load_robot()
CYCLE = ROBOT.cycle


def pusher(pepper: Pepper, name: str, force: FloatArray, *delays: float) -> None:
    """Push the place of a sensor for 0.5 s, after each of these times [s]."""
    sensors = ROBOT.sensors
    sensor = {**sensors.touch, **sensors.bumpers}[name]
    for delay in delays:
        pepper.push(sensor.parent, force, sensor.xyz, 0.5, delay=delay)


@pytest.mark.parametrize(
    ("source", "sensor", "force", "link", "joint"),
    [
        ("head", "Head/Touch/Front", [0.0, 0.0, -5.0], "Head", "HeadPitch"),
        ("hand-left", "LHand/Touch/Back", [0.0, 0.0, -5.0], "l_wrist", "LWristYaw"),
        ("bumper", "FrontLeft", [-20.0, 0.0, 0.0], "Tibia", None),
    ],
)
def test_touches_of_a_sensor_are_labelled_when_they_happen(
    tmp_path: Path, source: str, sensor: str, force: list[float], link: str, joint: str | None
) -> None:
    path, reported = tmp_path / "run.mcap", list[Label]()
    done = record_labelled(
        "mujoco",
        path,
        source,
        seconds=2.4,
        on_label=reported.append,
        on_start=lambda pepper: pusher(pepper, sensor, np.array(force), 0.3, 1.4),
    )
    log = read_log(path)
    assert log.complete
    assert log.labels == reported
    assert (done.touches, done.released, done.interrupt, done.missing) == (2, True, None, 0)
    assert done.seconds == pytest.approx(2.4)
    assert len(log) == 200
    start = float(log["time"][0]) - CYCLE
    # The force rises and falls over 0.1 s, and a sensor has a threshold.
    for push, onset in zip(pushes_of(log), (0.3, 1.4), strict=True):
        assert push.onset - start == pytest.approx(onset, abs=0.07)
        assert push.release - start == pytest.approx(onset + 0.5, abs=0.07)
        assert push.onset in log["time"]
        assert (push.link, push.joint) == (link, joint)
    sensed = [event for event in log.events if event.kind not in ("step", "cue", "push")]
    assert len(sensed) >= 4, "what the sensors reported is logged as in any other run"
    recording = recording_of(log, ROBOT)
    np.testing.assert_array_equal(recording.position, log["position"])
    assert log.truth is not None
    torque = np.abs(log.truth["contact_torque"]).max(axis=1)
    pushed = log["time"][torque > 0]
    if joint is not None:  # a push on the base turns no joint
        assert abs(pushed[0] - pushes_of(log)[0].onset) < 0.07


def test_a_recording_over_a_network_replays_to_the_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    late = np.random.default_rng(1).choice([0, 0, 0, 1, 2, 4], 400)
    monkeypatch.setattr("pepper_driver.robot.make_backend", lambda uri, _: Jittery(uri, late))
    path, wave = tmp_path / "run.mcap", load_experiment("wave", ROBOT)
    record_labelled("mujoco", path, "head", experiment=wave)
    assert len(read_log(path).unmatched["step"]) > 20
    run = load_run(path)
    result = compare(run, replay(run, run.observer(), run.reflexes()))
    assert result.identical, result.differences
    assert result.commands.compared > len(run.log) - 10


def test_a_motion_is_repeated_until_the_time_is_over(tmp_path: Path) -> None:
    text = "schema: 2\nname: short\nsteps: [{duration: 0.6, joints: {HeadYaw: 0.3}}]\n"
    (tmp_path / "short.yaml").write_text(text)
    short = load_experiment(tmp_path / "short.yaml", ROBOT)
    for seconds, ticks in ((None, 50), (1.0, 100), (1.3, 150)):
        path = tmp_path / "run.mcap"
        record_labelled("mujoco", path, "head", experiment=short, seconds=seconds)
        log = read_log(path)
        assert abs(len(log) - ticks) <= 3
        assert np.ptp(log["reference_position"][:, ROBOT.joint_index("HeadYaw")]) > 0.2


def test_random_goals_are_recorded_with_the_way_to_them(tmp_path: Path) -> None:
    (tmp_path / "nod.yaml").write_text(NOD)
    nod = load_experiment(tmp_path / "nod.yaml", ROBOT)
    done = record_labelled("mujoco", tmp_path / "run.mcap", "head", experiment=nod, seed=1)
    log = read_log(tmp_path / "run.mcap")
    assert len(log) == 150, "the way to its first posture is logged, too"
    assert done.seconds == pytest.approx(150 * CYCLE)
    assert np.ptp(log["reference_position"][:, ROBOT.joint_index("HeadPitch")]) > 0.1


NOD = """
schema: 2
name: nod
stiffness: 20.0
steps:
  - setpoints: {joints: [HeadPitch], range: 0.9, settle: 0.6, period: 0.6, count: 2}
reactions:
  - {say: Oh!, do: hold}                 # left out
"""


def test_ctrl_c_ends_the_run_and_leaves_the_recording(tmp_path: Path) -> None:
    def interrupt(label: Label) -> None:
        raise KeyboardInterrupt

    path = tmp_path / "run.mcap"
    done = record_labelled(
        "mujoco",
        path,
        "head",
        seconds=60.0,
        on_label=interrupt,
        on_start=lambda pepper: pusher(pepper, "Head/Touch/Rear", np.array([0, 0, -5.0]), 0.3),
    )
    assert (done.touches, done.released) == (1, False)
    assert done.interrupt is not None
    assert describe_interrupt(done.interrupt) == f"interrupted; log: {path}"
    log = read_log(path)
    assert log.complete
    assert 20 < len(log) < 60
    assert [label.phase for label in log.labels] == ["onset"]
    assert pushes_of(log)[0].release == log["time"][-1]


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), float("inf")])
def test_a_time_that_is_none_is_refused(tmp_path: Path, seconds: float) -> None:
    with pytest.raises(LabelError, match="seconds must be"):
        record_labelled("mujoco", tmp_path / "run.mcap", "head", seconds=seconds)
    with pytest.raises(LabelError, match="give seconds"):
        record_labelled("mujoco", tmp_path / "run.mcap", "head")
    assert list(tmp_path.iterdir()) == []


# -- keys ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """The far end of a terminal that is standard input."""
    far, near = pty.openpty()
    with os.fdopen(near) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield far
    os.close(far)


def press(terminal: int) -> None:
    os.write(terminal, b" ")


def wait_for(bar: SpaceBar, on: bool) -> None:
    assert wait_until(lambda: bar.on == on), "the key was not seen"


def test_each_press_of_the_space_bar_turns_it(terminal: int) -> None:
    import termios

    before = termios.tcgetattr(sys.stdin.fileno())
    with SpaceBar(stop=print) as bar:
        assert not bar.on
        os.write(terminal, b"x ")
        wait_for(bar, True)
        os.write(terminal, b" ")
        wait_for(bar, False)
        os.write(terminal, b" ")
        wait_for(bar, True)
        bar.forget()
        assert not bar.on
    assert termios.tcgetattr(sys.stdin.fileno()) == before


def test_a_key_labels_a_simulated_run_in_real_time(terminal: int, tmp_path: Path) -> None:
    begin = time.monotonic()
    phases: list[str] = []

    def answer(label: Label) -> None:
        phases.append(label.phase)
        if len(phases) < 3:
            os.write(terminal, b" ")

    done = record_labelled(
        "mujoco",
        tmp_path / "run.mcap",
        "key",
        seconds=2.4,
        link="LForeArm",
        on_label=answer,
        on_start=lambda _: press(terminal),
    )
    assert time.monotonic() - begin > 2.3
    assert phases == ["onset", "release", "onset"]
    assert (done.touches, done.released) == (2, False)
    log = read_log(tmp_path / "run.mcap")
    assert [label.phase for label in log.labels] == phases
    assert {(label.source, label.link, label.joint) for label in log.labels} == {
        ("key", "LForeArm", "LElbowRoll")
    }
    assert np.isfinite(log["tick_end"]).all(), "ticks were paced"


def test_q_stops_a_robot_while_the_space_bar_labels_touches(terminal: int, tmp_path: Path) -> None:
    """The label of before is kept; the space bar itself stops nothing."""
    phases: list[str] = []

    def stop(label: Label) -> None:
        phases.append(label.phase)
        os.write(terminal, b"q")

    with pytest.raises(FaultError, match="q was pressed") as caught:
        record_labelled(
            "mujoco",
            tmp_path / "run.mcap",
            "key",
            seconds=60.0,
            on_label=stop,
            on_start=lambda _: press(terminal),
        )
    assert caught.value.fault.reason is FaultReason.EMERGENCY_STOP
    assert phases == ["onset"]
    assert [label.phase for label in read_log(tmp_path / "run.mcap").labels] == ["onset"]


def test_keys_need_a_terminal(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with (tmp_path / "empty").open("w+") as file:
        for stdin in (file, None):
            monkeypatch.setattr(sys, "stdin", stdin)
            with pytest.raises(NoTerminalError, match="need a terminal"):
                record_labelled("mujoco", tmp_path / "run.mcap", "key", seconds=1.0)
    assert not (tmp_path / "run.mcap").exists()


# -- the command --------------------------------------------------------------------------------------------------


def test_the_command_says_what_it_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.mcap"
    assert run(["record", "--out", str(path), "--label", "head", "--seconds", "0.6"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("recording: touch the robot")
    assert lines[1:] == ["0.6 s, 0 touches", f"log: {path}"]
    assert len(read_log(path)) == 50


def test_the_command_in_a_terminal(tmp_path: Path) -> None:
    """Space, space, Ctrl-C."""
    path = tmp_path / "run.mcap"
    far, near = pty.openpty()
    arguments = ["--out", str(path), "--label", "key", "--link", "Head", "--seconds", "600"]
    process = subprocess.Popen(
        [sys.executable, "-m", "pepper_driver", "record", *arguments],
        stdin=near,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        bufsize=1,
    )
    os.close(near)
    guard = threading.Timer(120.0, process.kill)  # readline would wait for ever
    guard.start()
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert "press the space bar" in line
        assert "q stops the robot" in line
        for phase in ("onset", "release"):
            os.write(far, b" ")
            assert phase in process.stdout.readline()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        guard.cancel()
        process.kill()
        os.close(far)
    assert process.returncode == 130
    *missed, last = err.splitlines()
    assert last == f"pepper: interrupted; log: {path}"
    assert all("missed so far" in line for line in missed), err  # on a busy machine
    assert out.splitlines()[-2].endswith(" s, 1 touch")
    log = read_log(path)
    assert log.complete
    (push,) = pushes_of(log)
    assert (push.link, push.joint) == ("Head", "HeadPitch")
    assert push.release > push.onset


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ([], "--label"),
        (["--label", "hed"], "must be key, head,"),
        (["--label", "head", "--backend", "mujocco"], "did you mean mujoco"),
        (["--label", "head", "--seconds", "0"], "seconds must be"),
        (["--label", "head", "--play", "wav"], "did you mean wave"),
        (["--label", "head", "--play", "dem"], "did you mean demo"),
        (["--label", "head", "--play", "gone.yaml"], "gone.yaml: cannot be read"),
        (["--label", "head", "--motion", "wave"], "unknown option '--motion'"),
        (["--label", "head", "--link", "Hed"], "did you mean Head"),
        (["--label", "head", "--joint", "HeadPich"], "did you mean HeadPitch"),
        (["--label", "head", "--out", "/dev/null/x.mcap"], "/dev/null/x.mcap"),
        (["--label", "key"], "need a terminal"),
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
    monkeypatch.setattr(sys, "stdin", None)
    out = [] if "--out" in arguments else ["--out", "x.mcap"]
    assert run(["record", *out, *arguments]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("pepper: ")
    assert word in line
    assert list(tmp_path.iterdir()) == [], "nothing half-written"
