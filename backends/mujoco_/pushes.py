"""Hands that push the simulated robot, or take hold of it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends.interface import CommandError, finite_numbers
from pepper_driver.backends.motion_profile import minimum_jerk, minimum_jerk_slope
from pepper_driver.backends.mujoco_.contact_accumulator import ContactAccumulator
from pepper_driver.backends.mujoco_.plant_model import PlantModel
from pepper_driver.backends.mujoco_.wheels import WheelDynamics
from pepper_driver.backends.pushes import ScheduledPush, check_grab
from pepper_driver.backends.simulated import Grab, Hand, Push, Resumable
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import Matrix, Out, kernel


@kernel
def place_push(
    position: FloatArray,
    rotation: Matrix[FloatArray],
    point: FloatArray,
    push: FloatArray,
    in_link: bool,
    strength: float,
    where: Out[FloatArray],
    force: Out[FloatArray],
) -> float:
    """Write place and force of a push in the world; return the size of the force [N].

    Args:
        position: (3,) of the link in the world [m].
        rotation: (3, 3) from link to world.
        point: (3,) in the link [m].
        push: (3,) [N].
        in_link: True if ``push`` is in the axes of the link.
        strength: Fraction of it that acts.
        where: (3,) [m].
        force: (3,) [N].
    """
    square = 0.0
    for i in range(3):
        row = rotation[i]
        where[i] = position[i] + (row[0] * point[0] + row[1] * point[1] + row[2] * point[2])
        force[i] = strength * push[i]
        if in_link:
            force[i] = strength * (row[0] * push[0] + row[1] * push[1] + row[2] * push[2])
        square += force[i] * force[i]
    return math.sqrt(square)


class Pushes(Resumable):
    """The pending and present pushes."""

    STATE = ("_pending",)

    def __init__(self, model: PlantModel, data: mujoco.MjData) -> None:
        self._bodies, self._data = model.bodies, data
        self._centres = centres_of_mass(model)
        self._pending: list[ScheduledPush] = []
        self._due: list[ScheduledPush] = []
        self._place = place_push.load()

    def add(self, push: Push) -> None:
        """Schedule a push; raises as :meth:`Backend.push` says."""
        self._pending.append(ScheduledPush.of(push, self._centres, self._data.time))

    def clear(self) -> None:
        """Forget all pushes."""
        self._pending.clear()

    def begin_cycle(self, now: float, end: float) -> bool:
        """Return true if any may act between ``now`` and ``end`` [s]; forget those that are over."""
        if not self._pending:
            self._due.clear()
            return False
        self._pending = [push for push in self._pending if push.end > now]
        self._due = [push for push in self._pending if push.start < end]
        return bool(self._due)

    def apply(self, accumulator: ContactAccumulator, joint_torque: FloatArray) -> None:
        """Add J^T f of all pushes to ``joint_torque`` (nv,), at the state whose kinematics MuJoCo holds."""
        data = self._data
        for push in self._due:
            strength = push.strength(data.time)
            if strength == 0.0:
                continue
            body = self._bodies[push.link]
            entry = accumulator.entry(push, "push", body)
            where, force = accumulator.place(entry)
            size = self._place(
                data.xpos[body],
                data.xmat[body].reshape(3, 3),
                push.point,
                push.force,
                push.frame == "link",
                strength,
                where,
                force,
            )
            joint_torque += accumulator.put(entry, size)


HAND_MASS = 0.4
"""[kg] of an adult's hand. The damping is critical for it, 2 sqrt(K m): 40 N s/m at 1000 N/m."""

CLOSING = 0.1
"""[s] in which a hand closes: its damping grows from none, so that it takes a moving link without a jolt."""

HAND_SPEED, HAND_ACCELERATION = 1.0, 10.0
"""[m/s], [m/s2] of a hand that a person moves without a plan, at most: a jump of the goal is no blow."""

SETTLING = 0.1
"""[s] with which such a hand comes near its goal."""

FIRM_LOAD, NO_LOAD = 0.4, 0.1
"""Load of the wheel that carries least, over the mean of all three: from the first down such a hand gets weaker, and at
the second it gives no force any more. People let go of a robot that tips."""

RECOVERY = 1.0
"""[s] in which a hand that a tipping robot made weak is strong again: at once, it would rock the robot ever further."""

