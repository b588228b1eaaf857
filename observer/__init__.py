"""Feels contacts from tracking errors: expected error, residual, detection, isolation, events; fitting and scoring."""

from pepper_driver.observer.closed_form import MotorParameters, expected_error, external_torque
from pepper_driver.observer.contact import Contact
from pepper_driver.observer.contact_observer import ContactObserver
from pepper_driver.observer.fitting import FittingError, fit_joint, nrmse_fit
from pepper_driver.observer.interface import JointState, Observation, Observer
from pepper_driver.observer.model_file import ModelFileError, ModelSet, load_shipped, shipped
from pepper_driver.observer.recording import Recording, RecordingBuilder, RecordingError
from pepper_driver.observer.scoring import RELEASE_GRACE, Felt, Push, Score, score
from pepper_driver.observer.threshold import free_threshold
from pepper_driver.observer.tree import (
    TREE_TYPES,
    AffineTree,
    CartTree,
    ExpectedErrorModel,
    TreeKind,
)

__all__ = [
    "RELEASE_GRACE",
    "TREE_TYPES",
    "AffineTree",
    "CartTree",
    "Contact",
    "ContactObserver",
    "ExpectedErrorModel",
    "Felt",
    "FittingError",
    "JointState",
    "ModelFileError",
    "ModelSet",
    "MotorParameters",
    "Observation",
    "Observer",
    "Push",
    "Recording",
    "RecordingBuilder",
    "RecordingError",
    "Score",
    "TreeKind",
    "expected_error",
    "external_torque",
    "fit_joint",
    "free_threshold",
    "load_shipped",
    "nrmse_fit",
    "score",
    "shipped",
]
