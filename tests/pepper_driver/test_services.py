"""Speech, lights and the rest as a user asks for them: on a robot that has them, and on one that has not."""

import logging
import threading
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest

from pepper_driver import Pepper, PepperError
from pepper_driver.backends import BackendError, BackendInfo, Measurement, RobotServices
from pepper_driver.backends.mock import MockBackend
from support.experiments import STAND, make_run


class Recorder(RobotServices):
    """Keeps the calls it got, and their threads."""

    def __init__(self, backend: "Gifted") -> None:
        super().__init__("gifted")
        self._backend = backend
        self.done: list[tuple[object, ...]] = []
        self.threads: set[int] = set()

    def say(self, text: str) -> None:
        self._do("say", text)

    def leds(self, group: str, colour: tuple[float, float, float], duration: float) -> None:
        self._do("leds", group, colour, duration)

    def go_to_posture(self, name: str, speed: float) -> None:
        self._do("go_to_posture", name, speed)

    def rest(self) -> None:
        self._do("rest")

    def _do(self, *what: object) -> None:
        assert self._backend.connected, "the robot is not there"
        self.threads.add(threading.get_ident())
        self.done.append(what)


class Gifted(MockBackend):
    """Has services, and knows whether it is open."""

    connected = False

    @property
    def info(self) -> BackendInfo:
        return replace(super().info, capabilities=frozenset({"speech", "leds", "postures", "wake"}))

    @cached_property
    def services(self) -> Recorder:
        return Recorder(self)

    def open(self) -> Measurement:
        measurement = super().open()
        self.connected = True
        return measurement

    def close(self) -> None:
        self.connected = False
        super().close()


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> tuple[Pepper, Gifted]:
    backend = Gifted()
    monkeypatch.setattr("pepper_driver.robot.make_backend", lambda uri, config: backend)
    return Pepper("gifted", observer=None), backend


def test_a_robot_without_extras_says_so_once(caplog: pytest.LogCaptureFixture) -> None:
    pepper = Pepper("mujoco", observer=None)
    with caplog.at_level(logging.WARNING, logger="pepper_driver"):
        for _ in range(2):
            pepper.services.say("hello")
            pepper.services.leds("FaceLeds", (1, 0, 0))
            pepper.services.show_image("http://198.18.0.1/a.png")
            pepper.services.hide_image()
            pepper.services.go_to_posture("Stand")
            pepper.services.wake_up()
            pepper.services.rest()
    messages = [record.getMessage() for record in caplog.records]
    assert len(messages) == 5, messages
    assert all("'mujoco'" in text for text in messages)


def test_services_connect_for_their_time(robot: tuple[Pepper, Gifted]) -> None:
    pepper, backend = robot
    pepper.services.say("hello")
    pepper.services.go_to_posture("Crouch", speed=0.3)
    assert backend.services.done == [("say", "hello"), ("go_to_posture", "Crouch", 0.3)]
    assert not backend.connected
    assert backend.calls == ["open", "close"] * 2
    with pepper:
        pepper.services.leds("EarLeds", [0, 0.5, 1], 1)
        assert backend.connected
        assert backend.calls.count("open") == 3
    assert backend.services.done[-1] == ("leds", "EarLeds", (0.0, 0.5, 1.0), 1.0)


def test_only_one_program_moves_the_robot(robot: tuple[Pepper, Gifted]) -> None:
    pepper, backend = robot
    with pepper:
        for move in (pepper.services.wake_up, pepper.services.rest):
            with pytest.raises(BackendError, match="while the loop moves it"):
                move()
        with pytest.raises(BackendError, match="set_posture"):
            pepper.services.go_to_posture("Stand")
    assert backend.services.done == []
    pepper.services.rest()
    assert backend.services.done == [("rest",)]


def test_a_connection_of_another_user_is_left_alone(robot: tuple[Pepper, Gifted]) -> None:
    """The loop may be just about to start, in another thread."""
    pepper, backend = robot
    backend.open()
    with pytest.raises(BackendError, match="already open"):
        pepper.services.rest()
    assert backend.connected


@pytest.mark.parametrize(
    ("method", "arguments"),
    [
        ("say", ("",)),
        ("say", (7,)),
        ("leds", ("FaceLeds", (1, 0))),
        ("leds", ("FaceLeds", (1, 0, float("nan")))),
        ("leds", ("FaceLeds", (1, 0, 1.5))),
        ("leds", ("FaceLeds", "red")),
        ("leds", ("", (1, 0, 0))),
        ("leds", ("FaceLeds", (1, 0, 0), -1.0)),
        ("leds", ("FaceLeds", (1, 0, 0), float("inf"))),
        ("show_image", ("",)),
        ("go_to_posture", ("Stand", 0)),
        ("go_to_posture", ("Stand", 1.1)),
        ("go_to_posture", ("",)),
    ],
)
def test_what_is_no_order_is_refused(
    robot: tuple[Pepper, Gifted], method: str, arguments: tuple[object, ...]
) -> None:
    pepper, backend = robot
    with pytest.raises(PepperError):
        getattr(pepper.services, method)(*arguments)
    assert backend.calls == []


def test_cues_of_an_experiment_are_performed_off_the_tick(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    backend = Gifted()
    cues: list[dict[str, Any]] = [
        {"say": "left"},
        {"leds": {"colour": [0, 0.5, 1], "duration": 0.4}},
        {"say": "bye"},
    ]
    run = make_run(monkeypatch, tmp_path, STAND, *cues, backend=backend)
    assert run.perform().completed
    done = [("say", "left"), ("leds", "FaceLeds", (0.0, 0.5, 1.0), 0.4), ("say", "bye")]
    assert backend.services.done == done
    assert threading.get_ident() not in backend.services.threads

    def broken(text: str) -> None:
        raise BackendError(f"the robot is hoarse: {text}")

    monkeypatch.setattr(backend.services, "say", broken)
    assert run.perform().completed, "an experiment goes on without speech"
    assert backend.services.done == [*done, done[1]], "once for each cue, also in a second run"
    assert "left out: say: left: the robot is hoarse" in caplog.text