LIVE_RELEASE = 0.1
"""[s] in which the force of such a hand fades."""

_MAX_DAMPING, _MAX_STIFFNESS = 0.4, 0.5
"""Largest damping h D / m and stiffness h^2 K / m on a point of mass m. A step is stable while 2 h D + h^2 K < 4 m; the
rest is kept for links that get lighter at that point as they move."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ScheduledGrab(Grab):
    """Hand that was checked.

    Attributes:
        body: Number of the link.
        start: When it closes [s].
    """

    pull: FloatArray
    point: FloatArray
    body: int
    start: float

    @property
    def end(self) -> float:
        """Time at which the hand has released it [s]."""
        return self.start + self.rise + self.hold + self.release


def centres_of_mass(model: PlantModel) -> dict[str, FloatArray]:
    """Return that of each link, in its frame [m]."""
    return {link: model.mj.body_ipos[body] for link, body in model.bodies.items()}


def first_overlap(holds: Iterable[tuple[str, float, float]]) -> tuple[str, float] | None:
    """Return the first (link, time [s]) at which two hands hold one link, or None; holds are (link, start, end).

    One may grab the link at the very moment the other has released it.
    """
    latest: dict[str, float] = {}
    for link, start, end in sorted(holds, key=lambda hold: hold[1]):
        if link in latest and start < latest[link]:
            return link, start
        latest[link] = max(end, latest.get(link, end))
    return None


@dataclass(slots=True, eq=False)
class _Grip:
    """A hand, and what it found when it closed: (3,) place and pull in the world, its spring and damper."""

    hand: ScheduledGrab
    anchor: FloatArray | None = None
    pull: FloatArray | None = None
    stiffness: float = 0.0
    damping: float = 0.0

    @property
    def end(self) -> float:
        """Time at which the hand has released the link [s]."""
        return self.hand.end

    @property
    def max_force(self) -> float:
        """Largest force that the hand may give [N]."""
        return self.hand.max_force

    def ended(self, now: float) -> bool:
        """Return True once the hand has released the link."""
        return now - self.hand.start - self.hand.rise - self.hand.hold >= self.hand.release

    def begin_cycle(self, now: float, end: float, min_load: float) -> None:
        """Nothing: its motion was planned when it was asked for."""

    def motion(self, now: float) -> tuple[float, float, float]:
        """Return the fraction of the pull completed at ``now`` [s], its rate [1/s], and that of the force left."""
        hand, since = self.hand, now - self.hand.start
        fading = since - hand.rise - hand.hold
        fraction_left = (
            0.5 + 0.5 * math.cos(math.pi * fading / hand.release) if fading > 0.0 else 1.0
        )
        if since < hand.rise:
            t = since / hand.rise
            return minimum_jerk(t), minimum_jerk_slope(t) / hand.rise, fraction_left
        return 1.0, 0.0, fraction_left


class _LiveGrip(_Grip):
    """Hand of a person who has no plan: it follows a goal, and fades when it is let go, or when no one moves it."""

    __slots__ = (
        "_begin",
        "_care",
        "_length",
        "_timeout",
        "force",
        "goal",
        "limit",
        "moved",
        "released",
        "velocity",
        "where",
    )

    def __init__(self, hand: ScheduledGrab, timeout: float) -> None:
        super().__init__(hand)
        self._timeout = timeout
        self.goal: FloatArray | None = None
        self.limit = hand.max_force
        self.moved = hand.start
        self.released: float | None = None
        self.force, self.where, self.velocity = np.zeros(3), np.zeros(3), np.zeros(3)
        self._begin, self._length, self._care = 0.0, 1.0, 1.0

    @property
    def end(self) -> float:
        """Time at which the hand has released the link [s]; without end while it is moved."""
        return math.inf if self.released is None else self.released + self.hand.release

    @property
    def max_force(self) -> float:
        """Largest force that the hand may give [N]."""
        return self._care * self.limit

    def ended(self, now: float) -> bool:
        """Return True once the hand has released the link."""
        return now >= self.end

    def begin_cycle(self, now: float, end: float, min_load: float) -> None:
        """Go on towards the goal as a hand can, from ``now`` to ``end`` [s], weaker where a wheel is about to lift."""
        care = min(max((min_load - NO_LOAD) / (FIRM_LOAD - NO_LOAD), 0.0), 1.0)
        self._care = min(care, self._care + (end - now) / RECOVERY)
        if self.released is None and now - self.moved > self._timeout:
            self.released = now
        if self.anchor is None or self.pull is None:
            return
        self._begin, self._length = now, end - now
        self.anchor = self.anchor + self.pull
        way = (self.anchor if self.goal is None else self.goal) - self.anchor
        # Slower near the goal, so that it does not stop with a jerk.
        goal_velocity = _bounded(way / SETTLING, HAND_SPEED)
        self.velocity = self.velocity + _bounded(
            goal_velocity - self.velocity, HAND_ACCELERATION * self._length
        )
        self.pull = self.velocity * self._length

    def motion(self, now: float) -> tuple[float, float, float]:
        """Return the completed fraction of this cycle's path, its rate [1/s], and the fraction of the force left."""
        fraction_left = 1.0
        if self.released is not None:
            faded = min(max(now - self.released, 0.0) / self.hand.release, 1.0)
            fraction_left = 0.5 + 0.5 * math.cos(math.pi * faded)
        return (now - self._begin) / self._length, 1.0 / self._length, fraction_left


