"""Centre of mass: its rows against the bodies' own places; what may move for it."""

from __future__ import annotations

import numpy as np
import pytest

from pepper_driver.config import UnknownNameError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import ComTask, TargetError
from support.controller import MIDDLE, controller
from support.tasks import STEP, Bench, State, centre_of_mass, later, link_pose, random_state


def centre(state: State, root: str | None) -> FloatArray:
    place = centre_of_mass(state)
    if root is not None:
        base = link_pose(state, "base_link")
        place = base[:3, :3].T @ (place - base[:3, 3])
    return place


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("root", [None, "base_link"])
def test_the_rows_are_those_of_the_bodies(root: str | None, seed: int) -> None:
    state = random_state(seed)
    task = ComTask(root=root)
    bench = Bench(task)
    task.target = target = np.array([0.1, -0.2, 0.5])
    measured = bench.at(state)
    np.testing.assert_allclose(measured.error, target - centre(state, root), atol=1e-12)
    before, after = (centre(later(state, time), root) for time in (-STEP, STEP))
    np.testing.assert_allclose(bench.rate(state), (after - before) / (2 * STEP), atol=1e-8)
    np.testing.assert_allclose(measured.bias, bench.rate_changes(state), atol=1e-6)
    assert np.abs(measured.bias).max() > 1e-3


def test_in_base_link_it_goes_along_with_the_base() -> None:
    control = controller()
    task = ComTask(root="base_link")
    control.add(task)
    control.base_velocity.target = [0.2, 0.0, 0.3]
    for _ in range(200):
        control.step()
    assert np.linalg.norm(control.base_pose[:2]) > 0.3
    assert np.abs(control.position - MIDDLE).max() < 1e-3
    assert np.linalg.norm(task.error) < 1e-4


@pytest.mark.parametrize("weights", [[1, 1, 0], [1, 1, 1]])
def test_without_weight_the_height_goes_with_the_arms(weights: list[float]) -> None:
    control = controller()
    task = ComTask()
    task.dim_weight = weights
    control.add(task)
    control.step()
    start = task.target
    control.posture.target = {"LShoulderPitch": -1.5, "RShoulderPitch": -1.5}
    for _ in range(600):
        control.step()
    assert np.abs(task.error[:2]).max() < 2e-3
    assert (abs(task.error[2]) > 0.01) == (weights[2] == 0)
    assert np.array_equal(task.target, start)


def test_what_is_none_is_refused() -> None:
    with pytest.raises(UnknownNameError):
        ComTask(joints=("Knee",))
    with pytest.raises(UnknownNameError, match="base_link"):
        ComTask(root="torso")
    task = ComTask()
    assert np.isnan(task.target).all()
    task.target = [0.0, 0.0, 0.8]
    for wrong in ([0.0, 0.0], [0.0, np.nan, 0.0], None, "up"):
        with pytest.raises(TargetError, match="centre of mass"):
            task.target = wrong  # type: ignore[assignment]
    assert task.target.tolist() == [0.0, 0.0, 0.8]
