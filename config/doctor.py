"""Levels of ``pepper doctor``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.loading import STRICT, load, own_or_shipped
from pepper_driver.config.parts import Positive

UnitInterval = Annotated[float, Field(ge=0, le=1)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class DoctorSettings:
    """Limits of the checks; see ``doctor.yaml`` for the meaning of each."""

    inspection_time: Annotated[float, Field(ge=0.5)]
    max_drift: Positive
    tilt_warning: Positive
    tilt_failure: Positive
    gravity: tuple[Positive, Positive]
    wheel_rest: Positive
    clock_rate: UnitInterval
    clock_jump: Positive
    late_fraction: UnitInterval
    motion: Annotated[float, Field(ge=5.0, le=60.0)]
    segment_time: Annotated[float, Field(ge=1.0)]
    amplitude: Annotated[float, Field(gt=0, le=0.2)]
    hand_amplitude: Annotated[float, Field(gt=0, le=0.5)]
    limit_distance: Positive
    clearance: Positive
    clearance_motion: dict[str, float]
    min_following_ratio: UnitInterval
    worn_rms: Positive
    worn_peak: Positive
    misfit_peak: Positive
    misfit_median: Positive

    def __post_init__(self) -> None:
        """Check what spans fields: warnings come before failures."""
        if self.tilt_warning > self.tilt_failure:
            raise ValueError("'tilt_warning' must not be above 'tilt_failure'")
        if self.gravity[0] > self.gravity[1]:
            raise ValueError("'gravity' must be the lower bound, then the upper one")


def load_doctor_settings(path: Path | str | None = None) -> DoctorSettings:
    """Levels from ``path``, by default the shipped ``doctor.yaml``."""
    return load(DoctorSettings, own_or_shipped(path, "doctor.yaml"))
