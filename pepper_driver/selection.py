"""Observers by name: those of the project and those that other packages register."""

from __future__ import annotations

from pathlib import Path

from pepper_driver.config import (
    ConfigError,
    ObserverSettings,
    RobotConfig,
    UnknownNameError,
    load_observer_settings,
)
from pepper_driver.config.plugins import load_plugin
from pepper_driver.observer import (
    ContactObserver,
    ModelFileError,
    ModelKind,
    ModelSet,
    Observer,
    load_shipped,
)

OBSERVER_GROUP = "pepper_driver.observers"
"""Entry-point group for observers: ``name = "module:factory"``, factory(robot, identity, models) -> Observer."""

_OBSERVERS = {
    "fusion": "pepper_driver.selection:fusion_observer",
    "momentum": "pepper_driver.selection:momentum_observer",
    "paper": "pepper_driver.selection:paper_observer",
}


def make_observer(
    name: str, robot: RobotConfig, identity: str, models: Path | None = None
) -> Observer:
    """The observer of this name.

    Args:
        name: ``fusion``, ``paper``, the baseline ``momentum``, or what another package registered.
        robot: Description of the robot.
        identity: Of the backend that will be observed.
        models: Model file; None for the one shipped for this robot.

    Raises:
        UnknownNameError: No observer of this name.
        ModelFileError: The models cannot be used here.
        ConfigError: What another package registered makes no observer.
    """
    factory = load_plugin("observer", OBSERVER_GROUP, name, _OBSERVERS)
    observer = factory(robot, identity, models)
    if not isinstance(observer, Observer):
        raise ConfigError(
            f"observer '{name}': its factory returned {type(observer).__name__}, no Observer"
        )
    return observer


def check_observer(name: str, models: Path | None) -> None:
    """Check what can be known of an observer before its robot is.

    Raises:
        UnknownNameError: No observer of this name.
        ModelFileError: There is no such file of models.
    """
    load_plugin("observer", OBSERVER_GROUP, name, _OBSERVERS)
    if models is not None and not models.is_file():
        raise ModelFileError(f"{models}: there is no such file of models")


def contact_observer(
    mode: str,
    robot: RobotConfig,
    identity: str,
    models: Path | None,
    settings: ObserverSettings,
) -> ContactObserver:
    """The observer of the project of this mode, with the models of ``models`` or the shipped ones.

    Raises:
        UnknownNameError: No such mode.
        ModelFileError: The models cannot be used here.
    """
    if mode not in _OBSERVERS:
        raise UnknownNameError("mode of the observer", mode, _OBSERVERS)
    shipped: ModelKind = settings.tree if mode == "paper" else "fusion"
    kinds: tuple[ModelKind, ...] = ("cart", "affine") if mode == "paper" else ("fusion",)
    return ContactObserver(
        robot,
        find_models(identity, models, shipped, kinds),
        settings,
        momentum=mode == "momentum",
    )


def paper_observer(robot: RobotConfig, identity: str, models: Path | None) -> ContactObserver:
    """The observer of the paper."""
    return contact_observer("paper", robot, identity, models, load_observer_settings())


def fusion_observer(robot: RobotConfig, identity: str, models: Path | None) -> ContactObserver:
    """The observer that goes beyond the paper."""
    return contact_observer("fusion", robot, identity, models, load_observer_settings())


def momentum_observer(robot: RobotConfig, identity: str, models: Path | None) -> ContactObserver:
    """A momentum observer with the constants of fusion models: a baseline to compare with."""
    return contact_observer("momentum", robot, identity, models, load_observer_settings())


def find_models(
    identity: str, path: Path | None, shipped: ModelKind, kinds: tuple[ModelKind, ...]
) -> ModelSet:
    """The models of a file, or those of kind ``shipped`` that come with the package.

    Args:
        identity: Of the robot's backend.
        path: The file; None for those of the package.
        shipped: Their kind.
        kinds: That will do.

    Raises:
        ModelFileError: There are none, or they are of another robot or of another kind.
    """
    if path is None:
        return load_shipped(shipped, identity)
    models = ModelSet.load(path)
    if models.identity != identity:
        raise ModelFileError(
            f"{path}: identified on another robot ({models.identity}, this one is {identity}); "
            "identify this one with 'pepper identify'"
        )
    if models.kind not in kinds:
        mode = "fusion" if models.kind == "fusion" else "paper"
        raise ModelFileError(
            f"{path}: these are models of kind '{models.kind}', for the observer '{mode}'; "
            f"this one needs {' or '.join(kinds)}, from 'pepper identify --kind {kinds[-1]}'"
        )
    return models
