"""Plans the contacts of an experiment: where, when and how hard, such that the robot can take them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from pepper_driver.backends import Backend, SimulatedPlant
from pepper_driver.config import ConfigError, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_specs import (
    AnyContact,
    GrabSpec,
    JointPushSpec,
    RandomForces,
    RandomPushes,
    StatedContact,
)
from pepper_driver.config.experiment import Experiment
from pepper_driver.controller import RobotModel
from pepper_driver.experiments.push_planning import (
    PlannedPush,
    PushLimits,
    PushTooStrongError,
    evaluate_push,
    plan_push,
)
from pepper_driver.experiments.segments import PlannedContact, Segment

TRIES = 200
"""Random pushes drawn before another goal is tried, or it is said that none fits."""

EVEN_TRIES = 40
"""Sizes drawn for one joint, where joints are pushed evenly, before it is another's turn."""

GOALS = 30
"""Random goals tried before that is said."""


class ContactPlanner:
    """Plans the contacts of one experiment on one robot that can be pushed by software."""

    def __init__(self, experiment: Experiment, robot: RobotConfig, backend: Backend) -> None:
        self._experiment, self._robot, self._plant = experiment, robot, backend.plant
        self._model = RobotModel(robot)

    def with_random(
        self,
        draw: Callable[[], Segment],
        contacts: Sequence[tuple[str, RandomPushes | RandomForces]],
        settled: float,
        rng: np.random.Generator,
    ) -> Segment:
        """Draw a goal with its random contacts; another goal where none of their sizes fits in this one.

        Args:
            draw: Makes the segment of a new random goal.
            contacts: Key and contact of those in this step.
            settled: When the first goal of the step was set [s].
            rng: Source of all that is random.
        """
        for left in reversed(range(GOALS)):
            segment = draw()
            try:
                for key, contact in contacts:
                    if segment.start - settled >= contact.after - self._robot.cycle / 2:
                        self._add_random(segment, key, contact, rng)
                break
            except ConfigError:
                if left == 0:
                    raise
        return segment

    def _add_random(
        self,
        segment: Segment,
        key: str,
        contact: RandomPushes | RandomForces,
        rng: np.random.Generator,
    ) -> None:
        """Add the random contacts after one goal."""
        for time in contact.times:
            delay = time + rng.uniform(-0.5, 0.5) * contact.jitter
            duration = rng.uniform(*contact.duration)
            rise = None if contact.rise is None else rng.uniform(*contact.rise)
            concurrent = _concurrent(segment.contacts, delay, duration)
            postures = [segment.posture]
            if contact.in_motion:
                postures = [
                    segment.expected(delay + (rise or 0.0)),
                    segment.expected(delay + duration),
                ]
            planned = self._draw(contact, key, postures, concurrent, rng)
            moving = segment.moves(planned.joint, delay, self._robot)
            drawn = PlannedContact(
                planned=planned, delay=delay, duration=duration, moving=moving, rise=rise
            )
            self._add(key, drawn, segment.contacts)

    def add_stated(
        self,
        key: str,
        contact: StatedContact,
        segment: Segment,
        delay: float,
        concurrent: list[PlannedContact],
    ) -> None:
        """Plan a contact of known place and add it.

        Args:
            key: Its place in the file.
            contact: As the file has it.
            segment: In which it begins.
            delay: Time from the beginning of the segment [s].
            concurrent: Contacts with the same origin of time as ``contact.start``; it is added to them.

        Raises:
            ConfigError: The robot could not take it, or there is another hand.
        """
        try:
            planned = plan_stated(
                self._model,
                self._robot,
                self._plant,
                contact,
                posture=segment.posture,
                bounds=self._bounds(contact),
                concurrent=_concurrent(concurrent, contact.start, contact.duration),
            )
        except PushTooStrongError as error:
            raise self._experiment.error(key, str(error)) from error
        stated = PlannedContact(
            planned=planned,
            delay=contact.start,
            duration=contact.duration,
            moving=segment.moves(planned.joint, delay, self._robot),
            grab=contact if isinstance(contact, GrabSpec) else None,
        )
        self._add(key, stated, concurrent)

    def _add(self, key: str, new: PlannedContact, concurrent: list[PlannedContact]) -> None:
        """Add a contact, unless a hand is on its link."""
        link = new.planned.link
        if any(push.link == link for push in _concurrent(concurrent, new.delay, new.duration)):
            raise self._experiment.error(
                key, f"another hand is on {link} between {new.delay:g} and {new.end:g} s"
            )
        concurrent.append(new)

    def _bounds(self, contact: AnyContact) -> PushLimits:
        bounds = PushLimits(
            load=self._experiment.max_load,
            tipping=self._experiment.max_tipping,
            saturating=contact.saturating,
        )
        if not isinstance(contact, RandomPushes):
            return bounds
        outer = np.inf if contact.max_distal_ratio is None else contact.max_distal_ratio
        return replace(bounds, force=contact.max_force, max_distal_ratio=outer)

    def _draw(
        self,
        contact: RandomPushes | RandomForces,
        key: str,
        postures: Sequence[FloatArray],
        concurrent: Sequence[PlannedPush],
        rng: np.random.Generator,
    ) -> PlannedPush:
        """Return a push of random place, size and direction that the robot can take at rest in all postures."""
        joint = ""
        for attempt in range(TRIES):
            try:
                if isinstance(contact, RandomForces):
                    return self._force(contact, postures, concurrent, rng)
                if attempt % (EVEN_TRIES if contact.balanced else 1) == 0:
                    joint = contact.joints[int(rng.integers(len(contact.joints)))]
                return self._push(contact, joint, postures, concurrent, rng)
            except PushTooStrongError as error:
                last = error
        raise self._experiment.error(key, f"no push of its sizes fits; the last tried: {last}")

    def _push(
        self,
        contact: RandomPushes,
        joint: str,
        postures: Sequence[FloatArray],
        concurrent: Sequence[PlannedPush],
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
                    concurrent=concurrent,
                )
                self._check_later(planned, contact, postures, concurrent)
                return planned
            except PushTooStrongError as error:
                last = error
        raise last

    def _force(
        self,
        contact: RandomForces,
        postures: Sequence[FloatArray],
        concurrent: Sequence[PlannedPush],
        rng: np.random.Generator,
    ) -> PlannedPush:
        """One try at a force on trunk or base; it turns with the link, and so with the base."""
        place = contact.points[int(rng.integers(len(contact.points)))]
        size = float(np.exp(rng.uniform(*np.log(contact.newtons))))
        heading = rng.uniform(-np.pi, np.pi)
        in_world = size * np.array([np.cos(heading), np.sin(heading), 0.0])
        planned = evaluate_push(
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
            concurrent=concurrent,
        )
        self._check_later(planned, contact, postures, concurrent)
        return planned

    def _check_later(
        self,
        planned: PlannedPush,
        contact: RandomPushes | RandomForces,
        postures: Sequence[FloatArray],
        concurrent: Sequence[PlannedPush],
    ) -> None:
        """Refuse what the robot could not take in the postures after the first."""
        for posture in postures[1:]:
            evaluate_push(
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
                concurrent=concurrent,
            )


def plan_stated(
    model: RobotModel,
    robot: RobotConfig,
    plant: SimulatedPlant,
    contact: StatedContact,
    *,
    posture: FloatArray,
    bounds: PushLimits,
    concurrent: Sequence[PlannedPush] = (),
) -> PlannedPush:
    """Plan a stated contact on the robot at rest in a posture (17,) [rad]; the rest as for :func:`plan_push`.

    Raises:
        PushTooStrongError: It is too strong for the robot, or does nothing to the joint that is meant.
    """
    if isinstance(contact, JointPushSpec):
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
            concurrent=concurrent,
        )
    return evaluate_push(
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
        concurrent=concurrent,
    )


def _concurrent(
    contacts: Iterable[PlannedContact], start: float, duration: float
) -> list[PlannedPush]:
    """Pushes planned so far that act at some time between ``start`` and the end of ``duration`` [s]."""
    return [
        contact.planned
        for contact in contacts
        if contact.delay < start + duration and start < contact.end
    ]
