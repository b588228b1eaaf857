"""Hands that push the simulated robot, or take hold of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import cos, pi, sqrt
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends.commands import check_grab
from pepper_driver.backends.interface import CommandError
from pepper_driver.backends.motion_profile import minimum_jerk, minimum_jerk_slope
from pepper_driver.backends.mujoco_.plant_model import PlantModel
from pepper_driver.backends.mujoco_.tally import Point, Tally
from pepper_driver.backends.pushes import ScheduledPush, schedule_push
from pepper_driver.backends.simulated import Resumable
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import check_name


class Pushes(Resumable):
    """The pushes still to come or under way."""

    STATE = ("_pending",)

    def __init__(self, model: PlantModel, data: mujoco.MjData) -> None:
        self._bodies, self._data = model.bodies, data
        self._pending: list[ScheduledPush] = []
        self._due: list[ScheduledPush] = []

    def add(self, push: ScheduledPush) -> None:
        """Schedule a push."""
        self._pending.append(push)

    def clear(self) -> None:
        """Forget all pushes."""
        self._pending.clear()

    def begin_cycle(self, now: float, end: float) -> bool:
        """Whether any may act between ``now`` and ``end`` [s]; forgets those that are over."""
        if not self._pending:
            self._due.clear()
            return False
        self._pending = [push for push in self._pending if push.end > now]
        self._due = [push for push in self._pending if push.start < end]
        return bool(self._due)

    def apply(self, tally: Tally, joint_torque: FloatArray) -> None:
        """Add J^T f of all pushes to ``joint_torque`` (nv,), at the state whose kinematics MuJoCo holds."""
        data = self._data
        for push in self._due:
            strength = push.strength(data.time)
            if strength == 0.0:
                continue
            body = self._bodies[push.link]
            rotation = data.xmat[body].reshape(3, 3)
            force = strength * push.force
            if push.turns_with_link:
                force = rotation @ force
            px, py, pz = (data.xpos[body] + rotation @ push.point).tolist()
            x, y, z = force.tolist()
            joint_torque += tally.put(
                tally.entry(push, "push", body),
                (px, py, pz),
                (x, y, z),
                sqrt(x * x + y * y + z * z),
            )


HAND_MASS = 0.4
"""[kg] of an adult's hand. The damping is critical for it, 2 sqrt(K m): 40 N s/m at 1000 N/m."""

CLOSING = 0.1
"""[s] in which a hand closes: its damping grows from none, so that it takes a moving link without a jolt."""

_LARGEST_DAMPING, _LARGEST_STIFFNESS = 0.4, 0.5
"""Largest damping h D / m and stiffness h^2 K / m on a point of mass m. A step is stable while 2 h D + h^2 K < 4 m; the
rest is kept for links that get lighter at that point as they move."""


@dataclass(frozen=True, kw_only=True)
class Hand:
    """One hand on a link.

    Attributes:
        body, link: Number and name of the link.
        pull: (3,) way of the hand [m], in world axes or those of the link when it closes (``in_link_axes``).
        point: (3,) where it holds, in the link's frame [m].
        stiffness: [N/m].
        start: When it closes [s].
        rise, hold, release: Times to move, to stay and to let go [s].
        largest_force: [N].
    """

    body: int
    link: str
    pull: FloatArray
    point: FloatArray
    in_link_axes: bool
    stiffness: float
    start: float
    rise: float
    hold: float
    release: float
    largest_force: float

    @property
    def end(self) -> float:
        """When it has let go [s]."""
        return self.start + self.rise + self.hold + self.release


def first_overlap(holds: Iterable[tuple[str, float, float]]) -> tuple[str, float] | None:
    """The first (link, time [s]) at which two hands hold one link, None if there is none; holds are (link, start, end).

    One may take the link at the very moment the other has let go.
    """
    latest: dict[str, float] = {}
    for link, start, end in sorted(holds, key=lambda hold: hold[1]):
        if link in latest and start < latest[link]:
            return link, start
        latest[link] = max(end, latest.get(link, end))
    return None


@dataclass(slots=True, eq=False)
class _Grip:
    """A hand, and what it found when it closed; plain numbers, for the step."""

    hand: Hand
    point: Point
    anchor: Point | None = None
    pull: Point = (0.0, 0.0, 0.0)
    stiffness: float = 0.0
    damping: float = 0.0


