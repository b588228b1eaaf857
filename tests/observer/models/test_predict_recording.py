"""Predicted tracking errors of a whole run, without its measurements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pepper_driver.observer.models.model_file import predict_recording
from support.fusion import (
    ELBOW,
    MODEL,
    drive,
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
