"""A real browser without a screen: Debian's Chromium, driven by selenium; tests are skipped where it is not there."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

SIZE = (1200, 800)
"""[pixels] of the window."""

LONG = 60.0
"""[s] A machine without a graphics card draws a few pictures a second."""

OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-dev-shm-usage",
    "--disable-quic",
    "--disable-sync",
    "--enable-unsafe-swiftshader",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--force-device-scale-factor=1",
)

HIDE_NOTICES = (
    "document.querySelectorAll('.mantine-Notification-root').forEach(e => e.style.display = 'none')"
)
"""One of them says that the browser has no graphics card."""


@contextmanager
def open_browser(niceness: int = 19) -> Iterator[Any]:
    """Yield a browser, which takes no more of the processors than its niceness lets it."""
    webdriver = pytest.importorskip("selenium.webdriver")
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("needs chromium and chromedriver")
    options = webdriver.ChromeOptions()
    for option in (*OPTIONS, f"--window-size={SIZE[0]},{SIZE[1]}"):
        options.add_argument(option)
    options.binary_location = chromium
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    # It draws by itself where there is no graphics card, and must not take the processors from the robot.
    for process in psutil.Process(browser.service.process.pid).children(recursive=True):
        process.nice(niceness)
    try:
        yield browser
    finally:
        browser.quit()


def wait_until(what: Callable[[], Any]) -> Any:
    """Wait until something is true, and return it."""
    end = time.monotonic() + LONG
    while not (found := what()):
        assert time.monotonic() < end, "it took too long"
        time.sleep(0.05)
    return found


def keep_picture(browser: Any, name: str) -> None:
    """Write a picture of the page into the folder ``SCREENSHOTS`` of the environment, where there is one."""
    if folder := os.environ.get("SCREENSHOTS"):
        from PIL import Image

        browser.execute_script(HIDE_NOTICES)
        pixels = Image.open(BytesIO(browser.get_screenshot_as_png())).convert("RGB")
        pixels.quantize(255).save(Path(folder) / f"{name}.png", optimize=True)


def place_on_screen(browser: Any, point: np.ndarray) -> tuple[int, int]:
    """Pixels from the middle of the scene at which a point (3,) of the world is drawn, as the page begins."""
    from pepper_driver.viewer.page import CAMERA, FIELD_OF_VIEW, LOOK_AT  # needs the extra

    forward = np.array(LOOK_AT) - CAMERA
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    away = point - np.array(CAMERA)
    height = browser.find_element("tag name", "canvas").rect["height"]
    scale = 0.5 * height / np.tan(0.5 * FIELD_OF_VIEW) / (away @ forward)
    return round(scale * float(away @ right)), round(-scale * float(away @ up))


def text_of(browser: Any) -> str:
    """Text of the whole page."""
    return str(browser.execute_script("return document.body.innerText"))


def click(browser: Any, label: str) -> None:
    """Click a button or tab by the begin of its label, once it is there."""

    def find() -> Any:
        elements = browser.find_elements("css selector", "button, [role=tab]")
        return next((e for e in elements if e.text.startswith(label)), None)

    wait_until(find).click()


def hosts_asked(browser: Any) -> set[str]:
    """Hosts of all requests that the page made."""
    import json
    from urllib.parse import urlsplit

    hosts = set()
    for entry in browser.get_log("performance"):
        message = json.loads(entry["message"])["message"]
        url = message.get("params", {}).get("request", {}).get("url") or message.get(
            "params", {}
        ).get("url", "")
        if urlsplit(url).scheme in ("http", "https", "ws", "wss"):
            hosts.add(urlsplit(url).hostname or "")
    return hosts
