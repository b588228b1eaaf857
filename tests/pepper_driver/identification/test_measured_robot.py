"""A robot is measured before its models are identified; the facts stay with the models."""

import shutil
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.backends.selection import with_delay
from pepper_driver.config import ConfigError, load_plant
from pepper_driver.identification import (
    Confirm,
    DryRunError,
    RecordingFolderError,
    fit_folder,
    read_manifest,
    record_joints,
)
from pepper_driver.identification import identify as identify_module
from pepper_driver.identification.dataset import recording_path
from pepper_driver.identification.measurements.program import (
    MAX_WEIGHT,
    MEASUREMENTS,
    RESPONSE,
    held_weight,
    measure_robot,
    measured_joints,
)
from pepper_driver.identification.measurements.response import (
    MeasuredResponse,
    ResponseError,
    measure_response,
)
from pepper_driver.identification.runs import IdentificationRun, plan_measurements
from pepper_driver.observer import ModelFileError, ModelSet, Recording
from support.evaluation import recording as still
from support.identification import ROBOT, SHORT, SlowRobot, use_backends
from support.once import made_once

PLANT = "recorded"
WEIGHT = held_weight(0.5, "right")


@pytest.fixture(scope="module")
def folder(request: pytest.FixtureRequest) -> Path:
    def make(folder: Path) -> None:
        record_joints(
            f"mujoco://?plant={PLANT}",
            ["LElbowRoll"],
            SHORT,
            folder,
            measure=True,
            weight=WEIGHT,
            workers=2,
        )

    return made_once(request, "measured", make)


def test_the_robot_comes_before_its_joints(folder: Path) -> None:
    names = [run.name for run in read_manifest(folder).runs]
    assert names[:4] == [f"{name}-1" for name in (*MEASUREMENTS, "measure_weight")]
    assert names[4].startswith("LElbowRoll-")


def test_the_facts_are_those_of_the_plant_and_stay_with_the_models(
    folder: Path, tmp_path: Path
) -> None:
    plant = load_plant(PLANT, ROBOT)
    models = fit_folder(folder, "affine", compare=False, workers=1).models
    found = models.measured
    assert found is not None
    assert set(found.joints) == set(measured_joints(ROBOT))
    assert found.reported_delay == plant.response_delay == found.response_delay
    assert found.late == pytest.approx(plant.transport.late, abs=0.02)
    assert found.lost == pytest.approx(plant.transport.lost, abs=0.01)
    for joint in ("LShoulderPitch", "RElbowYaw"):
        one, drive = found.joints[joint], plant.actuator(joint)
        assert one.load_scale == pytest.approx(1.0 / drive.efficiency, rel=0.1)
        assert one.speed == pytest.approx(plant.targets.speed_limit, rel=0.1)
        assert one.speed_limited
        # Less than a count: most rests show nothing.
        assert one.encoder_noise is not None
        assert one.encoder_noise < ROBOT.sensors.encoder.step
        assert one.current_noise is not None
        assert 0.3 * plant.transport.current_noise < one.current_noise < 0.03
    assert found.joints["HeadYaw"].speed is None
    assert found.weight == 0.5
    for joint in ("RShoulderPitch", "RElbowRoll"):
        true = 1.0 / plant.actuator(joint).efficiency
        assert found.joints[joint].torque_scale == pytest.approx(true, rel=0.1)
    assert found.joints["LShoulderPitch"].torque_scale is None
    models.save(tmp_path / "models.json")
    assert ModelSet.load(tmp_path / "models.json") == models


def test_a_weight_that_was_not_held_is_a_warning_and_does_not_count(
    folder: Path, tmp_path: Path
) -> None:
    other = Path(shutil.copytree(folder, tmp_path / "other"))
    empty = Recording.load(recording_path(folder, "measure_friction-1"), ROBOT)
    held = Recording.load(recording_path(folder, "measure_weight-1"), ROBOT)
    # The same motion with an empty hand.
    same = np.minimum(np.arange(len(held)), len(empty) - 1)
    never = replace(held, current=empty.current[same])
    never.save(recording_path(other, "measure_weight-1"))
    found = fit_folder(other, "affine", compare=False, workers=1)
    first, *_ = found.findings
    assert (first.kind, first.joint, first.run) == ("weight", None, "measure_weight-1")
    assert "it was not in the hand" in first.text
    measured = found.models.measured
    assert measured is not None
    assert measured.weight is None
    assert measured.weight_doubt is not None
    assert measured.weight_doubt in first.text
    assert {one.torque_scale for one in measured.joints.values()} == {None}
    assert measured.joints["RElbowRoll"].load_scale is not None


