"""Observers by name: those of the project and those that other packages register."""

from __future__ import annotations

from pathlib import Path

from pepper_driver.config import RobotConfig, load_observer_settings
from pepper_driver.config.plugins import load_plugin
from pepper_driver.observer import (
    ContactObserver,
    ModelFileError,
    ModelSet,
    Observer,
    load_shipped,
)

OBSERVER_GROUP = "pepper_driver.observers"
"""Entry-point group for observers: ``name = "module:factory"``, factory(robot, identity, models) -> Observer."""

_OBSERVERS = {"paper": "pepper_driver.selection:paper_observer"}


def make_observer(
    name: str, robot: RobotConfig, identity: str, models: Path | None = None
) -> Observer:
    """The observer of this name.

    Args:
        name: ``paper``, or what another package registered.
        robot: Description of the robot.
        identity: Of the backend that will be observed.
        models: Model file; None for the one shipped for this robot.

    Raises:
        UnknownNameError: No observer of this name.
        ModelFileError: The models cannot be used here.
    """
    factory = load_plugin("observer", OBSERVER_GROUP, name, _OBSERVERS)
    observer: Observer = factory(robot, identity, models)
    return observer


def paper_observer(robot: RobotConfig, identity: str, models: Path | None) -> ContactObserver:
    """The observer of the paper, with the models of ``models`` or the shipped ones."""
    settings = load_observer_settings()
    if models is None:
        return ContactObserver(robot, load_shipped(settings.tree, identity), settings)
    model_set = ModelSet.load(models)
    if model_set.identity != identity:
        raise ModelFileError(
            f"{models}: identified on another robot ({model_set.identity}, this one is {identity}); "
            "identify this one with 'pepper identify'"
        )
    return ContactObserver(robot, model_set, settings)
