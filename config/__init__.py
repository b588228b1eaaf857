"""Facts of the robot and settings of the software: files in, typed objects out."""

from importlib import import_module
from typing import TYPE_CHECKING

from pepper_driver.config.errors import (
    ConfigError,
    MissingExtraError,
    PepperError,
    UnknownNameError,
    suggestion,
)
from pepper_driver.config.plant import (
    PlantConfig,
    RobotIdentity,
    draws,
    load_plant,
    parent_plants,
    plant_hash,
    plant_names,
)
from pepper_driver.config.robot import JointArray, Posture, RobotConfig, load_robot
from pepper_driver.config.self_collision import (
    Capsule,
    SelfCollisionSettings,
    load_self_collision,
)
from pepper_driver.config.settings import (
    ConstraintSwitches,
    ControllerSettings,
    ObserverSettings,
    SafetySettings,
    load_controller_settings,
    load_observer_settings,
    load_safety_settings,
)

if TYPE_CHECKING:
    from pepper_driver.config.doctor import DoctorSettings, load_doctor_settings
    from pepper_driver.config.experiment import Experiment, load_experiment
    from pepper_driver.config.naoqi import NaoqiSettings, load_naoqi_settings
    from pepper_driver.config.naoqi_services import NaoqiServices, load_naoqi_services
    from pepper_driver.config.network import Network, load_network, network_names
    from pepper_driver.config.recordings import (
        Calibration,
        CalibrationSettings,
        ChaseProtocol,
        ChaseResults,
        Chases,
        HoldStatistics,
        RampProtocol,
        ReferenceData,
        TrackingTable,
        load_calibration,
        load_recordings,
    )
    from pepper_driver.config.world import World, load_world, world_names

__all__ = [
    "Calibration",
    "CalibrationSettings",
    "Capsule",
    "ChaseProtocol",
    "ChaseResults",
    "Chases",
    "ConfigError",
    "ConstraintSwitches",
    "ControllerSettings",
    "DoctorSettings",
    "Experiment",
    "HoldStatistics",
    "JointArray",
    "MissingExtraError",
    "NaoqiServices",
    "NaoqiSettings",
    "Network",
    "ObserverSettings",
    "PepperError",
    "PlantConfig",
    "Posture",
    "RampProtocol",
    "ReferenceData",
    "RobotConfig",
    "RobotIdentity",
    "SafetySettings",
    "SelfCollisionSettings",
    "TrackingTable",
    "UnknownNameError",
    "World",
    "draws",
    "load_calibration",
    "load_controller_settings",
    "load_doctor_settings",
    "load_experiment",
    "load_naoqi_services",
    "load_naoqi_settings",
    "load_network",
    "load_observer_settings",
    "load_plant",
    "load_recordings",
    "load_robot",
    "load_safety_settings",
    "load_self_collision",
    "load_world",
    "network_names",
    "parent_plants",
    "plant_hash",
    "plant_names",
    "suggestion",
    "world_names",
]

# Looked up when first used: a program that only moves a robot needs none of them.
_HOMES = {
    "Calibration": "recordings",
    "CalibrationSettings": "recordings",
    "ChaseResults": "recordings",
    "ChaseProtocol": "recordings",
    "Chases": "recordings",
    "DoctorSettings": "doctor",
    "Experiment": "experiment",
    "HoldStatistics": "recordings",
    "NaoqiServices": "naoqi_services",
    "NaoqiSettings": "naoqi",
    "Network": "network",
    "RampProtocol": "recordings",
    "ReferenceData": "recordings",
    "TrackingTable": "recordings",
    "World": "world",
    "load_calibration": "recordings",
    "load_doctor_settings": "doctor",
    "load_experiment": "experiment",
    "load_naoqi_services": "naoqi_services",
    "load_naoqi_settings": "naoqi",
    "load_network": "network",
    "load_recordings": "recordings",
    "load_world": "world",
    "network_names": "network",
    "world_names": "world",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'pepper_driver.config' has no attribute '{name}'")
    return getattr(import_module(f"pepper_driver.config.{_HOMES[name]}"), name)
