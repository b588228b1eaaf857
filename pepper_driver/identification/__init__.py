"""Identification: the runs a robot makes, their recordings in a folder, the models fitted to them."""

from pepper_driver.identification.dataset import (
    MANIFEST,
    IdentificationDataset,
    JointDataset,
    RecordingFolderError,
    finished,
    load_recordings,
    mirror_joint,
    read_manifest,
)
from pepper_driver.identification.fit import CLOSED_FORM, FittedModels, SharedFit, fit_models
from pepper_driver.identification.identify import (
    BlindModelError,
    Confirm,
    Identification,
    Progress,
    chosen_joints,
    fit_folder,
    identify_joints,
    record_joints,
)
from pepper_driver.identification.population import (
    IdentifiedRobot,
    RobotProgress,
    identify_population,
)
from pepper_driver.identification.quality import Finding, inspect_recordings
from pepper_driver.identification.runs import (
    CALIBRATION_STIFFNESS,
    DryRunError,
    IdentificationRun,
    check_dry_run,
    plan_measurements,
    plan_runs,
    sweeps_of,
)

__all__ = [
    "CALIBRATION_STIFFNESS",
    "CLOSED_FORM",
    "MANIFEST",
    "BlindModelError",
    "Confirm",
    "DryRunError",
    "Finding",
    "FittedModels",
    "Identification",
    "IdentificationDataset",
    "IdentificationRun",
    "IdentifiedRobot",
    "JointDataset",
    "Progress",
    "RecordingFolderError",
    "RobotProgress",
    "SharedFit",
    "check_dry_run",
    "chosen_joints",
    "finished",
    "fit_folder",
    "fit_models",
    "identify_joints",
    "identify_population",
    "inspect_recordings",
    "load_recordings",
    "mirror_joint",
    "plan_measurements",
    "plan_runs",
    "read_manifest",
    "record_joints",
    "sweeps_of",
]