def test_the_command_that_made_models_measures_the_same(folder: Path) -> None:
    command = fit_folder(folder, "affine", compare=False, workers=1).models.created_by
    assert "--calibration none" in command
    assert "--weight 0.5 --hand right" in command
    assert "--no-measure" not in command


def test_a_wrong_fact_in_a_file_is_refused(folder: Path, tmp_path: Path) -> None:
    models = fit_folder(folder, "affine", compare=False, workers=1).models
    assert models.measured is not None
    path = tmp_path / "models.json"
    replace(models, measured=replace(models.measured, late=1.5)).save(path)
    with pytest.raises(ModelFileError, match="late"):
        ModelSet.load(path)


def test_a_delay_that_was_reported_wrongly_is_found(folder: Path) -> None:
    runs = {
        name: Recording.load(recording_path(folder, f"{name}-1"), ROBOT) for name in MEASUREMENTS
    }
    response = runs[RESPONSE]
    late = replace(response, current=response.current[[0] * 4 + [*range(len(response) - 4)]])
    # One joint that never rests: its noise is not known.
    sent, head = late.sent_position.copy(), ROBOT.joint_index("HeadYaw")
    sent[:, head] = 0.01 * np.arange(len(late))
    found = measure_robot({**runs, RESPONSE: replace(late, sent_position=sent)}, 6, ROBOT)
    assert (found.delay_error, found.response_delay) == (4, 10)
    assert (found.joints["HeadYaw"].encoder_noise, found.joints["HeadYaw"].current_noise) == (
        None,
        None,
    )
    assert found.joints["HeadPitch"].encoder_noise is not None
    still = replace(response, current=0.0 * response.current)
    with pytest.raises(ResponseError):
        measure_robot({**runs, RESPONSE: still}, 6, ROBOT)


