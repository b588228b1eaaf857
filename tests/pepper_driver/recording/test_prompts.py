"""Touches that the robot asks for, and their labels."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.backends.mock import MockBackend
from pepper_driver.cli.app import run
from pepper_driver.config import load_robot
from pepper_driver.config.touch_prompts import TouchPrompt, TouchPrompts
from pepper_driver.log import read_log
from pepper_driver.recording.labels import LabelError, PromptedLabeller, pushes_of
from pepper_driver.recording.record import record_labelled
from pepper_driver.recording.terminal_keys import SpaceBar
from pepper_driver.robot import Pepper

ROBOT = load_robot()
HEAD = list(ROBOT.sensors.touch).index("Head/Touch/Front")
PROMPTS = TouchPrompts(
    version=1,
    rest=1.0,
    time=2.0,
    touches=(
        TouchPrompt(say="My left hand.", link="l_wrist"),
        TouchPrompt(say="My head.", link="Head", force=8.0),
        TouchPrompt(say="My chest.", link="torso"),
    ),
)


def labelled(*touches: tuple[float, float], skipped: int = 0) -> list[tuple[str, str | None]]:
    """Phases and links of the labels where the head is touched from one time to another.

    Times are those of the player, which counts ticks; after each of them ``skipped`` are missed.
    """
    labeller = PromptedLabeller("head", PROMPTS, ROBOT, SpaceBar(stop=print))
    still = MockBackend(ROBOT).open()
    found: list[tuple[str, str | None]] = []
    for tick in range(round(9.0 / ROBOT.cycle)):
        time = tick * ROBOT.cycle
        touch = np.zeros(len(ROBOT.sensors.touch))
        touch[HEAD] = float(any(begin <= time < end for begin, end in touches))
        # The clock of a robot does not begin at 0.
        measurement = replace(still, time=100.0 + (1 + skipped) * time, touch=touch)
        labels = labeller.step(measurement)
        found += [(label.phase, label.link) for label in labels]
    return found


def test_each_touch_has_the_place_that_was_asked_for() -> None:
    assert labelled((1.5, 2.0), (3.2, 4.0), (5.5, 6.0)) == [
        ("onset", "l_wrist"),
        ("release", "l_wrist"),
        ("onset", "Head"),
        ("release", "Head"),
        ("onset", "torso"),
        ("release", "torso"),
    ]


def test_places_stay_with_the_words_where_ticks_are_missed() -> None:
    touches = (1.5, 2.0), (3.2, 4.0), (5.5, 6.0)
    assert labelled(*touches, skipped=1) == labelled(*touches)


def test_a_touch_that_lasts_keeps_its_place_and_two_in_a_row_have_one() -> None:
    assert labelled((2.5, 3.6), (3.8, 4.5)) == [
        ("onset", "l_wrist"),
        ("release", "l_wrist"),
        ("onset", "Head"),
        ("release", "Head"),
    ]
    assert labelled((1.2, 1.6), (2.0, 2.4))[::2] == [("onset", "l_wrist"), ("onset", "l_wrist")]


def test_the_robot_asks_and_the_log_has_what_was_touched(tmp_path: Path) -> None:
    path, asked = tmp_path / "touches.mcap", list[tuple[int, str]]()
    sensor = ROBOT.sensors.touch["Head/Touch/Front"]

    def touch(pepper: Pepper) -> None:
        for delay in (1.5, 3.5):
            pepper.push(sensor.parent, (0.0, 0.0, -5.0), sensor.xyz, 0.5, delay=delay)

    done = record_labelled(
        "mujoco",
        path,
        "head",
        prompts=PROMPTS,
        on_prompt=lambda number, prompt: asked.append((number, prompt.say)),
        on_start=touch,
    )
    assert asked == [(0, "My left hand."), (1, "My head."), (2, "My chest.")]
    assert done.touches == 2
    assert done.seconds == pytest.approx(PROMPTS.seconds, abs=0.1)
    pushes = pushes_of(read_log(path))
    assert [push.link for push in pushes] == ["l_wrist", "Head"]
    # Of the force only that of the spring scale is known.
    assert math.isnan(pushes[0].force)
    assert pushes[1].force == 8.0


def test_the_robot_stands_before_it_asks(tmp_path: Path) -> None:
    path = tmp_path / "touches.mcap"
    record_labelled("mock://?posture=StandZero", path, "head", prompts=PROMPTS)
    log = read_log(path)
    # All of the log, since the places of the labels go by its ticks.
    np.testing.assert_allclose(
        log["position"], np.broadcast_to(ROBOT.posture("Stand"), (len(log), 17)), atol=0.01
    )
    assert np.ptp(log["time"]) == pytest.approx(PROMPTS.seconds, abs=0.1)


def test_prompts_have_their_own_motion_times_and_places(tmp_path: Path) -> None:
    with pytest.raises(LabelError, match="of their own"):
        record_labelled("mujoco", tmp_path / "x.mcap", "head", prompts=PROMPTS, seconds=3.0)
    with pytest.raises(LabelError, match="of their own"):
        record_labelled("mujoco", tmp_path / "x.mcap", "head", prompts=PROMPTS, link="Head")


def test_the_command_prints_what_it_asks_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    prompts = tmp_path / "own.yaml"
    prompts.write_text(
        'version: 1\nrest: 0.2\ntime: 2.0\ntouches: [{say: "My head.", link: Head, force: 8.0}]\n'
    )
    out = ["--out", str(tmp_path / "run.mcap"), "--label", "head"]
    assert run(["record", *out, "--prompts", str(prompts)]) == 0
    shown = capsys.readouterr().out
    assert "1 touch in 2 s" in shown
    assert "  1. My head. (8 N)" in shown
    prompts.write_text("version: 1\n")
    assert run(["record", *out, "--prompts", str(prompts)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "own.yaml" in line
