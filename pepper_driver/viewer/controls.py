"""Requests of the page to the robot: checked here, in the robot's process, and done through the facade."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends import CapabilityError
from pepper_driver.config import PepperError, RobotConfig, UnknownNameError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_specs import Axes
from pepper_driver.robot import Pepper
from pepper_driver.steady_hand import SteadyHand
from pepper_driver.telemetry.server import Request

GRIP_RADIUS = 0.06
"""[m] A hand closes around what is thinner."""

PRESSURE = 3.0
"""Force on a sensor that is pressed, over the least that it answers to."""

TAP_RISE = 0.02
"""[s] in which the force of a tap rises."""

REAL_ROBOT = "This is a real robot: the page only looks, and stops it."
"""What the page says where it may not move the robot."""


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


class Touchable(Protocol):
    """A simulated robot that is touched: a :class:`pepper_driver.Pepper`, or one that is served."""

    @property
    def config(self) -> RobotConfig:
        """Its description."""

    def push(
        self,
        link: str,
        force: ArrayLike,
        point: ArrayLike | None = None,
        *,
        duration: float,
        frame: Axes,
        rise: float,
    ) -> None:
        """Push a link; see :meth:`pepper_driver.Pepper.push`."""

    def take_hand(self, link: str, point: ArrayLike | None, *, stiffness: float) -> SteadyHand:
        """Take a link in a hand; see :meth:`pepper_driver.Pepper.take_hand`."""


Action = tuple[str, Callable[..., object]]
"""Kind of a request (stop, touch or control), and the method that does it, given the listener and arguments."""


class TouchControls:
    """Does what listeners of the telemetry ask for with their hands, and nothing else.

    Args:
        robot: That is touched.
        note: What the page says of what it cannot do.
    """

    def __init__(self, robot: Touchable, *, note: str) -> None:
        self._robot, self._note = robot, note
        self._hands: dict[tuple[int, str], SteadyHand] = {}

    @property
    def can(self) -> dict[str, Any]:
        """Offers of the page: ``stop``, ``touch``, ``control``, names of sensors, and ``note`` on what it cannot do."""
        sensors = self._robot.config.sensors
        return {
            "stop": False,
            "touch": True,
            "control": False,
            "sensors": [*sensors.touch, *sensors.bumpers, *sensors.buttons],
            "note": self._note,
        }

    def __call__(self, listener: int, request: Request) -> object:
        """Do one request; return what it answers."""
        arguments = dict(request)
        do = arguments.pop("do", None)
        action = self._ACTIONS.get(do) if isinstance(do, str) else None
        if action is None:
            raise CapabilityError(f"there is no request {do!r}")
        kind, method = action
        self._check(kind)
        return method(self, listener, **arguments)

    def _check(self, kind: str) -> None:
        """Raise a CapabilityError where requests of a kind are not taken."""

    def leave(self, listener: int) -> None:
        """Let go of what a listener held that has left."""
        for key in [key for key in self._hands if key[0] == listener]:
            with suppress(PepperError):  # the robot has ended, and holds on to nothing
                self._release(*key)

    def _tap(
        self, listener: int, link: str, force: list[float], point: list[float], duration: float
    ) -> None:
        self._robot.push(link, force, point, duration=duration, frame="link", rise=TAP_RISE)

    def _take(self, listener: int, link: str, point: list[float], stiffness: float) -> None:
        self._release(listener, link)
        held = gripped_point(self._robot.config, link, point)
        self._hands[listener, link] = self._robot.take_hand(link, held, stiffness=stiffness)

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
        """Press a sensor as a finger does: with three times the force that it needs, inwards."""
        sensors = self._robot.config.sensors
        place = {**sensors.touch, **sensors.bumpers, **sensors.buttons}.get(sensor)
        if place is None:
            raise UnknownNameError("sensor", sensor, self.can["sensors"])
        inwards = -np.array(place.xyz) / np.linalg.norm(place.xyz)
        force = PRESSURE * place.threshold * inwards
        self._robot.push(
            place.parent, force, place.xyz, duration=duration, frame="link", rise=TAP_RISE
        )

    _ACTIONS: Mapping[str, Action] = {
        "tap": ("touch", _tap),
        "take": ("touch", _take),
        "move": ("touch", _move),
        "release": ("touch", _release),
        "press": ("touch", _press),
    }


class Controls(TouchControls):
    """Does all that listeners of the telemetry ask for, through the facade of the robot's program.

    On a real robot, only ``stop`` is taken unless control is allowed; the hand of a person is never simulated there.
    Motions pass the safety gate as those of a program do. Driving ends ``drive_time`` of ``safety.yaml``, half a
    second, after the last request.

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
        super().__init__(pepper, note=REAL_ROBOT)
        self._pepper, self._perform = pepper, perform
        self._simulated = not pepper.backend.real_time
        self._controllable = allow_control or not pepper.backend.real_time
        self._choices = choices

    @property
    def can(self) -> dict[str, Any]:
        """Offers of the page: as in :class:`TouchControls`, names of postures, and the choices."""
        return {
            **super().can,
            "stop": True,
            "touch": self._simulated,
            "control": self._controllable,
            "postures": sorted(self._pepper.config.postures),
            **self._choices(),
        }

    def _check(self, kind: str) -> None:
        if kind == "touch" and not self._simulated:
            raise CapabilityError("a real robot must be touched by hand")
        if kind == "control" and not self._controllable:
            raise CapabilityError(
                "the view only looks at a real robot, and stops it: start it with --allow-control to move it"
            )

    def _stop(self, listener: int) -> None:
        self._pepper.emergency_stop("stopped in the view")

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

    _ACTIONS: Mapping[str, Action] = {
        **TouchControls._ACTIONS,
        "stop": ("stop", _stop),
        "drive": ("control", _drive),
        "posture": ("control", _posture),
        "attentive": ("control", _attentive),
        "play": ("control", _play),
        "restart": ("control", _restart),
    }
