"""Identification drives the robot as Sec. IV says, and gives the same models whatever does the work."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.config import ConfigError, UnknownNameError, load_experiment
from pepper_driver.experiments.segments import swept_range
from pepper_driver.identification import (
    CALIBRATION_STIFFNESS,
    CLOSED_FORM,
    IdentificationDataset,
    chosen_joints,
    fit_folder,
    fit_models,
    identify_joints,
    load_recordings,
    plan_runs,
    record_joints,
    sweeps_of,
)
from pepper_driver.identification.dataset import JointDataset
from pepper_driver.identification.fit import mean_fit, predictor, shared_fits
from pepper_driver.identification.runs import IdentificationRun, perform
from pepper_driver.observer import (
    FitScore,
    FittingError,
    FusionModel,
    Recording,
    nrmse_fit,
    predict_recording,
)
from support.fusion import STICK_SLIP, drive, followed, fusion_model, recording_of, swing
from support.identification import (
    BODY,
    FULL,
    ROBOT,
    SHORT,
    record_elbows,
    recorded_elbows,
    short_body,
)

LEGS = ("KneePitch", "HipPitch", "HipRoll")


@pytest.fixture(scope="module")
def folder(request: pytest.FixtureRequest) -> Path:
    return recorded_elbows(request)


@pytest.fixture(scope="module")
def recordings(folder: Path) -> IdentificationDataset:
    return load_recordings(folder, ROBOT)


def one_run(joint: str, stiffness: float = 9.0) -> IdentificationRun:
    experiment = replace(SHORT, stiffness=stiffness)
    return plan_runs(ROBOT, [joint], experiment, seed=1)[-1]


def swept(run: Recording, joint: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return run.sent_position[:, ROBOT.joint_index(joint)]


def test_one_run_moves_the_joint_and_changes_its_neighbours_half_way() -> None:
    run = perform("mujoco", one_run("LShoulderRoll"))
    half = len(run) // 2
    # The main joint repeats its sequence: once its start is forgotten, the same commands.
    first, second = swept(run, "LShoulderRoll")[:half], swept(run, "LShoulderRoll")[half:]
    np.testing.assert_allclose(first[-100:], second[-100:], atol=0.02)
    assert np.ptp(second) > 0.3
    for name in ("LShoulderPitch", "LElbowYaw"):
        assert abs(swept(run, name)[-1] - swept(run, name)[half - 5]) > 0.02
    for name in ("RShoulderRoll", "HeadYaw", "KneePitch"):
        assert np.ptp(swept(run, name)) < 0.02
    assert (run.sent_position >= ROBOT.lower).all()
    assert (run.sent_position <= ROBOT.upper).all()
    assert not run.limited.any()


@pytest.mark.parametrize("joint", LEGS)
def test_a_leg_stays_near_the_standing_posture_and_the_wheels_stand(joint: str) -> None:
    run = perform("mujoco", one_run(joint))
    posture = dict(zip(ROBOT.joint_names, ROBOT.posture("Stand").tolist(), strict=True))
    for name in LEGS:
        lower, upper = swept_range(sweeps_of(SHORT), name, posture, ROBOT)
        whole = ROBOT.joints[ROBOT.joint_index(name)]
        assert upper - lower == pytest.approx(0.25 * (whole.upper - whole.lower))
        assert swept(run, name).min() > lower - 0.01
        assert swept(run, name).max() < upper + 0.01
    assert np.ptp(swept(run, joint)) > 0.05
    assert not run.sent_wheel_speed.any()
    assert not run.limited.any()


def test_the_range_of_a_joint_is_a_fraction_of_the_distance_from_the_first_posture_to_its_limits() -> (
    None
):
    knee = ROBOT.joints[ROBOT.joint_index("KneePitch")]
    motion = replace(sweeps_of(FULL), ranges={"KneePitch": 0.5})
    lower, upper = swept_range(motion, "KneePitch", {"KneePitch": 0.4}, ROBOT)
    assert lower == pytest.approx((0.4 + knee.lower) / 2)
    assert upper == pytest.approx((0.4 + knee.upper) / 2)
    head = ROBOT.joints[ROBOT.joint_index("HeadYaw")]
    assert swept_range(motion, "HeadYaw", {"HeadYaw": 0.4}, ROBOT) == (head.lower, head.upper)


def test_a_range_of_an_unknown_joint_is_refused(tmp_path: Path) -> None:
    text = Path(FULL.source).read_text().replace("ranges: {KneePitch:", "ranges: {KneePith:")
    (tmp_path / "typo.yaml").write_text(text)
    with pytest.raises(
        ConfigError, match=r"key 'steps\.0\.sweeps\.ranges'.*did you mean KneePitch"
    ):
        load_experiment(tmp_path / "typo.yaml", ROBOT)


def test_a_stiffer_task_moves_faster() -> None:
    speeds = [
        np.abs(perform("mujoco", one_run("RElbowRoll", k)).velocity).max() for k in (2.0, 9.0)
    ]
    assert speeds[1] > 1.5 * speeds[0]


def test_the_whole_body_moves_for_the_calibration() -> None:
    body = short_body().with_goals(count=3)
    run = plan_runs(ROBOT, ["HeadYaw"], SHORT, calibration=body)[-2]
    recording = perform("mujoco", run)
    assert np.ptp(recording.sent_position, axis=0).min() > 0.01
    assert recording.sent_wheel_speed.any()
    assert not recording.limited.any()


def test_the_plan_is_that_of_the_paper_and_four_runs_of_the_whole_body() -> None:
    joints, tested = chosen_joints(ROBOT, FULL, None, mirror=True, share_types=False)
    runs = plan_runs(ROBOT, joints, FULL, tested=tested, calibration=BODY)
    assert len(joints) == 11
    assert len(runs) == 11 * 8 + 4
    assert len({run.seed for run in runs}) == len({run.name for run in runs}) == len(runs)
    knee = [run for run in runs if run.joint == "KneePitch"]
    assert [run.experiment.stiffness for run in knee] == [2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 9.0]
    assert [run.role for run in knee] == ["estimation"] * 7 + ["test"]
    assert {run.joint for run in runs if run.watched} == {*LEGS, None}
    assert tuple(run.experiment.stiffness for run in runs[-4:]) == CALIBRATION_STIFFNESS
    assert all(50 < run.seconds < 130 for run in runs)


def test_a_run_does_not_depend_on_the_others() -> None:
    alone = plan_runs(ROBOT, ["HeadPitch"], FULL)
    among = plan_runs(ROBOT, ["LHand", "HeadPitch"], FULL, calibration=BODY)
    assert alone == among[8:16]
    tested = plan_runs(ROBOT, ["LHand"], FULL, tested=["HeadPitch"])
    assert tested[-1] == alone[-1]


def test_both_sides_are_recorded_without_a_mirror_and_one_joint_of_a_type_when_they_share() -> None:
    both, none = chosen_joints(ROBOT, FULL, None, mirror=False, share_types=False)
    assert (set(both), none) == (set(ROBOT.joint_names), ())
    full, tested = chosen_joints(ROBOT, FULL, None, mirror=True, share_types=True)
    assert full == ("LShoulderPitch", "LShoulderRoll", "LWristYaw", "KneePitch", "HipRoll")
    assert len(tested) == 6
    kinds = {ROBOT.motors.joints[name].type for name in full}
    assert len(kinds) == len(full)


@pytest.mark.parametrize(
    ("joints", "error", "word"),
    [
        (["LShoulderRol"], UnknownNameError, "LShoulderRoll"),
        (["HeadYaw", "HeadYaw"], ConfigError, "twice"),
        ([], ConfigError, "nothing to identify"),
    ],
)
def test_joints_that_cannot_be_are_refused_before_anything_moves(
    joints: list[str], error: type[Exception], word: str, tmp_path: Path
) -> None:
    with pytest.raises(error, match=word):
        record_joints("mujoco", joints, SHORT, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_another_kind_of_goals_identifies_nothing(tmp_path: Path) -> None:
    demo = load_experiment("demo", ROBOT)
    with pytest.raises(ConfigError, match=r"demo\.yaml: key 'steps': .* a step with sweeps"):
        record_joints("mujoco", ["LShoulderRoll"], demo, tmp_path / "new")
    with pytest.raises(ConfigError, match=r"demo\.yaml: key 'contacts'"):
        plan_runs(ROBOT, ["LShoulderRoll"], SHORT, calibration=demo)


def test_the_plant_of_the_experiment_is_the_one_identified(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="key 'plant': unknown plant 'worm'"):
        record_joints("mujoco", ["RElbowRoll"], replace(SHORT, plant="worm"), tmp_path / "new")
    body = replace(short_body(), plant="worn")
    with pytest.raises(ConfigError, match="key 'plant'"):
        record_joints("mujoco", ["RElbowRoll"], SHORT, tmp_path / "new", calibration=body)


def test_the_result_does_not_depend_on_who_does_the_work(
    recordings: IdentificationDataset, folder: Path, tmp_path: Path
) -> None:
    """Two processes one run after the other, or this one a single run."""
    again = Path(shutil.copytree(folder, tmp_path / "again"))
    (again / "RElbowRoll-test.npz").unlink()
    alone = record_elbows(again, workers=1).sweeps[1].test
    assert alone.position.tobytes() == recordings.sweeps[1].test.position.tobytes()


def test_the_test_run_is_the_fastest_and_runs_differ(recordings: IdentificationDataset) -> None:
    entry = recordings.sweeps[1]
    # Of the same error, a stiffer task makes the larger acceleration.
    peaks = [np.abs(run.acceleration[:, entry.index]).max() for run in entry.runs]
    assert peaks == sorted(peaks)
    ends = [run.sent_position[-1, entry.index] for run in entry.estimation]
    assert abs(ends[0] - ends[1]) > 1e-3


def test_a_mirrored_model_predicts_the_joint_of_the_other_side(
    recordings: IdentificationDataset,
) -> None:
    left, right = recordings.sweeps[:2]
    only_left = IdentificationDataset(sweeps=(left,), calibration=())
    fitted = fit_models("affine", only_left, ROBOT)
    assert set(fitted.models) == {"LElbowRoll", "RElbowRoll"}
    assert fitted.fits["RElbowRoll"].test == pytest.approx(fitted.fits["LElbowRoll"].test, abs=1.0)

    model = fitted.models["RElbowRoll"]
    # What the left arm does the right one does in a mirror: the elbow turns the other way, and errs so.
    seen = left.mirrored(ROBOT)
    assert seen.joint == "RElbowRoll"
    as_left = predict_recording(fitted.models["LElbowRoll"], left.joint, left.test)
    as_right = predict_recording(model, seen.joint, seen.test)
    assert np.abs(as_right + as_left).mean() < 1e-4
    truly = right.test.tracking_error(right.index)
    assert nrmse_fit(truly, predict_recording(model, right.joint, right.test)) > 55.0
    assert set(fit_models("affine", only_left, ROBOT, mirror=False).models) == {"LElbowRoll"}


def test_a_shared_model_is_that_of_the_first_joint_and_its_cost_is_reported(folder: Path) -> None:
    result = fit_folder(folder, "affine")
    models = result.models.models
    assert models["HeadPitch"] == models["RElbowRoll"] == models["LElbowRoll"]
    assert [(fit.joint, fit.source, fit.halves) for fit in result.shared] == [
        ("RElbowRoll", "LElbowRoll", False),
        ("HeadPitch", "LElbowRoll", True),
    ]
    own = fit_models(
        "affine",
        IdentificationDataset(sweeps=load_recordings(folder, ROBOT).sweeps[1:2], calibration=()),
        ROBOT,
    )
    right = result.shared[0]
    assert right.own == own.fits["RElbowRoll"].test
    assert right.shared == result.fits["affine"]["RElbowRoll"].test
    assert right.loss == own.fits["RElbowRoll"].test - right.shared
    assert result.shared[1].loss is not None
    assert "--share-types" in result.models.created_by


@pytest.mark.parametrize("halves", [False, True])
def test_own_and_shared_models_have_the_same_limit_of_the_target(
    halves: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both have the constants of the joint itself: sharing costs nothing."""
    motion, limit = swing(16.0), 0.4
    slower = replace(motion, position=followed(motion.position, limit))
    run = recording_of(motion, drive(slower))
    shared = fusion_model(replace(STICK_SLIP, target_speed=limit))
    entry = JointDataset(joint="LElbowRoll", estimation=() if halves else (run,), test=run)
    source = replace(entry, joint="HeadPitch", estimation=(run,))
    recordings = IdentificationDataset(sweeps=(source, entry), calibration=())

    def fit(*_: object, target_speed: float) -> FusionModel:
        return fusion_model(replace(STICK_SLIP, target_speed=target_speed))

    monkeypatch.setattr("pepper_driver.identification.fit.fit_joint_fusion", fit)
    test = mean_fit(entry, (run,), predictor(shared, "LElbowRoll"))
    fits = {"LElbowRoll": FitScore(estimation=test, test=test)}
    (one,) = shared_fits("fusion", recordings, ROBOT, fits, {"LElbowRoll": limit})
    assert test > 90.0
    # A half begins without the memory of the first one.
    assert one.loss == pytest.approx(0.0, abs=3.0 if halves else 1e-9)


