from __future__ import annotations

import numpy as np
import pytest

from pepper_driver.config import PepperError, UnknownNameError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.fitting.bounds import free_threshold
from pepper_driver.observer.fitting.samples import FALLING_TIME, SETTLING_TIME
from pepper_driver.observer.fitting.tree import (
    LEAVES,
    SHRINKAGES,
    FittingError,
    fit_affine,
    fit_cart,
    fit_joint,
    nrmse_fit,
)
from pepper_driver.observer.models.tree import AffineTree, CartTree, Tree
from support.observer import CYCLE, ROBOT, free_error, free_run, motion, recording

JOINT = "LShoulderRoll"
INDEX = ROBOT.joint_index(JOINT)
ESTIMATION = [free_run(k, seed) for seed, k in enumerate((2.0, 3.0, 4.0, 5.0))]


def fit_on(tree: Tree, stiffness: float, seed: int) -> float:
    run = free_run(stiffness, seed)
    return nrmse_fit(run.tracking_error(INDEX), tree.predict(run.features(INDEX)))


def test_fit_figure_by_hand() -> None:
    y = np.array([1.0, 2.0, 3.0, 4.0])
    assert nrmse_fit(y, y) == 100.0
    assert nrmse_fit(y, np.full(4, 2.5)) == pytest.approx(0.0)
    # |y - y_pred| = 1, |y - mean| = sqrt(5)
    assert nrmse_fit(y, np.array([1.0, 2.0, 3.0, 5.0])) == pytest.approx(100 * (1 - 5**-0.5))
    assert nrmse_fit(y, -y) < 0
    # The mean is that of the measured signal: an offset of the prediction counts.
    assert nrmse_fit(y, y + 10.0) == pytest.approx(100 * (1 - 20 / 5**0.5))


def test_the_fit_is_no_fraction_of_variance() -> None:
    rng = np.random.default_rng(0)
    y = rng.standard_normal(100_000)
    assert nrmse_fit(y, y + 0.189 * rng.standard_normal(100_000)) == pytest.approx(81.1, abs=0.3)


@pytest.mark.parametrize(
    ("measured", "predicted"),
    [
        (np.zeros(4), np.zeros(4)),
        (np.arange(4.0), np.arange(5.0)),
        (np.arange(4.0), np.zeros((4, 1))),
        (np.zeros(0), np.zeros(0)),
    ],
)
def test_fit_figure_refuses_what_has_no_fit(measured: FloatArray, predicted: FloatArray) -> None:
    with pytest.raises(FittingError):
        nrmse_fit(measured, predicted)


def test_affine_follows_faster_motion_than_it_was_fitted_on_and_cart_less() -> None:
    affine, cart = fit_joint(JOINT, ESTIMATION, "affine"), fit_joint(JOINT, ESTIMATION, "cart")
    assert isinstance(affine, AffineTree)
    assert isinstance(cart, CartTree)
    assert 4 <= affine.leaves <= 64
    features = np.concatenate([run.features(INDEX) for run in ESTIMATION])
    error = np.concatenate([run.tracking_error(INDEX) for run in ESTIMATION])
    assert cart == fit_cart(features, error)
    sizes = [fit_affine(features, error, leaves=n, shrinkage=s) for n in LEAVES for s in SHRINKAGES]
    assert affine in sizes
    assert fit_on(affine, 4.0, 50) > 95.0
    assert fit_on(cart, 4.0, 50) > 75.0
    assert fit_on(affine, 9.0, 51) > 93.0
    assert fit_on(affine, 9.0, 51) > fit_on(cart, 9.0, 51) + 5.0


def test_size_is_what_the_runs_support() -> None:
    features = [motion(k, 10 + int(k), 20.0) for k in (2.0, 3.0, 4.0, 5.0)]
    linear = [recording(f, 0.05 * f[:, 0] + f[:, 2] / 60) for f in features]
    assert fit_joint(JOINT, linear, "affine").leaves == 1
    # Two dozen steps: only more leaves than that predict the run that was left out.
    steps = [recording(f, np.floor(3 * f[:, 2]) / 100) for f in features]
    assert fit_joint(JOINT, steps, "affine").leaves > 16


def test_altered_and_stale_samples_are_left_out() -> None:
    clean, spoilt = [], []
    for seed, stiffness in enumerate((2.0, 3.5, 5.0)):
        features = motion(stiffness, seed, 15.0)
        error = free_error(features, seed)
        limited = np.zeros(len(error), dtype=np.bool_)
        limited[100:180] = True
        age = np.zeros(len(error))
        age[300:350] = 0.05
        keep = ~limited & (age == 0)
        clean.append(recording(features[keep], error[keep]))
        wrong = np.where(keep, error, 7.0)
        spoilt.append(recording(features, wrong, limited=limited, age=age))
    assert fit_joint(JOINT, spoilt, "affine") == fit_joint(JOINT, clean, "affine")
    assert fit_joint(JOINT, spoilt, "cart") == fit_joint(JOINT, clean, "cart")


def test_a_joint_that_falls_behind_changes_neither_model_nor_threshold() -> None:
    clean, chasing = [], []
    for seed, stiffness in enumerate((2.0, 3.5, 5.0)):
        features = motion(stiffness, seed, 15.0)
        error = free_error(features, seed)
        assert np.abs(error).max() < 0.15
        behind = error.copy()
        behind[400:450] = 0.6
        keep = np.ones(len(error), dtype=np.bool_)
        keep[400 - round(FALLING_TIME / CYCLE) : 450 + round(SETTLING_TIME / CYCLE)] = False
        clean.append(recording(features[keep], error[keep]))
        chasing.append(recording(features, behind))
    model = fit_joint(JOINT, chasing, "affine")
    assert model == fit_joint(JOINT, clean, "affine")
    quiet = [recording(motion(3.0, 7, 15.0), free_error(motion(3.0, 7, 15.0), 7))]
    assert free_threshold(JOINT, [*quiet, chasing[0]], model, 11) < 0.1


def test_same_recordings_same_model() -> None:
    assert fit_joint(JOINT, ESTIMATION[:3], "affine") == fit_joint(JOINT, ESTIMATION[:3], "affine")


def test_one_or_two_recordings_are_enough_for_a_small_tree() -> None:
    tree = fit_joint(JOINT, ESTIMATION[:1], "affine")
    assert 1 < tree.leaves <= 16
    assert fit_on(tree, 2.0, 60) > 85.0


def test_refuses_data_that_teach_nothing() -> None:
    short = recording(motion(3.0, 0, 3.0), np.zeros(250))
    with pytest.raises(FittingError, match=f"{JOINT}: 250 usable samples in 1 recordings"):
        fit_joint(JOINT, [short], "affine")
    with pytest.raises(FittingError, match="0 usable samples"):
        fit_joint(JOINT, [], "cart")
    still = recording(np.zeros((2000, 3)), np.zeros(2000))
    with pytest.raises(FittingError, match="does not move"):
        fit_joint(JOINT, [still], "cart")
    with pytest.raises(UnknownNameError, match="LShoulderRoll"):
        fit_joint("LShoulderRol", ESTIMATION, "cart")
    assert issubclass(FittingError, PepperError)
    assert issubclass(FittingError, ValueError)
