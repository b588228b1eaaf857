from __future__ import annotations

from dataclasses import replace

import numpy as np

from pepper_driver.observer.models.model_file import predict_recording
from pepper_driver.observer.models.tree import AffineTree
from support.fusion import (
    ELBOW,
    MODEL,
    STICK_SLIP,
    drive,
    fusion_model,
    quantised,
    recording_of,
    swing,
)
from support.observer import AFFINE, SILENT, free_run

JOINT = "LElbowRoll"


def test_of_a_tree_it_is_the_tree() -> None:
    run = free_run(3.0, 0, seconds=3.0)
    np.testing.assert_array_equal(
        predict_recording(AFFINE, JOINT, run), AFFINE.predict(run.features(ELBOW))
    )
    assert (predict_recording(SILENT, JOINT, run) == 0).all()


def test_of_a_fusion_model_it_is_the_error_of_the_joint() -> None:
    motion = swing(5.0, rest=1.0)
    driven = drive(motion)
    error = motion.position - driven.position
    predicted = predict_recording(MODEL, JOINT, recording_of(motion, driven))
    assert np.sqrt(np.mean((predicted - error) ** 2)) < 0.05 * error.std()


def test_it_does_not_look_at_what_was_measured_but_the_start() -> None:
    motion = swing(3.0)
    run = recording_of(motion, drive(motion))
    position = run.position.copy()
    position[1:] += 0.3
    np.testing.assert_array_equal(
        predict_recording(MODEL, JOINT, run),
        predict_recording(MODEL, JOINT, replace(run, position=position)),
    )
    displaced = drive(motion, start=0.006)
    there = predict_recording(MODEL, JOINT, recording_of(motion, displaced))
    assert there[0] == motion.position[0] - quantised(displaced.position)[0]


def test_the_remainder_adds_to_the_stick_slip_model() -> None:
    motion = swing(3.0)
    run = recording_of(motion, drive(motion))
    tree = AffineTree(
        feature=(-1,),
        threshold=(0.0,),
        left=(-1,),
        right=(-1,),
        coefficients=((0.001, 0.02, -0.003, 0.004),),
        lower=(-9.0, -99.0, -99.0),
        upper=(9.0, 99.0, 99.0),
    )
    more = predict_recording(fusion_model(STICK_SLIP, remainder=tree), JOINT, run)
    expected = 0.001 + 0.02 * motion.velocity - 0.003 * motion.acceleration + 0.004 * motion.load
    np.testing.assert_allclose(more - predict_recording(MODEL, JOINT, run), expected, atol=1e-12)
