"""Pushes of known size on a simulated robot: so many equivalent degrees on a joint, and never into saturation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pepper_driver.backends import Truth
from pepper_driver.config import PepperError, RobotConfig
from pepper_driver.config.parts import FloatArray
from pepper_driver.controller import RobotModel


class PushTooStrongError(PepperError, ValueError):
    """No push of the wanted size fits under what the motor boards can hold."""


@dataclass(frozen=True, kw_only=True)
class PlannedPush:
    """A force on a link that puts a wanted torque on a joint.

    Attributes:
        joint: The joint.
        link: A link that hangs on it rigidly, where the force acts.
        point: (3,) where, in the link's frame [m].
        force: (3,) in the link's frame, so that the torque on the joint stays the same as the link turns [N].
        torque: Largest torque on the joint, signed [N m].
        degrees: Its size divided by the joint's proportional stiffness [deg].
    """

    joint: str
    link: str
    point: FloatArray
    force: FloatArray
    torque: float
    degrees: float


def plan_push(
    model: RobotModel,
    robot: RobotConfig,
    truth: Truth,
    *,
    joint: str,
    link: str,
    point: FloatArray,
    degrees: float,
    direction: int,
    posture: FloatArray,
    largest_load: float,
) -> PlannedPush:
    """The smallest force at a point that puts ``degrees`` equivalent degrees on a joint.

    Equivalent degrees of a push: peak external torque on the joint divided by its proportional stiffness
    K = kp N Kt / R. The force points the way the joint would carry the point.

    Args:
        model: Of the controller.
        robot: Its description.
        truth: Of the plant: only the plant knows its stiffness.
        joint: The joint.
        link: The link it carries.
        point: (3,) in the link's frame [m].
        degrees: Wanted size [deg].
        direction: Wanted sign of the torque on the joint.
        posture: (17,) where the robot will be, for the load on the other joints [rad].
        largest_load: Share of each board's holding torque that push and gravity together may take.

    Raises:
        PushTooStrongError: Another joint, or this one, would saturate.
    """
    index = robot.joint_index(joint)
    jacobian = model.point_jacobian(link, point, posture)
    rotation_link_to_world = model.link_pose(link, posture)[:3, :3]
    lever = float(np.linalg.norm(jacobian[:, index]))
    if lever < 1e-3:
        raise PushTooStrongError(f"a force at this point of {link} does not turn {joint}")
    torque = direction * np.radians(degrees) * float(truth.stiffness[index])
    force = jacobian[:, index] / lever * (torque / lever)
    load = np.abs(jacobian.T @ force) + np.abs(model.gravity_torque(posture))
    over = load / truth.torque_limit
    if over.max() > largest_load:
        worst = robot.joint_names[int(over.argmax())]
        raise PushTooStrongError(
            f"{degrees:.1f} equivalent degrees on {joint} would load {worst} to {over.max():.0%} of its limit"
        )
    return PlannedPush(
        joint=joint,
        link=link,
        point=point,
        force=rotation_link_to_world.T @ force,
        torque=torque,
        degrees=degrees,
    )
