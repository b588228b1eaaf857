"""Plan of ``pepper first-hour``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.loading import STRICT, load, own_or_shipped
from pepper_driver.config.parts import NonNegative, Positive


@dataclass(frozen=True, kw_only=True, config=STRICT)
class FirstHourSettings:
    """Motions of a robot in its first hour, and times of the person; see ``first_hour.yaml``."""

    version: Literal[1]
    experiment: str
    calibration: str
    free: str
    rest: Annotated[float, Field(gt=0, le=3600.0)]
    prompts: str
    session: NonNegative
    confirmation: NonNegative
    weighing: NonNegative
    answer: Positive


def load_first_hour(path: Path | str | None = None) -> FirstHourSettings:
    """Load the plan from ``path``, by default the shipped ``first_hour.yaml``."""
    return load(FirstHourSettings, own_or_shipped(path, "first_hour.yaml"))
