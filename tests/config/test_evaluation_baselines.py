"""Factors of the baselines: complete, positive, and with their provenance."""

from pathlib import Path

import pytest

from pepper_driver.config import ConfigError
from pepper_driver.config.evaluation_baselines import (
    STATIC_BASELINES,
    load_evaluation_baselines,
)

TEXT = """version: 1
factors:
  momentum: 1.0
  paper-affine: 1.0
  paper-cart: 1.0
  error: 1.0
chosen_on: nothing
"""


def test_each_static_baseline_has_a_factor(tmp_path: Path) -> None:
    shipped = load_evaluation_baselines()
    assert set(shipped.factors) == set(STATIC_BASELINES)
    # At the published thresholds each has more false contacts than ours.
    assert min(shipped.factors.values()) > 1.0
    path = tmp_path / "own.yaml"
    path.write_text(TEXT.replace("momentum: 1.0", "momentum: 2.5"))
    assert load_evaluation_baselines(path).factors["momentum"] == 2.5


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("  error: 1.0\n", "", "none for 'error'"),
        ("  error: 1.0", "  error: 1.0\n  fusion: 2.0", "one for 'fusion'"),
        ("error: 1.0", "error: 0.0", "error"),
        ("version: 1", "version: 2", "version"),
        ("chosen_on: nothing", "chosen: nothing", "chosen"),
    ],
)
def test_a_wrong_file_is_refused(tmp_path: Path, old: str, new: str, text: str) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(TEXT.replace(old, new))
    with pytest.raises(ConfigError, match=f"own.yaml.*{text}"):
        load_evaluation_baselines(path)
