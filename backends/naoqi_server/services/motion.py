"""ALMotion: joints, stiffness, limits, positions, tasks.

Angles of joints; NAOqi 2.8 page "Joint control".

Motors on and off; NAOqi 2.8 page "Stiffness control".

Names, limits, tasks, positions of parts; NAOqi 2.8 pages "General tools", "Motion task", "Cartesian control".
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from pepper_driver.backends.naoqi_server.almotion.curves import Bezier, Point, Spline
from pepper_driver.backends.naoqi_server.almotion.joints import AlmotionTask, Curve
from pepper_driver.backends.naoqi_server.almotion.kinematics import (
    CallError,
    Kinematics,
    lists,
    number,
    numbers,
    position6,
)
from pepper_driver.backends.naoqi_server.services.calls import blocking
from pepper_driver.backends.naoqi_server.services.context import Context, MotionCalls, rising
from pepper_driver.backends.naoqi_server.services.motion_base import BaseCalls, ReflexCalls
from pepper_driver.config.arrays import FloatArray

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
        fraction = _fraction(fraction, where)
        speed = self._motion.body.speed

        def make(joint: int, start: tuple[float, float]) -> Spline:
            goal = self._motion.body.clipped(joint, goals[joints.index(joint)])
            # The fastest moment of such a curve is half as fast again as its mean.
            time = max(1.5 * abs(goal - start[0]) / (fraction * speed[joint]), 0.02)
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
        """Move joints to angles at a fraction of their largest speeds; do not wait."""
        where = "ALMotion::setAngles"
        joints = self._motion.body.joints(names, where)
        goals = numbers(angles, len(joints), where, "angles")
        fractions = [
            _fraction(s, where) for s in numbers(fraction, len(joints), where, "fractions")
        ]
        with self._motion.lock:
            for joint, goal, fraction in zip(joints, goals, fractions, strict=True):
                self._motion.joints.set_target(joint, goal, fraction)

    def changeAngles(self, names: object, changes: object, fraction: object) -> None:
        """Change the targets of joints by angles; do not wait."""
        where = "ALMotion::changeAngles"
        joints = self._motion.body.joints(names, where)
        steps = numbers(changes, len(joints), where, "changes")
        fraction = _fraction(fraction, where)
        with self._motion.lock:
            for joint, step in zip(joints, steps, strict=True):
                goal = self._motion.joints.target(joint) + step
                self._motion.joints.set_target(joint, goal, fraction)

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
        task = AlmotionTask(name=name, what="angle", joints=frozenset(joints), make=make)
        with self._motion.lock:
            self._motion.joints.tasks.add(task)
        # Without the lock, which the writer needs to move the joints.
        task.wait(self._clock)


def _fraction(value: object, where: str) -> float:
    fraction = number(value, where, "the fraction of the maximum speed")
    if not 0 < fraction <= 1:
        raise CallError(
            where, f"the fraction of the maximum speed must be above 0, at most 1: {fraction}"
        )
    return fraction


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
        # A handle that is not given has no length: without both, the segment is straight.
        before, after = (*offsets, (0.0, 0.0), (0.0, 0.0))[:2]
        angle = number(angle, where, "an angle")
        points.append(Point(time=time, value=angle, before=before, after=after))
    return points


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
        """Stop, move to the posture of rest, then motors off; wait until it is done. Brakes hold the leg."""
        self._shared.waking.rest()

    def robotIsWakeUp(self) -> bool:
        """Return true if the motors are on."""
        return self._motion.awake

    def setStiffnesses(self, names: object, stiffnesses: object) -> None:
        """Stiffnesses of joints, 0..1; does not wait. The leg's cannot be set so on Pepper."""
        where = "ALMotion::setStiffnesses"
        joints = self._motion.body.joints(names, where)
        values = _stiffnesses(numbers(stiffnesses, len(joints), where, "stiffnesses"), where)
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
            _stiffnesses(row, where)
        points = {
            joint: [Point(time=time, value=value) for time, value in zip(date, row, strict=True)]
            for joint, date, row in zip(joints, dates, rows, strict=True)
        }
        task = AlmotionTask(
            name="stiffnessInterpolation",
            what="stiffness",
            joints=self._allowed(joints, where),
            make=lambda joint, start: Bezier(start[0], points[joint]),  # without handles: straight
        )
        with self._motion.lock:
            self._motion.joints.tasks.add(task)
        # Without the lock, which the writer needs to change the stiffness.
        task.wait(self._clock)

    def _allowed(self, joints: Sequence[int], where: str) -> frozenset[int]:
        """Return the joints whose stiffness can be set: not the leg's. "Body" then stands for the others."""
        allowed = frozenset(joints) - self._motion.body.legs
        if not allowed:
            raise CallError(where, "the stiffness of the leg cannot be set: use wakeUp or rest")
        if len(allowed) < len(joints):
            logger.info("%s: the leg is left as it is; use wakeUp or rest", where)
        return allowed


def _stiffnesses(values: list[float], where: str) -> list[float]:
    for value in values:
        if not 0 <= value <= 1:
            raise CallError(where, f"a stiffness must be in 0 to 1: {value}")
    return values


EVENT_CYCLES = 5
"""Cycles from one update of the velocities and torques in ALMemory to the next."""


