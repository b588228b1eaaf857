"""Anything at all as an argument: taken, or refused in one line by an error of the project."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver import Hold, Pepper, PepperError
from pepper_driver.backends import make_backend
from pepper_driver.backends.naoqi_server.faults import parse_fault
from pepper_driver.config import load_plant, load_robot, load_world
from pepper_driver.controller import ComplianceTask, HandTask, PositionTask, PostureTask
from pepper_driver.log import read_log
from support.bad_input import check_line
from support.examples import examples
from support.yaml_values import ANYTHING

ROBOT = load_robot()
JUNK = ANYTHING | st.sampled_from(
    [
        np.zeros(3),
        np.zeros((3, 1)),
        np.array(1.0),
        np.array([1, None]),
        np.float32(0.1),
        np.int8(3),
        np.datetime64("2020-01-01"),
        1j,
        b"Stand",
        object(),
        Pepper,
        print,
        lambda: None,
        range(3),
        {"HeadYaw"},
        {"HeadYaw": "0.1"},
        {"HeadYaw": True},
        [True, False, True],
        ["0", "1", "2"],
        [float("nan")] * 3,
        [float("inf")] * 17,
        "x" * 2000,
        "a\0b",
        "a\nb\x1b[31m",
        -1,
        10**400,
    ]
)

TAKES: dict[str, Callable[[Pepper, Any], object]] = {
    "set_posture": lambda p, junk: p.set_posture(junk),
    "an angle": lambda p, junk: p.set_posture({"HeadYaw": junk}),
    "a stiffness": lambda p, junk: p.set_posture("Stand", stiffness=junk),
    "a duration": lambda p, junk: p.set_posture("Stand", duration=junk),
    "drive": lambda p, junk: p.drive(junk, 0, 0),
    "hold": lambda p, junk: p.drive(0, 0, 0, hold=junk),
    "play": lambda p, junk: p.play(junk, on_tick=print),  # of two arguments
    "push": lambda p, junk: p.push("LForeArm", junk, delay=100.0),
    "a link to push": lambda p, junk: p.push(junk, [0, 0, 1], delay=100.0),
    "a point": lambda p, junk: p.push("LForeArm", [0, 0, 1], junk, delay=100.0),
    "a time": lambda p, junk: p.push("LForeArm", [0, 0, 1], duration=junk, delay=100.0),
    "link_pose": lambda p, junk: p.link_pose(junk),
    "of": lambda p, junk: p.link_pose("Head", of=junk),
    "on_touch": lambda p, junk: p.on_touch(sensor=junk),
    "pressed": lambda p, junk: p.on_touch(pressed=junk),
    "every": lambda p, junk: p.on_tick(every=junk),
    "say": lambda p, junk: p.services.say(junk),
    "leds": lambda p, junk: p.services.leds("FaceLeds", junk),
    "a robot": lambda _, junk: make_backend(junk),
    "a log": lambda _, junk: read_log(junk),
    "a plant": lambda _, junk: load_plant(junk, ROBOT),
    "a world": lambda _, junk: load_world(junk),
    "a fault": lambda _, junk: parse_fault(junk),
    "a link": lambda _, junk: PositionTask(junk),
    "joints": lambda _, junk: PostureTask(junk),
    "a target": lambda _, junk: setattr(PositionTask("l_wrist"), "target", junk),
    "a posture": lambda _, junk: setattr(PostureTask(), "target", junk),
    "an aperture": lambda _, junk: setattr(HandTask("LHand"), "target", junk),
    "a torque": lambda _, junk: setattr(ComplianceTask(), "torque", junk),
    "a tolerance": lambda _, junk: PositionTask("l_wrist").reached(junk),
    "a pause": lambda _, junk: Hold(release_delay=junk),
    "a name": lambda _, junk: Hold(name=junk),
    "reflexes": lambda _, junk: Pepper("mock", observer=None, reflexes=junk),
}


@pytest.fixture(scope="module")
def active() -> Iterator[Pepper]:
    with Pepper("mujoco", observer=None) as pepper:
        yield pepper


@pytest.mark.parametrize("what", TAKES)
@examples(25, deadline=None)
@given(junk=JUNK)
def test_it_is_taken_or_refused_in_one_line(active: Pepper, what: str, junk: Any) -> None:
    if what == "play" and isinstance(junk, str) and junk in ("reach", "stretch", "wave"):
        return
    try:
        TAKES[what](active, junk)
    except PepperError as error:
        check_line(str(error))
