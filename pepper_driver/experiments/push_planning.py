"""Pushes of known size on a simulated robot, in newtons and in equivalent degrees: never into saturation by mistake."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pepper_driver.backends import SimulatedPlant
from pepper_driver.config import PepperError, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_specs import MAX_HAND_FORCE
from pepper_driver.controller import RobotModel
from pepper_driver.controller.support_polygon import SupportPolygon

MIN_LEVER = 1e-3
"""[m] A force with less to turn a joint by does nothing to it."""

DOWNWARD_RATIOS = (0.5, 1.0)
"""Downward force that is added to a push that would tip the robot, as a ratio to its size."""

HELD_BY_FRICTION = 0.5
"""Ratio to a joint's dry friction above which a torque counts."""


class PushTooStrongError(PepperError, ValueError):
    """A push of this size exceeds the holding torque of a motor board, or would tip the robot."""


@dataclass(frozen=True, kw_only=True)
class PushLimits:
    """Limits of a push on the robot.

    Attributes:
        load: Largest ratio of push and gravity together to each motor board's holding torque.
        tipping: Largest ratio to the moment that would lift a wheel; applied on a base that rolls.
        saturating: The push may take more than ``load`` of the boards, and more than they can hold.
        force: Of the hand, at most [N].
        max_distal_ratio: Torque on a joint further out in the chain than the one that is meant, in equivalent degrees,
            as a ratio to those on that one; infinite for any. A torque that friction holds is always allowed.
    """

    load: float
    tipping: float
    saturating: bool = False
    force: float = MAX_HAND_FORCE
    max_distal_ratio: float = np.inf


@dataclass(frozen=True, kw_only=True)
class PlannedPush:
    """A force on a link that puts a known torque on a joint.

    Attributes:
        joint: The joint; None for a push on trunk or base.
        link: Where the force acts.
        point: (3,) where, in the link's frame [m].
        force: (3,) [N].
        frame: Axes of the force. In those of the ``link`` the torque on the joint stays the same as the link turns.
        torques: (17,) largest torque on each joint, signed [N m].
        torque: That on the joint; of a push on trunk or base, on the leg joint with the most degrees.
        degrees: Its size divided by the joint's proportional stiffness [deg].
        load: Largest ratio of this push, other pushes and gravity together to a motor board's holding torque.
        tipping: Ratio to the moment that would lift a wheel from the floor; 0 on a fixed base.
    """

    joint: str | None
    link: str
    point: FloatArray
    force: FloatArray
    frame: Literal["world", "link"]
    torques: FloatArray
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
    plant: SimulatedPlant,
    *,
    joint: str,
    link: str,
    point: FloatArray,
    degrees: float,
    direction: int,
    posture: FloatArray,
    bounds: PushLimits,
    concurrent: Sequence[PlannedPush] = (),
) -> PlannedPush:
    """Return the smallest force at a point that puts ``degrees`` equivalent degrees on a joint.

    Equivalent degrees of a push: peak external torque on the joint divided by its proportional stiffness
    K = kp N Kt / R. The force points along the motion of the point under this joint. With a bound on the torques of
    distal joints, other forces with this torque are tried too.

    Args:
        model: Of the controller.
        robot: Its description.
        plant: Of the simulation: it defines the stiffness.
        joint: The joint.
        link: The link it carries.
        point: (3,) in the link's frame [m].
        degrees: Requested size [deg].
        direction: Requested sign of the torque on the joint.
        posture: (17,) where the robot will be, for the load on the other joints [rad].
        bounds: What the push may ask of the robot.
        concurrent: Pushes that act at the same time.

    Raises:
        PushTooStrongError: Another joint, or this one, would saturate, or the robot would tip.
    """
    index = robot.joint_index(joint)
    torque = direction * np.radians(degrees) * float(plant.stiffness[index])
    rotation_link_to_world = model.link_pose(link, posture)[:3, :3]
    gravity = float(model.gravity_torque(posture)[index])
    refused: PushTooStrongError | None = None
    for force in _forces(model, robot, joint, link, point, torque, posture, bounds):
        try:
            return evaluate_push(
                model,
                robot,
                plant,
                joint=joint,
                link=link,
                point=point,
                force=rotation_link_to_world.T @ force,
                frame="link",
                posture=posture,
                bounds=bounds,
                concurrent=concurrent,
            )
        except PushTooStrongError as error:
            refused = refused or error
            own = (abs(torque) + abs(gravity)) / plant.torque_limit[index]
            if own > bounds.load and not bounds.saturating:
                break  # independent of the direction
    assert refused is not None
    raise refused


def _forces(
    model: RobotModel,
    robot: RobotConfig,
    joint: str,
    link: str,
    point: FloatArray,
    torque: float,
    posture: FloatArray,
    bounds: PushLimits,
) -> Iterator[FloatArray]:
    """(3,) forces in the world that put ``torque`` on a joint: the smallest, then some that may fit where it does not.

    Those leave the joints further out alone, or press the robot down on its wheels as well.
    """
    index = robot.joint_index(joint)
    column = _column(model, index, joint, link, point, posture)
    smallest = column * (torque / float(column @ column))
    yield smallest
    if not np.isfinite(bounds.max_distal_ratio):
        return
    levers = model.point_jacobian(link, point, posture)[:, _outer(robot, joint)]
    # A point on the axis of a joint has a lever of rounding errors, in any direction.
    turning = levers[:, np.linalg.norm(levers, axis=0) >= MIN_LEVER]
    alone = column - turning @ np.linalg.lstsq(turning, column, rcond=None)[0]
    candidates = [smallest]
    if turning.size and float(np.linalg.norm(alone)) >= MIN_LEVER:
        for fraction in (0.4, 0.2, 0.0):
            along = alone + fraction * (column - alone)
            candidates.append(along * (torque / float(along @ column)))
    yield from candidates[1:]
    along = column / np.linalg.norm(column)
    down = np.array([0.0, 0.0, -1.0])
    down -= along * float(along @ down)
    for fraction in DOWNWARD_RATIOS:
        yield from (force + fraction * float(np.linalg.norm(force)) * down for force in candidates)


