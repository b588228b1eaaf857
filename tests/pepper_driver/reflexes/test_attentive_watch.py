"""Watch over an attentive robot: hot and soft joints rest, joints that do not slide are found, and it is said once."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pepper_driver import Pepper
from pepper_driver.backends import Measurement
from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import load_controller_settings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.dither import Dither
from pepper_driver.log import read_log
from pepper_driver.reflexes.attentive import (
    CHECK_TIME,
    COOLED,
    STUCK_PERIODS,
    AttentiveNote,
    AttentiveWatch,
)
from support.reflexes import BLANK, ROBOT, ROLL

SETTINGS = load_controller_settings(ROBOT).attentive
WRIST = ROBOT.joint_index("LWristYaw")
ELBOW = ROBOT.joint_index("LElbowRoll")
FULL = np.ones(len(ROBOT.joint_names))
LIMIT = SETTINGS.max_temperature
MIDDLE = (ROBOT.lower + ROBOT.upper) / 2.0
CHECK = round(CHECK_TIME / ROBOT.cycle) + 1
FADE = round(SETTINGS.fade_time / ROBOT.cycle)
PERIOD = round(SETTINGS.period / ROBOT.cycle)

Follow = Callable[[FloatArray], FloatArray]


class Bench:
    """An attentive robot whose joints are where ``follow`` of the oscillation says, about a posture."""

    def __init__(self, posture: FloatArray = MIDDLE) -> None:
        self.dither = Dither(ROBOT, SETTINGS, ROBOT.cycle)
        self.dither.enabled = True
        self.watch = AttentiveWatch(ROBOT, self.dither)
        self.temperature, self.stiffness = np.full(len(FULL), 40.0), FULL
        self._posture = posture

    def run(self, ticks: int, follow: Follow = lambda d: d) -> list[AttentiveNote]:
        """Tick; return all notes."""
        notes = []
        for _ in range(ticks):
            self.dither.step(self._posture)
            measurement = replace(
                BLANK,
                position=self._posture + follow(self.dither.position),
                temperature=self.temperature,
            )
            notes += self.watch.step(measurement, self.stiffness)
        return notes


def heated(joint: int, degrees: float) -> FloatArray:
    temperature = np.full(len(FULL), 40.0)
    temperature[joint] = degrees
    return temperature


def test_a_robot_that_slides_needs_no_word(caplog: pytest.LogCaptureFixture) -> None:
    bench = Bench()
    assert bench.run(FADE + (STUCK_PERIODS + 2) * PERIOD) == []
    assert bench.watch.withheld == ()
    assert caplog.messages == []


def test_a_hot_joint_rests_until_it_has_cooled_and_that_is_said_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    bench = Bench()
    bench.run(FADE)
    bench.temperature = heated(ROLL, LIMIT)
    notes = bench.run(FADE + CHECK)
    assert [note.joint for note in notes] == ["LShoulderRoll"]
    assert f"{LIMIT:.0f} deg C" in notes[0].text
    assert bench.watch.withheld == ("LShoulderRoll",)
    assert bench.dither.position[ROLL] == 0.0
    assert bench.dither.full[ELBOW]
    # A motor about its limit must not swing on and off.
    bench.temperature = heated(ROLL, LIMIT - COOLED + 0.1)
    assert bench.run(2 * CHECK) == []
    bench.temperature = heated(ROLL, LIMIT - COOLED - 0.1)
    [again] = bench.run(FADE + CHECK)
    assert (again.joint, again.text) == ("LShoulderRoll", "it oscillates again")
    assert bench.dither.full[ROLL]
    # Each time it is in the log, and once it is warned of.
    bench.temperature = heated(ROLL, LIMIT + 5.0)
    assert len(bench.run(CHECK)) == 1
    assert len(caplog.messages) == 1
    assert caplog.records[0].levelno == logging.WARNING


@pytest.mark.parametrize("degrees", [np.nan, LIMIT - 0.1])
def test_a_joint_is_not_hot_for_lack_of_a_thermometer(degrees: float) -> None:
    bench = Bench()
    bench.temperature = heated(ROLL, degrees)
    assert bench.run(FADE + CHECK) == []
    assert bench.dither.full[ROLL]


def test_a_hot_joint_whose_thermometer_fails_stays_hot() -> None:
    bench = Bench()
    bench.temperature = heated(ROLL, LIMIT)
    assert len(bench.run(CHECK)) == 1
    bench.temperature = heated(ROLL, np.nan)
    assert bench.run(2 * CHECK) == []
    assert bench.watch.withheld == ("LShoulderRoll",)
    bench.temperature = heated(ROLL, LIMIT - COOLED - 0.1)
    [again] = bench.run(CHECK)
    assert again.text == "it oscillates again"


def test_a_hot_joint_that_does_not_oscillate_is_not_its_concern() -> None:
    bench = Bench()
    bench.temperature = heated(WRIST, 90.0)
    assert bench.run(CHECK) == []
    assert bench.watch.withheld == ()


def test_a_joint_of_lowered_stiffness_rests_for_no_observer_judges_it() -> None:
    bench = Bench()
    bench.run(FADE)
    soft = FULL.copy()
    soft[ROLL] = 0.6
    bench.stiffness = soft
    [note] = bench.run(FADE + CHECK)
    assert note.joint == "LShoulderRoll"
    assert "stiffness is lowered" in note.text
    assert bench.dither.position[ROLL] == 0.0
    bench.stiffness = FULL
    [again] = bench.run(FADE + CHECK)
    assert again.text == "it oscillates again"
    # Hot and soft at a time: it rests until it is neither.
    bench.stiffness, bench.temperature = soft, heated(ROLL, LIMIT)
    assert len(bench.run(CHECK)) == 2
    bench.stiffness = FULL
    assert bench.run(CHECK) == []
    assert bench.watch.withheld == ("LShoulderRoll",)


def stuck(*joints: int) -> Follow:
    """Joints that friction holds, as under a load that was not identified."""

    def follow(dither: FloatArray) -> FloatArray:
        position = dither.copy()
        position[list(joints)] = 0.001
        return position

    return follow


def test_a_joint_that_friction_holds_is_named_after_some_periods() -> None:
    bench = Bench()
    bench.run(FADE + PERIOD)
    assert bench.run((STUCK_PERIODS - 1) * PERIOD, stuck(ROLL)) == []
    [note] = bench.run(2 * PERIOD, stuck(ROLL))
    assert note.joint == "LShoulderRoll"
    assert "hardly moves" in note.text
    assert f"of {2.0 * SETTINGS.slide_deg:.1f} deg" in note.text
    assert bench.run(3 * STUCK_PERIODS * PERIOD, stuck(ROLL)) == []
    assert bench.watch.withheld == (), "it stays attentive as far as it can"


def test_a_joint_that_a_hand_holds_for_a_moment_is_not_named() -> None:
    bench = Bench()
    bench.run(FADE + PERIOD)
    for _ in range(4):
        assert bench.run((STUCK_PERIODS - 1) * PERIOD, stuck(ROLL)) == []
        assert bench.run(PERIOD) == []


def test_joints_that_a_reflex_has_are_not_named() -> None:
    bench = Bench()
    claimed = np.zeros(len(FULL), dtype=np.bool_)
    claimed[ROLL] = True
    for _ in range((STUCK_PERIODS + 2) * PERIOD):
        bench.dither.suspend(claimed)
        assert bench.run(1, stuck(ROLL)) == []


def test_a_joint_that_is_led_away_from_its_limit_is_named_once() -> None:
    posture = MIDDLE.copy()
    posture[ELBOW] = ROBOT.upper[ELBOW]
    bench = Bench(posture)
    [note] = bench.run(FADE + 4 * PERIOD)
    assert note.joint == "LElbowRoll"
    assert f"{SETTINGS.amplitude_deg:.1f} deg inside of its target" in note.text


def test_another_attentive_time_says_it_again() -> None:
    bench = Bench()
    bench.temperature = heated(ROLL, LIMIT)
    assert len(bench.run(CHECK)) == 1
    bench.watch.reset()
    assert bench.watch.withheld == ()
    assert len(bench.run(CHECK)) == 1


def test_log_and_robot_say_it(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Through all layers: a motor gets hot while the robot is attentive."""
    path = tmp_path / "run.mcap"

    def hot(measurement: Measurement) -> Measurement:
        return replace(measurement, temperature=heated(ROLL, LIMIT + 1.0))

    with Pepper("mock", observer=None, log=path) as pepper:
        assert isinstance(pepper.backend, MockBackend)
        pepper.attentive = True
        pepper.run(3.0)
        pepper.backend.faults = dict.fromkeys(range(10_000), hot)
        pepper.run(4.0)
        rows: list[FloatArray] = []
        pepper.run(3.0, on_tick=lambda *_: rows.append(pepper.controller.position))
    moved = np.ptp(np.array(rows), axis=0)
    assert moved[ROLL] < 1e-3
    assert moved[ELBOW] > np.radians(SETTINGS.amplitude_deg)
    updates = [event for event in read_log(path).events if event.phase == "update"]
    assert [(event.kind, event.joints) for event in updates] == [("attentive", ("LShoulderRoll",))]
    assert "deg C" in updates[0].text
    assert sum("LShoulderRoll" in message for message in caplog.messages) == 1
