"""The page in a real browser: a robot that is seen, pulled, touched and stopped; a log that is played."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser")
pytest.importorskip("selenium")
from selenium.webdriver.common.action_chains import ActionChains

from pepper_driver import Pepper
from pepper_driver.config import load_robot
from pepper_driver.figure_style import in_words
from pepper_driver.log import read_log
from pepper_driver.reflexes import Comply
from pepper_driver.viewer.page import CAMERA, FIELD_OF_VIEW, LOOK_AT
from pepper_driver.viewer.serving import serve_page
from pepper_driver.viewer.view import View
from support.browsers import (
    click,
    hosts_asked,
    keep_picture,
    open_browser,
    place_on_screen,
    text_of,
    wait_until,
)

TOKEN = "test-token"

STOP_AFTER_SCROLLING = """
const panel = document.querySelector('.mantine-ScrollArea-viewport');
panel.scrollTop = panel.scrollHeight;
if (panel.scrollTop == 0) return 'does not scroll';
const stop = [...document.querySelectorAll('button')].find(b => b.innerText.startsWith('STOP'));
const box = stop.getBoundingClientRect();
const seen = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
return seen === null ? 'out of sight' : seen.innerText;
"""
"""Text that is seen in the middle of the button that stops, after the panel is scrolled down."""


@pytest.fixture
def browser() -> Iterator[Any]:
    with open_browser() as browser:
        yield browser


def open_live(browser: Any, view: View, pepper: Pepper) -> None:
    view.show(pepper)
    browser.get(view.address)
    wait_until(lambda: "touched:" in text_of(browser))


@pytest.mark.realtime
def test_the_page_shows_a_robot_and_stops_it(browser: Any) -> None:
    pepper = Pepper("mujoco", real_time=True)
    with View(port=0, token=TOKEN) as view:
        pepper.start()
        try:
            open_live(browser, view, pepper)
            assert "touched: nothing" in text_of(browser)
            assert hosts_asked(browser) <= {"127.0.0.1"}, "it works without internet"
            wait_until(lambda: browser.execute_script(STOP_AFTER_SCROLLING) == "STOP (key X)")
            click(browser, "STOP")
            wait_until(lambda: pepper.state.value == "fault")
            wait_until(lambda: "stopped in the view" in text_of(browser))
        finally:
            with pytest.raises(Exception, match="view"):
                pepper.stop()


@pytest.mark.realtime
@pytest.mark.whole
def test_a_drag_of_the_arm_is_detected_and_logged(browser: Any, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    with (
        Pepper("mujoco", real_time=True, reflexes=[Comply()], log=log) as pepper,
        View(port=0, token=TOKEN) as view,
    ):
        pepper.set_posture({"LShoulderPitch": 1.2, "LShoulderRoll": 0.3}, duration=1.0)
        pepper.run(1.5)
        open_live(browser, view, pepper)
        canvas = browser.find_element("tag name", "canvas")
        pose = pepper.backend.truth.link_pose("LForeArm")
        x, y = place_on_screen(browser, pose[:3, :3] @ [0.06, 0.0, 0.0] + pose[:3, 3])
        mouse = ActionChains(browser, duration=100)
        mouse.move_to_element_with_offset(canvas, x, y).click_and_hold()
        for _ in range(10):
            mouse.move_by_offset(12, -3).pause(0.1)
        mouse.perform()
        wait_until(lambda: pepper.contact_history)
        wait_until(lambda: "touched: left_arm" in text_of(browser))
        keep_picture(browser, "view_drag")
        assert [c.kind for c in pepper.backend.truth.contacts] == ["hand"]
        wait_until(lambda: " N" in text_of(browser))
        ActionChains(browser).release().perform()
        wait_until(lambda: not pepper.backend.truth.contacts)
        pepper.run(0.5)
        assert pepper.backend.truth.tilt == pytest.approx([0.0, 0.0], abs=0.02)
    run = read_log(log)
    assert run.contacts[0].limb == "left_arm"
    assert run.truth is not None
    assert np.abs(run.truth["contact_torque"]).max() > 0.5


@pytest.mark.realtime
@pytest.mark.whole
def test_a_browser_that_goes_in_a_drag_lets_go(browser: Any) -> None:
    with (
        Pepper("mujoco", real_time=True) as pepper,
        View(port=0, token=TOKEN) as view,
    ):
        open_live(browser, view, pepper)
        canvas = browser.find_element("tag name", "canvas")
        pose = pepper.backend.truth.link_pose("torso")
        x, y = place_on_screen(browser, pose[:3, :3] @ [0.1, 0.0, 0.15] + pose[:3, 3])
        mouse = ActionChains(browser, duration=100)
        mouse.move_to_element_with_offset(canvas, x, y).click_and_hold()
        mouse.move_by_offset(40, 0).pause(0.2).move_by_offset(10, 0).perform()
        wait_until(lambda: pepper.backend.truth.contacts)
        browser.get("about:blank")
        wait_until(lambda: not pepper.backend.truth.contacts)
        pepper.run(0.2)
        assert pepper.state.value == "active"


@pytest.mark.whole
def test_a_log_is_played_and_computed_again(browser: Any, tmp_path: Path) -> None:
    from pepper_driver.viewer.recorded import RecordedPage

    log = tmp_path / "run.mcap"
    with Pepper("mujoco", log=log) as pepper:
        pepper.set_posture({"LShoulderPitch": 0.6, "LElbowRoll": -0.9}, duration=2.0)
        pepper.run(3.0)
        pepper.grab("LForeArm", [0.0, 0.15, 0.05], hold=1.0)
        pepper.run(3.0)
    recorded = [contact for contact, _ in read_log(log).lasting_contacts()]
    assert recorded
    page = RecordedPage(log, serve_page(host="127.0.0.1", port=0, token=TOKEN))
    threading.Thread(target=page.run, daemon=True).start()
    browser.get(page.address)
    wait_until(lambda: "touched:" in text_of(browser))
    page.seek(recorded[0].time - 0.1)
    wait_until(lambda: "touched: left_arm" in text_of(browser))
    click(browser, "Play")
    wait_until(lambda: f"{read_log(log)['time'][-1]:.2f} s" in text_of(browser))
    click(browser, "Contacts")
    click(browser, "Recompute")
    line = f"{recorded[0].onset_time:.2f} s {in_words(recorded[0].link)}"
    wait_until(lambda: text_of(browser).count(line) == 2)
    keep_picture(browser, "view_log")
    page.server.stop()


def test_the_camera_sees_the_whole_robot() -> None:
    """The head is below the upper edge, the base above the lower one."""
    assert load_robot().links
    half = np.tan(0.5 * FIELD_OF_VIEW)
    forward = np.array(LOOK_AT) - CAMERA
    forward /= np.linalg.norm(forward)
    up = np.cross(np.cross(forward, [0.0, 0.0, 1.0]), forward)
    up /= np.linalg.norm(up)
    for height in (0.0, 1.21):
        away = np.array([0.0, 0.0, height]) - CAMERA
        assert abs(away @ up) / (away @ forward) < half
