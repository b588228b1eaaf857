"""What a log says of the run it belongs to."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from pepper_driver.backends import Backend
from pepper_driver.backends.selection import parse_uri
from pepper_driver.config import ControllerSettings, RobotConfig, SafetySettings
from pepper_driver.config.passwords import without_secrets
from pepper_driver.observer import Observer

LIBRARIES = ("numpy", "mujoco", "pin", "daqp", "mcap")
"""Whose versions decide what a run gives, or how it was written."""


def run_metadata(
    backend: Backend,
    observer: Observer | None,
    robot: RobotConfig,
    controller: ControllerSettings,
    safety: SafetySettings,
    *,
    observer_name: str | None = None,
    reflexes: Sequence[Mapping[str, object]] = (),
) -> dict[str, str]:
    """Who runs what on which robot, with which settings and versions, as text; no name of a person or a machine.

    Args:
        backend: Of the robot.
        observer: Or None.
        robot: Its description.
        controller: Settings in force.
        safety: Settings in force.
        observer_name: By which it was asked for; None for an object.
        reflexes: As declared, see :func:`pepper_driver.reflexes.declared.declare`.
    """
    info = backend.info
    settings = {"controller": _text(asdict(controller)), "safety": _text(asdict(safety))}
    metadata = {
        "start": datetime.now(UTC).isoformat(timespec="seconds"),
        "backend": without_secrets(backend.uri),
        "robot": robot.name,
        "identity": info.identity,
        "cycle": str(info.cycle),
        "response_delay": str(info.response_delay),
        "observer": observer.describe() if observer is not None else "none",
        "reflexes": _text(reflexes),
    }
    if info.parents:
        metadata["parents"] = _text([asdict(parent) for parent in info.parents])
    if (seed := parse_uri(backend.uri).query.get("seed")) is not None:
        metadata["seed"] = seed
    if observer_name is not None:
        metadata["observer_name"] = observer_name
    if observer is not None:
        for name, text in observer.provenance().items():
            metadata[f"observer_{name}"] = text
    for name, text in settings.items():
        metadata[f"{name}_settings"] = text
        metadata[f"{name}_settings_sha256"] = hashlib.sha256(text.encode()).hexdigest()
    return {
        **metadata,
        "pepper_driver": _version("pepper-driver"),
        "python": platform.python_version(),
        **{name: _version(name) for name in LIBRARIES},
        "machine": f"{platform.system()} {platform.release()} {platform.machine()}, "
        f"{os.cpu_count()} processors",
    }


def _version(package: str) -> str:
    """Of an installed package; some systems install without saying so, which must stop no run."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def _text(value: object) -> str:
    return json.dumps(value, sort_keys=True, default=_plain)


def _plain(value: object) -> object:
    """What JSON does not know: numbers of NumPy, and what reflexes of other packages are made with."""
    return value.item() if isinstance(value, np.generic) else str(value)
