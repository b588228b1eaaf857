"""Factors on the thresholds of baselines that are compared at the false contacts of the project's own observer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import STRICT, load, own_or_shipped

STATIC_BASELINES = ("momentum", "paper-affine", "paper-cart", "error")
"""Baselines with a constant threshold, each of which has a factor."""

Factor = Annotated[float, Field(gt=0.0, le=100.0)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class EvaluationBaselines:
    """Content of ``evaluation_baselines.yaml``.

    Attributes:
        version: Of its format.
        factors: By baseline, factor on its published threshold.
        chosen_on: Takes and code on which the factors were chosen.
    """

    version: Literal[1]
    factors: dict[str, Factor]
    chosen_on: Annotated[str, Field(min_length=1)]

    def __post_init__(self) -> None:
        """Check that each baseline has a factor."""
        for name in STATIC_BASELINES:
            if name not in self.factors:
                raise ValueError(f"'factors' has none for '{name}'")
        for name in self.factors:
            if name not in STATIC_BASELINES:
                raise ValueError(
                    f"'factors' has one for '{name}', possible are {', '.join(STATIC_BASELINES)}"
                )


@with_lines
def load_evaluation_baselines(path: Path | str | None = None) -> EvaluationBaselines:
    """Load the factors from ``path``, by default the shipped ``evaluation_baselines.yaml``.

    Raises:
        ConfigError: The file is wrong.
    """
    return load(EvaluationBaselines, own_or_shipped(path, "evaluation_baselines.yaml"))
