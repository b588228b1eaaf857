"""Hands that push the simulated robot, or take hold of it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from pepper_driver.backends.interface import CommandError
from pepper_driver.backends.motion_profile import minimum_jerk, minimum_jerk_slope
from pepper_driver.backends.mujoco_.contact_accumulator import ContactAccumulator
from pepper_driver.backends.mujoco_.plant_model import PlantModel
from pepper_driver.backends.pushes import ScheduledPush, check_grab
from pepper_driver.backends.simulated import Grab, Push, Resumable
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

_LARGEST_DAMPING, _LARGEST_STIFFNESS = 0.4, 0.5
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
    share: float,
    force: Out[FloatArray],
) -> float:
    """Write the force of a hand, a spring and damper between its place and the point it holds; return its size [N].

    Args:
        where: (3,) of the point [m].
        velocity: (3,) of the point [m/s].
        anchor: (3,) where the hand has closed [m].
        pull: (3,) way that the hand goes [m].
        way: Fraction of it that is gone.
        rate: Its derivative [1/s].
        stiffness: [N/m]
        damping: [N s/m]
        max_force: [N]
        share: Fraction of the force that is left while the hand lets go.
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
        share *= max_force / size
    for i in range(3):
        force[i] *= share
    return share * size


class GrabForces(Resumable):
    """The hands still to come or holding on."""

    STATE = ("_pending",)

    def __init__(self, model: PlantModel, data: mujoco.MjData) -> None:
        self._mj, self._data, self._bodies = model.mj, data, model.bodies
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
        holds = [(g.hand.link, g.hand.start, g.hand.end) for g in self._pending]
        clash = first_overlap([*holds, (hand.link, hand.start, hand.end)])
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
        self._pending.append(_Grip(hand=hand))

    def clear(self) -> None:
        """Forget all hands."""
        self._pending.clear()

    def begin_cycle(self, now: float, end: float) -> bool:
        """Return true if any may act between ``now`` and ``end`` [s]; remove those that have ended."""
        if not self._pending:
            self._due.clear()
            return False
        self._pending = [grip for grip in self._pending if grip.hand.end > now]
        self._due = [grip for grip in self._pending if grip.hand.start < end]
        return bool(self._due)

    def apply(self, accumulator: ContactAccumulator, joint_torque: FloatArray) -> None:
        """Add J^T f of all hands to ``joint_torque`` (nv,), at the state whose kinematics MuJoCo holds."""
        now = self._data.time
        for grip in self._due:
            hand = grip.hand
            since = now - hand.start
            gone = since - hand.rise - hand.hold
            if since < 0.0 or gone >= hand.release:
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
            way, rate, share = 1.0, 0.0, 1.0
            if since < hand.rise:
                t = since / hand.rise
                way, rate = minimum_jerk(t), minimum_jerk_slope(t) / hand.rise
            if gone > 0.0:
                share = 0.5 + 0.5 * math.cos(math.pi * gone / hand.release)
            size = self._pull(
                where,
                velocity,
                grip.anchor,
                grip.pull,
                way,
                rate,
                grip.stiffness,
                damping,
                hand.max_force,
                share,
                force,
            )
            joint_torque += accumulator.put(entry, size)

    def _close(self, grip: _Grip, where: FloatArray) -> FloatArray:
        """Set spring and damper of a hand that closes at ``where`` (3,) in the world; return its pull there."""
        hand, step = grip.hand, float(self._mj.opt.timestep)
        mass = self._lightest(hand.body, where)
        grip.stiffness = min(hand.stiffness, _LARGEST_STIFFNESS * mass / step**2)
        critical = 2.0 * math.sqrt(hand.stiffness * HAND_MASS)
        grip.damping = min(critical, _LARGEST_DAMPING * mass / step)
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
        where = data.xpos[hand.body] + data.xmat[hand.body].reshape(3, 3) @ hand.point
        return _LARGEST_STIFFNESS * self._lightest(hand.body, where) / float(mj.opt.timestep) ** 2

    def _lightest(self, body: int, where: FloatArray) -> float:
        """Mass [kg] of a body at a point of the world in its lightest direction: 1 / max eig(J M^-1 J^T)."""
        jacobian, response = np.zeros((3, self._mj.nv)), np.zeros((3, self._mj.nv))
        mujoco.mj_jac(self._mj, self._data, jacobian, None, where, body)
        mujoco.mj_solveM(self._mj, self._data, response, jacobian)
        lightness = float(np.linalg.eigvalsh(jacobian @ response.T)[-1])
        return 1.0 / max(lightness, 1e-9)