@pytest.fixture
def real(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A robot in real time whose runs take no time; the names of those that were made."""
    made: list[str] = []

    def perform(uri: str, run: IdentificationRun, **_: object) -> Recording:
        made.append(run.name)
        return still(0.5)

    use_backends(monkeypatch, SlowRobot)
    monkeypatch.setattr(identify_module, "perform", perform)
    response = MeasuredResponse(lead=0, steps=40, earliest=0.0, latest=0.0)
    monkeypatch.setattr(identify_module, "measure_response", lambda *_: response)
    return made


def test_the_weight_is_taken_out_before_the_next_run_of_any_call(
    real: list[str], tmp_path: Path
) -> None:
    asked: list[str] = []

    def ask(run: IdentificationRun) -> None:
        asked.append(f"{run.name}: {run.watched}")

    def leave(run: IdentificationRun) -> None:
        ask(run)
        raise KeyboardInterrupt

    def record(confirm: Confirm, *, measure_only: bool = False) -> list[str]:
        asked.clear()
        with suppress(KeyboardInterrupt):
            record_joints(
                "fake://robot",
                ["LElbowRoll"],
                SHORT,
                tmp_path,
                measure=True,
                measure_only=measure_only,
                weight=WEIGHT,
                workers=1,
                confirm=confirm,
            )
        return list(asked)

    empty = "LElbowRoll-1: take the weight out of the hand now"
    (_, hang) = record(ask, measure_only=True)
    assert "hang it there now" in hang
    assert real == [f"{name}-1" for name in (*MEASUREMENTS, "measure_weight")]
    assert record(leave) == [empty]
    assert record(ask) == [empty]
    # In a call that makes both, and after a call that made the weight's run again.
    for name in ("measure_weight-1", "LElbowRoll-2"):
        recording_path(tmp_path, name).unlink()
    asked_again = record(ask)
    assert len(asked_again) == 2
    assert asked_again[1] == empty.replace("-1", "-2")
    recording_path(tmp_path, "measure_weight-1").unlink()
    record(ask, measure_only=True)
    recording_path(tmp_path, "measure_friction-1").unlink()
    assert record(ask) == [empty.replace("LElbowRoll", "measure_friction")]


def test_a_robot_without_currents_is_no_dead_end(
    real: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(identify_module, "measure_response", measure_response)

    def record(folder: Path, *, measure: bool) -> None:
        record_joints("fake://robot", ["LElbowRoll"], SHORT, folder, measure=measure, workers=1)

    with pytest.raises(ResponseError, match=r"'pepper identify --no-measure', with another folder"):
        record(tmp_path / "one", measure=True)
    with pytest.raises(RecordingFolderError):
        record(tmp_path / "one", measure=False)
    record(tmp_path / "other", measure=False)
    assert real[-1] == "LElbowRoll-test"


@pytest.mark.parametrize("measure_only", [False, True])
def test_all_that_is_missing_is_dry_run_before_the_arms_move_fast(
    measure_only: bool, real: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[str] = []

    def refuse_the_last(run: IdentificationRun) -> None:
        tried.append(run.name)
        if run.name == "LElbowRoll-test":
            raise DryRunError(f"run {run.name} would fail")

    monkeypatch.setattr(identify_module, "check_dry_run", refuse_the_last)

    def record() -> None:
        record_joints(
            "fake://robot",
            ["LElbowRoll"],
            SHORT,
            tmp_path,
            measure=True,
            measure_only=measure_only,
            workers=1,
        )

    measurements = [f"{name}-1" for name in MEASUREMENTS]
    if measure_only:
        record()
        assert tried == real == measurements
        return
    with pytest.raises(DryRunError, match="LElbowRoll-test would fail"):
        record()
    assert tried[:3] == measurements
    assert real == []


def test_only_the_fast_arms_are_asked_for() -> None:
    runs = plan_measurements(ROBOT)
    weighed = plan_measurements(ROBOT, weight=WEIGHT)
    assert weighed[:3] == runs
    assert "0.5 kg in the right hand: hang it there now" in weighed[3].watched
    slow, fast = runs[1].after_weight(), runs[2].after_weight()
    assert slow.watched == "take the weight out of the hand now"
    assert fast.watched == f"{slow.watched}; {runs[2].watched}"
    assert [bool(run.watched) for run in runs] == [False, False, True]
    assert not any(run.moves_legs for run in runs)
    speeds = dict(
        zip(ROBOT.joint_names, runs[2].controller(ROBOT).joint_velocity(ROBOT), strict=True)
    )
    assert speeds["LElbowYaw"] > 2.5
    assert speeds["HeadYaw"] == 2.0
    # Less than five minutes of the robot's hour.
    assert sum(run.seconds for run in runs) < 300.0


@pytest.mark.parametrize(
    ("uri", "expected"),
    [
        ("naoqi://pepper.local", "naoqi://pepper.local?delay=7"),
        ("naoqis://me@robot?delay=3&wake=1", "naoqis://me@robot?delay=7&wake=1"),
        ("naoqi://robot?mode=angles", "naoqi://robot?mode=angles"),
        ("mujoco://?plant=worn", "mujoco://?plant=worn"),
        ("mujoco", "mujoco"),
    ],
)
def test_a_robot_without_its_delay_gets_it(uri: str, expected: str) -> None:
    assert with_delay(uri, 7) == expected


@pytest.mark.parametrize("mass", [0.0, -1.0, 0.05, MAX_WEIGHT + 0.1, float("nan")])
def test_a_weight_that_no_hand_carries_is_refused(mass: float) -> None:
    with pytest.raises(ConfigError, match="a weight for a hand"):
        held_weight(mass, "left")


def test_recordings_with_another_weight_are_not_continued(folder: Path) -> None:
    for weight, measure, text in (
        (held_weight(0.3, "right"), True, "0.5 kg at r_wrist, not 0.3 kg"),
        (None, True, "measuring"),
        (None, False, "measuring"),
    ):
        with pytest.raises(RecordingFolderError, match=text):
            record_joints(
                f"mujoco://?plant={PLANT}",
                ["LElbowRoll"],
                SHORT,
                folder,
                measure=measure,
                weight=weight,
            )
