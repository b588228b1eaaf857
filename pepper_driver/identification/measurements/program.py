"""Measurement of a robot: its runs, before those of the models, and the facts that they show."""

from __future__ import annotations

from collections.abc import Mapping

from pepper_driver.config import RobotConfig
from pepper_driver.identification.measurements.friction import measure_friction
from pepper_driver.identification.measurements.noise import (
    late_fraction,
    lost_fraction,
    measure_noise,
)
from pepper_driver.identification.measurements.response import measure_response
from pepper_driver.identification.measurements.speed import measure_speed
from pepper_driver.observer import Recording
from pepper_driver.observer.models.measured_robot import MeasuredJoint, MeasuredRobot

RESPONSE, FRICTION, SPEED = "measure_response", "measure_friction", "measure_speed"
"""Names of the experiments, and of their runs."""

MEASUREMENTS = (RESPONSE, FRICTION, SPEED)

TESTED_SPEED = 2.6
"""[rad/s] that arm joints may be told while their speed is measured: a little more than recorded robots reached."""


def measured_joints(robot: RobotConfig) -> tuple[str, ...]:
    """Return the joints that step and sweep: those of arms and head, without the hands."""
    return tuple(
        name
        for name in robot.joint_names
        if name not in robot.chains["legs"] and name not in robot.hands.joints
    )


def measure_robot(
    recordings: Mapping[str, Recording], reported_delay: int, robot: RobotConfig
) -> MeasuredRobot:
    """Return the facts that the runs of MEASUREMENTS show.

    Args:
        recordings: By name of the run.
        reported_delay: Ticks from a command to the sample that answers it, by which the recordings are paired.
        robot: Its description.

    Raises:
        ResponseError: No current answers a command.
    """
    joints = measured_joints(robot)
    response = measure_response(recordings[RESPONSE], joints, robot)
    runs = list(recordings.values())
    lost = lost_fraction([recordings[SPEED]], joints, robot)
    return MeasuredRobot(
        reported_delay=reported_delay,
        delay_error=response.lead,
        delay_spread=(response.earliest, response.latest),
        late=late_fraction(runs),
        lost=0.0 if lost is None else lost,
        weight=None,
        joints={joint: _joint(recordings, joint, robot) for joint in joints},
    )


def _joint(recordings: Mapping[str, Recording], joint: str, robot: RobotConfig) -> MeasuredJoint:
    noise = measure_noise(recordings[RESPONSE], joint)
    encoder, current = (0.0, 0.0) if noise is None else noise
    friction = measure_friction([recordings[FRICTION]], joint, robot)
    speed = measure_speed(recordings[SPEED], joint, robot)
    return MeasuredJoint(
        encoder_noise=encoder,
        current_noise=current,
        friction=None if friction is None else friction.friction,
        load_scale=None if friction is None else friction.load_scale,
        speed=None if speed is None else speed.reached,
        speed_limited=speed is not None and speed.limited,
    )
