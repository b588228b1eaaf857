"""Plans the contacts of a scenario: where, when and how hard, such that the robot can take them."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pepper_driver.backends import Backend, SimulatedPlant
from pepper_driver.config import ConfigError, RobotConfig, Scenario
from pepper_driver.config.parts import FloatArray
from pepper_driver.config.scenario_contacts import (
    AnyContact,
    Grab,
    JointPush,
    Push,
    RandomForces,
    RandomPushes,
    RandomTouch,
)
from pepper_driver.config.scenario_motion import Holds, Setpoints
from pepper_driver.controller import RobotModel
from pepper_driver.pushing import Bounds, PlannedPush, PushTooStrongError, plan_push, weigh_push
from pepper_driver.scene import PlannedTouch, Scene, scene_after
from pepper_driver.timeline import random_leg

TRIES = 200
"""Random pushes drawn before another goal is tried, or it is said that none fits."""

EVEN_TRIES = 40
"""Sizes drawn for one joint, where joints are pushed evenly, before it is another's turn."""

GOALS = 30
"""Random goals tried before that is said."""


class TouchPlanner:
    """Plans the contacts of one scenario on one robot."""

    def __init__(self, scenario: Scenario, robot: RobotConfig, backend: Backend) -> None:
        if "push" not in backend.info.capabilities:
            raise ConfigError(
                f"{scenario.source}: key 'contacts': only a simulated robot can be pushed by software, and "
                f"'{backend.uri}' is none"
            )
        self._scenario, self._robot, self._plant = scenario, robot, backend.plant
        self._model = RobotModel(robot)

    def with_random(self, scene: Scene, last: Scene | None, rng: np.random.Generator) -> Scene:
        """A scene with its random pushes; one with another goal where none of their sizes fits in this one."""
        motion = self._scenario.motion
        for left in reversed(range(GOALS)):
            try:
                self._add_random(scene, rng)
            except ConfigError:
                if left == 0 or not isinstance(motion, Setpoints | Holds):
                    raise
                leg = random_leg(motion, self._robot, rng)
                scene = scene_after(last, leg, self._scenario, self._robot)
            else:
                break
        return scene

    def _add_random(self, scene: Scene, rng: np.random.Generator) -> None:
        """The random pushes after one goal."""
        for number, contact in enumerate(self._scenario.contacts):
            if not isinstance(contact, RandomPushes | RandomForces):
                continue
            if scene.start < contact.after - self._robot.cycle / 2:
                continue
            for time in contact.times:
                delay = time + rng.uniform(-0.5, 0.5) * contact.jitter
                duration = rng.uniform(*contact.duration)
                rise = None if contact.rise is None else rng.uniform(*contact.rise)
                beside = _beside([scene], scene.start + delay, duration)
                postures = [scene.posture]
                if contact.on_the_way:
                    postures = [
                        scene.expected(delay + (rise or 0.0)),
                        scene.expected(delay + duration),
                    ]
                planned = self._draw(contact, number, postures, beside, rng)
                scene.touches.append(self._touch(scene, planned, delay, duration, rise=rise))

    def add_stated(self, scenes: list[Scene]) -> None:
        """The contacts whose time is stated, each into the scene in which it begins."""
        cycle, last = self._robot.cycle, scenes[-1]
        end = last.start + last.leg.ticks * cycle
        rounding = len(scenes) * cycle / 2  # legs last whole cycles
        starts = [scene.start for scene in scenes]
        for number, contact in enumerate(self._scenario.contacts):
            if isinstance(contact, RandomTouch):
                continue
            where = f"{self._scenario.source}: key 'contacts.{number}'"
            if contact.start + contact.duration > end + rounding:
                raise ConfigError(f"{where}: ends after this run, which is over at {end:g} s")
            scene = scenes[bisect_right(starts, contact.start) - 1]
            try:
                beside = _beside(scenes, contact.start, contact.duration)
                planned = plan_stated(
                    self._model,
                    self._robot,
                    self._plant,
                    contact,
                    posture=scene.posture,
                    bounds=self._bounds(contact),
                    beside=beside,
                )
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
        rise: float | None = None,
    ) -> PlannedTouch:
        if planned.joint is None:
            arrival = float(scene.arrival.max())
        else:
            arrival = float(scene.arrival[self._robot.joint_index(planned.joint)])
        return PlannedTouch(
            planned=planned,
            delay=delay,
            duration=duration,
            moving=scene.start + delay < arrival,
            grab=grab,
            rise=rise,
        )

    def _bounds(self, contact: AnyContact) -> Bounds:
        bounds = Bounds(
            load=self._scenario.largest_load,
            tipping=self._scenario.largest_tipping,
            saturating=contact.saturating,
        )
        if not isinstance(contact, RandomPushes):
            return bounds
        outer = np.inf if contact.further_out is None else contact.further_out
        return replace(bounds, force=contact.largest_force, further_out=outer)

    def _draw(
        self,
        contact: RandomPushes | RandomForces,
        number: int,
        postures: Sequence[FloatArray],
        beside: Sequence[PlannedPush],
        rng: np.random.Generator,
    ) -> PlannedPush:
        """A push of random place, size and direction that the robot can take at rest in all postures."""
        joint = ""
        for attempt in range(TRIES):
            try:
                if isinstance(contact, RandomForces):
                    return self._force(contact, postures, beside, rng)
                if attempt % (EVEN_TRIES if contact.evenly else 1) == 0:
                    joint = contact.joints[int(rng.integers(len(contact.joints)))]
                return self._push(contact, joint, postures, beside, rng)
            except PushTooStrongError as error:
                last = error
        raise ConfigError(
            f"{self._scenario.source}: key 'contacts.{number}': no push of its sizes fits; the last tried: {last}"
        )

    def _push(
        self,
        contact: RandomPushes,
        joint: str,
        postures: Sequence[FloatArray],
        beside: Sequence[PlannedPush],
        rng: np.random.Generator,
    ) -> PlannedPush:
        """One try at a push on a joint."""
        degrees = float(np.exp(rng.uniform(*np.log(contact.degrees))))
        direction = int(rng.choice([-1, 1]))
        places = contact.points[joint]
        if len(places) > 1:
            places = tuple(places[int(k)] for k in rng.permutation(len(places)))
        for place in places:
            try:
                planned = plan_push(
                    self._model,
                    self._robot,
                    self._plant,
                    joint=joint,
                    link=place.link,
                    point=np.array(place.xyz),
                    degrees=degrees,
                    direction=direction,
                    posture=postures[0],
                    bounds=self._bounds(contact),
                    beside=beside,
                )
                self._check_later(planned, contact, postures, beside)
                return planned
            except PushTooStrongError as error:
                last = error
        raise last

    def _force(
        self,
        contact: RandomForces,
        postures: Sequence[FloatArray],
        beside: Sequence[PlannedPush],
        rng: np.random.Generator,
    ) -> PlannedPush:
        """One try at a force on trunk or base; it turns with the link, and so with the base."""
        place = contact.points[int(rng.integers(len(contact.points)))]
        size = float(np.exp(rng.uniform(*np.log(contact.newtons))))
        heading = rng.uniform(-np.pi, np.pi)
        in_world = size * np.array([np.cos(heading), np.sin(heading), 0.0])
        planned = weigh_push(
            self._model,
            self._robot,
            self._plant,
            joint=None,
            link=place.link,
            point=np.array(place.xyz),
            force=self._model.link_pose(place.link, postures[0])[:3, :3].T @ in_world,
            frame="link",
            posture=postures[0],
            bounds=self._bounds(contact),
            beside=beside,
        )
        self._check_later(planned, contact, postures, beside)
        return planned

    def _check_later(
        self,
        planned: PlannedPush,
        contact: RandomPushes | RandomForces,
        postures: Sequence[FloatArray],
        beside: Sequence[PlannedPush],
    ) -> None:
        """Refuse what the robot could not take in the postures after the first."""
        for posture in postures[1:]:
            weigh_push(
                self._model,
                self._robot,
                self._plant,
                joint=planned.joint,
                link=planned.link,
                point=planned.point,
                force=planned.force,
                frame=planned.frame,
                posture=posture,
                bounds=self._bounds(contact),
                beside=beside,
            )