def test_a_joint_without_estimation_runs_needs_one_that_shares(
    recordings: IdentificationDataset,
) -> None:
    head = IdentificationDataset(sweeps=recordings.sweeps[2:], calibration=())
    with pytest.raises(FittingError, match="HeadPitch: no joint with a motor of type 2"):
        fit_models("affine", head, ROBOT, share_types=True)
    with pytest.raises(FittingError, match="HeadPitch: 0 usable samples"):
        fit_models("affine", head, ROBOT)


def test_a_joint_that_stands_still_is_refused(recordings: IdentificationDataset) -> None:
    entry = replace(recordings.sweeps[0], joint="RHand")
    still = tuple(replace(run, velocity=np.zeros_like(run.velocity)) for run in entry.estimation)
    with pytest.raises(FittingError, match="RHand: the joint does not move"):
        fit_models(
            "affine",
            IdentificationDataset(sweeps=(replace(entry, estimation=still),), calibration=()),
            ROBOT,
        )


def test_models_come_with_fits_of_all_methods_and_progress_counts_seconds() -> None:
    reported: list[tuple[float, float]] = []
    result = identify_joints(
        "mujoco",
        ["LShoulderRoll"],
        SHORT,
        "affine",
        workers=1,
        progress=lambda what, done, total: reported.append((done, total)),
    )
    assert list(result.fits) == ["affine", "cart", CLOSED_FORM]
    seconds = [run.seconds for run in plan_runs(ROBOT, ["LShoulderRoll"], SHORT)]
    np.testing.assert_allclose([done for done, _ in reported], [0.0, *np.cumsum(seconds)])
    assert {total for _, total in reported} == {sum(seconds)}
    fit = result.fits["affine"]["LShoulderRoll"]
    assert list(result.models.models) == ["LShoulderRoll"]
    assert result.models.test_fit["LShoulderRoll"] == fit.test
    assert 50.0 < fit.estimation <= 100.0
    # Even without friction's memory, the plant's own parameters explain most of the error.
    assert result.fits[CLOSED_FORM]["LShoulderRoll"].test > 60.0
