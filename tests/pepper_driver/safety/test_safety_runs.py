"""The gate on the simulated robot: it leaves normal runs alone, and what it changes raises no contact."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver import FaultError, FaultReason, Hold, Pepper, RobotState
from pepper_driver.config import (
    ControllerSettings,
    RobotConfig,
    SafetySettings,
    load_observer_settings,
    load_robot,
    load_safety_settings,
)
from pepper_driver.config.loading import package_file
from pepper_driver.controller import Tick
from pepper_driver.observer import ContactObserver, ModelSet, Observation
from pepper_driver.safety import SafetyGate
from support.fakes import slowed

ROBOT = load_robot()
MODELS = Path(str(package_file("..", "observer", "models", "nominal-fusion.json")))
ARMS = [
    n
    for n in ROBOT.joint_names
    if n[1:] in ("ShoulderPitch", "ShoulderRoll", "ElbowYaw", "ElbowRoll")
]


def observer() -> ContactObserver:
    """With the models of the nominal robot, whatever has become of it since."""
    return ContactObserver(ROBOT, ModelSet.load(MODELS), load_observer_settings())


def flail(pepper: Pepper, seed: int, on_tick: Any, goals: int = 4) -> None:
    """Both arms to random goals, flat out."""
    rng = np.random.default_rng(seed)
    middle, half = (ROBOT.lower + ROBOT.upper) / 2, (ROBOT.upper - ROBOT.lower) / 2
    for _ in range(goals):
        goal = middle + rng.uniform(-0.7, 0.7, 17) * half
        pepper.set_posture(
            {name: float(goal[ROBOT.joint_index(name)]) for name in ARMS}, stiffness=20.0
        )
        pepper.run(2.5, on_tick=on_tick)


def test_clamping_for_a_second_raises_no_contact(monkeypatch: pytest.MonkeyPatch) -> None:
    """The gate lets no joint pass faster than 0.7 rad/s, the controller requests up to 2."""

    def slow(robot: RobotConfig, safety: SafetySettings, limits: ControllerSettings) -> SafetyGate:
        return SafetyGate(robot, safety, slowed(limits, 0.7 / safety.speed_margin))

    monkeypatch.setattr("pepper_driver.session.SafetyGate", slow)
    limited: list[Any] = []
    speeds: list[Any] = []

    def on_tick(tick: Tick, observation: Observation | None) -> None:
        limited.append(tick.limited)
        speeds.append(tick.sent.position)

    with Pepper("mujoco://?seed=3", observer=observer()) as pepper:
        pepper.run(3.0)
        flail(pepper, 3, on_tick)
        assert [contact for contact in pepper.contact_history if contact.phase == "begin"] == []
    longest = max(_longest(column) for column in np.array(limited).T)
    assert longest * ROBOT.cycle > 1.0, "a joint was clamped for a second without a break"
    assert np.abs(np.diff(speeds, axis=0)).max() <= 0.7 * ROBOT.cycle + 1e-9


def _longest(flags: Any) -> int:
    longest = run = 0
    for flag in flags.tolist():
        run = run + 1 if flag else 0
        longest = max(longest, run)
    return longest


def test_a_normal_run_with_touches_and_reflexes_is_left_alone() -> None:
    limited = 0
    held = Hold()
    held_ticks = 0

    def on_tick(tick: Tick, observation: Observation | None) -> None:
        nonlocal limited, held_ticks
        limited += bool(tick.limited.any())
        wheels = ROBOT.wheels.matrix @ tick.reference.base_twist
        limited += not np.allclose(wheels, tick.sent.wheel_speed, atol=1e-12)
        held_ticks += held.active

    with Pepper("mujoco", observer="fusion", reflexes=[held]) as pepper:
        pepper.controller.base_velocity.target = np.array([0.1, 0.05, 0.3])
        for time in (1.0, 4.0, 7.0):
            pepper.push("LForeArm", [0.0, 25.0, 0.0], delay=time, duration=0.5)
        flail(pepper, 1, on_tick)
    assert held_ticks > 20
    assert limited == 0


def test_a_press_on_the_chest_stops_the_robot() -> None:
    with Pepper("mujoco", observer=None) as pepper:
        pepper.controller.base_velocity.target = np.array([0.1, 0.0, 0.0])
        pepper.run(1.0)
        button = ROBOT.sensors.buttons["ChestBoard/Button"]
        pepper.push("torso", [-10.0, 0.0, 0.0], button.xyz, duration=0.3)
        with pytest.raises(FaultError, match="chest") as caught:
            pepper.run(1.0)
        assert caught.value.fault.reason is FaultReason.CHEST_BUTTON
        assert pepper.state is RobotState.FAULT


def test_a_press_on_the_chest_is_only_a_push_where_that_is_asked_for() -> None:
    safety = replace(load_safety_settings(), chest_button=False)
    pressed = []
    with Pepper("mujoco", observer=None, safety=safety) as pepper:
        pepper.push("torso", [-10.0, 0.0, 0.0], [0.05, 0.0, 0.194], duration=0.3)
        pepper.run(0.5, on_tick=lambda tick, _: pressed.append(tick.measurement.buttons.max()))
    assert max(pressed) == 1.0


def test_a_bumper_stops_the_driving_base_and_lets_it_go_on() -> None:
    speeds, pressed = [], []

    def on_tick(tick: Tick, observation: Observation | None) -> None:
        speeds.append(np.abs(tick.measurement.wheel_speed).max())
        pressed.append(tick.measurement.bumpers.max())

    with Pepper("mujoco", observer=None) as pepper:
        pepper.controller.base_velocity.target = np.array([0.15, 0.0, 0.0])
        pepper.run(2.0, on_tick=on_tick)
        pepper.push("Tibia", [-20.0, 0.0, 0.0], [0.2, 0.15, -0.26], duration=0.3)
        pepper.run(3.0, on_tick=on_tick)
        assert pepper.state is RobotState.ACTIVE
    first = int(np.argmax(pressed))
    assert speeds[first - 1] > 1.0
    still = round(0.5 / ROBOT.cycle)
    assert max(speeds[first + still : first + 2 * still]) < 0.1
    assert speeds[-1] > 1.0