def plan_stated(
    model: RobotModel,
    robot: RobotConfig,
    plant: SimulatedPlant,
    contact: Push | JointPush | Grab,
    *,
    posture: FloatArray,
    bounds: Bounds,
    beside: Sequence[PlannedPush] = (),
) -> PlannedPush:
    """What a stated contact means for the robot at rest in a posture (17,) [rad]; the rest as for :func:`plan_push`.

    Raises:
        PushTooStrongError: It is too strong for the robot, or does nothing to the joint that is meant.
    """
    if isinstance(contact, JointPush):
        return plan_push(
            model,
            robot,
            plant,
            joint=contact.joint,
            link=contact.link,
            point=np.array(contact.xyz),
            degrees=contact.degrees,
            direction=contact.direction,
            posture=posture,
            bounds=bounds,
            beside=beside,
        )
    return weigh_push(
        model,
        robot,
        plant,
        joint=contact.joint,
        link=contact.link,
        point=np.array(contact.xyz),
        force=np.array(contact.largest),
        frame=contact.frame,
        posture=posture,
        bounds=bounds,
        beside=beside,
    )


def _beside(scenes: Sequence[Scene], start: float, duration: float) -> list[PlannedPush]:
    """The pushes planned so far that act at some time between ``start`` and the end of ``duration`` [s]."""
    return [
        touch.planned
        for scene in scenes
        for touch in scene.touches
        if scene.start + touch.delay < start + duration
        and start < scene.start + touch.delay + touch.duration
    ]
