"""Where the small motion goes: near the posture the robot is in, within limits, and with room between its links."""

from __future__ import annotations

import numpy as np

from pepper_driver.config import DoctorSettings, PepperError, RobotConfig, load_self_collision
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import RobotModel
from pepper_driver.controller.collision import CapsuleDistances

SEED = 1
"""Of the goals: each motion is the same, so that they can be compared over months."""

LEAST_SHARE = 0.4
"""Of the amplitude that each goal is away from the middle at least."""

STEPS = 6
"""From no way aside to all of it."""


class NoRoomError(PepperError, RuntimeError):
    """The arms are where they cannot move freely; nothing has moved."""


def moving_joints(robot: RobotConfig) -> tuple[str, ...]:
    """The joints of arms and head: those that cannot tip the robot over."""
    return tuple(name for name in robot.joint_names if name not in robot.chains["legs"])


def plan_goals(start: FloatArray, robot: RobotConfig, settings: DoctorSettings) -> list[FloatArray]:
    """(17,) goals [rad] from one side of a middle to the other, and back to the start at the end.

    The middle is the first posture, moved off limits and, as far as needed, with the arms aside: where links are near,
    the controller would move the legs for them.

    Args:
        start: (17,) the first posture [rad], within the limits.
        robot: Its description.
        settings: Amplitudes and distances.

    Raises:
        NoRoomError: Links are too near to one another all the same.
    """
    room = _Room(robot, settings.clearance)
    aside = np.zeros(len(start))
    for joint, angle in settings.aside.items():
        aside[robot.joint_index(joint)] = angle
    for share in np.linspace(0.0, 1.0, STEPS):
        goals = _goals_around(start + share * aside, robot, settings)
        if all(room.is_free(goal) for goal in goals):
            return [*goals, start]
    raise NoRoomError(
        "there is no room for a small motion around this posture: links are too near to one another; "
        "bring the arms away from the body by hand, robot at rest"
    )


def _goals_around(
    posture: FloatArray, robot: RobotConfig, settings: DoctorSettings
) -> list[FloatArray]:
    moving = np.array([name not in robot.chains["legs"] for name in robot.joint_names])
    is_hand = np.array([name in robot.hands.joints for name in robot.joint_names])
    amplitude = np.where(is_hand, settings.hand_amplitude, settings.amplitude) * moving
    edge = amplitude + settings.limit_distance * moving
    middle = np.where(moving, np.clip(posture, robot.lower + edge, robot.upper - edge), posture)
    rng = np.random.default_rng(SEED)
    side = rng.choice([-1.0, 1.0], len(posture))
    goals = [middle]
    for _ in range(round(settings.motion / settings.stretch) - 2):
        side = -side
        goals.append(middle + side * amplitude * rng.uniform(LEAST_SHARE, 1.0, len(posture)))
    return goals


class _Room:
    """Says whether links keep a distance [m]."""

    def __init__(self, robot: RobotConfig, distance: float) -> None:
        self._model = RobotModel(robot)
        self._capsules = CapsuleDistances(self._model, load_self_collision(robot), distance)

    def is_free(self, posture: FloatArray) -> bool:
        model = self._model
        model.set_state(model.configuration(posture), np.zeros(model.nv))
        model.update_kinematics()
        self._capsules.place(model.data)
        return not self._capsules.any_near()