def _bounded(vector: FloatArray, size: float) -> FloatArray:
    """Return a vector, shortened to a size."""
    length = float(np.linalg.norm(vector))
    return vector if length <= size else vector * (size / length)


class LiveHand(Hand):
    """A hand on the simulated robot."""

    def __init__(
        self, forces: GrabForces, grip: _LiveGrip, lock: AbstractContextManager[object]
    ) -> None:
        self._forces, self._grip, self._lock = forces, grip, lock

    def move(self, position: ArrayLike, *, max_force: float | None = None) -> None:
        """Set where the hand is to go, and what it can do."""
        goal = finite_numbers("hand: position", position, 3).copy()
        with self._lock:
            if max_force is not None:
                if not max_force > 0.0:
                    raise CommandError(f"hand: max_force must be above 0 N, got {max_force:g}")
                self._grip.limit = float(max_force)
            self._grip.goal, self._grip.moved = goal, self._forces.time

    def release(self) -> None:
        """Let go."""
        with self._lock:
            if self._grip.released is None:
                self._grip.released = self._forces.time

    @property
    def holds(self) -> bool:
        """True until it has let go."""
        with self._lock:
            return self._forces.has(self._grip)

    @property
    def force(self) -> FloatArray:
        """(3,) force on the robot in the last step of physics, in the world [N]."""
        with self._lock:
            return self._grip.force.copy() if self._forces.has(self._grip) else np.zeros(3)

    @property
    def point(self) -> FloatArray:
        """(3,) where it holds the link, in the world [m]."""
        with self._lock:
            return self._grip.where.copy()

    @property
    def position(self) -> FloatArray:
        """(3,) of the hand itself, in the world [m]."""
        with self._lock:
            anchor = self._grip.anchor
            return self._grip.where.copy() if anchor is None else anchor.copy()


@kernel
def move_point(
    position: FloatArray,
    rotation: Matrix[FloatArray],
    twist: FloatArray,
    centre: FloatArray,
    point: FloatArray,
    where: Out[FloatArray],
    velocity: Out[FloatArray],
) -> None:
    """Write place [m] and velocity [m/s] of a point of a link in the world.

    Args:
        position: (3,) of the link [m].
        rotation: (3, 3) from link to world.
        twist: (6,) rotation [rad/s] and translation [m/s] of the link, about ``centre``.
        centre: (3,) [m].
        point: (3,) in the link [m].
        where: (3,)
        velocity: (3,)
    """
    for i in range(3):
        row = rotation[i]
        where[i] = position[i] + (row[0] * point[0] + row[1] * point[1] + row[2] * point[2])
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        velocity[i] = twist[3 + i] + (
            twist[j] * (where[k] - centre[k]) - twist[k] * (where[j] - centre[j])
        )


