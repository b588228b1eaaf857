"""The page over the stand-in, in a real browser: of the robot it serves, and of a program connected to it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import psutil
import pytest

pytest.importorskip("viser")
pytest.importorskip("selenium")
from selenium.webdriver.common.action_chains import ActionChains

from pepper_driver import Pepper
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.config import load_robot, load_safety_settings
from pepper_driver.telemetry import Kind, TelemetryClient
from pepper_driver.viewer.live import DRIVE_SPEED
from pepper_driver.viewer.served import ServedRobot
from pepper_driver.viewer.view import View
from support.browsers import click, open_browser, place_on_screen, text_of, wait_until
from support.stand_ins import PATIENT, patient_driver, since, url

pytestmark = [pytest.mark.realtime, pytest.mark.whole, pytest.mark.usefixtures("qi")]

TOKEN = "test-token"


@pytest.fixture
def browser() -> Iterator[Any]:
    with open_browser() as browser:
        yield browser


@pytest.fixture
def stand_in(qi: Any) -> Iterator[StandIn]:
    with patient_driver(), StandIn("mujoco://?seed=3", consent=True) as stand_in:
        yield stand_in


def connected(stand_in: StandIn, observer: str | None = None) -> Pepper:
    """A program of another computer, for which the robot is a real one."""
    return Pepper(f"{url(stand_in)}?wake=1", observer=observer, safety=PATIENT)


def buttons(browser: Any) -> list[str]:
    """Texts of the buttons that are seen; asked at once, as the page may draw them again between two questions."""
    script = """
    const seen = button => button.offsetParent !== null;
    return [...document.querySelectorAll('button')].filter(seen).map(button => button.innerText.trim());
    """
    return [text for text in browser.execute_script(script) if text]


def drag(browser: Any, stand_in: StandIn, link: str, point: list[float]) -> None:
    """Take a link with the mouse, draw it aside, and hold it there."""
    from pepper_driver.controller.model import RobotModel

    scene = stand_in.robot.look()
    x, y, yaw = scene.base
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    pose = RobotModel(load_robot()).link_pose(link, scene.position)
    place = turn @ (pose[:3, :3] @ point + pose[:3, 3]) + [x, y, 0.0]
    canvas = browser.find_element("tag name", "canvas")
    mouse = ActionChains(browser, duration=100)
    mouse.move_to_element_with_offset(canvas, *place_on_screen(browser, place)).click_and_hold()
    for _ in range(10):
        mouse.move_by_offset(12, -3).pause(0.1)
    mouse.perform()


@pytest.fixture
def served_page(stand_in: StandIn, browser: Any) -> Iterator[View]:
    with View(port=0, token=TOKEN) as view:
        served = ServedRobot(stand_in.robot, load_robot(), stand_in.url)
        view.show_served(served)
        browser.get(view.address)
        wait_until(lambda: "served" in text_of(browser))
        yield view
        served.close()


@pytest.mark.usefixtures("served_page")
def test_a_drag_of_the_served_arm_is_detected_by_a_program_elsewhere(
    stand_in: StandIn, browser: Any
) -> None:
    assert "Residuals, torques and contacts are not known here" in text_of(browser)
    assert not browser.find_elements("css selector", ".uplot")
    assert buttons(browser) == [], "nothing here moves or stops it"
    with connected(stand_in, observer="fusion") as pepper:
        pepper.set_posture({"LShoulderPitch": 1.2, "LShoulderRoll": 0.3}, duration=1.0)
        pepper.run(1.5)
        before = len(pepper.contact_history)
        drag(browser, stand_in, "LForeArm", [0.06, 0.0, 0.0])
        wait_until(lambda: "left_arm" in {c.limb for c in pepper.contact_history[before:]})
        ActionChains(browser).release().perform()
        wait_until(lambda: not stand_in.robot.look().contacts)
        assert pepper.state.value == "active"


@pytest.mark.usefixtures("served_page")
def test_a_browser_that_goes_in_a_drag_lets_the_served_robot_go(
    stand_in: StandIn, browser: Any
) -> None:
    drag(browser, stand_in, "torso", [0.1, 0.0, 0.15])
    wait_until(lambda: stand_in.robot.look().contacts)
    browser.get("about:blank")
    wait_until(lambda: not stand_in.robot.look().contacts)
    before = stand_in.black_box(1).cycle[-1]
    wait_until(lambda: stand_in.black_box(1).cycle[-1] > before + 20)


def test_a_view_of_a_real_robot_looks_and_stops(stand_in: StandIn, browser: Any) -> None:
    """No control is on its page, and a request that does not come from the page is refused with one line."""
    pepper = connected(stand_in)
    with View(port=0, token=TOKEN) as view:
        pepper.start()
        try:
            view.show(pepper)
            browser.get(view.address)
            wait_until(lambda: "active" in text_of(browser))
            wait_until(lambda: buttons(browser) == ["STOP (key X)"])
            click(browser, "Touch and move")
            wait_until(lambda: "real robot: the page only looks" in text_of(browser))
            assert buttons(browser) == ["STOP (key X)"]
            telemetry = view._telemetry
            before = stand_in.black_box(1).base[-1]
            with TelemetryClient(telemetry.address, telemetry.token) as forger:
                for do, arguments in (
                    ("drive", {"vx": 0.2, "vy": 0.0, "wz": 0.0}),
                    ("posture", {"name": "Crouch", "duration": 1.0}),
                    ("attentive", {"on": True}),
                    ("play", {"name": "wave"}),
                    ("take", {"link": "Head", "point": [0, 0, 0], "stiffness": 1000.0}),
                ):
                    number = forger.request(do, **arguments)
                    answer: dict[str, Any] = {}
                    while answer.get("number") != number:
                        message = forger.receive(20.0)
                        assert message is not None
                        answer = message.json if message.kind is Kind.ANSWER else {}
                    assert "real robot" in answer["error"]
                    assert "\n" not in answer["error"]
            pepper.run(0.5)
            assert stand_in.black_box(1).base[-1] == pytest.approx(before, abs=1e-3)
            click(browser, "STOP")
            wait_until(lambda: pepper.state.value == "fault")
        finally:
            with pytest.raises(Exception, match="view"):
                pepper.stop()


def test_a_browser_that_dies_while_it_drives_a_real_robot_stops_it(
    stand_in: StandIn, browser: Any
) -> None:
    """By the time of the robot: half a second after the browser the base brakes, as the controller lets it."""
    with connected(stand_in) as pepper, View(port=0, token=TOKEN, allow_control=True) as view:
        view.show(pepper)
        browser.get(view.address)
        click(browser, "Touch and move")
        wait_until(lambda: any(text.startswith("Forward") for text in buttons(browser)))
        pad = browser.find_element("xpath", "//button[contains(., 'Forward')]")
        begin = stand_in.black_box(1).base[-1]
        ActionChains(browser).move_to_element(pad).click_and_hold().perform()
        wait_until(lambda: stand_in.black_box(1).base[-1][0] - begin[0] > 0.1)
        processes = psutil.Process(browser.service.process.pid).children(recursive=True)
        for process in processes:
            process.kill()
        death = time.monotonic()
        pepper.run(3.0)
        box = since(stand_in, death)
        speed = np.gradient(box.base[:, 0], box.begin)
        braking = death + load_safety_settings().drive_time
        commands = np.abs(box.wheel_command).max(axis=1)
        assert commands[box.begin > braking].max() < 0.9 * commands[0] or commands[0] < 0.1
        assert np.all(np.diff(commands[box.begin > braking]) <= 1e-6), "it never speeds up again"
        assert np.abs(speed[box.begin > braking + 1.0]).max() < 0.05 * DRIVE_SPEED
        assert np.abs(speed[-1]) < 1e-3
        assert pepper.state.value == "active"
