"""What a model of any kind expects of a joint over a whole recording."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.fusion_model import FusionModel
from pepper_driver.observer.recording import Recording
from pepper_driver.observer.tree import Tree
from pepper_driver.observer.twin import Twins

JointModel = Tree | FusionModel


def predict_recording(model: JointModel, joint: str, recording: Recording) -> FloatArray:
    """(n,) expected tracking error of a joint over a run [rad], with no look at what was measured.

    Of a fusion model, twin and remainder; only where the joint starts is taken from the recording.
    """
    index = recording.joint_names.index(joint)
    features = recording.features(index)
    if not isinstance(model, FusionModel):
        return model.predict(features)
    twins = Twins.of([model.twin], recording.cycle)
    sent = recording.sent_position[:, [index]]
    twins.start(recording.position[0, [index]], sent[0])
    at = [
        twins.step(target, load)[0]
        for target, load in zip(sent, recording.load_torque[:, [index]], strict=True)
    ]
    error: FloatArray = sent[:, 0] - np.array(at) + model.remainder.predict(features)
    return error
