"""Levels of the doctor."""

from pathlib import Path

import pytest

from pepper_driver.config import ConfigError, load_doctor_settings
from pepper_driver.config.loading import package_file


def test_the_shipped_levels_load() -> None:
    assert load_doctor_settings().motion == 20.0


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("tilt_failure: 0.14", "tilt_failure: 0.01", "tilt_warning"),
        ("gravity: [9.3, 10.3]", "gravity: [10.3, 9.3]", "gravity"),
        ("amplitude: 0.09", "amplitude: 1.0", "amplitude"),
        ("min_following_ratio: 0.3", "min_following_ratio: 0.3\nmin_folowing: 0.3", "min_folowing"),
    ],
)
def test_wrong_levels_are_refused(tmp_path: Path, old: str, new: str, word: str) -> None:
    text = package_file("doctor.yaml").read_text()
    assert f"\n{old}" in text
    path = tmp_path / "doctor.yaml"
    path.write_text(text.replace(f"\n{old}", f"\n{new}"))
    with pytest.raises(ConfigError, match=word):
        load_doctor_settings(path)
