"""Harm injected into a driving robot's sensors: what it was sent then, tick by tick."""

import logging
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver import Pepper
from pepper_driver.backends import Measurement
from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import ConfigError, load_safety_settings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.loading import package_file
from pepper_driver.controller import WholeBodyController
from pepper_driver.loop import Loop
from pepper_driver.reflexes import Arbiter
from pepper_driver.safety import FaultError, FaultReason, NotReadyError, RobotState, SafetyGate
from pepper_driver.testing import aged, displaced, drained, heated, pressed, standing_measurement
from support.safety import CONTROLLER, ROBOT, SAFETY, active_gate, new_gate

BEGIN = 60
"""Tick at which the harm is done; arm and wheels move then."""


def drive(
    backend: MockBackend,
    harm: Callable[[Measurement], Measurement],
    ticks: int,
    lasting: int = 10**6,
    seen: Callable[[FloatArray], object] = lambda _: None,
) -> tuple[Loop, SafetyGate]:
    """Drive an arm and the wheels for a number of ticks; harm from tick BEGIN on. ``seen`` gets each reference."""
    controller = WholeBodyController(ROBOT, CONTROLLER)
    gate = new_gate()
    backend.open()
    first = backend.activate()
    start = first.position
    controller.reset(start)
    gate.activate(start)
    loop = Loop(
        backend,
        ROBOT,
        arbiter := Arbiter(controller, ROBOT),
        gate,
        first=first,
        observer=None,
        publish=lambda record: None,
    )
    target = arbiter.target.copy()
    target[6] += 0.8
    arbiter.move_to(target)
    arbiter.drive(np.array([0.2, 0.0, 0.0]))
    for tick in range(BEGIN, min(ticks, BEGIN + lasting)):
        backend.faults[tick] = harm
    for _ in range(ticks):
        seen(loop.tick().tick.reference.position)
    return loop, gate


@pytest.mark.parametrize(
    ("harm", "reason", "word", "within"),
    [
        (aged(0.101), FaultReason.STALE_SAMPLE, "101 ms old", 1),
        (aged(np.nan), FaultReason.STALE_SAMPLE, "old", 1),
        (displaced("HeadPitch", np.nan), FaultReason.SENSOR, ROBOT.joint_names[4], 1),
        (displaced("HeadPitch", np.inf), FaultReason.SENSOR, ROBOT.joint_names[4], 1),
        (pressed("buttons"), FaultReason.CHEST_BUTTON, "chest", 1),
        (displaced("LShoulderRoll", 0.7), FaultReason.FOLLOWING_ERROR, ROBOT.joint_names[6], 43),
        (
            heated("LWristYaw", 75.0),
            FaultReason.TEMPERATURE,
            f"{ROBOT.joint_names[9]} has 75 deg C",
            127,
        ),
        (drained(0.04), FaultReason.BATTERY, "4%", 127),
    ],
)
def test_harm_stops_arm_and_wheels(harm: Any, reason: FaultReason, word: str, within: int) -> None:
    backend = MockBackend()
    with pytest.raises(FaultError, match=word) as caught:
        drive(backend, harm, BEGIN + within)
    assert caught.value.fault.reason is reason
    sent = backend.commands
    assert np.abs(sent[BEGIN - 1].wheel_speed).max() > 0.3, "it rolled before"
    assert sent[BEGIN - 1].position[6] != sent[BEGIN - 2].position[6], "it moved before"
    np.testing.assert_array_equal(sent[-1].wheel_speed, 0.0)
    np.testing.assert_array_equal(sent[-1].stiffness, 1.0)
    # what had left the gate is where it stays
    assert np.abs(sent[-1].position - sent[-2].position).max() < 0.01


@pytest.mark.parametrize(
    ("harm", "lasting"),
    [
        (aged(0.079), 100),
        (displaced("LShoulderRoll", 0.5), 100),
        (displaced("LShoulderRoll", 0.7), 20),
        (heated("LWristYaw", 75.0), 60),
        (heated("LWristYaw", 73.0), 200),
        (heated("LWristYaw", np.nan), 200),
        (drained(0.04), 60),
        (drained(0.06), 200),
        (drained(np.nan), 200),
    ],
)
def test_what_is_bearable_or_short_changes_nothing(harm: Any, lasting: int) -> None:
    free, backend = MockBackend(), MockBackend()
    drive(free, lambda measurement: measurement, 280)
    drive(backend, harm, 280, lasting)
    for ours, theirs in zip(backend.commands, free.commands, strict=True):
        np.testing.assert_array_equal(ours.position, theirs.position)
        np.testing.assert_array_equal(ours.wheel_speed, theirs.wheel_speed)


