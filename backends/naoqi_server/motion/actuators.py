"""The keys by which ALMotion reads the robot and gives orders to the DCM."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from pepper_driver.backends.naoqi_server.clock import wrapped
from pepper_driver.backends.naoqi_server.dcm import UpdateType
from pepper_driver.backends.naoqi_server.robot import Robot
from pepper_driver.config import RobotConfig


class Actuators:
    """Joints by their index, wheels in the order of ``RobotConfig.wheels.names``.

    Args:
        robot: Whose.
        config: Its description.
        lead: How far ahead of the date given an order is dated [ms].
    """

    def __init__(self, robot: Robot, config: RobotConfig, lead: int) -> None:
        self._robot, self._lead = robot, lead
        names, joints, wheels = config.naoqi, config.joint_names, config.wheels.names
        self._angle = [names.prefix + names.position_command.format(joint=j) for j in joints]
        self._stiffness = [names.prefix + names.stiffness_command.format(joint=j) for j in joints]
        self._wheel = [names.prefix + names.wheel_speed_command.format(wheel=w) for w in wheels]
        self._wheel_stiffness = [
            names.prefix + names.wheel_stiffness_command.format(wheel=w) for w in wheels
        ]
        places = robot.keys
        self._sensed = [places[names.prefix + names.position.format(joint=j)] for j in joints]
        self._rolled = [places[names.prefix + names.wheel_speed.format(wheel=w)] for w in wheels]

    def read(self) -> tuple[list[float], list[float]]:
        """Measured (17) angles [rad] and (3) wheel speeds [rad/s]."""
        values = self._robot.values()
        return [values[place] for place in self._sensed], [values[place] for place in self._rolled]

    def stiffness(self) -> list[float]:
        """(17) hardnesses that the DCM sent last."""
        return [self._robot.value(key) for key in self._stiffness]

    def order_angles(
        self, date: int, angles: Mapping[int, float], update: UpdateType = "ClearAfter"
    ) -> None:
        """Order angles [rad] of some joints."""
        self._order(date, [self._angle[joint] for joint in angles], angles.values(), update)

    def order_stiffnesses(self, date: int, stiffnesses: Mapping[int, float]) -> None:
        """Order stiffnesses of some joints."""
        keys = [self._stiffness[joint] for joint in stiffnesses]
        self._order(date, keys, stiffnesses.values())

    def order_wheels(self, date: int, speeds: Sequence[float]) -> None:
        """Order the speeds of all wheels [rad/s]."""
        self._order(date, self._wheel, speeds)

    def order_wheel_stiffness(self, date: int, stiffness: float) -> None:
        """Order the stiffness of all wheels."""
        self._order(date, self._wheel_stiffness, [stiffness] * len(self._wheel_stiffness))

    def _order(
        self,
        date: int,
        keys: Sequence[str],
        values: Iterable[float],
        update: UpdateType = "ClearAfter",
    ) -> None:
        if keys:
            when = wrapped(date + self._lead)
            self._robot.order(keys, update, [[(float(value), when)] for value in values])
