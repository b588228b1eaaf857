"""Names, limits, tasks, positions of parts; NAOqi 2.8 pages "General tools", "Motion task", "Cartesian control"."""

from __future__ import annotations

from pepper_driver.backends.naoqi_server.context import Context
from pepper_driver.backends.naoqi_server.modules.motion_calls import MotionCalls
from pepper_driver.backends.naoqi_server.motion.kinematics import Kinematics, position6
from pepper_driver.backends.naoqi_server.motion.tasks import Task
from pepper_driver.config.arrays import FloatArray

TOLD = 5
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
        motors = config.motors
        self._torque_per_ampere = [
            motors.of(joint).torque_constant * motors.joints[joint].ratio
            for joint in config.joint_names
        ]
        self._cycles = 0
        self._motion.on_cycle.append(self._tell)

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
        """Of each joint: least and largest angle [rad], largest speed [rad/s] and torque [N m]."""
        body = self._motion.body
        joints = body.joints(names, "ALMotion::getLimits")
        return [[body.lower[j], body.upper[j], body.speed[j], body.torque[j]] for j in joints]

    def getMotionCycleTime(self) -> int:
        """[ms] of a cycle of ALMotion."""
        return round(1000 * self._shared.settings.cycle)

    def getSummary(self) -> str:
        """A table of stiffnesses, commands and sensors, for people."""
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
        """Whether no task has any of the joints."""
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
            tasks: list[Task] = self._motion.joints.tasks.of(set(joints))
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
        """The same as a matrix: 16 numbers, line by line."""
        pose = self._pose(name, frame, sensors, "ALMotion::getTransform")
        numbers: list[float] = pose.ravel().tolist()
        return numbers

    def _pose(self, name: object, frame: object, sensors: object, where: str) -> FloatArray:
        with self._motion.lock:
            joints, base = self._motion.joints, self._motion.base
            angles = list(joints.sensed if sensors else joints.command)
            pose = base.pose if sensors else base.commanded
        return self._kinematics.pose(name, frame, angles, pose, where)

    def _tell(self) -> None:
        """Velocities and torques of the joints into ALMemory; hands have none there."""
        self._cycles += 1
        if self._cycles % TOLD:
            return
        values = self._context.robot.values()
        body = self._motion.body
        for joint in body.groups["Joints"]:
            name = body.name(joint)
            velocity = self._motion.joints.sensed_velocity[joint]
            torque = values[self._currents[joint]] * self._torque_per_ampere[joint]
            self._memory.insert(f"Motion/Velocity/Sensor/{name}", velocity)
            self._memory.insert(f"Motion/Torque/Sensor/{name}", torque)
