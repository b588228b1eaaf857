"""The service ``ALTabletService``; NAOqi 2.8 page "ALTabletService API". There is no tablet: what it shows is kept."""

from __future__ import annotations

import qi

from pepper_driver.backends.naoqi_server.context import Context
from pepper_driver.backends.naoqi_server.motion.body import CallError, number

TABLET_SIDE = "198.18.0.1"
"""Address of the robot as its tablet sees it."""


class TabletService:
    """Shows images, pages and videos to nobody. Addresses are not looked up: every one is taken."""

    def __init__(self, context: Context) -> None:
        self._record = context.shared.record
        self._brightness = 1.0
        self._page = ""
        self.onTouchDown = qi.Signal("(ff)")
        self.onTouchDownRatio = qi.Signal("(ffs)")
        self.onTouchMove = qi.Signal("(ff)")
        self.onTouchUp = qi.Signal("(ff)")
        self.onJSEvent = qi.Signal("(s)")
        self.onConsoleMessage = qi.Signal("(s)")
        self.onPageStarted = qi.Signal("()")
        self.onPageFinished = qi.Signal("()")
        self.onImageLoaded = qi.Signal("()")
        self.videoStarted = qi.Signal("()")
        self.videoFinished = qi.Signal("()")

    def showImage(self, url: object) -> bool:
        """Show an image."""
        self._show("showImage", url)
        self.onImageLoaded()
        return True

    def showImageNoCache(self, url: object) -> bool:
        """Show an image, loaded anew."""
        self._show("showImageNoCache", url)
        self.onImageLoaded()
        return True

    def preLoadImage(self, url: object) -> bool:
        """Load an image without showing it."""
        return self._show("preLoadImage", url)

    def hideImage(self) -> None:
        """Hide it."""
        self._record.add("ALTabletService", "hideImage")

    def setBackgroundColor(self, colour: object) -> bool:
        """Behind images: "#RRGGBB"."""
        return self._show("setBackgroundColor", colour)

    def showWebview(self, *url: object) -> bool:
        """Show a page, or the one that was loaded."""
        if url:
            self.loadUrl(url[0])
        self._record.add("ALTabletService", "showWebview", self._page)
        return True

    def hideWebview(self) -> bool:
        """Hide it."""
        self._record.add("ALTabletService", "hideWebview")
        return True

    def loadUrl(self, url: object) -> bool:
        """Load a page without showing it."""
        self._show("loadUrl", url)
        self._page = str(url)
        self.onPageStarted()
        self.onPageFinished()
        return True

    def loadApplication(self, name: object) -> bool:
        """Load an application of the robot."""
        return self._show("loadApplication", name)

    def executeJS(self, script: object) -> None:
        """Run a script in the page; nothing runs here."""
        self._show("executeJS", script)

    def reloadPage(self, bypass: object) -> None:
        """Load the page again."""
        self._record.add("ALTabletService", "reloadPage", bypass)

    def cleanWebview(self) -> None:
        """Empty the page."""
        self._page = ""

    def playVideo(self, url: object) -> bool:
        """Play a video."""
        self._show("playVideo", url)
        self.videoStarted()
        return True

    def stopVideo(self) -> bool:
        """End it."""
        self._record.add("ALTabletService", "stopVideo")
        self.videoFinished()
        return True

    def hide(self) -> None:
        """Hide whatever is shown."""
        self._record.add("ALTabletService", "hide")

    def robotIp(self) -> str:
        """Address of the robot for pages on the tablet."""
        return TABLET_SIDE

    def setBrightness(self, brightness: object) -> bool:
        """Above 0, up to 1."""
        where = "ALTabletService::setBrightness"
        level = number(brightness, where, "the brightness")
        if not 0 < level <= 1:
            raise CallError(where, f"the brightness must be above 0, at most 1: {level}")
        self._brightness = level
        return True

    def getBrightness(self) -> float:
        """What was set."""
        return self._brightness

    def turnScreenOn(self, on: object) -> None:
        """Light or darken the screen."""
        self._record.add("ALTabletService", "turnScreenOn", on)

    def wakeUp(self) -> bool:
        """End its sleep."""
        self._record.add("ALTabletService", "wakeUp")
        return True

    def goToSleep(self) -> bool:
        """Let it sleep."""
        self._record.add("ALTabletService", "goToSleep")
        return True

    def resetTablet(self) -> None:
        """As if nobody had used it."""
        self._page = ""
        self._record.add("ALTabletService", "resetTablet")

    def setVolume(self, volume: object) -> bool:
        """0..15."""
        return self._show(
            "setVolume", str(number(volume, "ALTabletService::setVolume", "the volume"))
        )

    def getWifiStatus(self) -> str:
        """Of the tablet's own network."""
        return "DISCONNECTED"

    def version(self) -> str:
        """Of the tablet's browser."""
        return "stand-in"

    def _show(self, method: str, what: object) -> bool:
        if not isinstance(what, str):
            raise CallError(f"ALTabletService::{method}", f"expected a text, got {what!r}")
        self._record.add("ALTabletService", method, what)
        return True
