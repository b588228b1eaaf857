"""The one place that decides, for each tick, what the controller follows: user, motion or reflex."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import count

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.backends.motion_profile import PEAK_SPEED_RATIO
from pepper_driver.callbacks.events import ReflexEvent
from pepper_driver.config import RobotConfig
from pepper_driver.config.arguments import as_tuple, checked_arguments
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.errors import shown
from pepper_driver.controller import WholeBodyController
from pepper_driver.controller.constraints import Constraint
from pepper_driver.controller.tasks import Task
from pepper_driver.observer import Observation
from pepper_driver.reflexes.attentive import AttentiveNote, AttentiveWatch
from pepper_driver.reflexes.basic import Ignore
from pepper_driver.reflexes.reflex import Reflex, ReflexError, kind_of
from pepper_driver.reflexes.requests import BRAKING_STIFFNESS, ReflexRequests


@checked_arguments
def prepare_reflexes(reflexes: Sequence[Reflex], robot: RobotConfig) -> tuple[Reflex, ...]:
    """Return reflexes in the order of their priority, those of the same one in the order given.

    Those of the same name are numbered, and their ``full_name`` ends in the number.

    Raises:
        ReflexError: Something among them is no reflex, or is there twice.
        UnknownNameError: One is for a limb, link or joint that the robot does not have.
    """
    if isinstance(reflexes, Reflex):
        raise ReflexError(f"reflexes are given in a list: [{type(reflexes).__name__}()]")
    given = as_tuple(reflexes)
    if given is None:
        raise ReflexError(f"reflexes are given in a list, such as [Hold()], got {shown(reflexes)}")
    for reflex in given:
        if not isinstance(reflex, Reflex):
            raise ReflexError(f"reflexes are objects such as Hold(), got {shown(reflex)}")
        if sum(other is reflex for other in given) > 1:
            raise ReflexError(f"'{reflex.full_name}' is given twice: make a second one like it")
    ordered = sorted(given, key=lambda reflex: -reflex.priority)
    names = [reflex.name for reflex in ordered]
    for reflex in ordered:
        reflex.setup(robot)
        reflex.number, reflex.full_name = 1, reflex.name
    for name in dict.fromkeys(names):
        alike = [reflex for reflex in ordered if reflex.name == name]
        free = (n for n in count(1) if f"{name} {n}" not in names)  # a name may end in a number
        if len(alike) > 1:
            for reflex, number in zip(alike, free, strict=False):
                reflex.number, reflex.full_name = number, f"{name} {number}"
    return tuple(ordered)


class Arbiter:
    """Assigns posture, tasks, motor stiffness and base to reflexes or user; nothing else writes to the controller.

    User and motions make lasting requests: a posture, a twist of the base, tasks. Reflexes make theirs again in each
    tick, in the order of their priority, and go before. Joints that a reflex gives back return to the user's posture,
    or the posture finds them where they are.

    Args:
        controller: Reset to the posture the robot holds.
        robot: Its description.
        reflexes: In the order in which they are asked, see :func:`prepare_reflexes`.

    Attributes:
        controller: The same.
        target: (17,) posture that user or motion request [rad].
        posture_stiffness: Stiffness of the posture task that they request [1/s2]; may be set.
        stiffness: (17,) stiffness of the motors 0..1 for this tick.
        paused: True while the robot comes to rest and stands, independent of the requests of user and motion.
        watch: Watch over the joints of an attentive robot.
        notes: What it said in this tick.
    """

    def __init__(
        self, controller: WholeBodyController, robot: RobotConfig, reflexes: Sequence[Reflex] = ()
    ) -> None:
        self.controller, self._robot, self.reflexes = controller, robot, tuple(reflexes)
        self._requests = ReflexRequests(controller, robot)
        self._no_joints: BoolArray = np.zeros(len(robot.joint_names), dtype=np.bool_)
        for reflex in self.reflexes:
            reflex.reset()
        self.target = controller.position
        self.posture_stiffness = controller.posture.stiffness
        self.stiffness = self._requests.stiffness
        self.watch = AttentiveWatch(robot, controller.dither)
        self.notes: list[AttentiveNote] = []
        self.paused = False
        self._rest: FloatArray | None = None  # where it stands while it is paused
        # Bytes of the posture that the posture task follows: the quickest to compare.
        self._followed = self.target.tobytes()
        self._duration: float | None = None
        self._drive_time: float | None = None
        self._drive_end: float | None = None  # known from the next tick on

    # -- lasting requests of user and motion ----------------------------------------------------------------------

    def move_to(self, target: FloatArray, duration: float | None = None) -> None:
        """Request a posture (17,) [rad], reached within ``duration`` [s] along a spline; without one a set-point.

        The current motion ends here, even one to the same posture.
        """
        self.target, self._duration = target, duration
        self._followed = b""

    def drive(self, twist: FloatArray, duration: float | None = None) -> None:
        """Request a twist of the base (3,), vx [m/s], vy [m/s], wz [rad/s], for some time [s]; None for ever."""
        self.controller.base_velocity.target = twist
        self._drive_time, self._drive_end = duration, None

    def add(self, part: Task | Constraint) -> None:
        """Request a task, or that a constraint is kept; see :meth:`WholeBodyController.add`."""
        self.controller.add(part)

    def remove(self, part: Task | Constraint) -> None:
        """Take a request for a task or constraint back; one that is not there is no error."""
        self.controller.remove(part)

    @property
    def attentive(self) -> bool:
        """True to oscillate by a little on top of any motion, with the joints that no reflex has; may be set."""
        return self.controller.dither.enabled

    @attentive.setter
    def attentive(self, value: bool) -> None:
        self.controller.dither.enabled = value
        self.watch.reset()

    @property
    def holds(self) -> bool:
        """True while a reflex, or a pause, holds the whole robot: motions wait."""
        return self._requests.posture is not None or self._rest is not None

    # -- one tick -------------------------------------------------------------------------------------------------

    def step(self, observation: Observation | None, measurement: Measurement) -> list[ReflexEvent]:
        """Decide for one tick and set up the controller; return the changes of the reflexes."""
        events: list[ReflexEvent] = []
        if self.reflexes and observation is not None:
            tasks = self._requests.tasks
            self._requests.clear()
            events = self._ask_reflexes(observation, measurement)
            self._exchange_tasks(tasks)
            self.stiffness = self._requests.stiffness
        self._watch_drive(measurement.time)
        self._follow_posture()
        self._lead_dither(measurement)
        return events

    def _ask_reflexes(
        self, observation: Observation, measurement: Measurement
    ) -> list[ReflexEvent]:
        requests, events = self._requests, []
        for reflex in self.reflexes:
            if isinstance(reflex, Ignore):
                observation = _without(observation, reflex)
                continue
            claimed, was_active = requests.claimed, reflex.active
            reflex.step(observation, measurement, requests)
            if requests.claimed is claimed:
                held = self._no_joints
            else:
                held = requests.claimed & ~claimed
                reflex.granted_joints = reflex.granted_joints | held
            given_others = reflex.active and np.count_nonzero(held != reflex.held_joints) > 0
            if given_others:
                reflex.held_joints = held
            if given_others or reflex.active != was_active:
                events.append(self._event(reflex, was_active, measurement.time))
        return events

    def _exchange_tasks(self, before: Mapping[int, Task]) -> None:
        """Take back the reflexes' tasks of the previous tick, give the controller those of this one."""
        now = self._requests.tasks
        if not (before or now):
            return
        for task in [task for key, task in before.items() if key not in now]:
            self.controller.remove(task)
        for task in [task for key, task in now.items() if key not in before]:
            self.controller.add(task, enforce_limit=False)

    def _watch_drive(self, time: float) -> None:
        """Stop the base when the time is over for which it was to be driven."""
        if self._drive_time is None:
            return
        if self._drive_end is None:
            self._drive_end = time + self._drive_time - 0.5 * self._robot.cycle
        elif time >= self._drive_end:
            self.drive(np.zeros(3))

    def _follow_posture(self) -> None:
        """Lead the posture task to the posture of user or motion, or to the one that holds the whole robot."""
        controller, requests, task = self.controller, self._requests, self.controller.posture
        if np.count_nonzero(requests.released_in_place):
            rest = controller.stopping_position(self.posture_stiffness, dither=False)
            self.target = np.where(requests.released_in_place, rest, self.target)
        held, stiffness = requests.posture, requests.posture_stiffness
        if self.paused:
            if self._rest is None:
                self._rest = controller.stopping_position(BRAKING_STIFFNESS)
            held, stiffness = self._rest, BRAKING_STIFFNESS
        else:
            self._rest = None
        # A posture has no weight above other tasks: they must not move joints that are held.
        controller.hold = held is not None
        target = self.target if held is None else held
        # By value: a reflex may change its array in place.
        followed = np.asarray(target).tobytes()
        if followed != self._followed:
            if held is None and self._duration is not None:
                task.move_to(target, self._duration)
            else:
                task.target = target
            self._followed = followed
        elif held is None and np.count_nonzero(requests.released_to_posture) and not task.under_way:
            # A spring would jerk at first, and creep at the end, where worn gears stick and slip.
            away = (target - controller.position)[requests.released_to_posture]
            task.move_to(target, return_time(away, controller))
        stiffness = self.posture_stiffness if stiffness is None else stiffness
        if task.stiffness != stiffness:
            task.stiffness = stiffness

    def _lead_dither(self, measurement: Measurement) -> None:
        """Keep joints from oscillating: those that a reflex has, or a pause, and those that are hot or soft."""
        self.notes = []
        if self.controller.dither.active:
            self.notes = self.watch.step(measurement, self.stiffness)
            claimed = np.ones_like(self._requests.claimed) if self.holds else self._requests.claimed
            if np.count_nonzero(claimed):
                self.controller.dither.suspend(claimed)

    def _event(self, reflex: Reflex, was_active: bool, time: float) -> ReflexEvent:
        return ReflexEvent(
            reflex=reflex.full_name,
            kind=kind_of(type(reflex)),
            number=reflex.number,
            phase="end" if not reflex.active else "update" if was_active else "begin",
            time=time,
            contact_id=None if reflex.contact is None else reflex.contact.id,
            joints=self._names(reflex.joints | reflex.held_joints),
            held_joints=self._names(reflex.held_joints),
        )

    def _names(self, joints: BoolArray) -> tuple[str, ...]:
        return tuple(self._robot.joint_names[joint] for joint in np.flatnonzero(joints))


def return_time(away: FloatArray, controller: WholeBodyController) -> float:
    """Return the time for joints to come back from ``away`` [rad] by the controller's settings [s]."""
    distance = float(np.abs(away).max())
    return max(PEAK_SPEED_RATIO * distance / controller.return_speed, controller.min_return_time)


def _without(observation: Observation, ignore: Ignore) -> Observation:
    """Return it without the contacts that are ignored; one that turns out to be ignored is over for those below."""
    if not observation.contacts:
        return observation
    remaining = tuple(
        replace(contact, phase="end") if ignore.matches(contact) else contact
        for contact in observation.contacts
    )
    return replace(observation, contacts=remaining)
