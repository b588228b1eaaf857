"""Identification drives the robot as Sec. IV says, and gives the same models whatever does the work."""

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config import ConfigError, UnknownNameError, load_robot, load_scenario
from pepper_driver.identify import (
    CLOSED_FORM,
    identify_joints,
    record_joints,
    record_run,
    sweeps_of,
)

ROBOT = load_robot()
FULL = load_scenario("identify", ROBOT)
SHORT = replace(
    FULL,
    motion=replace(
        sweeps_of(FULL),
        estimation_stiffness=(2.0, 4.0),
        sweeps=1,
        setpoints=2,
        dwell=(0.6, 1.2),
    ),
)


def test_one_run_moves_the_joint_and_changes_its_neighbours_half_way() -> None:
    run = record_run("mujoco", "LShoulderRoll", SHORT, 9.0, (1, 2))
    index = ROBOT.joint_index("LShoulderRoll")
    half = len(run) // 2
    # The main joint repeats its sequence: once its start is forgotten, the same commands.
    first, second = run.sent_position[:half, index], run.sent_position[half:, index]
    np.testing.assert_allclose(first[-100:], second[-100:], atol=0.02)
    assert np.ptp(second) > 0.3
    for name in ("LShoulderPitch", "LElbowYaw"):
        neighbour = run.sent_position[:, ROBOT.joint_index(name)]
        assert np.ptp(neighbour[: half - 5]) < 0.35
        assert abs(neighbour[-1] - neighbour[half - 5]) > 0.02
    for name in ("RShoulderRoll", "HeadYaw", "KneePitch"):
        assert np.ptp(run.sent_position[:, ROBOT.joint_index(name)]) < 0.02
    assert (run.sent_position >= ROBOT.lower).all()
    assert (run.sent_position <= ROBOT.upper).all()
    assert not run.changed.any()


def test_a_stiffer_task_moves_faster() -> None:
    speeds = [
        np.abs(record_run("mujoco", "RElbowRoll", SHORT, k, (1, 2)).velocity).max() for k in (2, 9)
    ]
    assert speeds[1] > 1.5 * speeds[0]


def test_the_result_does_not_depend_on_who_does_the_work() -> None:
    alone = record_joints("mujoco", ["RElbowRoll"], SHORT, workers=1)
    together = record_joints("mujoco", ["RElbowRoll"], SHORT, workers=2)
    for a, b in zip(
        (*alone[0].estimation, alone[0].test),
        (*together[0].estimation, together[0].test),
        strict=True,
    ):
        assert a.position.tobytes() == b.position.tobytes()


def test_the_test_run_is_the_fastest_and_the_estimation_runs_grow() -> None:
    recordings = record_joints("mujoco", ["RElbowRoll"], SHORT, workers=1)[0]
    index = ROBOT.joint_index("RElbowRoll")
    # Of the same error, a stiffer task makes the larger acceleration.
    peaks = [
        np.abs(run.acceleration[:, index]).max()
        for run in (*recordings.estimation, recordings.test)
    ]
    assert peaks == sorted(peaks)


def test_runs_differ_in_motion_and_noise() -> None:
    recordings = record_joints("mujoco", ["RElbowRoll"], SHORT, workers=1)[0]
    first, second = recordings.estimation
    index = ROBOT.joint_index("RElbowRoll")
    assert abs(first.sent_position[-1, index] - second.sent_position[-1, index]) > 1e-3


def test_models_come_with_fits_of_all_methods() -> None:
    told: list[tuple[int, int]] = []
    result = identify_joints(
        "mujoco",
        ["LShoulderRoll"],
        SHORT,
        "affine",
        progress=lambda done, total: told.append((done, total)),
    )
    assert list(result.fits) == ["affine", "cart", CLOSED_FORM]
    assert told == [(1, 3), (2, 3), (3, 3)]
    fit = result.fits["affine"]["LShoulderRoll"]
    assert result.models.test_fit["LShoulderRoll"] == fit.test
    assert 50.0 < fit.estimation <= 100.0
    # Even without friction's memory, the plant's own parameters explain most of the error.
    assert result.fits[CLOSED_FORM]["LShoulderRoll"].test > 60.0


def test_an_unknown_joint_is_refused_before_anything_moves() -> None:
    with pytest.raises(UnknownNameError, match="LShoulderRoll"):
        record_joints("mujoco", ["LShoulderRol"], SHORT)


def test_another_kind_of_motion_identifies_nothing() -> None:
    with pytest.raises(
        ConfigError, match=r"demo\.yaml: key 'motion\.kind': .*sweeps, not setpoints"
    ):
        record_joints("mujoco", ["LShoulderRoll"], load_scenario("demo", ROBOT))


def test_the_plant_of_the_scenario_is_the_one_identified() -> None:
    with pytest.raises(UnknownNameError, match="unknown plant 'worm'"):
        record_joints("mujoco", ["RElbowRoll"], replace(SHORT, plant="worm"))
    with pytest.raises(UnknownNameError, match="unknown plant 'worm'"):
        identify_joints("mujoco", ["RElbowRoll"], replace(SHORT, plant="worm"), "affine")
