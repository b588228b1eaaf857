"""Services of a robot for its user: speech, lights, tablet, postures, wake-up and rest."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from pepper_driver.backends import Backend, BackendError, Capability, RobotServices
from pepper_driver.callbacks.events import CueEvent
from pepper_driver.config import PepperError
from pepper_driver.config.arguments import checked_arguments, is_number, real_array
from pepper_driver.config.errors import shown

logger = logging.getLogger("pepper_driver")


class ExtrasError(PepperError, ValueError):
    """An invalid colour, time or text."""


class UserServices:
    """Abilities of a robot other than moving and measuring: ``pepper.services``.

    A backend without an ability does nothing and logs that once; ``info.capabilities`` lists the abilities.
    Each connects to the robot for its time where that is not yet connected. All may be called from any thread, but not
    inside a tick: a robot may take its time.

    Args:
        backend: The robot.
        is_active: Whether a loop of ours moves it now.
    """

    def __init__(self, backend: Backend, is_active: Callable[[], bool]) -> None:
        self._backend = backend
        self._is_active = is_active

    @checked_arguments
    def say(self, text: str) -> None:
        """Begin to speak; returns before the text is spoken.

        Raises:
            PepperError: That is no text, or the robot cannot be reached or refuses.
        """
        _check_text("say", text)
        self._call("speech", lambda services: services.say(text))

    @checked_arguments
    def leds(self, group: str, colour: Sequence[float], duration: float = 0.2) -> None:
        """Begin to fade lights to a colour; returns before they have it.

        Args:
            group: NAOqi's name of lights: ``FaceLeds``, ``EarLeds``, ``ChestLeds``, ...
            colour: (r, g, b), each 0..1.
            duration: Of the fade [s], up to 60.

        Raises:
            PepperError: An argument is invalid, or the robot cannot be reached or refuses.
        """
        _check_text("group", group)
        rgb = real_array(colour, (3,))
        if rgb is None or not all(0 <= part <= 1 for part in rgb):
            raise ExtrasError(f"a colour is (r, g, b), each from 0 to 1, got {shown(colour)}")
        if not (is_number(duration) and 0 <= duration <= 60):
            raise ExtrasError(f"lights fade within a time from 0 to 60 s, got {shown(duration)}")
        r, g, b = rgb.tolist()
        self._call("leds", lambda services: services.leds(group, (r, g, b), float(duration)))

    @checked_arguments
    def show_image(self, url: str) -> None:
        """Have the tablet show an image.

        Args:
            url: Address that the tablet, not this computer, can reach; ``http://198.18.0.1/...`` is the robot itself.

        Raises:
            PepperError: That is no text, or the robot cannot be reached or refuses.
        """
        _check_text("url", url)
        self._call("tablet", lambda services: services.show_image(url))

    def hide_image(self) -> None:
        """Have the tablet show no image.

        Raises:
            PepperError: The robot cannot be reached or refuses.
        """
        self._call("tablet", lambda services: services.hide_image())

    @checked_arguments
    def go_to_posture(self, name: str, speed: float = 0.5) -> None:
        """Have the robot's own program take it to a posture; returns when it is there. Not inside the ``with`` block.

        Args:
            name: NAOqi's name for it: ``Stand``, ``StandInit``, ``StandZero``, ``Crouch``.
            speed: Ratio to the full speed, above 0 up to 1.

        Raises:
            PepperError: The robot is active, cannot be reached or refuses, or an argument is invalid.
        """
        _check_text("name", name)
        if not (is_number(speed) and 0 < speed <= 1):
            raise ExtrasError(
                f"a speed is a ratio to the full one, above 0 up to 1, got {shown(speed)}"
            )
        self._check_inactive(f"go to posture '{name}'", "set_posture() moves it now")
        self._call("postures", lambda services: services.go_to_posture(name, float(speed)))

    def wake_up(self) -> None:
        """Have the robot switch its motors on and stand up; returns when it stands. Not inside the ``with`` block.

        Raises:
            PepperError: The robot is active, cannot be reached or refuses.
        """
        self._check_inactive("wake up", "it is awake")
        self._call("wake", lambda services: services.wake_up())

    def rest(self) -> None:
        """Have the robot sit down and switch its motors off; returns when it is done. Not inside the ``with`` block.

        Raises:
            PepperError: The robot is active, cannot be reached or refuses.
        """
        self._check_inactive("rest", "leave the 'with' block first")
        self._call("wake", lambda services: services.rest())

    def perform(self, cue: CueEvent) -> None:
        """Say or show the output of an experiment. A refusal of the robot is logged, and the experiment continues."""
        try:
            if cue.kind == "say":
                self.say(cue.text)
            elif cue.kind == "leds":
                self.leds(cue.group, cue.colour, cue.duration)
        except PepperError as error:
            logger.warning("left out: %s: %s", cue, error)

    def _check_inactive(self, what: str, instead: str) -> None:
        if self._is_active():
            raise BackendError(
                f"'{self._backend.uri}' cannot {what} by its own program while the loop moves it: {instead}"
            )

    def _call(self, capability: Capability, call: Callable[[RobotServices], None]) -> None:
        """Call the backend's services, with a connection as long as it takes where there is one to be made."""
        backend = self._backend
        if self._is_active() or capability not in backend.info.capabilities:
            call(backend.services)
            return
        backend.open()  # fails where another program part has it open, which then closes it
        with backend:
            call(backend.services)


def _check_text(what: str, text: object) -> None:
    if not (isinstance(text, str) and text.strip()):
        raise ExtrasError(f"{what} must be a text, got {shown(text)}")
