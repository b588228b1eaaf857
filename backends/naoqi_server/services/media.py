"""Cameras and tablet.

The service ``ALVideoDevice``: a test image in the form of NAOqi 2.8 page "ALVideoDevice API".

The service ``ALTabletService``; NAOqi 2.8 page "ALTabletService API". There is no tablet: what it shows is kept.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from math import radians

import numpy as np
import qi

from pepper_driver.backends.naoqi_server.almotion.kinematics import CallError, number
from pepper_driver.backends.naoqi_server.services.context import Context
from pepper_driver.config.arrays import FloatArray

SIZES = {
    0: (160, 120),
    1: (320, 240),
    2: (640, 480),
    3: (1280, 960),
    4: (2560, 1920),
    7: (80, 60),
    8: (40, 30),
    9: (320, 180),
    10: (320, 240),
    11: (640, 360),
    12: (640, 480),
    13: (1280, 720),
    14: (1280, 960),
    15: (1280, 360),
    16: (2560, 720),
}
"""Width and height by resolution."""

LAYERS = {0: 1, 9: 2, 10: 3, 11: 3, 12: 3, 13: 3, 17: 2, 18: 3, 19: 12, 20: 2, 21: 2, 23: 2}
"""Bytes of a pixel by colour space: 0 grey, 9 YUV422, 11 RGB, 13 BGR, 17 depth, 20 infrared, 21 distance [mm], ..."""

CAMERAS = {0: "CameraTop", 1: "CameraBottom", 2: "CameraDepth", 3: "CameraStereo"}

FIELD = (radians(56.3), radians(43.7))
"""[rad] Width and height of what is seen. NAOqi 2.8 page "2D Cameras"."""

# A signature of libqi: i is a 32-bit integer, f a float, r raw bytes.
IMAGE = "(iiiiiiriffff)"
"""Width, height, layers, colour space, seconds, microseconds, bytes, camera, then left, top, right, bottom [rad]."""


@dataclass(kw_only=True)
class _Stream:
    camera: int
    resolution: int
    colours: int
    rate: int


class VideoService:
    """Cameras. All show the same: a ramp from dark to light, and a stripe that walks on once a second."""

    __qi_threading__ = "multi"

    def __init__(self, context: Context) -> None:
        self._streams: dict[str, _Stream] = {}

    def subscribeCamera(
        self, name: object, camera: object, resolution: object, colours: object, rate: object
    ) -> str:
        """Begin to take images; return the handle for all other calls."""
        where = "ALVideoDevice::subscribeCamera"
        for kind, value, known in (
            ("camera", camera, CAMERAS),
            ("resolution", resolution, SIZES),
            ("colour space", colours, LAYERS),
        ):
            if value not in known:
                raise CallError(
                    where, f"unknown {kind}: {value} (possible: {', '.join(map(str, known))})"
                )
        numbers = (
            int(number(value, where, "a parameter"))
            for value in (camera, resolution, colours, rate)
        )
        stream = _Stream(
            **dict(zip(("camera", "resolution", "colours", "rate"), numbers, strict=True))
        )
        handle = next(
            h for i in range(len(self._streams) + 1) if (h := f"{name}_{i}") not in self._streams
        )
        self._streams[handle] = stream
        return handle

    def subscribe(self, name: object, resolution: object, colours: object, rate: object) -> str:
        """As ``subscribeCamera``, of the camera on top."""
        return self.subscribeCamera(name, 0, resolution, colours, rate)

    def unsubscribe(self, handle: object) -> bool:
        """End it; whether there was such a handle."""
        return self._streams.pop(str(handle), None) is not None

    def getSubscribers(self) -> list[str]:
        """Return the handles."""
        return list(self._streams)

    def getCameraIndexes(self) -> list[int]:
        """Numbers of the cameras."""
        return list(CAMERAS)

    def getCameraName(self, camera: object) -> str:
        """Name of a camera."""
        if camera not in CAMERAS:
            raise CallError("ALVideoDevice::getCameraName", f"unknown camera: {camera}")
        return CAMERAS[int(number(camera, "ALVideoDevice::getCameraName", "the camera"))]

    def hasDepthCamera(self) -> bool:
        """Yes."""
        return True

    def getActiveCamera(self, *handle: object) -> int:
        """Return the number of the camera."""
        return self._stream(handle[0], "getActiveCamera").camera if handle else 0

    def setActiveCamera(self, handle: object, camera: object) -> bool:
        """Another camera for a handle."""
        stream = self._stream(handle, "setActiveCamera")
        if camera in CAMERAS:
            stream.camera = int(number(camera, "ALVideoDevice::setActiveCamera", "the camera"))
        return camera in CAMERAS

    def getResolution(self, handle: object) -> int:
        """Resolution of a handle."""
        return self._stream(handle, "getResolution").resolution

    def getColorSpace(self, handle: object) -> int:
        """Colour space of a handle."""
        return self._stream(handle, "getColorSpace").colours

    def getFrameRate(self, handle: object) -> int:
        """Pictures a second that were asked for."""
        return self._stream(handle, "getFrameRate").rate

    def getParameter(self, camera: object, parameter: object) -> int:
        """Return 0: settings of cameras are not kept."""
        return 0

    def setParameter(self, camera: object, parameter: object, value: object) -> bool:
        """Accept it, without effect."""
        return True

    @qi.bind(IMAGE, ["m"])  # type: ignore[untyped-decorator]  # qi has no types
    def getImageRemote(self, handle: object) -> tuple[object, ...]:
        """Return an image, as the tuple of NAOqi with its bytes."""
        stream = self._stream(handle, "getImageRemote")
        width, height = SIZES[stream.resolution]
        now = time.time()
        wide, high = FIELD[0] / 2, FIELD[1] / 2
        return (
            width,
            height,
            LAYERS[stream.colours],
            stream.colours,
            int(now),
            int(now % 1.0 * 1e6),
            _picture(width, height, LAYERS[stream.colours], int(now)),
            stream.camera,
            wide,
            high,
            -wide,
            -high,
        )

    def releaseImage(self, handle: object) -> bool:
        """Nothing is to be released."""
        self._stream(handle, "releaseImage")
        return True

    def _stream(self, handle: object, method: str) -> _Stream:
        stream = self._streams.get(str(handle))
        if stream is None:
            raise CallError(f"ALVideoDevice::{method}", f"unknown handle: {handle}")
        return stream


def _picture(width: int, height: int, layers: int, second: int) -> bytes:
    ramp: FloatArray = np.linspace(0, 200, width)
    row = np.repeat(ramp.astype(np.uint8), layers)
    picture = np.tile(row, (height, 1))
    stripe = second % 10 * height // 10
    picture[stripe : stripe + height // 10] = 255
    return picture.tobytes()


TABLET_SIDE = "198.18.0.1"
"""Address of the robot as its tablet sees it."""


class TabletService:
    """Accepts images, pages and videos without a screen. Addresses are not resolved: every one is accepted."""

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
        """Show an image, loaded again."""
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
        """Hide the present content."""
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
        """Return the value that was set."""
        return self._brightness

    def turnScreenOn(self, on: object) -> None:
        """Light or darken the screen."""
        self._record.add("ALTabletService", "turnScreenOn", on)

    def wakeUp(self) -> bool:
        """End its sleep."""
        self._record.add("ALTabletService", "wakeUp")
        return True

    def goToSleep(self) -> bool:
        """Put it to sleep."""
        self._record.add("ALTabletService", "goToSleep")
        return True

    def resetTablet(self) -> None:
        """Reset it to its initial state."""
        self._page = ""
        self._record.add("ALTabletService", "resetTablet")

    def setVolume(self, volume: object) -> bool:
        """0..15."""
        return self._show(
            "setVolume", str(number(volume, "ALTabletService::setVolume", "the volume"))
        )

    def getWifiStatus(self) -> str:
        """Return the state of the tablet's own network."""
        return "DISCONNECTED"

    def version(self) -> str:
        """Return the version of the tablet's browser."""
        return "stand-in"

    def _show(self, method: str, what: object) -> bool:
        if not isinstance(what, str):
            raise CallError(f"ALTabletService::{method}", f"expected a text, got {what!r}")
        self._record.add("ALTabletService", method, what)
        return True
