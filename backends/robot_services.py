"""Services of a Pepper: speak, shine, show, and move by its own programs."""

from __future__ import annotations

import logging

logger = logging.getLogger("pepper_driver")


class RobotServices:
    """The services of a robot that has none: each does nothing and says so once by ``logging``.

    A backend whose robot has some gives a subclass and names them among its capabilities: ``speech``, ``leds``,
    ``tablet``, ``postures``, ``wake``. All may be called from any thread, but not inside a tick: a robot may take its
    time. On a robot they raise a NotConnectedError while the backend is closed, a BackendError for what it refuses.

    Args:
        uri: Of the backend.
    """

    def __init__(self, uri: str) -> None:
        self._uri = uri
        self._reported: set[str] = set()

    def say(self, text: str) -> None:
        """Begin to speak; return when the robot has accepted the order, before it has spoken."""
        self._report_missing("cannot speak")

    def leds(self, group: str, colour: tuple[float, float, float], duration: float) -> None:
        """Begin to fade lights to a colour; return when the robot has accepted the order.

        Args:
            group: NAOqi's name of lights: ``FaceLeds``, ``EarLeds``, ``ChestLeds``, ...
            colour: (r, g, b), each 0..1.
            duration: Of the fade [s].
        """
        self._report_missing("has no lights")

    def show_image(self, url: str) -> None:
        """Have the tablet show an image, by an address that the tablet can reach."""
        self._report_missing("has no tablet")

    def hide_image(self) -> None:
        """Have the tablet show no image."""
        self._report_missing("has no tablet")

    def go_to_posture(self, name: str, speed: float) -> None:
        """Have the robot's own program move it to a named posture; return when it is there.

        Args:
            name: NAOqi's name for it: ``Stand``, ``StandInit``, ``StandZero``, ``Crouch``.
            speed: Ratio to the full speed, above 0 up to 1.

        Raises:
            BackendError: The backend is active: two programs would move the robot. Or the robot got stuck.
        """
        self._report_missing("goes to no posture by a program of its own")

    def wake_up(self) -> None:
        """Have the robot switch its motors on and stand up; returns when it stands.

        Raises:
            BackendError: The backend is active, or the robot refuses.
        """
        self._report_missing("neither wakes up nor rests")

    def rest(self) -> None:
        """Have the robot sit down on its brakes and switch its motors off; returns when it is done.

        Raises:
            BackendError: The backend is active, or the robot refuses.
        """
        self._report_missing("neither wakes up nor rests")

    def _report_missing(self, what: str) -> None:
        if what not in self._reported:
            self._reported.add(what)
            logger.warning("'%s' %s: nothing happens", self._uri, what)
