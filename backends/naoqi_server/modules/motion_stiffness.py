"""Motors on and off; NAOqi 2.8 page "Stiffness control"."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from pepper_driver.backends.naoqi_server.modules.calls import blocking
from pepper_driver.backends.naoqi_server.modules.motion_calls import MotionCalls, rising
from pepper_driver.backends.naoqi_server.motion.body import CallError, lists, numbers
from pepper_driver.backends.naoqi_server.motion.curves import Bezier, Point
from pepper_driver.backends.naoqi_server.motion.tasks import Task

logger = logging.getLogger(__name__)


class StiffnessCalls(MotionCalls):
    """A part of ALMotion."""

    @blocking
    def wakeUp(self) -> bool:
        """Motors on, then to the posture Stand; waits until it is done.

        Switches all reflexes on again but diagnosis effect and smart stiffness.
        """
        return self._shared.waking.wake_up()

    @blocking
    def rest(self) -> None:
        """Stop, go to the posture of rest, then motors off; waits until it is done. Brakes hold the leg."""
        self._shared.waking.rest()

    def robotIsWakeUp(self) -> bool:
        """Whether the motors are on."""
        return self._motion.awake

    def setStiffnesses(self, names: object, stiffnesses: object) -> None:
        """Stiffnesses of joints, 0..1; does not wait. The leg's cannot be set so on Pepper."""
        where = "ALMotion::setStiffnesses"
        joints = self._motion.body.joints(names, where)
        values = _shares(numbers(stiffnesses, len(joints), where, "stiffnesses"), where)
        allowed = self._allowed(joints, where)
        with self._motion.lock:
            for joint, value in zip(joints, values, strict=True):
                if joint in allowed:
                    self._motion.joints.stiffness[joint] = value

    def getStiffnesses(self, names: object) -> list[float]:
        """Stiffnesses of joints as they were asked for."""
        joints = self._motion.body.joints(names, "ALMotion::getStiffnesses")
        with self._motion.lock:
            return [self._motion.joints.stiffness[joint] for joint in joints]

    @blocking
    def stiffnessInterpolation(self, names: object, stiffnesses: object, times: object) -> None:
        """Stiffnesses through values at times; waits until it is done."""
        where = "ALMotion::stiffnessInterpolation"
        joints = self._motion.body.joints(names, where)
        rows = lists(stiffnesses, len(joints), where, "stiffnesses")
        dates = [rising(row, where) for row in lists(times, len(joints), where, "times")]
        for row, date in zip(rows, dates, strict=True):
            if len(row) != len(date):
                raise CallError(
                    where, f"{len(row)} stiffnesses and {len(date)} times for one joint"
                )
            _shares(row, where)
        points = {
            joint: [Point(time=time, value=value) for time, value in zip(date, row, strict=True)]
            for joint, date, row in zip(joints, dates, rows, strict=True)
        }
        task = Task(
            name="stiffnessInterpolation",
            what="stiffness",
            joints=self._allowed(joints, where),
            make=lambda joint, start: Bezier(start[0], points[joint]),  # without handles: straight
        )
        with self._motion.lock:
            self._motion.joints.tasks.add(task)
        task.wait()

    def _allowed(self, joints: Sequence[int], where: str) -> frozenset[int]:
        """Those of the joints whose stiffness can be set: not the leg's. "Body" then stands for the others."""
        allowed = frozenset(joints) - self._motion.body.legs
        if not allowed:
            raise CallError(where, "the stiffness of the leg cannot be set: use wakeUp or rest")
        if len(allowed) < len(joints):
            logger.info("%s: the leg is left as it is; use wakeUp or rest", where)
        return allowed


def _shares(values: list[float], where: str) -> list[float]:
    for value in values:
        if not 0 <= value <= 1:
            raise CallError(where, f"a stiffness must be in 0 to 1: {value}")
    return values
