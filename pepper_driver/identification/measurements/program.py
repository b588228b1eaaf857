"""Measurement of a robot: its runs, before those of the models, and the facts that they show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

from pepper_driver.config import ConfigError, RobotConfig
from pepper_driver.identification.measurements.friction import (
    HeldWeight,
    measure_dead_band,
    measure_friction,
    measure_torque_scale,
)
from pepper_driver.identification.measurements.held_weight import falling_weight
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

WEIGHT = "measure_weight"
"""Name of the run that makes FRICTION again with a weight in a hand."""

Hand = Literal["left", "right"]

HAND_LINKS: dict[Hand, str] = {"left": "l_wrist", "right": "r_wrist"}

GRIP = (0.07, 0.0, 0.0)
"""(3,) Middle of a hand in the frame of its link [m]."""

MIN_WEIGHT, MAX_WEIGHT = 0.2, 0.6
"""[kg] The hands of a Pepper are documented to carry 0.5 kg."""

TESTED_SPEED = 2.6
"""[rad/s] Largest commanded speed of arm joints while their speed is measured: recorded robots reached less."""


def held_weight(mass: float, hand: Hand) -> HeldWeight:
    """Return a weight [kg] that hangs from the middle of a hand.

    Raises:
        ConfigError: No hand carries it safely, or it is too light to be detected.
    """
    if not MIN_WEIGHT <= mass <= MAX_WEIGHT:
        raise ConfigError(
            f"a weight for a hand is {MIN_WEIGHT:g} to {MAX_WEIGHT:g} kg, got {mass:g}: a lighter one shows nothing, a "
            "heavier one strains the arm"
        )
    return HeldWeight(mass=mass, link=HAND_LINKS[hand], xyz=GRIP)


def weighted_hand(weight: HeldWeight) -> Hand:
    """Return the hand that carries a weight."""
    return next(hand for hand, link in HAND_LINKS.items() if link == weight.link)


def measured_joints(robot: RobotConfig) -> tuple[str, ...]:
    """Return the joints that step and sweep: those of arms and head, without the hands."""
    return tuple(
        name
        for name in robot.joint_names
        if name not in robot.chains["legs"] and name not in robot.hands.joints
    )


def measure_robot(
    recordings: Mapping[str, Recording],
    reported_delay: int,
    robot: RobotConfig,
    weight: HeldWeight | None = None,
) -> MeasuredRobot:
    """Return the facts that the runs of MEASUREMENTS show.

    A weight that was not in the hand during all of its run does not count: see ``weight_doubt``.

    Args:
        recordings: By name of the run.
        reported_delay: Ticks from a command to the sample that answers it, by which the recordings are paired.
        robot: Its description.
        weight: In the hand in the run WEIGHT; None without one.

    Raises:
        ResponseError: No current answers a command.
    """
    joints = measured_joints(robot)
    response = measure_response(recordings[RESPONSE], joints, robot)
    runs = list(recordings.values())
    lost = lost_fraction([recordings[SPEED]], joints, robot)
    found = {joint: _joint(recordings, joint, robot, weight) for joint in joints}
    doubt = None
    if weight is not None:
        doubt = falling_weight(found, recordings[WEIGHT], weight, robot)
    if doubt is not None:
        found = {joint: replace(one, torque_scale=None) for joint, one in found.items()}
    return MeasuredRobot(
        reported_delay=reported_delay,
        delay_error=response.lead,
        delay_spread=(response.earliest, response.latest),
        late=late_fraction(runs),
        lost=0.0 if lost is None else lost,
        weight=None if weight is None or doubt is not None else weight.mass,
        weight_doubt=doubt,
        joints=found,
    )


def _joint(
    recordings: Mapping[str, Recording],
    joint: str,
    robot: RobotConfig,
    weight: HeldWeight | None,
) -> MeasuredJoint:
    noise = measure_noise(recordings[RESPONSE], joint)
    encoder, current = (None, None) if noise is None else noise
    friction = measure_friction([recordings[FRICTION]], joint, robot)
    speed = measure_speed(recordings[SPEED], joint, robot)
    torque_scale = None
    if weight is not None:
        without, loaded = [recordings[FRICTION]], [recordings[WEIGHT]]
        torque_scale = measure_torque_scale(without, loaded, joint, weight, robot)
    return MeasuredJoint(
        encoder_noise=encoder,
        current_noise=current,
        dead_band=measure_dead_band([recordings[FRICTION]], joint, robot),
        friction=None if friction is None else friction.friction,
        load_scale=None if friction is None else friction.load_scale,
        torque_scale=torque_scale,
        speed=None if speed is None else speed.reached,
        speed_limited=speed is not None and speed.limited,
    )
