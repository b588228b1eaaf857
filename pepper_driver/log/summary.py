"""Metadata of a run for its log, and the summary of a log."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from pepper_driver.backends import Backend
from pepper_driver.backends.log_file import Gap
from pepper_driver.backends.selection import parse_uri
from pepper_driver.config import ControllerSettings, RobotConfig, SafetySettings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.passwords import without_secrets
from pepper_driver.log.reader import RunLog
from pepper_driver.observer import Observer
from pepper_driver.realtime import Quantiles

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
    """Return program, robot, settings and versions of a run as text; no name of a person or a machine.

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
    if "truth" in info.capabilities:
        plant = backend.plant
        known = {"stiffness": plant.stiffness.tolist(), "friction": plant.friction.tolist()}
        metadata["plant"] = _text(known)
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
    return metadata | versions()


def versions() -> dict[str, str]:
    """Return the versions of program, interpreter and libraries, and the kind of this computer, not its name."""
    return {
        "pepper_driver": _version("pepper-driver"),
        "python": platform.python_version(),
        **{name: _version(name) for name in LIBRARIES},
        "machine": f"{platform.system()} {platform.release()} {platform.machine()}, "
        f"{os.cpu_count()} processors",
    }


def _version(package: str) -> str:
    """Return the version of an installed package; a system without metadata must stop no run."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def _text(value: object) -> str:
    return json.dumps(value, sort_keys=True, default=_plain)


def _plain(value: object) -> object:
    """Convert a value that JSON does not know: numbers of NumPy, and arguments of reflexes of other packages."""
    return value.item() if isinstance(value, np.generic) else str(value)


@dataclass(frozen=True, kw_only=True)
class LogSummary:
    """Results of one log.

    Attributes:
        robot: Name of the robot.
        complete: False when the log ends early.
        gaps: What is missing before the end.
        missing: All that is missing, as text in one line.
        duration: From the first tick to the last [s].
        ticks: Number of rows.
        absent: Numbers of cycles between the first and the last that have no row.
        dropped: Ticks between the first and the last that did not get into the log.
        missed: Ticks that were missed, as the run counted them.
        dropped_commands: Commands that the backend dropped.
        tick_end: From the deadline of a tick to its end [ms]; None where ticks were not paced.
        sample_age: Of the samples that ticks worked with [ms]; None without ticks.
        contacts: How many there were, by kind.
        joints: Contacts by the joint that detected them; ``trunk`` for those without a joint.
        reflexes: How often each began to act.
        touches: Labelled ones.
        faults: When the robot was stopped [s], and why.
        metadata: Of the run.
    """

    robot: str
    complete: bool
    gaps: tuple[Gap, ...]
    missing: str
    duration: float
    ticks: int
    absent: int
    dropped: int
    missed: int
    dropped_commands: int
    tick_end: Quantiles | None
    sample_age: Quantiles | None
    contacts: dict[str, int]
    joints: dict[str, int]
    reflexes: dict[str, int]
    touches: int
    faults: tuple[tuple[float, str], ...]
    metadata: dict[str, str]

    def as_json(self) -> dict[str, Any]:
        """``ticks``, ``missed``, ``tick_end_ms.median``, and so on; see ``docs/log.md``."""
        return {
            "robot": self.robot,
            "complete": self.complete,
            "gaps": [asdict(gap) for gap in self.gaps],
            "missing": self.missing,
            "duration": self.duration,
            "ticks": self.ticks,
            "absent": self.absent,
            "dropped": self.dropped,
            "missed": self.missed,
            "dropped_commands": self.dropped_commands,
            "tick_end_ms": None if self.tick_end is None else asdict(self.tick_end),
            "sample_age_ms": None if self.sample_age is None else asdict(self.sample_age),
            "contacts": {"total": sum(self.contacts.values()), **self.contacts},
            "contacts_of": self.joints,
            "reflexes": {"total": sum(self.reflexes.values()), **self.reflexes},
            "touches": self.touches,
            "faults": len(self.faults),
            "fault_reasons": [text for _, text in self.faults],
            "metadata": self.metadata,
        }


def summarise(log: RunLog) -> LogSummary:
    """Return the figures of a log; one without ticks has none."""
    lasting = [contact for contact, _ in log.lasting_contacts()]
    reflexes = (e.name for e in log.events if e.kind == "reflex" and e.phase == "begin")
    time, tick = log["time"], log["tick"]
    return LogSummary(
        robot=log.robot,
        complete=log.complete,
        gaps=log.gaps,
        missing=log.missing,
        duration=float(time[-1] - time[0])
        if len(log) and np.isfinite(time[[0, -1]]).all()
        else 0.0,
        ticks=len(log),
        absent=int(np.maximum(np.diff(tick) - 1, 0).sum()),
        dropped=int((np.diff(log["step"]) - 1).sum()),
        missed=int(log["missed"].max(initial=0)),
        dropped_commands=int(log["dropped_commands"].max(initial=0)),
        tick_end=_milliseconds(log["tick_end"]),
        sample_age=_milliseconds(log["age"]),
        contacts=_counted(contact.kind for contact in lasting),
        joints=_counted(contact.joint or "trunk" for contact in lasting),
        reflexes=_counted(reflexes),
        touches=sum(label.phase == "onset" for label in log.labels),
        faults=tuple(
            (event.time, ": ".join(part for part in (event.name, event.text) if part))
            for event in log.events
            if event.kind == "fault"
        ),
        metadata=log.metadata,
    )


def _milliseconds(seconds: FloatArray) -> Quantiles | None:
    known = 1e3 * seconds[np.isfinite(seconds)]
    return Quantiles.from_values(known) if len(known) else None


def _counted(names: Iterable[str]) -> dict[str, int]:
    """Count each name, the most frequent first."""
    return dict(Counter(names).most_common())