@kernel
def pull_hand(
    where: FloatArray,
    velocity: FloatArray,
    anchor: FloatArray,
    pull: FloatArray,
    way: float,
    rate: float,
    stiffness: float,
    damping: float,
    max_force: float,
    fraction_left: float,
    force: Out[FloatArray],
) -> float:
    """Write the force of a hand, a spring and damper between its place and the point it holds; return its size [N].

    Args:
        where: (3,) of the point [m].
        velocity: (3,) of the point [m/s].
        anchor: (3,) where the hand has closed [m].
        pull: (3,) way that the hand goes [m].
        way: Completed fraction of it.
        rate: Its derivative [1/s].
        stiffness: [N/m]
        damping: [N s/m]
        max_force: [N]
        fraction_left: Fraction of the force that is left while the hand lets go.
        force: (3,) on the robot, in the world [N].
    """
    square = 0.0
    for i in range(3):
        force[i] = stiffness * (anchor[i] + pull[i] * way - where[i]) + damping * (
            pull[i] * rate - velocity[i]
        )
        square += force[i] * force[i]
    size = math.sqrt(square)
    if size > max_force:
        fraction_left *= max_force / size
    for i in range(3):
        force[i] *= fraction_left
    return fraction_left * size


class GrabForces(Resumable):
    """The hands still to come or holding on."""

    STATE = ("_pending",)

    def __init__(self, model: PlantModel, data: mujoco.MjData, wheels: WheelDynamics) -> None:
        self._mj, self._data, self._bodies = model.mj, data, model.bodies
        self._wheels = wheels
        self._centres = centres_of_mass(model)
        root = model.mj.body_rootid
        self._motion = {
            body: (
                data.xpos[body],
                data.xmat[body].reshape(3, 3),
                data.cvel[body],
                data.subtree_com[root[body]],
            )
            for body in model.bodies.values()
        }
        self._move_point, self._pull = move_point.load(), pull_hand.load()
        self._velocity = np.zeros(3)
        self._pending: list[_Grip] = []
        self._due: list[_Grip] = []

    def add(self, grab: Grab) -> None:
        """Schedule a hand; raises as :meth:`Backend.grab` says."""
        self._pending.append(_Grip(hand=self._schedule(grab)))

    def take(self, grab: Grab, timeout: float, lock: AbstractContextManager[object]) -> LiveHand:
        """Close a hand that is moved later; raises as :meth:`Backend.take_hand` says."""
        if not 0.0 < timeout < math.inf:
            raise CommandError(f"hand: timeout must be above 0 s and finite, got {timeout:g}")
        grip = _LiveGrip(self._schedule(grab, live=True), float(timeout))
        grip.where = self._place(grip.hand)  # to be moved from, before the first step
        self._pending.append(grip)
        return LiveHand(self, grip, lock)

    def _schedule(self, grab: Grab, *, live: bool = False) -> ScheduledGrab:
        """Check a hand, and date it."""
        check_grab(grab, self._centres)
        point = self._centres[grab.link] if grab.point is None else grab.point
        hand = ScheduledGrab(
            link=grab.link,
            pull=np.array(grab.pull, dtype=np.float64),
            point=np.array(point, dtype=np.float64),
            stiffness=float(grab.stiffness),
            rise=float(grab.rise),
            hold=float(grab.hold),
            release=float(grab.release),
            max_force=float(grab.max_force),
            frame=grab.frame,
            delay=float(grab.delay),
            body=self._bodies[grab.link],
            start=self._data.time + grab.delay,
        )
        holds = [(g.hand.link, g.hand.start, g.end) for g in self._pending]
        end = math.inf if live else hand.end
        clash = first_overlap([*holds, (hand.link, hand.start, end)])
        if clash is not None:
            raise CommandError(
                f"grab: a hand already holds {hand.link} at {clash[1]:.3f} s: "
                "wait until it has released it, or use another link"
            )
        x, y, z = hand.point.tolist()
        stiffest = self._stiffest(hand)
        if hand.stiffness > stiffest:
            raise CommandError(
                f"grab: {hand.link} is too light at ({x:g}, {y:g}, {z:g}) for a hand of {hand.stiffness:g} N/m "
                f"(at most {stiffest:.0f}): take a point nearer to the link, or a softer hand"
            )
        return hand

    @property
    def time(self) -> float:
        """Clock of the simulation [s]."""
        return float(self._data.time)

    def has(self, grip: _Grip) -> bool:
        """Return True while a hand holds on, or is still to come."""
        return any(one is grip and not one.ended(self.time) for one in self._pending)

    def restore(self, saved: dict[str, Any]) -> None:
        """Return to a state of :meth:`save`, without the hands that a person moved then: no one moves them now."""
        super().restore(saved)
        self._pending = [grip for grip in self._pending if not isinstance(grip, _LiveGrip)]

    def clear(self) -> None:
        """Forget all hands."""
        self._pending.clear()

    def begin_cycle(self, now: float, end: float) -> bool:
        """Return true if any may act between ``now`` and ``end`` [s]; remove those that have ended."""
        if not self._pending:
            self._due.clear()
            return False
        self._pending = [grip for grip in self._pending if grip.end > now]
        self._due = [grip for grip in self._pending if grip.hand.start < end]
        for grip in self._due:
            grip.begin_cycle(now, end, self._wheels.min_load)
        return bool(self._due)

    def apply(self, accumulator: ContactAccumulator, joint_torque: FloatArray) -> None:
        """Add J^T f of all hands to ``joint_torque`` (nv,), at the state whose kinematics MuJoCo holds."""
        now = self._data.time
        for grip in self._due:
            hand = grip.hand
            since = now - hand.start
            if since < 0.0 or grip.ended(now):
                continue
            entry = accumulator.entry(grip, "hand", hand.body)
            where, force = accumulator.place(entry)
            velocity = self._velocity
            self._move_point(*self._motion[hand.body], hand.point, where, velocity)
            if grip.anchor is None or grip.pull is None:
                grip.anchor, grip.pull = where.copy(), self._close(grip, where)
            damping = grip.damping
            if since < CLOSING:
                damping *= since / CLOSING
            way, rate, fraction_left = grip.motion(now)
            size = self._pull(
                where,
                velocity,
                grip.anchor,
                grip.pull,
                way,
                rate,
                grip.stiffness,
                damping,
                grip.max_force,
                fraction_left,
                force,
            )
            if isinstance(grip, _LiveGrip):
                grip.force, grip.where = force.copy(), where.copy()
            joint_torque += accumulator.put(entry, size)

    def _close(self, grip: _Grip, where: FloatArray) -> FloatArray:
        """Set spring and damper of a hand that closes at ``where`` (3,) in the world; return its pull there."""
        hand, step = grip.hand, float(self._mj.opt.timestep)
        mass = self._lightest(hand.body, where)
        grip.stiffness = min(hand.stiffness, _MAX_STIFFNESS * mass / step**2)
        critical = 2.0 * math.sqrt(hand.stiffness * HAND_MASS)
        grip.damping = min(critical, _MAX_DAMPING * mass / step)
        if hand.frame == "link":
            pull: FloatArray = self._data.xmat[hand.body].reshape(3, 3) @ hand.pull
            return pull
        return hand.pull

    def _stiffest(self, hand: ScheduledGrab) -> float:
        """Stiffness [N/m] that a step of physics can follow where the hand would hold, in the posture of now."""
        mj, data = self._mj, self._data
        mujoco.mj_kinematics(mj, data)
        mujoco.mj_comPos(mj, data)
        mujoco.mj_makeM(mj, data)
        mujoco.mj_factorM(mj, data)
        mass = self._lightest(hand.body, self._place(hand))
        return _MAX_STIFFNESS * mass / float(mj.opt.timestep) ** 2

    def _place(self, hand: ScheduledGrab) -> FloatArray:
        """(3,) where a hand holds, in the world [m], by the kinematics that MuJoCo holds."""
        rotation = self._data.xmat[hand.body].reshape(3, 3)
        place: FloatArray = self._data.xpos[hand.body] + rotation @ hand.point
        return place

    def _lightest(self, body: int, where: FloatArray) -> float:
        """Mass [kg] of a body at a point of the world in its lightest direction: 1 / max eig(J M^-1 J^T)."""
        jacobian, response = np.zeros((3, self._mj.nv)), np.zeros((3, self._mj.nv))
        mujoco.mj_jac(self._mj, self._data, jacobian, None, where, body)
        mujoco.mj_solveM(self._mj, self._data, response, jacobian)
        lightness = float(np.linalg.eigvalsh(jacobian @ response.T)[-1])
        return 1.0 / max(lightness, 1e-9)
