"""A Pepper's services over NAOqi: speech, lights, tablet, and motions of its own programs."""

from __future__ import annotations

from collections.abc import Callable, Collection

from pepper_driver.backends.interface import BackendError, Capability
from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.backends.robot_services import RobotServices
from pepper_driver.config.naoqi import NaoqiSettings

SERVICES: dict[Capability, str] = {
    "speech": "ALTextToSpeech",
    "leds": "ALLeds",
    "tablet": "ALTabletService",
    "postures": "ALRobotPosture",
    "wake": "ALMotion",
}
"""What a robot must have for each of its abilities."""


def abilities(service_names: Collection[str]) -> frozenset[Capability]:
    """Return the abilities of a robot with these services."""
    return frozenset(ability for ability, name in SERVICES.items() if name in service_names)


class NaoqiRobotServices(RobotServices):
    """Services of a robot over NAOqi; see :class:`~pepper_driver.backends.robot_services.RobotServices`.

    ``say`` and ``leds`` only begin: what the robot refuses later is logged.

    Args:
        uri: Of the backend.
        connection: Returns the open connection, or raises with the reason.
        is_active: Whether the backend moves the robot now.
        settings: How long postures and the tablet may take.
    """

    def __init__(
        self,
        uri: str,
        connection: Callable[[], Connection],
        is_active: Callable[[], bool],
        settings: NaoqiSettings,
    ) -> None:
        super().__init__(uri)
        self._settings = settings
        self._connection = connection
        self._is_active = is_active

    def say(self, text: str) -> None:
        """Begin to speak."""
        if self._has("speech"):
            self._connection().begin(SERVICES["speech"], "say", text)
        else:
            super().say(text)

    def leds(self, group: str, colour: tuple[float, float, float], duration: float) -> None:
        """Begin to fade lights to a colour. Ears shine blue alone, as bright as the brightest part of the colour."""
        if not self._has("leds"):
            super().leds(group, colour, duration)
        elif "Ear" in group:
            self._connection().begin(SERVICES["leds"], "fade", group, max(colour), duration)
        else:
            self._connection().begin(SERVICES["leds"], "fadeRGB", group, *colour, duration)

    def show_image(self, url: str) -> None:
        """Have the tablet show an image; it may have to fetch it first."""
        if not self._has("tablet"):
            super().show_image(url)
        elif not self._call("tablet", "showImage", url, timeout=self._settings.tablet_time):
            raise BackendError(
                f"'{self._uri}': the tablet does not show '{url}'; it must be an image, at an address that the tablet "
                "itself can reach, such as http://198.18.0.1/... of the robot"
            )

    def hide_image(self) -> None:
        """Have the tablet show no image."""
        if self._has("tablet"):
            self._call("tablet", "hideImage", timeout=self._settings.tablet_time)
        else:
            super().hide_image()

    def go_to_posture(self, name: str, speed: float) -> None:
        """Have the robot's own program take it to a posture."""
        if not self._has("postures"):
            super().go_to_posture(name, speed)
            return
        self._check_inactive(f"go to posture '{name}'")
        if not self._call(
            "postures", "goToPosture", name, speed, timeout=self._settings.posture_time
        ):
            raise BackendError(
                f"'{self._uri}' did not reach posture '{name}'; is it awake, is an obstacle in its path, and does it "
                "have that posture?"
            )

    def wake_up(self) -> None:
        """Have the robot switch its motors on and stand up."""
        self._by_itself("wakeUp", "wake up", awake=True)

    def rest(self) -> None:
        """Have the robot sit down on its brakes and switch its motors off."""
        self._by_itself("rest", "rest", awake=False)

    def _by_itself(self, method: str, what: str, *, awake: bool) -> None:
        self._check_inactive(what)
        self._call("wake", method, timeout=self._settings.posture_time)
        # wakeUp and rest do not report whether the robot did it.
        if bool(self._call("wake", "robotIsWakeUp")) is not awake:
            raise BackendError(
                f"'{self._uri}' does not {what}; press the chest button once, its notifications say why"
            )

    def _has(self, ability: Capability) -> bool:
        return ability in abilities(self._connection().service_names)

    def _call(
        self, ability: Capability, method: str, *arguments: object, timeout: float | None = None
    ) -> object:
        return self._connection().call(SERVICES[ability], method, *arguments, timeout=timeout)

    def _check_inactive(self, what: str) -> None:
        # The last command to a joint wins: two programs that command it make it shake.
        if self._is_active():
            raise BackendError(
                f"'{self._uri}' cannot {what} by its own program while it is moved from here: deactivate it first"
            )
