"""Plans a scenario to its last goal and contact, before the robot moves."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np

from pepper_driver.backends import Backend
from pepper_driver.config import ConfigError, RobotConfig, Scenario
from pepper_driver.config.parts import FloatArray
from pepper_driver.config.scenario_contacts import Grab, JointPush, Push, RandomPushes
from pepper_driver.controller import RobotModel
from pepper_driver.pushing import Bounds, PlannedPush, PushTooStrongError, plan_push, weigh_push
from pepper_driver.timeline import Leg, legs

ARRIVAL = 6.0
"""A joint counts as moving for this many time constants 1/sqrt(stiffness) of the posture task after a new goal."""

TRIES = 200
"""Random pushes drawn before it is said that none fits."""


@dataclass(frozen=True, kw_only=True)
class PlannedTouch:
    """A contact planned for ``delay`` [s] after its scene begins; ``moving`` tells whether its joint is under way then.

    ``planned`` of a grab is the pull of its spring while the link does not give way.
    """

    planned: PlannedPush
    delay: float
    duration: float
    moving: bool
    grab: Grab | None = None


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A leg of the motion that begins at ``start`` [s], and the contacts that begin during it.

    ``posture`` (17,) is where it leads [rad], NaN where nobody has said; ``arrival`` (17,) when each joint has come to
    rest there [s]; ``stiffness`` that of the posture task [1/s2].
    """

    leg: Leg
    start: float
    stiffness: float
    posture: FloatArray
    arrival: FloatArray
    touches: list[PlannedTouch] = field(default_factory=list)


def plan_scenes(
    scenario: Scenario,
    robot: RobotConfig,
    backend: Backend,
    rng: np.random.Generator,
    *,
    count: int | None = None,
) -> tuple[Scene, ...]:
    """All scenes of a scenario, times counted from the end of the settling. Nothing moves.

    Contacts are planned for a robot at rest in the goal that the motion has at their start.

    Args:
        scenario: What is to be performed.
        robot: Its description.
        backend: Where; need not be open.
        rng: Source of all that is random.
        count: How many goals, for motion of kind setpoints or holds, in place of the scenario's own number.

    Raises:
        ConfigError: A contact that the robot could not take, that comes too late, or on a robot that cannot be pushed
            by software; the message names file and key.
    """
    planner = _Planner(scenario, robot, backend) if scenario.contacts else None
    scenes: list[Scene] = []
    for leg in legs(scenario, robot, rng, count=count):
        scenes.append(_next_scene(scenes[-1] if scenes else None, leg, scenario, robot))
        if planner is not None and not leg.settling:
            planner.add_random(scenes[-1], rng)
    if planner is not None:
        planner.add_stated(scenes)
    for scene in scenes:
        scene.touches.sort(key=lambda touch: touch.delay)
    return tuple(scenes)


def _next_scene(last: Scene | None, leg: Leg, scenario: Scenario, robot: RobotConfig) -> Scene:
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
    return Scene(leg=leg, start=start, stiffness=stiffness, posture=posture, arrival=arrival)


class _Planner:
    """Plans the contacts of one scenario on one robot."""

    def __init__(self, scenario: Scenario, robot: RobotConfig, backend: Backend) -> None:
        if not {"push", "truth"} <= backend.info.capabilities:
            raise ConfigError(
                f"{scenario.source}: key 'contacts': only a simulated robot can be pushed by software, and "
                f"'{backend.info.uri}' is none"
            )
        self._scenario, self._robot, self._truth = scenario, robot, backend.truth
        self._model = RobotModel(robot)

    def add_random(self, scene: Scene, rng: np.random.Generator) -> None:
        """The random pushes after one goal."""
        for number, contact in enumerate(self._scenario.contacts):
            if not isinstance(contact, RandomPushes):
                continue
            for time in contact.times:
                delay = time + rng.uniform(-0.5, 0.5) * contact.jitter
                duration = rng.uniform(*contact.duration)
                planned = self._draw(contact, number, scene.posture, rng)
                scene.touches.append(self._touch(scene, planned, delay, duration))

    def add_stated(self, scenes: list[Scene]) -> None:
        """The contacts whose time is stated, each into the scene in which it begins."""
        cycle, last = self._robot.cycle, scenes[-1]
        end = last.start + last.leg.ticks * cycle
        rounding = len(scenes) * cycle / 2  # legs last whole cycles
        starts = [scene.start for scene in scenes]
        for number, contact in enumerate(self._scenario.contacts):
            if isinstance(contact, RandomPushes):
                continue
            where = f"{self._scenario.source}: key 'contacts.{number}'"
            if contact.start + contact.duration > end + rounding:
                raise ConfigError(f"{where}: ends after this run, which is over at {end:g} s")
            scene = scenes[bisect_right(starts, contact.start) - 1]
            try:
                planned = self._plan(contact, scene.posture)
            except PushTooStrongError as error:
                raise ConfigError(f"{where}: {error}") from error
            delay = max(0.0, contact.start - scene.start)
            grab = contact if isinstance(contact, Grab) else None
            scene.touches.append(self._touch(scene, planned, delay, contact.duration, grab))

    def _touch(
        self,
        scene: Scene,
        planned: PlannedPush,
        delay: float,
        duration: float,
        grab: Grab | None = None,
    ) -> PlannedTouch:
        arrival = scene.arrival[self._robot.joint_index(planned.joint)]
        return PlannedTouch(
            planned=planned,
            delay=delay,
            duration=duration,
            moving=bool(scene.start + delay < arrival),
            grab=grab,
        )

    def _bounds(self, saturating: bool) -> Bounds:
        scenario = self._scenario
        return Bounds(
            load=scenario.largest_load,
            tipping=scenario.largest_tipping,
            saturating=saturating,
        )

    def _plan(self, contact: Push | JointPush | Grab, posture: FloatArray) -> PlannedPush:
        """What a stated contact means for the robot in this posture."""
        if isinstance(contact, JointPush):
            return plan_push(
                self._model,
                self._robot,
                self._truth,
                joint=contact.joint,
                link=contact.link,
                point=np.array(contact.xyz),
                degrees=contact.degrees,
                direction=contact.direction,
                posture=posture,
                bounds=self._bounds(contact.saturating),
            )
        return weigh_push(
            self._model,
            self._robot,
            self._truth,
            joint=contact.joint,
            link=contact.link,
            point=np.array(contact.xyz),
            force=np.array(contact.largest),
            frame=contact.frame,
            posture=posture,
            bounds=self._bounds(contact.saturating),
        )

    def _draw(
        self, contact: RandomPushes, number: int, posture: FloatArray, rng: np.random.Generator
    ) -> PlannedPush:
        """A push of random joint, size and direction that the robot can take at rest."""
        low, high = np.log(contact.degrees)
        for _ in range(TRIES):
            joint = contact.joints[int(rng.integers(len(contact.joints)))]
            where = contact.points[joint]
            try:
                return plan_push(
                    self._model,
                    self._robot,
                    self._truth,
                    joint=joint,
                    link=where.link,
                    point=np.array(where.xyz),
                    degrees=float(np.exp(rng.uniform(low, high))),
                    direction=int(rng.choice([-1, 1])),
                    posture=posture,
                    bounds=self._bounds(contact.saturating),
                )
            except PushTooStrongError as error:
                last = error
        raise ConfigError(
            f"{self._scenario.source}: key 'contacts.{number}': no push of its sizes fits; the last tried: {last}"
        )