def test_an_old_sample_brakes_and_a_new_one_lets_go_on() -> None:
    backend = MockBackend()
    _, gate = drive(backend, aged(0.09), 400, lasting=40)
    assert gate.state is RobotState.ACTIVE
    position = np.array([command.position[6] for command in backend.commands])
    wheels = np.array([command.wheel_speed for command in backend.commands])
    assert not wheels[BEGIN : BEGIN + 40].any()
    assert np.ptp(position[BEGIN + 20 : BEGIN + 40]) == 0.0
    acceleration = np.abs(np.diff(position, 2)) / ROBOT.cycle**2
    assert (
        acceleration.max()
        <= SAFETY.acceleration_margin * CONTROLLER.acceleration_limit["LShoulderRoll"] + 1e-6
    )
    assert position[-1] - position[BEGIN + 40] > 0.1, "it goes on"
    assert np.abs(wheels[-1]).max() > 0.3


def test_while_samples_are_old_the_integrated_reference_stands_still() -> None:
    """Else the robot would have to catch up, at a jump, with all that it was not seen to do."""
    references: list[FloatArray] = []
    drive(MockBackend(), aged(0.09), 400, lasting=150, seen=references.append)
    position = np.array(references)
    moving = np.abs(np.diff(position[:BEGIN], axis=0)).max()
    assert moving > 0.005
    held = position[BEGIN + 30 : BEGIN + 148]
    # One cycle's acceleration ahead of where the joints stand, again and again.
    assert np.ptp(held, axis=0).max() < 1e-9
    after = np.diff(position[BEGIN + 140 :], axis=0)
    assert np.abs(after).max() < 1.2 * moving, "it goes on from there, and is in no hurry"


@pytest.mark.parametrize("index", [0, 1, 2])
def test_a_bumper_stops_the_base_until_some_time_after_it_was_let_go(
    index: int, caplog: pytest.LogCaptureFixture
) -> None:
    backend, free = MockBackend(), MockBackend()
    lasting, wait = 50, round(SAFETY.bumper_release / ROBOT.cycle)
    with caplog.at_level(logging.WARNING):
        _, gate = drive(backend, pressed("bumpers", index), 400, lasting)
    drive(free, lambda measurement: measurement, 400)
    assert gate.state is RobotState.ACTIVE
    speeds = np.array([np.abs(command.wheel_speed).max() for command in backend.commands])
    assert speeds[BEGIN - 1] > 0.3
    assert not speeds[BEGIN : BEGIN + lasting + wait].any()
    assert speeds[BEGIN + lasting + wait] > 0
    largest = np.abs(np.diff(speeds[BEGIN:])).max()
    assert largest < 0.1, "it starts gently"
    assert speeds[-1] > 0.3
    # the arms do not care
    for ours, theirs in zip(backend.commands, free.commands, strict=True):
        np.testing.assert_allclose(ours.position, theirs.position, atol=1e-6)
    messages = [record.getMessage() for record in caplog.records if "bumper" in record.getMessage()]
    assert messages == [
        f"the base stands still: bumper {list(ROBOT.sensors.bumpers)[index]} is pressed"
    ]


def test_a_bumper_that_cannot_be_read_and_an_open_charging_flap_stop_the_base() -> None:
    harms: list[Callable[[Measurement], Measurement]] = [
        lambda m: replace(m, bumpers=np.array([0.0, np.nan, 0.0])),
        lambda m: replace(m, charging_flap=1.0),
    ]
    for harm in harms:
        backend = MockBackend()
        _, gate = drive(backend, harm, 120)
        assert gate.state is RobotState.ACTIVE
        assert gate.base_stopped
        for command in backend.commands[BEGIN:]:
            np.testing.assert_array_equal(command.wheel_speed, 0.0)


