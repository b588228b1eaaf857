"""Angles of joints; NAOqi 2.8 page "Joint control"."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pepper_driver.backends.naoqi_server.modules.calls import blocking
from pepper_driver.backends.naoqi_server.modules.motion_calls import MotionCalls, rising
from pepper_driver.backends.naoqi_server.motion.body import CallError, lists, number, numbers
from pepper_driver.backends.naoqi_server.motion.curves import Bezier, Point, Spline
from pepper_driver.backends.naoqi_server.motion.tasks import Curve, Task

Make = Callable[[int, tuple[float, float]], Curve]


class JointCalls(MotionCalls):
    """A part of ALMotion."""

    @blocking
    def angleInterpolation(
        self, names: object, angles: object, times: object, absolute: object
    ) -> None:
        """Move joints through angles at times; waits until it is done."""
        where = "ALMotion::angleInterpolation"
        joints = self._motion.body.joints(names, where)
        rows = lists(angles, len(joints), where, "angles")
        dates = [rising(row, where) for row in lists(times, len(joints), where, "times")]
        for row, date in zip(rows, dates, strict=True):
            if len(row) != len(date):
                raise CallError(where, f"{len(row)} angles and {len(date)} times for one joint")

        def make(joint: int, start: tuple[float, float]) -> Spline:
            place = joints.index(joint)
            base = 0.0 if absolute else start[0]
            return Spline(start, dates[place], [base + angle for angle in rows[place]])

        self._run("angleInterpolation", joints, make)

    @blocking
    def angleInterpolationWithSpeed(self, names: object, angles: object, fraction: object) -> None:
        """Move each joint to an angle at a fraction of its largest speed; waits until it is done."""
        where = "ALMotion::angleInterpolationWithSpeed"
        joints = self._motion.body.joints(names, where)
        goals = numbers(angles, len(joints), where, "angles")
        share = _fraction(fraction, where)
        speed = self._motion.body.speed

        def make(joint: int, start: tuple[float, float]) -> Spline:
            goal = self._motion.body.clipped(joint, goals[joints.index(joint)])
            # The fastest moment of such a curve is half as fast again as its mean.
            time = max(1.5 * abs(goal - start[0]) / (share * speed[joint]), 0.02)
            return Spline(start, [time], [goal])

        self._run("angleInterpolationWithSpeed", joints, make)

    @blocking
    def angleInterpolationBezier(self, names: object, times: object, points: object) -> None:
        """Move joints along Bezier curves, as Choregraphe exports its timelines; waits until it is done."""
        where = "ALMotion::angleInterpolationBezier"
        joints = self._motion.body.joints(names, where)
        dates = [rising(row, where) for row in lists(times, len(joints), where, "times")]
        if not isinstance(points, list | tuple) or len(points) != len(joints):
            raise CallError(
                where, f"expected a list of control points for each of {len(joints)} joints"
            )
        rows = [_points(row, date, where) for row, date in zip(points, dates, strict=True)]
        self._run(
            "angleInterpolationBezier",
            joints,
            lambda joint, start: Bezier(start[0], rows[joints.index(joint)]),
        )

    def setAngles(self, names: object, angles: object, fraction: object) -> None:
        """Let joints go to angles at a fraction of their largest speeds; does not wait."""
        where = "ALMotion::setAngles"
        joints = self._motion.body.joints(names, where)
        goals = numbers(angles, len(joints), where, "angles")
        shares = [_fraction(s, where) for s in numbers(fraction, len(joints), where, "fractions")]
        with self._motion.lock:
            for joint, goal, share in zip(joints, goals, shares, strict=True):
                self._motion.joints.set_target(joint, goal, share)

    def changeAngles(self, names: object, changes: object, fraction: object) -> None:
        """Let joints go on by angles from where they are going; does not wait."""
        where = "ALMotion::changeAngles"
        joints = self._motion.body.joints(names, where)
        steps = numbers(changes, len(joints), where, "changes")
        share = _fraction(fraction, where)
        with self._motion.lock:
            for joint, step in zip(joints, steps, strict=True):
                goal = self._motion.joints.target(joint) + step
                self._motion.joints.set_target(joint, goal, share)

    def getAngles(self, names: object, sensors: object) -> list[float]:
        """Angles [rad] as measured, or as ALMotion commanded them last."""
        joints = self._motion.body.joints(names, "ALMotion::getAngles")
        with self._motion.lock:
            angles = self._motion.joints.sensed if sensors else self._motion.joints.command
            return [angles[joint] for joint in joints]

    @blocking
    def openHand(self, hand: object) -> None:
        """Open a hand; waits until it is done. Its motor stays on, unlike on a robot."""
        self._hand(hand, 1.0, "openHand")

    @blocking
    def closeHand(self, hand: object) -> None:
        """Close a hand; waits until it is done. Its motor stays on, unlike on a robot."""
        self._hand(hand, 0.0, "closeHand")

    def _hand(self, hand: object, aperture: float, method: str) -> None:
        where = f"ALMotion::{method}"
        joints = self._motion.body.joints(hand, where)
        if not set(joints) <= self._motion.body.hands:
            raise CallError(where, f"unknown hand: {hand} (possible: LHand, RHand)")
        self._run(method, joints, lambda _, start: Spline(start, [1.0], [aperture]))

    def _run(self, name: str, joints: Sequence[int], make: Make) -> None:
        task = Task(name=name, what="angle", joints=frozenset(joints), make=make)
        with self._motion.lock:
            self._motion.joints.tasks.add(task)
        task.wait()


def _fraction(value: object, where: str) -> float:
    share = number(value, where, "the fraction of the maximum speed")
    if not 0 < share <= 1:
        raise CallError(
            where, f"the fraction of the maximum speed must be above 0, at most 1: {share}"
        )
    return share


def _points(row: object, times: Sequence[float], where: str) -> list[Point]:
    """Control points of a joint: angles, or ``[angle, [type, time, angle], [type, time, angle]]``."""
    if not isinstance(row, list | tuple) or len(row) != len(times):
        raise CallError(
            where, f"expected {len(times)} control points for one joint, as there are times"
        )
    points = []
    for value, time in zip(row, times, strict=True):
        angle, *handles = value if isinstance(value, list | tuple) else [value]
        offsets = []
        for handle in handles:
            if not isinstance(handle, list | tuple) or len(handle) != 3:
                raise CallError(where, "a handle is [interpolation type, time, angle]")
            _, *offset = (number(part, where, "a part of a handle") for part in handle)
            offsets.append((offset[0], offset[1]))
        before, after = (*offsets, (0.0, 0.0), (0.0, 0.0))[:2]
        angle = number(angle, where, "an angle")
        points.append(Point(time=time, value=angle, before=before, after=after))
    return points
