"""Colours, postures, and arrows at touches: common to all drawings of the robot."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.transforms import transform
from pepper_driver.config.visuals import Visual
from pepper_driver.controller.model import RobotModel
from pepper_driver.observer import Contact
from pepper_driver.viewer.picture import Force

GHOST_OPACITY, GHOST_SCALE = 0.25, 0.96
"""A little smaller than the robot: it is seen only where the robot is not."""
GHOST_COLOR = (60, 120, 220)
GLOW = (255, 90, 0)
"""Colour of a limb whose residual is at twice its threshold."""
MIN_GLOW = 0.35
"""Of a limb whose residual is just above its threshold, as a fraction: less would not be seen."""
FORCE_COLOR, TOUCH_COLOR, STD_COLOR = (30, 130, 60), (220, 40, 40), (240, 170, 170)
FORCE_LENGTH = 0.01
"""[m] of an arrow per newton."""
ROOT = "base_link"
"""Link in whose axes forces of contacts are."""
MIN_LEVER = 0.05
"""[m] A torque is shown as the force at the link's centre with this lever at least."""

Color = tuple[int, int, int]
"""Red, green, blue, each 0..255."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Arrow:
    """An arrow between two points (3,) of the world [m]."""

    start: FloatArray
    end: FloatArray
    color: Color


def rotation_of_tilt(tilt: FloatArray) -> FloatArray:
    """Return the rotation matrix of pitch and roll of the base [rad], in this order."""
    pitch, roll = tilt.tolist()
    return transform((0.0, 0.0, 0.0), (roll, pitch, 0.0))[:3, :3]


def configuration(model: RobotModel, position: FloatArray, base: FloatArray) -> FloatArray:
    """Return the configuration of the model at (17,) joint positions [rad] and (3,) a pose of the base; 0 for NaN."""
    q = model.with_joint_position(pin.neutral(model.pin), np.nan_to_num(position))
    return model.with_base_pose(q, np.nan_to_num(base))


def glow(excess: FloatArray) -> FloatArray:
    """Return how far links glow, 0 to 1, by the size of their residuals over the thresholds."""
    above = MIN_GLOW + (1.0 - MIN_GLOW) * np.clip(excess - 1.0, 0.0, 1.0)
    return np.where(excess > 1.0, above, 0.0)


def glowing(color: FloatArray, ratio: float) -> FloatArray:
    """Return the colour (3,), 0..255, of a part that glows by a ratio, 0 to 1."""
    return (1.0 - ratio) * color + ratio * np.array(GLOW, dtype=np.float64)


def centres_of(visuals: tuple[Visual, ...]) -> dict[str, FloatArray]:
    """Return the centre (3,) of each link that is drawn, in its frame [m]."""
    places: dict[str, list[FloatArray]] = {}
    for visual in visuals:
        places.setdefault(visual.link, []).append(visual.transform_visual_to_link[:3, 3])
    return {link: np.mean(of, axis=0) for link, of in places.items()}


def force_arrow(force: Force) -> Arrow:
    """Return the arrow of a true force, with its tip where it acts."""
    start = force.point - FORCE_LENGTH * force.force
    return Arrow(start=start, end=force.point, color=FORCE_COLOR)


def _fitted_arrows(name: str, contact: Contact, base: FloatArray) -> Iterator[tuple[str, Arrow]]:
    """Yield the arrow of a fitted force from its point, and from its end to the largest force of its interval."""
    start = base[:3, 3] + base[:3, :3] @ np.array(contact.point)
    force = base[:3, :3] @ np.array(contact.force)
    tip = start + FORCE_LENGTH * force
    yield name, Arrow(start=start, end=tip, color=TOUCH_COLOR)
    size = contact.force_size
    if size and contact.force_interval is not None:
        longer = max(contact.force_interval[1] / size, 1.0)
        end = start + longer * FORCE_LENGTH * force
        yield f"{name} std", Arrow(start=tip, end=end, color=STD_COLOR)


def touch_arrows(
    contact: Contact,
    robot: RobotConfig,
    link_pose: Callable[[str], FloatArray],
    centres: Mapping[str, FloatArray],
) -> Iterator[tuple[str, Arrow]]:
    """Yield arrows at a touch with their names: its force, and as far as its interval goes.

    Where no force was fitted, the arrow is the force at the link that gives the torque on the joint, and one deviation.

    Args:
        contact: As the observer reports it.
        robot: Description of the robot.
        link_pose: Gives (4, 4) the transform of a link to the world.
        centres: See :func:`centres_of`.
    """
    name = f"touch {contact.id}"
    if contact.force is not None and contact.point is not None:
        yield from _fitted_arrows(name, contact, link_pose(ROOT))
        return
    pose = link_pose(contact.link)
    centre = pose[:3, 3] + pose[:3, :3] @ centres.get(contact.link, np.zeros(3))
    if contact.joint is None or contact.torque is None:
        yield name, Arrow(start=centre + np.array([0.0, 0.0, 0.15]), end=centre, color=TOUCH_COLOR)
        return
    joint = robot.joints[robot.joint_index(contact.joint)]
    turning = link_pose(joint.child)
    across = np.cross(turning[:3, :3] @ np.array(joint.axis), centre - turning[:3, 3])
    length = float(np.linalg.norm(across))
    distance = max(length, MIN_LEVER)
    direction = across / max(length, 1e-9)
    size = contact.torque / distance
    tip = centre + FORCE_LENGTH * size * direction
    yield name, Arrow(start=centre, end=tip, color=TOUCH_COLOR)
    if contact.torque_std is not None:
        std = np.sign(size) * contact.torque_std / distance
        end = tip + FORCE_LENGTH * std * direction
        yield f"{name} std", Arrow(start=tip, end=end, color=STD_COLOR)
