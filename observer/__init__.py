"""Feels contacts from tracking errors: expected error, residual, detection, isolation, events; fitting and scoring."""

from pepper_driver.observer.base import BaseModel
from pepper_driver.observer.closed_form import MotorParameters, expected_error, external_torque
from pepper_driver.observer.contact import Contact
from pepper_driver.observer.contact_observer import ContactObserver
from pepper_driver.observer.fitting import FittingError, fit_joint, nrmse_fit
from pepper_driver.observer.fusion_fitting import fit_fusion, fit_joint_fusion
from pepper_driver.observer.fusion_model import FusionModel
from pepper_driver.observer.hand_load import HandLoad
from pepper_driver.observer.interface import JointState, Observation, Observer
from pepper_driver.observer.model_file import (
    MODEL_TYPES,
    ModelFileError,
    ModelKind,
    ModelSet,
    load_shipped,
    shipped,
)
from pepper_driver.observer.prediction import JointModel, predict_recording
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
    "MODEL_TYPES",
    "RELEASE_GRACE",
    "TREE_TYPES",
    "AffineTree",
    "BaseModel",
    "CartTree",
    "Contact",
    "ContactObserver",
    "ExpectedErrorModel",
    "Felt",
    "FittingError",
    "FusionModel",
    "HandLoad",
    "JointModel",
    "JointState",
    "ModelFileError",
    "ModelKind",
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
    "fit_fusion",
    "fit_joint",
    "fit_joint_fusion",
    "free_threshold",
    "load_shipped",
    "nrmse_fit",
    "predict_recording",
    "score",
    "shipped",
]
