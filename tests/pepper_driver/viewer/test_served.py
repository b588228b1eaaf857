"""A robot that is served, as its page gets it: what programs read and send, the truth, and hands; nothing else."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser")
from pepper_driver import PepperError
from pepper_driver.backends import CapabilityError
from pepper_driver.config import load_robot
from pepper_driver.controller.support_polygon import SupportPolygon
from pepper_driver.steady_hand import MAX_TIPPING
from pepper_driver.telemetry import Kind, TelemetryClient, TelemetryServer
from pepper_driver.viewer.controls import TouchControls
from pepper_driver.viewer.picture import Picture, RowDecoder
from pepper_driver.viewer.served import ServedRobot
from support.virtual_naoqi import VirtualNaoqi

ME = 1
ROBOT = load_robot()


@pytest.fixture
def naoqi() -> Iterator[VirtualNaoqi]:
    with VirtualNaoqi() as naoqi:
        yield naoqi


@pytest.fixture
def served(naoqi: VirtualNaoqi) -> Iterator[ServedRobot]:
    served = ServedRobot(naoqi.robot, ROBOT, "tcp://here")
    yield served
    served.close()


def picture_of(server: TelemetryServer) -> tuple[dict[str, Any], Picture]:
    """Greeting of a new listener, and the first picture it gets."""
    decoder = row = about = None
    with TelemetryClient(server.address, server.token) as client:
        end = time.monotonic() + 20.0
        while time.monotonic() < end:
            message = client.receive(1.0)
            if message is None:
                continue
            if message.kind is Kind.ABOUT:
                about = message.json
                decoder = RowDecoder(about["layout"])
            elif message.kind is Kind.TICK:
                row = message.data
            elif message.kind is Kind.POSE and decoder is not None and row is not None:
                assert about is not None
                return about, decoder.decode(row, message.json)
    raise AssertionError("no picture came")


def test_a_page_gets_what_clients_read_and_send_and_the_truth(
    naoqi: VirtualNaoqi, served: ServedRobot
) -> None:
    key = "HeadYaw/{}/Actuator/Value"
    count = naoqi.robot.time()
    prefix = ROBOT.naoqi.prefix
    naoqi.robot.order([prefix + key.format("Hardness")], "ClearAll", [[(1.0, count + 100)]])
    naoqi.robot.order([prefix + key.format("Position")], "ClearAll", [[(0.5, count + 500)]])
    served.push("torso", [8.0, 0.0, 0.0], duration=5.0, rise=0.1)
    naoqi.time.sleep(2.0)
    server = TelemetryServer(lambda *_: None, can=lambda: TouchControls(served, note="").can)
    served.stream_to(server)
    about, picture = picture_of(server)
    served.close()
    server.close()
    head = ROBOT.joint_names.index("HeadYaw")
    assert picture.time == pytest.approx(naoqi.black_box(1).cycle[-1] * ROBOT.cycle)
    assert picture.commanded[head] == 0.5
    assert picture.position[head] == pytest.approx(0.5, abs=0.02)
    assert np.array_equal(picture.base, naoqi.black_box(1).base[-1])
    (force,) = picture.forces
    assert force.link == "torso"
    assert np.linalg.norm(force.force) == pytest.approx(8.0, abs=0.1)
    assert np.isnan(picture.residual).all(), "it is unknown here"
    assert "observer" not in about["run"]
    assert (about["can"]["stop"], about["can"]["control"]) == (False, False)


def test_a_hand_pulls_it_no_harder_than_it_stands(naoqi: VirtualNaoqi, served: ServedRobot) -> None:
    controls = TouchControls(served, note="")
    controls(ME, {"do": "take", "link": "Head", "point": [0.0, 0.0, 0.05], "stiffness": 3000.0})
    naoqi.time.sleep(0.012)
    answer: Any = None
    for _ in range(20):
        answer = controls(ME, {"do": "move", "link": "Head", "to": [1.5, 0.0, 1.2]})
        naoqi.time.sleep(0.05)
    assert answer["limited"]
    scene = naoqi.robot.look()
    (contact,) = scene.contacts
    polygon = SupportPolygon.from_robot(ROBOT)
    ratio = polygon.tipping_ratio(scene.position, contact.point, contact.force)
    assert 0.3 < ratio <= MAX_TIPPING * 1.05, "of the moment that lifts a wheel"
    controls.leave(ME)
    naoqi.time.sleep(0.2)
    assert naoqi.robot.look().contacts == ()


def test_a_sensor_that_is_pressed_is_pressed_for_clients(
    naoqi: VirtualNaoqi, served: ServedRobot
) -> None:
    (button,) = ROBOT.sensors.buttons
    TouchControls(served, note="")(ME, {"do": "press", "sensor": button, "duration": 0.3})
    naoqi.time.sleep(0.2)
    key = ROBOT.naoqi.prefix + ROBOT.naoqi.button.format(button=button)
    assert naoqi.robot.value(key) == 1.0
    naoqi.time.sleep(0.5)
    assert naoqi.robot.value(key) == 0.0


@pytest.mark.parametrize(
    "request_",
    [
        {"do": "stop"},
        {"do": "drive", "vx": 0.1, "vy": 0.0, "wz": 0.0},
        {"do": "posture", "name": "Stand", "duration": 1.0},
        {"do": "tap", "link": "Tail", "force": [1, 0, 0], "point": [0, 0, 0], "duration": 0.1},
        {"do": "press", "sensor": "Nose", "duration": 0.1},
    ],
)
def test_what_a_server_of_a_robot_cannot_do_is_refused(
    served: ServedRobot, request_: dict[str, Any]
) -> None:
    with pytest.raises(PepperError) as error:
        TouchControls(served, note="")(ME, request_)
    assert "\n" not in str(error.value)
    if request_["do"] in ("stop", "drive", "posture"):
        assert isinstance(error.value, CapabilityError)
