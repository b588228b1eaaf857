"""Pushes of known size on a simulated robot, in newtons and in equivalent degrees: never into saturation by mistake."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pepper_driver.backends import Truth
from pepper_driver.config import PepperError, RobotConfig
from pepper_driver.config.parts import FloatArray
from pepper_driver.config.scenario_contacts import STRONGEST_HAND
from pepper_driver.controller import RobotModel
from pepper_driver.footing import Footing

SHORTEST_LEVER = 1e-3
"""[m] A force with less to turn a joint by does nothing to it."""


class PushTooStrongError(PepperError, ValueError):
    """No push of the wanted size fits under what the motor boards can hold, or under what the robot can stand."""


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """What a push may ask of the robot.

    Attributes:
        load: Share of each board's holding torque that push and gravity together may take.
        tipping: Share of the moment that would lift a wheel; heeded on a base that rolls.
        saturating: The push may take more than ``load`` of the boards, and more than they can hold.
    """

    load: float
    tipping: float
    saturating: bool = False


@dataclass(frozen=True, kw_only=True)
class PlannedPush:
    """A force on a link that puts a known torque on a joint.

    Attributes:
        joint: The joint.
        link: A link that hangs on it rigidly, where the force acts.
        point: (3,) where, in the link's frame [m].
        force: (3,) [N].
        frame: Axes of the force. In those of the ``link`` the torque on the joint stays the same as the link turns.
        torque: Largest torque on the joint, signed [N m].
        degrees: Its size divided by the joint's proportional stiffness [deg].
        load: Largest share of a board's holding torque that push and gravity together take.
        tipping: Share of the moment that would lift a wheel from the floor; 0 on a fixed base.
    """

    joint: str
    link: str
    point: FloatArray
    force: FloatArray
    frame: Literal["world", "link"]
    torque: float
    degrees: float
    load: float
    tipping: float

    @property
    def newtons(self) -> float:
        """Size of the force [N]."""
        return float(np.linalg.norm(self.force))


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
    bounds: Bounds,
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
        bounds: What the push may ask of the robot.

    Raises:
        PushTooStrongError: Another joint, or this one, would saturate, or the robot would tip.
    """
    index = robot.joint_index(joint)
    way = _way(model, index, joint, link, point, posture)
    lever = float(np.linalg.norm(way))
    torque = direction * np.radians(degrees) * float(truth.stiffness[index])
    rotation_link_to_world = model.link_pose(link, posture)[:3, :3]
    return weigh_push(
        model,
        robot,
        truth,
        joint=joint,
        link=link,
        point=point,
        force=rotation_link_to_world.T @ (way / lever * (torque / lever)),
        frame="link",
        posture=posture,
        bounds=bounds,
    )


def weigh_push(
    model: RobotModel,
    robot: RobotConfig,
    truth: Truth,
    *,
    joint: str,
    link: str,
    point: FloatArray,
    force: FloatArray,
    frame: Literal["world", "link"],
    posture: FloatArray,
    bounds: Bounds,
) -> PlannedPush:
    """What a force (3,) [N] on a point means for a joint, for the boards and for the stand of the robot.

    The base stands where it started: the axes of the world are those of base_link. The rest is as in :func:`plan_push`.

    Raises:
        PushTooStrongError: A board would saturate, the robot would tip, or the joint cannot feel the force.
    """
    index = robot.joint_index(joint)
    _way(model, index, joint, link, point, posture)
    pose = model.link_pose(link, posture)
    in_world = pose[:3, :3] @ force if frame == "link" else force
    torques = model.point_jacobian(link, point, posture).T @ in_world
    loads = (np.abs(torques) + np.abs(model.gravity_torque(posture))) / truth.torque_limit
    worst = int(loads.argmax())
    tipping = 0.0
    if truth.plant.base == "rolling":
        where = pose[:3, :3] @ point + pose[:3, 3]
        tipping = Footing.of(robot).share(posture, where, in_world)
    planned = PlannedPush(
        joint=joint,
        link=link,
        point=point,
        force=force,
        frame=frame,
        torque=float(torques[index]),
        degrees=float(np.degrees(abs(torques[index]) / truth.stiffness[index])),
        load=float(loads[worst]),
        tipping=tipping,
    )
    _check(planned, bounds, robot.joint_names[worst])
    return planned


def _way(
    model: RobotModel, index: int, joint: str, link: str, point: FloatArray, posture: FloatArray
) -> FloatArray:
    """(3,) where a joint carries a point, per radian [m]."""
    way = model.point_jacobian(link, point, posture)[:, index]
    if float(np.linalg.norm(way)) < SHORTEST_LEVER:
        raise PushTooStrongError(f"a force at this point of {link} does not turn {joint}")
    return way


def _check(planned: PlannedPush, bounds: Bounds, worst: str) -> None:
    size = f"{planned.newtons:.1f} N on {planned.link}, {planned.degrees:.1f} equivalent degrees on {planned.joint},"
    if planned.load > bounds.load and not bounds.saturating:
        raise PushTooStrongError(
            f"{size} would load {worst} to {planned.load:.0%} of its limit; at most {bounds.load:.0%}, or set "
            "'saturating'"
        )
    if planned.tipping > bounds.tipping:
        raise PushTooStrongError(
            f"{size} would come to {planned.tipping:.0%} of what tips the robot over; at most {bounds.tipping:.0%}"
        )
    if planned.newtons > STRONGEST_HAND:
        raise PushTooStrongError(f"{size} is more than any hand does, {STRONGEST_HAND:g} N")
