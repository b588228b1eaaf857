"""Requests of the page: all of them on a simulated robot, only the stop on a real one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver import FaultError, Pepper, PepperError
from pepper_driver.backends import CapabilityError
from pepper_driver.config import load_robot
from pepper_driver.viewer.controls import GRIP_RADIUS, Controls, gripped_point

ME = 1
ROBOT = load_robot()


class OnRealRobot:
    """A facade whose robot is real: it notes what reaches it."""

    def __init__(self) -> None:
        self.config = ROBOT
        self.backend = type("Backend", (), {"real_time": True})()
        self.asked: list[str] = []

    def __getattr__(self, name: str) -> Any:
        def note(*args: object, **kwargs: object) -> None:
            self.asked.append(name)

        return note


MOVES: dict[str, dict[str, Any]] = {
    "drive": {"vx": 0.1, "vy": 0.0, "wz": 0.0},
    "posture": {"name": "Stand", "duration": 2.0},
    "play": {"name": "wave"},
}
TOUCHES: dict[str, dict[str, Any]] = {
    "tap": {"link": "Head", "force": [1, 0, 0], "point": [0, 0, 0], "duration": 0.1},
    "take": {"link": "Head", "point": [0, 0, 0], "stiffness": 1000.0},
    "press": {"sensor": "Head/Touch/Front", "duration": 0.2},
}


@pytest.mark.parametrize("do", [*MOVES, *TOUCHES])
def test_a_real_robot_is_only_looked_at(do: str) -> None:
    robot = OnRealRobot()
    controls = Controls(robot)  # type: ignore[arg-type]
    with pytest.raises(CapabilityError):
        controls(ME, {"do": do, **(MOVES | TOUCHES)[do]})
    assert robot.asked == []
    assert (controls.can["touch"], controls.can["control"]) == (False, False)


def test_a_real_robot_is_stopped_in_any_case() -> None:
    robot = OnRealRobot()
    Controls(robot)(ME, {"do": "stop"})  # type: ignore[arg-type]
    assert robot.asked == ["emergency_stop"]


def test_where_control_is_allowed_a_real_robot_moves_but_is_not_touched() -> None:
    robot = OnRealRobot()
    controls = Controls(robot, allow_control=True)  # type: ignore[arg-type]
    controls(ME, {"do": "drive", **MOVES["drive"]})
    assert robot.asked == ["drive"]
    for do, arguments in TOUCHES.items():
        with pytest.raises(CapabilityError, match="by hand"):
            controls(ME, {"do": do, **arguments})
    assert robot.asked == ["drive"]


def test_a_simulated_robot_is_pulled_until_it_is_let_go() -> None:
    with Pepper("mujoco", observer=None) as pepper:
        controls = Controls(pepper)
        controls(ME, {"do": "take", "link": "torso", "point": [0.1, 0, 0.2], "stiffness": 1000.0})
        pepper.step()
        for _ in range(50):
            controls(ME, {"do": "move", "link": "torso", "to": [0.3, 0.0, 0.9]})
            pepper.step()
        (contact,) = pepper.backend.truth.contacts
        assert (contact.kind, contact.link) == ("hand", "torso")
        controls(ME, {"do": "release", "link": "torso"})
        pepper.run(0.2)
        assert pepper.backend.truth.contacts == ()
        assert controls(ME, {"do": "move", "link": "torso", "to": [0.3, 0.0, 0.9]}) is None


def test_who_leaves_lets_go() -> None:
    with Pepper("mujoco", observer=None) as pepper:
        controls = Controls(pepper)
        for listener, link in ((1, "torso"), (2, "Head")):
            controls(
                listener, {"do": "take", "link": link, "point": [0, 0, 0.1], "stiffness": 800.0}
            )
        pepper.step()
        for listener, link in ((1, "torso"), (2, "Head")):
            controls(listener, {"do": "move", "link": link, "to": [0.1, 0.0, 1.0]})
        pepper.run(0.2)
        controls.leave(1)
        pepper.run(0.2)
        assert {contact.link for contact in pepper.backend.truth.contacts} == {"Head"}


def run_with(request: dict[str, Any]) -> None:
    """Have a robot run after a request."""
    with Pepper("mujoco", observer=None) as pepper:
        Controls(pepper)(ME, request)
        pepper.run(0.6)


def test_the_button_on_the_chest_stops_the_robot() -> None:
    (button,) = ROBOT.sensors.buttons
    with pytest.raises(FaultError, match="button"):
        run_with({"do": "press", "sensor": button, "duration": 0.3})


@pytest.mark.parametrize("sensor", [*ROBOT.sensors.touch, *ROBOT.sensors.bumpers])
def test_a_sensor_that_is_pressed_answers(sensor: str) -> None:
    received = []
    with Pepper("mujoco", observer=None) as pepper:
        for register in (pepper.on_touch, pepper.on_bumper):
            register()(lambda event: received.append((event.name, event.pressed)))
        Controls(pepper)(ME, {"do": "press", "sensor": sensor, "duration": 0.3})
        pepper.run(0.6)
        measured = pepper.measurement
        now = np.concatenate([measured.touch, measured.bumpers])
    assert received == [(sensor, True)]
    assert not now.any(), "and no longer"


def test_stop_stops() -> None:
    with pytest.raises(FaultError, match="view"):
        run_with({"do": "stop"})


@pytest.mark.parametrize(
    "request_",
    [
        {},
        {"do": "jump"},
        {"do": ["stop"]},
        {"do": "press", "sensor": "Nose", "duration": 0.1},
        {"do": "take", "link": "Tail", "point": [0, 0, 0], "stiffness": 1000.0},
        {"do": "tap", "link": "Head", "force": [1e9, 0, 0], "point": [0, 0, 0], "duration": 0.1},
        {"do": "drive", "vx": float("nan"), "vy": 0.0, "wz": 0.0},
        {"do": "posture", "name": "Lie", "duration": 1.0},
    ],
)
def test_a_wrong_request_is_refused_and_moves_nothing(request_: dict[str, Any]) -> None:
    with Pepper("mujoco", observer=None) as pepper:
        before = pepper.target.copy()
        with pytest.raises(PepperError):
            Controls(pepper)(ME, request_)
        pepper.run(0.1)
        assert np.array_equal(pepper.target, before)
        assert pepper.backend.truth.contacts == ()


@given(st.tuples(*(st.floats(-0.2, 0.2) for _ in range(3))))
def test_a_grip_is_on_the_axis_of_what_is_thin(point: tuple[float, float, float]) -> None:
    """And is where it was asked for on what is not."""
    held = gripped_point(ROBOT, "LForeArm", point)
    axis = np.array(next(j.axis for j in ROBOT.joints if j.child == "LForeArm"))
    away = np.linalg.norm(np.cross(axis, point))
    if away <= GRIP_RADIUS:
        assert np.linalg.norm(np.cross(axis, held)) < 1e-12
        assert held @ axis == pytest.approx(np.array(point) @ axis)
    else:
        assert np.array_equal(held, point)
