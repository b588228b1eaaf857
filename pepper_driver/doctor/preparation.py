"""Checks of what is not the robot: settings in force, this computer, the models."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from pepper_driver.backends import Backend
from pepper_driver.config import ControllerSettings, RobotConfig, RobotIdentity, SafetySettings
from pepper_driver.doctor.body import named
from pepper_driver.doctor.result import Result, rated
from pepper_driver.observer import ModelSet
from pepper_driver.observers import source_of
from pepper_driver.realtime import priority_obstacle


def check_settings(safety: SafetySettings, controller: ControllerSettings) -> Result:
    """Whether nothing that protects is switched off."""
    found = (
        f"fault at {np.degrees(safety.divergence):.0f} deg from the command for {safety.divergence_time:g} s, "
        f"at samples {safety.stale_fault * 1e3:.0f} ms old, at {safety.temperature_fault:.0f} deg C"
    )
    off = []
    if not safety.chest_button:
        off.append("the chest button stops nothing (safety.yaml: chest_button)")
    for name in ("self_collision", "balance", "coupled_limits"):
        if not getattr(controller.constraints, name):
            off.append(f"no {name.replace('_', ' ')} (controller.yaml: constraints.{name})")
    if controller.velocity == "robot":
        off.append("joints at the robot's full speed (controller.yaml: velocity)")
    return rated(
        "settings",
        "; ".join([found, *off]),
        warning=bool(off),
        cure="set back in these files what was not meant",
    )


def check_computer(backend: Backend) -> Result:
    """Whether ticks can come in time here."""
    found = f"Python {platform.python_version()}, {os.cpu_count()} processors"
    if not backend.real_time:
        return rated("computer", f"{found}; simulated time needs no priority")
    obstacle = priority_obstacle()
    if obstacle:
        reason, _, cure = obstacle.partition("; ")
        return rated(
            "computer",
            f"{found}; {reason}: ticks may come late",
            warning=True,
            cure=cure or "run it on Linux",
        )
    return rated("computer", f"{found}; real-time priority permitted")


def check_models(
    models: ModelSet, identities: Sequence[RobotIdentity], robot: RobotConfig
) -> Result:
    """Check that models are of all joints and of this version; they were found for these ``identities``."""
    here, source = _version(), source_of(models, identities)
    without = [name not in models.models for name in robot.joint_names]
    found = (
        f"{models.kind} models of {len(models.models)} of {len(without)} joints, "
        f"identified on '{source.name}', "
        f"{'' if source == identities[0] else 'of which it is a variant, '}version {models.version}"
    )
    cures = []
    if any(without):
        cures.append(
            f"identify {named(robot.joint_names, without)} too: there nothing is felt directly"
        )
    if models.version != here:
        found += f" (this is {here})"
        cures.append("identify again ('pepper identify') where this version's notes say so")
    return rated("models", found, warning=bool(cures), cure="; ".join(cures))


def _version() -> str:
    """Of this package; some systems install without saying so."""
    try:
        return version("pepper-driver")
    except PackageNotFoundError:
        return "unknown"
