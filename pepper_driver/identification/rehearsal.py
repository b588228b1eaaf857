"""A run without the robot: controller and safety gate alone, to see beforehand that nothing stops them."""

from __future__ import annotations

import numpy as np

from pepper_driver.backends import Backend, BackendInfo, Command, Imu, Measurement
from pepper_driver.config import PepperError, RobotConfig, load_robot
from pepper_driver.controller import Tick
from pepper_driver.identification.runs import Run
from pepper_driver.observer import Observation
from pepper_driver.robot import Pepper
from pepper_driver.safety import FaultError
from pepper_driver.staging import Stage


class RehearsalError(PepperError, RuntimeError):
    """A run would not go as it should; nothing has moved."""


class IdealRobot(Backend):
    """Joints that are where they are told to be, at once. Begins in the posture Stand."""

    def __init__(self, robot: RobotConfig) -> None:
        self._robot = robot
        self._position = np.clip(robot.posture("Stand"), robot.lower, robot.upper)
        self._wheel_speed = np.zeros(3)
        self._tick = 0

    @property
    def uri(self) -> str:
        """Of no robot."""
        return "ideal"

    @property
    def info(self) -> BackendInfo:
        """Of no real robot."""
        return BackendInfo(
            joint_names=self._robot.joint_names,
            cycle=self._robot.cycle,
            response_delay=0,
            capabilities=frozenset(),
            identity="ideal",
        )

    def open(self) -> Measurement:
        """Standing."""
        return self._measure()

    def activate(self) -> Measurement:
        """Standing."""
        return self._measure()

    def read(self) -> Measurement:
        """Measure the last command."""
        self._tick += 1
        return self._measure()

    def write(self, command: Command) -> None:
        """Be there at once."""
        self._position, self._wheel_speed = command.position, command.wheel_speed

    def deactivate(self) -> None:
        """Nothing to do."""

    def close(self) -> None:
        """Nothing to do."""

    def _measure(self) -> Measurement:
        n, sensors = len(self._position), self._robot.sensors
        return Measurement(
            time=self._tick * self._robot.cycle,
            tick=self._tick,
            position=self._position.copy(),
            current=np.zeros(n),
            wheel_speed=self._wheel_speed.copy(),
            imu=Imu(
                acceleration=np.array([0.0, 0.0, 9.81]),
                angular_velocity=np.zeros(3),
                attitude=np.zeros(3),
            ),
            touch=np.zeros(len(sensors.touch)),
            bumpers=np.zeros(len(sensors.bumpers)),
            buttons=np.zeros(len(sensors.buttons)),
            temperature=np.full(n, 30.0),
            battery=1.0,
            age=0.0,
        )


def rehearse(run: Run) -> None:
    """Have controller and gate play a run.

    Raises:
        RehearsalError: The gate would stop the robot or alter a command, or the controller would find no motion that
            keeps its constraints.
    """
    robot = load_robot()
    pepper = Pepper("mujoco", observer=None, robot=robot)
    pepper.backend = IdealRobot(robot)
    time = 0.0

    def watch(tick: Tick, _: Observation | None) -> None:
        nonlocal time
        time = tick.measurement.time
        # Of the last cycle: it is the command of the next one.
        status = pepper.controller.status
        if status.solver != "solved":
            lost = ", ".join(status.unmet) or status.solver
            raise RehearsalError(f"the controller cannot keep its limits ({lost})")
        if tick.changed.any():
            joint = robot.joint_names[int(np.argmax(tick.changed))]
            raise RehearsalError(f"the safety gate would alter the command of {joint}")

    stage = Stage(pepper, run.scenario, run.seed)
    try:
        with pepper:
            stage.perform(on_tick=watch)
    except (RehearsalError, FaultError) as error:
        raise RehearsalError(
            f"run {run.name} would fail {time:.1f} s after its start: {error}; nothing has moved"
        ) from error