def evaluate_push(
    model: RobotModel,
    robot: RobotConfig,
    plant: SimulatedPlant,
    *,
    joint: str | None,
    link: str,
    point: FloatArray,
    force: FloatArray,
    frame: Literal["world", "link"],
    posture: FloatArray,
    bounds: PushLimits,
    concurrent: Sequence[PlannedPush] = (),
) -> PlannedPush:
    """Evaluate a force (3,) [N] on a point: its effect on a joint, the motor boards and the stand of the robot.

    The base stands where it started: the axes of the world are those of base_link. ``joint`` is None for a push on
    trunk or base. The rest is as in :func:`plan_push`.

    Raises:
        PushTooStrongError: A motor board would saturate, the robot would tip, or the force does not act on the joint.
    """
    jacobian = model.point_jacobian(link, point, posture)
    pose = model.link_pose(link, posture)
    in_world = pose[:3, :3] @ force if frame == "link" else force
    torques: FloatArray = jacobian.T @ in_world
    degrees = np.degrees(np.abs(torques) / plant.stiffness)
    if joint is None:
        index = int(degrees.argmax())
    else:
        index = robot.joint_index(joint)
        _column(model, index, joint, link, point, posture)
    # Magnitudes are added without signs: pushes begin and end at different times.
    together = np.abs(torques) + sum(np.abs(push.torques) for push in concurrent)
    loads = (together + np.abs(model.gravity_torque(posture))) / plant.torque_limit
    worst = int(loads.argmax())
    tipping = 0.0
    if plant.rolling:
        where = pose[:3, :3] @ point + pose[:3, 3]
        tipping = SupportPolygon.from_robot(robot).tipping_ratio(posture, where, in_world)
    planned = PlannedPush(
        joint=joint,
        link=link,
        point=point,
        force=force,
        frame=frame,
        torques=torques,
        torque=float(torques[index]),
        degrees=float(degrees[index]),
        load=float(loads[worst]),
        tipping=tipping,
    )
    _check(planned, bounds, robot.joint_names[worst], tipping + sum(p.tipping for p in concurrent))
    if joint is not None:
        _check_outer(planned, joint, degrees, robot, plant, bounds)
    return planned


def _column(
    model: RobotModel, index: int, joint: str, link: str, point: FloatArray, posture: FloatArray
) -> FloatArray:
    """(3,) where a joint carries a point, per radian [m]."""
    column = model.point_jacobian(link, point, posture)[:, index]
    if float(np.linalg.norm(column)) < MIN_LEVER:
        raise PushTooStrongError(f"a force at this point of {link} does not turn {joint}")
    return column


def _outer(robot: RobotConfig, joint: str) -> list[int]:
    """Return the joints further out in the chain of a joint."""
    chain = robot.chain_of(joint)
    return [robot.joint_index(name) for name in chain[chain.index(joint) + 1 :]]


def _check(planned: PlannedPush, bounds: PushLimits, worst: str, tipping: float) -> None:
    size = (
        f"{planned.newtons:.1f} N on {planned.link}, {planned.degrees:.1f} equivalent degrees"
        f"{f' on {planned.joint}' if planned.joint else ''},"
    )
    if planned.load > bounds.load and not bounds.saturating:
        raise PushTooStrongError(
            f"{size} would load {worst} to {planned.load:.0%} of its limit; at most {bounds.load:.0%}, or set "
            "'saturating'"
        )
    if tipping > bounds.tipping:
        raise PushTooStrongError(
            f"{size} would come to {tipping:.0%} of what tips the robot over; at most {bounds.tipping:.0%}"
        )
    if planned.newtons > MAX_HAND_FORCE:
        raise PushTooStrongError(f"{size} is more than any hand does, {MAX_HAND_FORCE:g} N")
    if planned.newtons > bounds.force:
        raise PushTooStrongError(f"{size} is more than the hand may do, {bounds.force:g} N")


def _check_outer(
    planned: PlannedPush,
    joint: str,
    degrees: FloatArray,
    robot: RobotConfig,
    plant: SimulatedPlant,
    bounds: PushLimits,
) -> None:
    """Refuse a push that would also load a distal joint."""
    if not np.isfinite(bounds.max_distal_ratio):
        return
    for index in _outer(robot, joint):
        name = robot.joint_names[index]
        held = HELD_BY_FRICTION * float(plant.friction[index])
        fraction = float(degrees[index]) / planned.degrees
        if abs(planned.torques[index]) > held and fraction > bounds.max_distal_ratio:
            raise PushTooStrongError(
                f"{planned.newtons:.1f} N on {planned.link} put {fraction:.0%} of the degrees of {joint} on {name} "
                f"too; at most {bounds.max_distal_ratio:.0%}"
            )
