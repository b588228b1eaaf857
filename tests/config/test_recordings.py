"""Figures of real robots: complete, of known joints, tables whose rows and columns fit."""

from pathlib import Path

import numpy as np
import pytest

from pepper_driver.config import ConfigError, load_calibration, load_recordings, load_robot
from pepper_driver.config.loading import package_file

ROBOT = load_robot()


def test_the_shipped_tables_leave_standing_still_out() -> None:
    tables = load_recordings(ROBOT).tables
    assert {name: table.error.shape for name, table in tables.items()} == {
        "LShoulderRoll": (7, 22),
        "RElbowRoll": (5, 20),
    }
    table = tables["LShoulderRoll"]
    assert 0.0 in table.velocity
    assert 0.0 not in table.moving
    row, column = table.torque.index(0.0), table.moving.index(0.05)
    assert np.degrees(table.error[row, column]) == pytest.approx(0.65)
    assert np.degrees(table.error[-1, -1]) == pytest.approx(1.50)
    assert np.degrees(tables["RElbowRoll"].error[0, 0]) == pytest.approx(-3.41)


def test_the_shipped_holds_are_of_the_right_arm() -> None:
    recordings = load_recordings(ROBOT)
    assert set(recordings.holds) <= set(ROBOT.chains["right_arm"])
    assert len(recordings.holds) == 5
    for holds in recordings.holds.values():
        assert holds.median_deg < holds.p90_deg < holds.max_deg
        assert list(holds.signed_deg) == sorted(holds.signed_deg)
        assert holds.current[0] <= holds.current[1]
    assert recordings.holds["RShoulderRoll"].p90_deg == 1.10


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("  RElbowRoll:\n    velocity", "  RElbowRol:\n    velocity", "tables.*RElbowRol"),
        ("  RWristYaw:", "  RWristYawn:", "holds.*RWristYawn"),
        ("[-3.41, -3.05,", "[-3.41,", "RElbowRoll.expected_error_deg.*5 rows of 21"),
        ("hold_time: 2.0", "hold_tim: 2.0", "hold_time"),
        ("median_deg: 0.50", "median_deg: -0.50", "median_deg"),
    ],
)
def test_a_wrong_file_is_reported(tmp_path: Path, old: str, new: str, words: str) -> None:
    text = package_file("recordings.yaml").read_text()
    assert old in text
    path = tmp_path / "recordings.yaml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError, match=words) as caught:
        load_recordings(ROBOT, path)
    assert str(path) in str(caught.value)


def test_calibration_measures_what_was_recorded() -> None:
    calibration = load_calibration(ROBOT)
    assert calibration.holds.joints == tuple(calibration.recordings.holds)
    assert calibration.holds.hold == calibration.recordings.hold_time
    assert set(calibration.settings.largest_residual_deg) == set(calibration.recordings.tables)
    assert calibration.settings.fit_seed != calibration.seed, "the check is not of the fitted goals"
