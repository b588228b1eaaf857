"""Experiments to be performed on a robot without physics, or on the simulated one."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from event_cases import Scripted

from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import load_experiment, load_robot
from pepper_driver.experiment import ExperimentRun
from pepper_driver.observer import Contact

ROBOT = load_robot()
EXAMPLES = sorted((Path(__file__).parents[2] / "examples" / "experiments").glob("*.yaml"))
STAND: dict[str, Any] = {"name": "stand", "posture": "Stand", "duration": 0.1}
TURN: dict[str, Any] = {"name": "turn", "joints": {"HeadYaw": 0.2}, "duration": 0.5}


def listen(name: str = "listen", timeout: float = 0.6, **more: Any) -> dict[str, Any]:
    return {"name": name, "wait": {"for": "contact", "timeout": timeout, **more}}


def write(folder: Path, *steps: dict[str, Any], **more: Any) -> Path:
    path = folder / "mine.yaml"
    content = {"schema": 1, "name": "mine", **more, "steps": list(steps)}
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def fake(
    monkeypatch: pytest.MonkeyPatch, backend: MockBackend | None = None
) -> tuple[MockBackend, Scripted]:
    """A robot without physics, and what it feels, in place of all others."""
    backend, observer = backend or MockBackend(), Scripted()
    monkeypatch.setattr("pepper_driver.robot.make_backend", lambda *_: backend)
    monkeypatch.setattr("pepper_driver.robot.make_observer", lambda *_: observer)
    return backend, observer


def make_run(
    monkeypatch: pytest.MonkeyPatch,
    folder: Path,
    *steps: dict[str, Any],
    at: Mapping[int, tuple[Contact, ...]] | None = None,
    backend: MockBackend | None = None,
    **more: Any,
) -> ExperimentRun:
    """An experiment whose robot feels contacts in given ticks, counted from 1; the experiment begins with the first."""
    _, observer = fake(monkeypatch, backend)
    observer.at = dict(at or {})
    return ExperimentRun(load_experiment(write(folder, *steps, **more), ROBOT))
