"""One goal of a scenario's motion, and the contacts planned for it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pepper_driver.backends import Backend
from pepper_driver.config import RobotConfig, Scenario
from pepper_driver.config.parts import FloatArray
from pepper_driver.config.scenario_contacts import Grab
from pepper_driver.pushing import PlannedPush
from pepper_driver.timeline import Leg

ARRIVAL = 6.0
"""A joint counts as moving for this many time constants 1/sqrt(stiffness) of the posture task after a new goal."""


@dataclass(frozen=True, kw_only=True)
class PlannedTouch:
    """A contact planned for ``delay`` [s] after its scene begins; ``moving`` tells whether its joint is under way then.

    ``planned`` of a grab is the pull of its spring while the link does not give way. ``rise`` of a push [s]; None for
    that of the backend.
    """

    planned: PlannedPush
    delay: float
    duration: float
    moving: bool
    grab: Grab | None = None
    rise: float | None = None


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A leg of the motion that begins at ``start`` [s], and the contacts that begin during it.

    ``posture`` (17,) is where it leads [rad], NaN where nobody has said; ``arrival`` (17,) when each joint has come to
    rest there [s]; ``stiffness`` that of the posture task [1/s2]; ``origin`` (17,) where it begins [rad].
    """

    leg: Leg
    start: float
    stiffness: float
    posture: FloatArray
    arrival: FloatArray
    origin: FloatArray
    touches: list[PlannedTouch] = field(default_factory=list)

    def expected(self, time: float) -> FloatArray:
        """(17,) where the joints should be ``time`` [s] after the goal was set at once: the law of the posture task."""
        rate = np.sqrt(self.stiffness) * time
        away: FloatArray = self.origin - self.posture
        there: FloatArray = self.posture + away * (1.0 + rate) * np.exp(-rate)
        return there


def scene_after(last: Scene | None, leg: Leg, scenario: Scenario, robot: RobotConfig) -> Scene:
    """The scene of a leg that follows the scene ``last``."""
    n = len(robot.joint_names)
    if last is None:
        start, stiffness = -leg.ticks * robot.cycle, scenario.stiffness
        posture, arrival = np.full(n, np.nan), np.full(n, -np.inf)
    else:
        start = last.start + last.leg.ticks * robot.cycle
        stiffness = last.stiffness if leg.stiffness is None else leg.stiffness
        posture, arrival = last.posture.copy(), last.arrival.copy()
    for name, angle in leg.joints.items():
        index = robot.joint_index(name)
        if last is not None and angle != posture[index]:
            arrival[index] = start + leg.move * robot.cycle + ARRIVAL / np.sqrt(stiffness)
        posture[index] = np.clip(angle, robot.lower[index], robot.upper[index])
    origin = posture.copy() if last is None else last.posture
    return Scene(
        leg=leg,
        start=start,
        stiffness=stiffness,
        posture=posture,
        arrival=arrival,
        origin=origin,
    )


def order_touch(backend: Backend, touch: PlannedTouch) -> None:
    """Have a simulated robot pushed, or grabbed, when its time has come.

    Raises:
        ValueError: There is another hand on that link then.
    """
    planned, grab = touch.planned, touch.grab
    if grab is None:
        backend.push(
            planned.link,
            planned.force,
            planned.point,
            touch.duration,
            frame=planned.frame,
            delay=touch.delay,
            **({} if touch.rise is None else {"rise": touch.rise}),
        )
        return
    backend.grab(
        grab.link,
        np.array(grab.pull),
        np.array(grab.xyz),
        stiffness=grab.stiffness,
        rise=grab.rise,
        hold=grab.hold,
        release=grab.release,
        largest_force=grab.largest_force,
        frame=grab.frame,
        delay=touch.delay,
    )