class ToolCalls(MotionCalls):
    """A part of ALMotion."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._kinematics = Kinematics(context.config, context.shared.settings)
        names, config = context.config.naoqi, context.config
        self._currents = [
            context.robot.keys[names.prefix + names.current.format(joint=joint)]
            for joint in config.joint_names
        ]
        self._torque_per_ampere = [
            config.motors.joint_torque_constant(joint) for joint in config.joint_names
        ]
        self._cycles = 0
        self._motion.on_cycle.append(self._notify)

    def getBodyNames(self, name: object) -> list[str]:
        """Names of the joints in a group or chain, or of all "Chains"."""
        return self._motion.body.names(name, "ALMotion::getBodyNames")

    def getJointNames(self, name: object) -> list[str]:
        """As ``getBodyNames``."""
        return self._motion.body.names(name, "ALMotion::getJointNames")

    def getSensorNames(self) -> list[str]:
        """Names of the sensors."""
        sensors = self._context.config.sensors
        bumpers = [f"Bumper/{name}" for name in sensors.bumpers]
        return [
            *sensors.touch,
            *bumpers,
            *sensors.buttons,
            "CameraTop",
            "CameraBottom",
            "CameraDepth",
        ]

    def getLimits(self, names: object) -> list[list[float]]:
        """Return for each joint the smallest and largest angle [rad], largest speed [rad/s] and torque [N m]."""
        body = self._motion.body
        joints = body.joints(names, "ALMotion::getLimits")
        return [[body.lower[j], body.upper[j], body.speed[j], body.torque[j]] for j in joints]

    def getMotionCycleTime(self) -> int:
        """[ms] of a cycle of ALMotion."""
        return round(1000 * self._shared.settings.cycle)

    def getSummary(self) -> str:
        """Return a human-readable table of stiffnesses, commands and sensors."""
        with self._motion.lock:
            joints = self._motion.joints
            rows = [
                f"{self._motion.body.name(j):>16}{joints.stiffness[j]:12.6f}"
                f"{joints.command[j]:12.6f}{joints.sensed[j]:12.6f}"
                for j in self._motion.body.groups["Body"]
            ]
        head = f"{'JointName':>16}{'Stiffness':>12}{'Command':>12}{'Sensor':>12}"
        return "\n".join(["---------------------- Model ---------------------------", head, *rows])

    def getRobotConfig(self) -> list[list[object]]:
        """Names and values of what the robot has."""
        values = {
            "Model Type": self._memory.get("RobotConfig/Body/Type"),
            "Head Version": self._memory.get("RobotConfig/Head/BaseVersion"),
            "Body Version": self._memory.get("RobotConfig/Body/BaseVersion"),
            "Arm Version": self._memory.get("RobotConfig/Body/BaseVersion"),
            "Laser": True,
            "Extended Arms": True,
            "Number of Legs": 0,
            "Number of Arms": 2,
            "Number of Hands": 2,
        }
        return [list(values), list(values.values())]

    def getTaskList(self) -> list[list[object]]:
        """``[name, number]`` of each motion that a blocking call asked for."""
        with self._motion.lock:
            return [[task.name, task.number] for task in self._motion.joints.tasks]

    def areResourcesAvailable(self, names: object) -> bool:
        """Return true if no task has any of the joints."""
        joints = self._motion.body.joints(names, "ALMotion::areResourcesAvailable")
        with self._motion.lock:
            return not self._motion.joints.tasks.of(set(joints))

    def killTask(self, number: int) -> bool:
        """End a task; whether there was one of this number."""
        with self._motion.lock:
            tasks = [task for task in self._motion.joints.tasks if task.number == number]
            self._motion.joints.kill(tasks)
        return bool(tasks)

    def killTasksUsingResources(self, names: object) -> None:
        """End all tasks that have, or wait for, any of the joints."""
        joints = self._motion.body.joints(names, "ALMotion::killTasksUsingResources")
        with self._motion.lock:
            tasks: list[AlmotionTask] = self._motion.joints.tasks.of(set(joints))
            self._motion.joints.kill(tasks)

    def killAll(self) -> None:
        """End all tasks, and stop the base."""
        with self._motion.lock:
            self._motion.joints.kill(self._motion.joints.tasks)
            self._motion.base.stop()

    def getPosition(self, name: object, frame: object, sensors: object) -> list[float]:
        """x, y, z [m], wx, wy, wz [rad] of a part in the frame of torso 0, world 1 or robot 2."""
        return position6(self._pose(name, frame, sensors, "ALMotion::getPosition"))

    def getTransform(self, name: object, frame: object, sensors: object) -> list[float]:
        """Return the same as a matrix: 16 numbers, line by line."""
        pose = self._pose(name, frame, sensors, "ALMotion::getTransform")
        numbers: list[float] = pose.ravel().tolist()
        return numbers

    def _pose(self, name: object, frame: object, sensors: object, where: str) -> FloatArray:
        with self._motion.lock:
            joints, base = self._motion.joints, self._motion.base
            angles = list(joints.sensed if sensors else joints.command)
            pose = base.pose if sensors else base.commanded
        return self._kinematics.pose(name, frame, angles, pose, where)

    def _notify(self) -> None:
        """Velocities and torques of the joints into ALMemory; hands have none there."""
        self._cycles += 1
        if self._cycles % EVENT_CYCLES:
            return
        values = self._context.robot.values()
        body = self._motion.body
        for joint in body.groups["Joints"]:
            name = body.name(joint)
            velocity = self._motion.joints.sensed_velocity[joint]
            # The measured current is absolute, so this torque has no sign.
            torque = values[self._currents[joint]] * self._torque_per_ampere[joint]
            self._memory.insert(f"Motion/Velocity/Sensor/{name}", velocity)
            self._memory.insert(f"Motion/Torque/Sensor/{name}", torque)


class MotionService(JointCalls, StiffnessCalls, BaseCalls, ReflexCalls, ToolCalls):
    """Moves the robot, 50 times a second. Its parts are the chapters of NAOqi's documentation."""