def test_the_chest_button_can_be_switched_off_and_must_be_read_otherwise() -> None:
    measurement = pressed("buttons")(standing_measurement())
    gate = active_gate(chest_button=False)
    gate.watch(measurement, gate.sent)
    assert gate.state is RobotState.ACTIVE
    gate = active_gate()
    gate.watch(replace(measurement, buttons=np.array([np.nan])), gate.sent)
    assert gate.fault is not None
    assert gate.fault.reason is FaultReason.SENSOR


def test_what_cannot_be_read_is_said_once_and_stops_nothing(
    caplog: pytest.LogCaptureFixture,
) -> None:
    gate = active_gate()
    measurement = heated("HipRoll", np.nan)(drained(np.nan)(standing_measurement()))
    with caplog.at_level(logging.WARNING):
        for _ in range(400):
            gate.watch(measurement, gate.sent)
    assert gate.fault is None
    charge, temperature = (record.getMessage() for record in caplog.records)
    assert charge == "the charge of the battery cannot be read: nothing watches it"
    assert temperature == "the temperature of HipRoll is unknown and not monitored"


def test_the_motor_that_is_too_hot_is_named_not_one_that_is_warm() -> None:
    gate = active_gate()
    measurement = heated("RHand", 70.0)(heated("HeadYaw", 80.0)(standing_measurement()))
    for _ in range(400):
        gate.watch(measurement, gate.sent)
    assert gate.fault is not None
    assert gate.fault.text == "the motor of HeadYaw has 80 deg C"


def test_a_warning_comes_once_for_each_motor(caplog: pytest.LogCaptureFixture) -> None:
    def harm(measurement: Measurement) -> Measurement:
        return drained(0.15)(heated("HipRoll", 70.0)(heated("LWristYaw", 70.0)(measurement)))

    with caplog.at_level(logging.WARNING):
        drive(MockBackend(), harm, 400)
    messages = sorted(record.getMessage() for record in caplog.records)
    assert len(messages) == 3
    assert messages[0].startswith("the battery is at 15%")
    for index, text in zip(
        (2, 9), sorted(messages[1:], key=lambda t: ROBOT.joint_names[9] in t), strict=True
    ):
        assert ROBOT.joint_names[index] in text
        assert "74" in text


@pytest.mark.parametrize(
    ("harm", "word"),
    [
        (drained(0.09), "battery: 9% .charge it: below 10% the robot does not start"),
        (
            heated("LWristYaw", 74.0),
            f"{ROBOT.joint_names[9]} is warmest with 74 deg C .let {ROBOT.joint_names[9]} cool .* below 68",
        ),
        (pressed("buttons"), "chest button"),
        (displaced("HeadPitch", np.nan), f"no position of {ROBOT.joint_names[4]}"),
    ],
)
def test_a_robot_that_is_not_fit_is_not_activated(
    harm: Callable[[Measurement], Measurement], word: str
) -> None:
    pepper = Pepper("mock", observer=None)
    pepper.backend = backend = MockBackend(faults={0: harm})
    with pytest.raises(NotReadyError, match=word):
        pepper.start()
    assert backend.calls == ["open", "close"]
    assert backend.commands == []
    assert pepper.state is RobotState.INACTIVE


def test_all_reasons_are_reported_at_once() -> None:
    gate = new_gate()
    measurement = drained(0.02)(heated("HipPitch", 90.0)(standing_measurement()))
    with pytest.raises(NotReadyError) as caught:
        gate.check_ready(measurement)
    assert "battery: 2%" in str(caught.value)
    assert f"{ROBOT.joint_names[1]} is warmest with 90 deg C" in str(caught.value)
    gate.check_ready(drained(np.nan)(heated("HipPitch", np.nan)(measurement)))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("stale_hold", "0.2"),
        ("temperature_warning", "80.0"),
        ("battery_fault", "0.15"),
        ("battery_activate", "0.5"),
        ("limit_activate", "0.001"),
        ("battery_warning", "1.5"),
        ("chest_button", "2"),
        ("speed_margin", "0.9"),
        ("bumper_release", "-1.0"),
    ],
)
def test_settings_that_cannot_be_are_refused(key: str, value: str, tmp_path: Path) -> None:
    shipped = package_file("safety.yaml").read_text()
    path = tmp_path / "safety.yaml"
    path.write_text(re.sub(rf"^{key}: \S+", f"{key}: {value}", shipped, flags=re.MULTILINE))
    with pytest.raises(ConfigError, match=key) as caught:
        load_safety_settings(path)
    assert "safety.yaml" in str(caught.value)
