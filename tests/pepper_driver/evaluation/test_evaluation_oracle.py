"""The oracle on a short simulated episode: it knows what the plant does, but not who pushes."""

import numpy as np
import pytest

from pepper_driver.evaluation.episode_score import watch
from pepper_driver.evaluation.observers_under_test import OracleObserver, untouched_error
from pepper_driver.observer import RecordingBuilder, nrmse_fit
from pepper_driver.robot import Pepper
from support.evaluation import INDEX, JOINTS, ROBOT, recording


@pytest.fixture(scope="module")
def builder() -> RecordingBuilder:
    """A shoulder that moves for two seconds and is pushed in the last of them."""
    builder = RecordingBuilder(ROBOT)
    with Pepper("mujoco://?seed=4", observer=None, robot=ROBOT) as pepper:
        pepper.run(1.5)
        pepper.set_posture({"LShoulderRoll": 0.9})
        pepper.push("LForeArm", [0.0, 25.0, 0.0], duration=0.8, delay=2.0)
        pepper.run(3.0, on_tick=lambda tick, _: builder.append(tick))
    return builder


def test_it_foresees_free_motion_and_nothing_else(builder: RecordingBuilder) -> None:
    run = builder.finish()
    expected = untouched_error(run, "mujoco", ROBOT)
    assert expected.shape == (len(run), JOINTS)
    free = slice(0, round(1.9 / ROBOT.cycle))
    assert nrmse_fit(run.tracking_error(INDEX)[free], expected[free, INDEX]) > 85.0
    # One tick off is worse on both sides: it is paired as the recording is.
    for shift in (-1, 1):
        late = np.roll(expected[:, INDEX], shift)[free]
        assert nrmse_fit(run.tracking_error(INDEX)[free], late) < 85.0
    residual = np.degrees(run.tracking_error(INDEX) - expected[:, INDEX])
    assert np.abs(residual[free]).max() < 0.6
    assert np.abs(residual).max() > 1.5


def test_it_says_when_the_residual_leaves_the_band() -> None:
    run = recording(3.0, np.full(250, 0.1))
    expected = np.zeros((250, JOINTS))
    expected[:100, INDEX] = 0.09  # 0.57 deg off, then 5.7
    watched = watch(OracleObserver(ROBOT, expected), run)
    begins = [c for c in watched.contacts if c.phase == "begin"]
    assert [c.joint for c in begins] == ["LShoulderRoll"]
    assert begins[0].direction == -1
    assert begins[0].detection_time == pytest.approx(105 * ROBOT.cycle)  # the median of 11
    assert watched.expected[50, INDEX] == 0.09
    again = OracleObserver(ROBOT, expected)
    watch(again, run)
    assert watch(again, run).contacts == watched.contacts
    assert "oracle" in again.describe()
