"""Targets: rotations and poses from users: what is taken, and what is refused with which words."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pepper_driver.controller import FrameTask, OrientationTask, TargetError
from pepper_driver.controller.tasks.targets import checked_pose, checked_rotation

TURN = Rotation.from_rotvec([0.3, -1.2, 0.8])
MIRROR = np.diag([1.0, 1.0, -1.0])


@pytest.mark.parametrize(
    "value",
    [
        TURN.as_matrix(),
        TURN.as_quat(),
        -TURN.as_quat(),
        TURN.as_quat().tolist(),
        TURN.as_quat() * 1.0005,
        TURN.as_matrix() * 1.0002,
        tuple(map(tuple, TURN.as_matrix())),
    ],
)
def test_a_rotation_comes_out_orthonormal(value: Any) -> None:
    matrix = checked_rotation("it", value)
    np.testing.assert_allclose(matrix, TURN.as_matrix(), atol=1e-3)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(matrix) > 0


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ([0, 0, 0, 1.01], "norm 1.01"),
        ([0, 0, 0, 0], "norm 0"),
        ([0, 0, np.nan, 1], "finite"),
        (TURN.as_matrix() * 1.01, "not orthonormal"),
        (MIRROR, "not orthonormal"),
        (TURN.as_matrix() + 0.01, "not orthonormal"),
        (np.full((3, 3), np.inf), "finite"),
        (np.zeros((3, 3)), "not orthonormal"),
        ([0.1, 0.2, 0.3], r"shape \(3,\)"),
        (np.eye(4), "shape"),
        (1.0, "shape"),
        ("up", "got .up."),
        (None, "got None"),
        ({"w": 1.0}, r"got \{.w.: 1.0\}"),
        ([[1, 0], [0]], r"got \[\[1, 0\], \[0\]\]"),
    ],
)
def test_what_is_no_rotation_is_refused(value: Any, words: str) -> None:
    with pytest.raises(TargetError, match=words) as caught:
        checked_rotation("the thing", value)
    assert "the thing" in str(caught.value)
    task = OrientationTask("Head")
    task.target = TURN.as_quat()
    with pytest.raises(TargetError):
        task.target = value
    with pytest.raises(TargetError):
        task.move_to(value, 1.0)
    np.testing.assert_allclose(task.target, TURN.as_matrix(), atol=1e-12)


def test_a_pose_is_taken_in_both_ways() -> None:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = TURN.as_matrix(), [0.1, 0.2, 0.3]
    np.testing.assert_allclose(checked_pose("it", matrix), matrix, atol=1e-12)
    both = [0.1, 0.2, 0.3, *TURN.as_quat()]
    np.testing.assert_allclose(checked_pose("it", both), matrix, atol=1e-12)


def transform(rotation: Any, row: Any = (0, 0, 0, 1)) -> Any:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[3] = rotation, row
    return matrix


@pytest.mark.parametrize(
    "value",
    [
        [0, 0, 0, 0, 0, 0, 1.1],
        [np.nan, 0, 0, 0, 0, 0, 1],
        transform(np.eye(3), (0, 0, 0, 2)),
        transform(np.eye(3), (0.1, 0, 0, 1)),
        transform(MIRROR),
        transform(1.1 * np.eye(3)),
        np.eye(3),
        np.zeros(6),
        None,
        "home",
        {"x": 1.0},
    ],
)
def test_what_is_no_pose_is_refused(value: Any) -> None:
    task = FrameTask("l_wrist")
    task.target = transform(TURN.as_matrix())
    with pytest.raises(TargetError):
        task.target = value
    with pytest.raises(TargetError):
        task.move_through([np.eye(4), value], [1.0, 1.0])
    np.testing.assert_allclose(task.target, transform(TURN.as_matrix()), atol=1e-12)
    assert not task.has_reference
