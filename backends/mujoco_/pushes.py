"""Hands that push the simulated robot, or take hold of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import cos, pi, sqrt

import mujoco
import numpy as np

from pepper_driver.backends.interface import CommandError
from pepper_driver.backends.motion_profile import minimum_jerk, minimum_jerk_slope
from pepper_driver.backends.mujoco_.contact_accumulator import ContactAccumulator, Point
from pepper_driver.backends.mujoco_.plant_model import PlantModel
from pepper_driver.backends.pushes import ScheduledPush, check_grab
from pepper_driver.backends.simulated import Grab, Push, Resumable
from pepper_driver.config.arrays import FloatArray


class Pushes(Resumable):
    """The pending and present pushes."""

    STATE = ("_pending",)

    def __init__(self, model: PlantModel, data: mujoco.MjData) -> None:
        self._bodies, self._data = model.bodies, data
        self._centres = centres_of_mass(model)
        self._pending: list[ScheduledPush] = []
        self._due: list[ScheduledPush] = []

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
            rotation = data.xmat[body].reshape(3, 3)
            force = strength * push.force
            if push.frame == "link":
                force = rotation @ force
            px, py, pz = (data.xpos[body] + rotation @ push.point).tolist()
            x, y, z = force.tolist()
            joint_torque += accumulator.put(
                accumulator.entry(push, "push", body),
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
    """A hand, and what it found when it closed; plain numbers, for the step."""

    hand: ScheduledGrab
    point: Point
    anchor: Point | None = None
    pull: Point = (0.0, 0.0, 0.0)
    stiffness: float = 0.0
    damping: float = 0.0


class GrabForces(Resumable):
    """The hands still to come or holding on."""

    STATE = ("_pending",)

    def __init__(self, model: PlantModel, data: mujoco.MjData) -> None:
        self._mj, self._data, self._bodies = model.mj, data, model.bodies
        self._centres = centres_of_mass(model)
        root = model.mj.body_rootid
        self._motion = {
            body: (data.xpos[body], data.xmat[body], data.cvel[body], data.subtree_com[root[body]])
            for body in model.bodies.values()
        }
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
        self._pending.append(_Grip(hand=hand, point=(x, y, z)))

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
            if size > hand.max_force:
                share = hand.max_force / size
            if gone > 0.0:
                share *= 0.5 + 0.5 * cos(pi * gone / hand.release)
            force = (share * fx, share * fy, share * fz)
            joint_torque += accumulator.put(entry, where, force, share * size)

    def _close(self, grip: _Grip, where: Point) -> Point:
        """Return the hand closes at ``where`` in the world: there it stays from now on, but for its own pull."""
        hand, step = grip.hand, float(self._mj.opt.timestep)
        pull = hand.pull
        if hand.frame == "link":
            pull = self._data.xmat[hand.body].reshape(3, 3) @ pull
        x, y, z = pull.tolist()
        grip.anchor, grip.pull = where, (x, y, z)
        mass = self._lightest(hand.body, np.array(where))
        grip.stiffness = min(hand.stiffness, _LARGEST_STIFFNESS * mass / step**2)
        grip.damping = min(2.0 * sqrt(hand.stiffness * HAND_MASS), _LARGEST_DAMPING * mass / step)
        return where

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
