"""Identification: the runs a robot makes, their recordings in a folder, the models fitted to them."""

from pepper_driver.identification.driving import Confirm, Progress
from pepper_driver.identification.fitting import CLOSED_FORM, Fit, FittedModels, fit_models
from pepper_driver.identification.folder import (
    MANIFEST,
    RecordingFolderError,
    finished,
    load_recordings,
    read_manifest,
)
from pepper_driver.identification.identify import (
    Identification,
    chosen_joints,
    fit_folder,
    identify_joints,
    record_joints,
)
from pepper_driver.identification.quality import Finding, inspect_recordings
from pepper_driver.identification.recordings import (
    IdentificationRecordings,
    JointRecordings,
    mirror_joint,
)
from pepper_driver.identification.rehearsal import RehearsalError, rehearse
from pepper_driver.identification.runs import CALIBRATION_STIFFNESS, Run, plan_runs, sweeps_of
from pepper_driver.identification.sharing import SharedFit

__all__ = [
    "CALIBRATION_STIFFNESS",
    "CLOSED_FORM",
    "MANIFEST",
    "Confirm",
    "Finding",
    "Fit",
    "FittedModels",
    "Identification",
    "IdentificationRecordings",
    "JointRecordings",
    "Progress",
    "RecordingFolderError",
    "RehearsalError",
    "Run",
    "SharedFit",
    "chosen_joints",
    "finished",
    "fit_folder",
    "fit_models",
    "identify_joints",
    "inspect_recordings",
    "load_recordings",
    "mirror_joint",
    "plan_runs",
    "read_manifest",
    "record_joints",
    "rehearse",
    "sweeps_of",
]
