"""The service ``ALTouch``; NAOqi 2.8 page "ALTouch API"."""

from __future__ import annotations

from pepper_driver.backends.naoqi_server.context import Context


class TouchService:
    """Touch sensors and bumpers. Its events stop when it is ended; joints are not among its sensors here."""

    def __init__(self, context: Context) -> None:
        self._events = context.events

    def getSensorList(self) -> list[str]:
        """Names of the sensors, as events have them."""
        return list(self._events.touched)

    def getStatus(self) -> list[list[object]]:
        """``[name, whether it is touched]`` of each."""
        return [[name, touched] for name, touched in self._events.touched.items()]

    def exit(self) -> None:
        """End the module: no events of touch any more."""
        self._events.on = False
