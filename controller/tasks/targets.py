"""Checks of targets from users: vectors, rotations, poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pepper_driver.config import RobotConfig, UnknownNameError
from pepper_driver.config.arguments import as_tuple, is_number, real_array
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import shown
from pepper_driver.config.task_specs import UNIT
from pepper_driver.controller.errors import TargetError

Target = ArrayLike | Mapping[str, float]
"""Target from a user; joints by name for tasks of joints."""


def checked_joints(robot: RobotConfig, joints: Sequence[str] | None) -> tuple[str, ...] | None:
    """Return names of joints from a user as a tuple; None for all joints.

    Raises:
        TargetError: Not a list of names, an empty one, or one that has a name twice.
        UnknownNameError: No such joint.
    """
    if joints is None:
        return None
    names = as_tuple(joints)
    if not names or not all(isinstance(name, str) for name in names):
        raise TargetError(
            f"joints must be a list of names of joints, one at least, got {shown(joints)}"
        )
    for name in names:
        robot.joint_index(name)
        if names.count(name) > 1:
            raise TargetError(f"joints: {name} is given twice")
    return names


def check_link(robot: RobotConfig, link: str) -> None:
    """Check that a value names a link of the robot.

    Raises:
        TargetError: Not a name.
        UnknownNameError: No such link.
    """
    if not isinstance(link, str):
        raise TargetError(f"a link is given by its name, got {shown(link)}")
    if link not in robot.links:
        raise UnknownNameError("link", link, robot.links)


def finite_vector(what: str, value: Target, size: int, *, names: Sequence[str] = ()) -> FloatArray:
    """Return a copy of ``value`` (size,) as floats.

    Args:
        what: Subject of the message.
        value: Value from the user.
        size: Number of values.
        names: (size,) joints, for messages.

    Raises:
        TargetError: Not ``size`` finite numbers.
    """
    vector = real_array(value)
    if vector is None:
        raise TargetError(_no_number(what, value, size, names))
    if vector.shape != (size,):
        got = f"shape {vector.shape}" if vector.ndim else shown(value)
        raise TargetError(f"{what} takes {_numbers(size)}, got {got}")
    finite = np.isfinite(vector)
    if not finite.all():
        index = int(np.argmin(finite))
        joint = names[index] if names else None
        raise TargetError(
            f"{what} takes finite numbers, got {vector[index]} for {joint or f'number {index}'}",
            joint=joint,
            value=float(vector[index]),
        )
    return vector


def checked_rotation(what: str, value: Target) -> FloatArray:
    """Return the (3, 3) rotation matrix of a rotation matrix or of a unit quaternion (x, y, z, w).

    Args:
        what: Subject of the message.
        value: (3, 3) or (4,).

    Raises:
        TargetError: Another shape; not finite; not a rotation; a quaternion that is not of unit length.
    """
    array = _array(what, value, "a (3, 3) rotation matrix or a unit quaternion (x, y, z, w)")
    if array.shape == (4,):
        norm = float(np.linalg.norm(array))
        if abs(norm - 1.0) > UNIT:
            raise TargetError(
                f"{what} takes a unit quaternion (x, y, z, w), got one of norm {norm:.4g}"
            )
        matrix: FloatArray = pin.Quaternion(array / norm).matrix()
        return matrix
    if array.shape == (3, 3):
        off = float(np.abs(array @ array.T - np.eye(3)).max())
        if off > UNIT or np.linalg.det(array) < 0:
            raise TargetError(
                f"{what} takes a rotation matrix, got one that is not orthonormal (off by {off:.2g})"
            )
        # Orthonormal to rounding again: the tolerance above would show as an error that never ends.
        left, _, right = np.linalg.svd(array)
        matrix = left @ right
        return matrix
    raise TargetError(
        f"{what} takes a (3, 3) rotation matrix or a unit quaternion (x, y, z, w), got shape {array.shape}"
    )


def checked_pose(what: str, value: Target) -> FloatArray:
    """Return the (4, 4) transform of a (4, 4) transform or of (7,) position [m] and unit quaternion (x, y, z, w).

    Raises:
        TargetError: Another shape; not finite; not a rotation; a quaternion that is not of unit length.
    """
    array = _array(what, value, "a (4, 4) transform or (x, y, z, qx, qy, qz, qw)")
    pose = np.eye(4)
    if array.shape == (7,):
        pose[:3, 3], pose[:3, :3] = array[:3], checked_rotation(what, array[3:])
    elif array.shape == (4, 4):
        if not np.allclose(array[3], [0.0, 0.0, 0.0, 1.0], rtol=0.0, atol=1e-9):
            raise TargetError(f"{what} takes a transform whose last row is 0 0 0 1, got {array[3]}")
        pose[:3, 3], pose[:3, :3] = array[:3, 3], checked_rotation(what, array[:3, :3])
    else:
        raise TargetError(
            f"{what} takes a (4, 4) transform or (x, y, z, qx, qy, qz, qw), got shape {array.shape}"
        )
    return pose


def _array(what: str, value: Target, kind: str) -> FloatArray:
    array = real_array(value)
    if array is None:
        raise TargetError(f"{what} takes {kind}, got {shown(value)}")
    if not np.isfinite(array).all():
        raise TargetError(f"{what} takes finite numbers, got {array.tolist()}")
    return array


def _numbers(size: int) -> str:
    return "one number" if size == 1 else f"{size} numbers"


def _no_number(what: str, value: object, size: int, names: Sequence[str]) -> str:
    """Return why a value is no vector of numbers; for a list of the right size, its first entry that is none."""
    if isinstance(value, list | tuple) and len(value) == size:
        for index, number in enumerate(value):
            if not is_number(number):
                place = names[index] if names else f"number {index}"
                some = "numbers" if size > 1 else "one number"
                return f"{what} takes {some}, got {shown(number)} for {place}"
    return f"{what} takes {_numbers(size)}, got {shown(value)}"
