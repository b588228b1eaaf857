"""Observers by name: those of the project and those that other packages register."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from pepper_driver.backends.selection import parse_uri, takes_delay, with_delay
from pepper_driver.config import (
    ConfigError,
    ObserverSettings,
    RobotConfig,
    RobotIdentity,
    UnknownNameError,
    load_observer_settings,
)
from pepper_driver.config.plugins import load_plugin, make_part, plugin_names
from pepper_driver.observer import (
    ContactObserver,
    FusionModel,
    ModelFileError,
    ModelKind,
    ModelSet,
    Observer,
    load_shipped,
)
from pepper_driver.observer.models.measured_robot import MeasuredRobot
from pepper_driver.safety.plugins import dry_run_observer

logger = logging.getLogger("pepper_driver")

OBSERVER_GROUP = "pepper_driver.observers"
"""Entry-point group for observers: ``name = "module:factory"``, factory(robot, identities, models) -> Observer."""

_OBSERVERS = {
    "fusion": "pepper_driver.observers:fusion_observer",
    "momentum": "pepper_driver.observers:momentum_observer",
    "paper": "pepper_driver.observers:paper_observer",
}


def observer_names() -> list[str]:
    """Return the names of observers, those of other packages too."""
    return list(plugin_names(OBSERVER_GROUP, _OBSERVERS))


def make_observer(
    name: str,
    robot: RobotConfig,
    identities: Sequence[RobotIdentity],
    models: Path | None = None,
) -> Observer:
    """Make the observer of this name.

    Args:
        name: ``fusion``, ``paper``, the baseline ``momentum``, or what another package registered.
        robot: Description of the robot.
        identities: Of the backend that will be observed: robots whose models serve it, itself first.
        models: Model file; None for the one shipped for this robot.

    Raises:
        UnknownNameError: No observer of this name.
        ModelFileError: The models cannot be used here.
        ConfigError: What another package registered makes no observer.
        PluginError: That of another package cannot be loaded, or fails.
        PluginInterfaceError: What it makes fails in a dry run.
    """
    factory = load_plugin("observer", OBSERVER_GROUP, name, _OBSERVERS)
    observer = make_part("observer", name, factory, robot, identities, models)
    if not isinstance(observer, Observer):
        raise ConfigError(
            f"observer '{name}': its factory returned {type(observer).__name__}, no Observer"
        )
    dry_run_observer(observer, robot)
    return observer


def check_observer(name: str, models: Path | None) -> None:
    """Check what can be known of an observer before its robot is.

    Raises:
        UnknownNameError: No observer of this name.
        ModelFileError: There is no such file.
    """
    load_plugin("observer", OBSERVER_GROUP, name, _OBSERVERS)
    if models is not None and not models.is_file():
        what = "it is a folder" if models.is_dir() else "there is no such file"
        raise ModelFileError(f"{models}: cannot be read ({what})")


def contact_observer(
    mode: str,
    robot: RobotConfig,
    identities: Sequence[RobotIdentity],
    models: Path | None,
    settings: ObserverSettings,
) -> ContactObserver:
    """Make the observer of the project of this mode, with the models of ``models`` or the shipped ones.

    Models of another robot are reported in the log.

    Raises:
        UnknownNameError: No such mode.
        ModelFileError: The models cannot be used here.
    """
    if mode not in _OBSERVERS:
        raise UnknownNameError("mode of the observer", mode, _OBSERVERS)
    shipped: ModelKind = settings.tree if mode == "paper" else "fusion"
    kinds: tuple[ModelKind, ...] = ("cart", "affine") if mode == "paper" else ("fusion",)
    found = find_models(identities, models, shipped, kinds)
    source = source_of(found, identities)
    if source != identities[0]:
        logger.warning(
            "'%s' uses the models of plant '%s', of which it is a variant",
            identities[0].name,
            source.name,
        )
    return ContactObserver(robot, found, settings, momentum=mode == "momentum")


def paper_observer(
    robot: RobotConfig, identities: Sequence[RobotIdentity], models: Path | None
) -> ContactObserver:
    """Return the observer of the paper."""
    return contact_observer("paper", robot, identities, models, load_observer_settings())


def fusion_observer(
    robot: RobotConfig, identities: Sequence[RobotIdentity], models: Path | None
) -> ContactObserver:
    """Return the observer that goes beyond the paper."""
    return contact_observer("fusion", robot, identities, models, load_observer_settings())


def momentum_observer(
    robot: RobotConfig, identities: Sequence[RobotIdentity], models: Path | None
) -> ContactObserver:
    """Return a momentum observer with the constants of fusion models: a baseline to compare with."""
    return contact_observer("momentum", robot, identities, models, load_observer_settings())


def find_models(
    identities: Sequence[RobotIdentity],
    path: Path | None,
    shipped: ModelKind,
    kinds: tuple[ModelKind, ...],
) -> ModelSet:
    """Load the models of a file, or those of kind ``shipped`` that come with the package.

    Args:
        identities: Robots whose models serve the one observed, itself first.
        path: The file; None for those of the package.
        shipped: Their kind.
        kinds: That will do.

    Raises:
        ModelFileError: Models do not exist, or are of another robot or of another kind.
    """
    if path is None:
        return load_shipped(shipped, identities)
    models = ModelSet.load(path)
    if all(models.identity != robot.identity for robot in identities):
        raise ModelFileError(
            f"{path}: identified on another robot than '{identities[0].name}'; "
            "identify this one with 'pepper identify'"
        )
    if models.kind not in kinds:
        mode = "fusion" if models.kind == "fusion" else "paper"
        raise ModelFileError(
            f"{path}: these are models of kind '{models.kind}', for the observer '{mode}'; "
            f"this one needs {' or '.join(kinds)}, from 'pepper identify --model-type {kinds[-1]}'"
        )
    return models


def source_of(models: ModelSet, identities: Sequence[RobotIdentity]) -> RobotIdentity:
    """Return which of the robots models were identified on; they were found for these."""
    return next(robot for robot in identities if robot.identity == models.identity)


def measured_robot(models: Path | ModelSet | None) -> MeasuredRobot | None:
    """Return the facts about the robot that are kept with its models.

    Args:
        models: Those of the robot, or their file; None for none.

    Raises:
        ModelFileError: The file is wrong.
    """
    if models is None:
        return None
    return (models if isinstance(models, ModelSet) else ModelSet.load(models)).measured


def friction_errors(models: Path | ModelSet | None) -> dict[str, float]:
    """Return by joint half of what it takes away from a swing, from peak to peak [rad].

    The motor turns from friction in motion one way to friction at rest the other way, through the board's dead band. A
    gap is not in the models: motor and link cross it while friction holds the link, which takes time, but no command.

    Args:
        models: Those of the robot, or their file; None for none. Only those of kind ``fusion`` have friction.

    Raises:
        ModelFileError: The file is wrong.
    """
    if models is None:
        return {}
    known = models if isinstance(models, ModelSet) else ModelSet.load(models)
    return {
        joint: model.twin.friction * (1.0 + model.twin.breakaway) / 2.0 + model.twin.dead_band
        for joint, model in known.models.items()
        if isinstance(model, FusionModel)
    }


def uri_with_measured_delay(uri: str, measured: MeasuredRobot | None) -> str:
    """Return the URI of a robot with the response delay that was measured.

    A delay in the URI itself comes first, and a robot that knows its own needs none.

    Args:
        uri: Of the backend.
        measured: Facts about the robot; None where it was not measured.
    """
    if measured is None or not takes_delay(uri) or "delay" in parse_uri(uri).query:
        return uri
    return with_delay(uri, measured.response_delay)


def warn_of_assumed_delay(uri: str, models: Path, measured: MeasuredRobot | None) -> None:
    """Warn where the response delay of a robot is only that of the settings: neither URI nor models have it.

    Args:
        uri: Of the backend.
        models: Their file.
        measured: Facts about the robot that the file has.
    """
    if measured is None and takes_delay(uri) and "delay" not in parse_uri(uri).query:
        logger.warning(
            "%s: without the response delay of the robot; that of naoqi_settings.yaml is assumed, and a wrong one "
            "causes false contacts. 'pepper doctor' measures it, '?delay=' in the address sets it",
            models,
        )