class Hands(Resumable):
    """The hands still to come or holding on."""

    STATE = ("_pending",)

    def __init__(self, model: PlantModel, data: mujoco.MjData) -> None:
        self._mj, self._data = model.mj, data
        root = model.mj.body_rootid
        self._motion = {
            body: (data.xpos[body], data.xmat[body], data.cvel[body], data.subtree_com[root[body]])
            for body in model.bodies.values()
        }
        self._pending: list[_Grip] = []
        self._due: list[_Grip] = []

    def add(self, hand: Hand) -> None:
        """Schedule a hand.

        Raises:
            CommandError: Another one holds the link at that time, or the point is too light for this stiffness.
        """
        holds = [(g.hand.link, g.hand.start, g.hand.end) for g in self._pending]
        clash = first_overlap([*holds, (hand.link, hand.start, hand.end)])
        if clash is not None:
            raise CommandError(
                f"grab: a hand already holds {hand.link} at {clash[1]:.3f} s: "
                "wait until it has let go, or take another link"
            )
        x, y, z = hand.point.tolist()
        stiffest = self._stiffest(hand)
        if hand.stiffness > stiffest:
            raise CommandError(
                f"grab: {hand.link} is too light at ({x:g}, {y:g}, {z:g}) for a hand of {hand.stiffness:g} N/m "
                f"(at most {stiffest:.0f}): take a point nearer to the link, or a softer hand"
            )
        self._pending.append(_Grip(hand=hand, point=(x, y, z)))

    def clear(self) -> None:
        """Forget all hands."""
        self._pending.clear()

    def begin_cycle(self, now: float, end: float) -> bool:
        """Whether any may act between ``now`` and ``end`` [s]; forgets those that have let go."""
        if not self._pending:
            self._due.clear()
            return False
        self._pending = [grip for grip in self._pending if grip.hand.end > now]
        self._due = [grip for grip in self._pending if grip.hand.start < end]
        return bool(self._due)

    def apply(self, tally: Tally, joint_torque: FloatArray) -> None:
        """Add J^T f of all hands to ``joint_torque`` (nv,), at the state whose kinematics MuJoCo holds."""
        now = self._data.time
        for grip in self._due:
            hand = grip.hand
            since = now - hand.start
            gone = since - hand.rise - hand.hold
            if since < 0.0 or gone >= hand.release:
                continue
            entry = tally.entry(grip, "hand", hand.body)
            # Where the point is: origin of the link and its rotation; how it moves: twist about the tree's centre.
            origin, rotation, twist, centre = self._motion[hand.body]
            x, y, z = grip.point
            px, py, pz = origin.tolist()
            a, b, c, d, e, f, g, h, i = rotation.tolist()
            px += a * x + b * y + c * z
            py += d * x + e * y + f * z
            pz += g * x + h * y + i * z
            rx, ry, rz, vx, vy, vz = twist.tolist()
            x, y, z = centre.tolist()
            x, y, z = px - x, py - y, pz - z
            vx += ry * z - rz * y
            vy += rz * x - rx * z
            vz += rx * y - ry * x
            where = (px, py, pz)
            ax, ay, az = grip.anchor or self._close(grip, where)
            wx, wy, wz = grip.pull
            stiffness, damping = grip.stiffness, grip.damping
            if since < CLOSING:
                damping *= since / CLOSING
            way, rate = 1.0, 0.0
            if since < hand.rise:
                t = since / hand.rise
                way, rate = minimum_jerk(t), minimum_jerk_slope(t) / hand.rise
            fx = stiffness * (ax + wx * way - px) + damping * (wx * rate - vx)
            fy = stiffness * (ay + wy * way - py) + damping * (wy * rate - vy)
            fz = stiffness * (az + wz * way - pz) + damping * (wz * rate - vz)
            size, share = sqrt(fx * fx + fy * fy + fz * fz), 1.0
            if size > hand.largest_force:
                share = hand.largest_force / size
            if gone > 0.0:
                share *= 0.5 + 0.5 * cos(pi * gone / hand.release)
            force = (share * fx, share * fy, share * fz)
            joint_torque += tally.put(entry, where, force, share * size)

    def _close(self, grip: _Grip, where: Point) -> Point:
        """The hand closes at ``where`` in the world: there it stays from now on, but for its own pull."""
        hand, step = grip.hand, float(self._mj.opt.timestep)
        pull = hand.pull
        if hand.in_link_axes:
            pull = self._data.xmat[hand.body].reshape(3, 3) @ pull
        x, y, z = pull.tolist()
        grip.anchor, grip.pull = where, (x, y, z)
        mass = self._lightest(hand.body, np.array(where))
        grip.stiffness = min(hand.stiffness, _LARGEST_STIFFNESS * mass / step**2)
        grip.damping = min(2.0 * sqrt(hand.stiffness * HAND_MASS), _LARGEST_DAMPING * mass / step)
        return where

    def _stiffest(self, hand: Hand) -> float:
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


def planned_push(
    model: PlantModel,
    data: mujoco.MjData,
    link: str,
    force: ArrayLike,
    point: ArrayLike | None,
    duration: float,
    frame: Literal["world", "link"],
    delay: float,
    rise: float,
) -> ScheduledPush:
    """The push that :meth:`Backend.push` was asked for; raises as it says."""
    check_name("link", link, model.bodies)
    return schedule_push(
        link,
        force,
        model.mj.body_ipos[model.bodies[link]] if point is None else point,
        links=model.bodies,
        now=data.time,
        duration=duration,
        frame=frame,
        delay=delay,
        rise=rise,
    )


def planned_hand(
    model: PlantModel,
    data: mujoco.MjData,
    link: str,
    pull: ArrayLike,
    point: ArrayLike | None,
    *,
    stiffness: float,
    rise: float,
    hold: float,
    release: float,
    largest_force: float,
    frame: Literal["world", "link"],
    delay: float,
) -> Hand:
    """The hand that :meth:`Backend.grab` was asked for; raises as it says."""
    check_grab(
        model.bodies,
        link,
        pull=pull,
        point=point,
        stiffness=stiffness,
        rise=rise,
        hold=hold,
        release=release,
        largest_force=largest_force,
        frame=frame,
        delay=delay,
    )
    body = model.bodies[link]
    return Hand(
        body=body,
        link=link,
        pull=_vector(pull),
        point=_vector(model.mj.body_ipos[body] if point is None else point),
        in_link_axes=frame == "link",
        stiffness=float(stiffness),
        start=data.time + delay,
        rise=float(rise),
        hold=float(hold),
        release=float(release),
        largest_force=float(largest_force),
    )


def _vector(value: ArrayLike) -> FloatArray:
    return np.array(value, dtype=np.float64)
