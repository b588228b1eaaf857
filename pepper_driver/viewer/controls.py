"""Requests of the page to the robot: checked here, in the robot's process, and done through the facade."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends import CapabilityError
from pepper_driver.config import RobotConfig, UnknownNameError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.robot import Pepper
from pepper_driver.steady_hand import SteadyHand
from pepper_driver.telemetry.server import Request

GRIP_RADIUS = 0.06
"""[m] A hand closes around what is thinner."""

PRESSURE = 3.0
"""Force on a sensor that is pressed, over the least that it answers to."""

TAP_RISE = 0.02
"""[s] in which the force of a tap rises."""


def gripped_point(robot: RobotConfig, link: str, point: ArrayLike) -> FloatArray:
    """Return where a hand holds that closes around a link: on the axis of its joint, where that is near.

    Held at its surface, a thin link would be twisted with every pull.

    Args:
        robot: Its description.
        link: Name of the link.
        point: (3,) of its surface, in its frame [m].
    """
    place = np.asarray(point, dtype=np.float64)
    for joint in robot.joints:
        if joint.child == link:
            on_axis: FloatArray = (place @ joint.axis) * np.array(joint.axis)
            if np.linalg.norm(place - on_axis) <= GRIP_RADIUS:
                return on_axis
    return place


class Controls:
    """Does what listeners of the telemetry ask for.

    On a real robot, only ``stop`` is taken unless control is allowed; the hand of a person is never simulated there.
    Motions pass the safety gate as those of a program do, and driving ends half a second after the last request.

    Args:
        pepper: The robot.
        allow_control: Take all requests on a real robot too.
        perform: Plays a motion or experiment by name, restarts a simulation; None where no program does that.
        choices: What ``perform`` can do, for the page to show.
    """

    def __init__(
        self,
        pepper: Pepper,
        *,
        allow_control: bool = False,
        perform: Callable[[str, Mapping[str, Any]], None] | None = None,
        choices: Callable[[], Mapping[str, object]] = dict,
    ) -> None:
        self._pepper, self._perform = pepper, perform
        self._simulated = not pepper.backend.real_time
        self._controllable = allow_control or not pepper.backend.real_time
        self._choices = choices
        self._hands: dict[tuple[int, str], SteadyHand] = {}

    @property
    def can(self) -> dict[str, Any]:
        """Offers of the page: ``touch``, ``control``, names of postures and sensors, and the choices."""
        robot = self._pepper.config
        return {
            "touch": self._simulated,
            "control": self._controllable,
            "postures": sorted(robot.postures),
            "sensors": [*robot.sensors.touch, *robot.sensors.bumpers, *robot.sensors.buttons],
            **self._choices(),
        }

    def __call__(self, listener: int, request: Request) -> object:
        """Do one request; return what it answers."""
        arguments = dict(request)
        do = arguments.pop("do", None)
        action = self._ACTIONS.get(do) if isinstance(do, str) else None
        if action is None:
            raise CapabilityError(f"there is no request {do!r}")
        kind, method = action
        if kind == "touch" and not self._simulated:
            raise CapabilityError("a real robot must be touched by hand")
        if kind == "control" and not self._controllable:
            raise CapabilityError(
                "the view only looks at a real robot, and stops it: start it with --allow-control to move it"
            )
        return method(self, listener, **arguments)

    def leave(self, listener: int) -> None:
        """Let go of what a listener held that is gone."""
        for key in [key for key in self._hands if key[0] == listener]:
            self._release(*key)

    # -- requests -------------------------------------------------------------------------------------------------

    def _stop(self, listener: int) -> None:
        self._pepper.emergency_stop("stopped in the view")

    def _tap(
        self, listener: int, link: str, force: list[float], point: list[float], duration: float
    ) -> None:
        self._pepper.push(link, force, point, duration=duration, frame="link", rise=TAP_RISE)

    def _take(self, listener: int, link: str, point: list[float], stiffness: float) -> None:
        self._release(listener, link)
        held = gripped_point(self._pepper.config, link, point)
        self._hands[listener, link] = self._pepper.take_hand(link, held, stiffness=stiffness)

    def _move(self, listener: int, link: str, to: list[float]) -> dict[str, object] | None:
        hand = self._hands.get((listener, link))
        if hand is None:
            return None
        hand.move(to)
        return {"limited": hand.limited, "max_force": hand.max_force}

    def _release(self, listener: int, link: str) -> None:
        hand = self._hands.pop((listener, link), None)
        if hand is not None:
            hand.release()

    def _press(self, listener: int, sensor: str, duration: float) -> None:
        """Press a sensor as a finger does: with twice the force that it needs, inwards."""
        sensors = self._pepper.config.sensors
        place = {**sensors.touch, **sensors.bumpers, **sensors.buttons}.get(sensor)
        if place is None:
            raise UnknownNameError("sensor", sensor, self.can["sensors"])
        inwards = -np.array(place.xyz) / np.linalg.norm(place.xyz)
        force = PRESSURE * place.threshold * inwards
        self._pepper.push(
            place.parent, force, place.xyz, duration=duration, frame="link", rise=TAP_RISE
        )

    def _drive(self, listener: int, vx: float, vy: float, wz: float) -> None:
        self._pepper.drive(vx, vy, wz)

    def _posture(self, listener: int, name: str, duration: float) -> None:
        self._pepper.set_posture(name, duration=duration)

    def _attentive(self, listener: int, on: bool) -> None:
        self._pepper.attentive = on

    def _play(self, listener: int, name: str) -> None:
        self._performed("play", name=name)

    def _restart(self, listener: int, **settings: object) -> None:
        self._performed("restart", **settings)

    def _performed(self, do: str, **arguments: object) -> None:
        if self._perform is None:
            raise CapabilityError("a program runs this robot: it alone decides what it plays")
        self._perform(do, arguments)

    _ACTIONS: Mapping[str, tuple[str, Callable[..., object]]] = {
        "stop": ("stop", _stop),
        "tap": ("touch", _tap),
        "take": ("touch", _take),
        "move": ("touch", _move),
        "release": ("touch", _release),
        "press": ("touch", _press),
        "drive": ("control", _drive),
        "posture": ("control", _posture),
        "attentive": ("control", _attentive),
        "play": ("control", _play),
        "restart": ("control", _restart),
    }
