"""Detection of contacts from tracking errors: expected error, residual, isolation, events; fitting and scoring."""

from pepper_driver.observer.contact_observer import ContactObserver
from pepper_driver.observer.fitting.bounds import free_threshold
from pepper_driver.observer.fitting.fusion import fit_fusion, fit_joint_fusion
from pepper_driver.observer.fitting.tree import FitScore, FittingError, fit_joint, nrmse_fit
from pepper_driver.observer.interface import Contact, HandLoad, JointState, Observation, Observer
from pepper_driver.observer.models.closed_form import (
    MotorParameters,
    expected_error,
    external_torque,
)
from pepper_driver.observer.models.fusion_model import BaseModel, FusionModel
from pepper_driver.observer.models.model_file import (
    MODEL_TYPES,
    JointModel,
    ModelFileError,
    ModelKind,
    ModelSet,
    load_shipped,
    predict_recording,
    shipped,
)
from pepper_driver.observer.models.tree import (
    TREE_TYPES,
    AffineTree,
    CartTree,
    ExpectedErrorModel,
    TreeKind,
)
from pepper_driver.observer.recording import Recording, RecordingBuilder, RecordingError
from pepper_driver.observer.scoring import (
    RELEASE_GRACE,
    ContactScore,
    DetectedPush,
    KnownPush,
    score,
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
    "ContactScore",
    "DetectedPush",
    "ExpectedErrorModel",
    "FitScore",
    "FittingError",
    "FusionModel",
    "HandLoad",
    "JointModel",
    "JointState",
    "KnownPush",
    "ModelFileError",
    "ModelKind",
    "ModelSet",
    "MotorParameters",
    "Observation",
    "Observer",
    "Recording",
    "RecordingBuilder",
    "RecordingError",
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
