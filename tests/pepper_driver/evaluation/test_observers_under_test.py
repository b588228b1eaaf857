"""Observers that are evaluated, their models, and the oracle."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.config import RobotIdentity, UnknownNameError, load_plant, plant_hash
from pepper_driver.evaluation import observers_under_test as module
from pepper_driver.evaluation.episode_score import watch
from pepper_driver.evaluation.observers_under_test import (
    ORACLE,
    RECORDED,
    ObserversUnderTest,
    OracleObserver,
    contestants,
    reference_plant,
    shared_by_type,
    untouched_error,
)
from pepper_driver.observer import (
    AffineTree,
    ModelFileError,
    ModelSet,
    RecordingBuilder,
    nrmse_fit,
    shipped,
)
from pepper_driver.robot import Pepper
from support.evaluation import INDEX, JOINTS, ROBOT, make_episode, recording

NOMINAL = RobotIdentity(name="nominal", identity=plant_hash(load_plant("nominal", ROBOT), ROBOT))
PAPER = ObserversUnderTest(modes=("paper-affine", "paper-cart"))


def tree(models: ModelSet, joint: str) -> AffineTree:
    model = models.models[joint]
    assert isinstance(model, AffineTree)
    return model


def test_contestants_are_checked_beforehand(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"unknown mode 'papr'.*did you mean paper"):
        contestants(["papr"], [], ROBOT)
    some = contestants(None, [], ROBOT)
    assert {"paper-affine", "paper-cart", ORACLE} <= set(some.modes)
    assert ORACLE in some.of_suite("fit")
    assert ORACLE not in some.of_suite("types")
    assert ORACLE in contestants([ORACLE], [], ROBOT).of_suite("types")
    assert contestants(["paper", "paper-affine"], [], ROBOT).modes == ("paper-affine",)
    damaged = tmp_path / "models.json"
    damaged.write_text("{")
    with pytest.raises(ModelFileError, match="damaged"):
        contestants(["paper"], [damaged], ROBOT)


def test_a_model_file_serves_its_kind() -> None:
    file = shipped("cart")["nominal"]
    some = contestants(["paper-cart", "paper-affine"], [file], ROBOT)
    assert [(f.kind, f.path) for f in some.files] == [("cart", file)]
    assert "cart trees" in some.observer("paper-cart", make_episode(), ROBOT).describe()
    assert "affine trees" in some.observer("paper-affine", make_episode(), ROBOT).describe()


@pytest.mark.parametrize(
    ("plant", "reference"),
    [("nominal", "nominal"), ("worn", "nominal"), ("drift", "nominal"), ("integral", "integral")],
)
def test_models_are_those_of_the_same_boards(plant: str, reference: str) -> None:
    assert reference_plant(plant, ROBOT) == reference


def test_a_file_of_one_reference_plant_is_not_used_for_the_other() -> None:
    file = shipped("affine")["nominal"]
    some = contestants(["paper"], [file], ROBOT)
    on = {
        plant: some.observer("paper-affine", replace(make_episode(), plant=plant), ROBOT).describe()
        for plant in ("nominal", "worn", "integral")
    }
    nominal = ModelSet.load(file).identity
    assert nominal in on["nominal"]
    assert nominal in on["worn"]
    assert nominal not in on["integral"]


def test_a_file_of_another_robot_stands_in_for_suites_but_not_for_recordings(
    tmp_path: Path,
) -> None:
    path = tmp_path / "mine.json"
    replace(ModelSet.load(shipped("affine")["nominal"]), identity="mine").save(path)
    some = contestants(["paper"], [path], ROBOT)
    for plant in ("nominal", "integral"):
        episode = replace(make_episode(), plant=plant)
        assert "mine" in some.observer("paper-affine", episode, ROBOT).describe()
    recorded = replace(make_episode(), plant=RECORDED)
    with pytest.raises(ModelFileError, match="identified on another robot"):
        some.observer("paper-affine", recorded, ROBOT)
    assert (
        "mine"
        in some.observer("paper-affine", replace(recorded, identity="mine"), ROBOT).describe()
    )
    with pytest.raises(ModelFileError, match="not the robot of a recording"):
        some.observer(ORACLE, recorded, ROBOT)


def test_a_recording_of_a_variant_is_judged_with_the_nearest_models(tmp_path: Path) -> None:
    """Its own before those of its parents, in a file before those shipped, whatever the order of the files."""
    parents = (RobotIdentity(name="worn", identity="of worn"), NOMINAL)
    episode = replace(make_episode(), plant=RECORDED, identity="of mine", parents=parents)
    assert NOMINAL.identity in PAPER.observer("paper-affine", episode, ROBOT).describe()
    fusion = ObserversUnderTest(modes=("fusion",)).observer("fusion", episode, ROBOT)
    assert NOMINAL.identity in fusion.describe()
    models, files = ModelSet.load(shipped("affine")["nominal"]), []
    for name in ("of mine", "of worn", "foreign"):
        files.append(tmp_path / f"{name}.json")
        replace(models, identity=name).save(files[-1])
    some = contestants(["paper"], files, ROBOT)
    assert "of mine" in some.observer("paper-affine", episode, ROBOT).describe()
    some = contestants(["paper"], files[1:], ROBOT)
    assert "of worn" in some.observer("paper-affine", episode, ROBOT).describe()
    some = contestants(["paper"], files[2:], ROBOT)
    with pytest.raises(ModelFileError, match="identified on another robot"):
        some.observer("paper-affine", episode, ROBOT)


def test_the_oracle_is_the_plant_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def note(_: object, uri: str, __: object) -> np.ndarray:
        asked.append(uri)
        return np.zeros((1, len(ROBOT.joint_names)))

    monkeypatch.setattr(module, "untouched_error", note)
    for plant in ("swaying", "swaying-integral"):
        PAPER.observer(ORACLE, replace(make_episode(), plant=plant), ROBOT)
    assert asked == ["mujoco://?plant=swaying", "mujoco://?plant=swaying-integral"]


def test_models_are_shared_by_type_of_motor_in_the_suite_about_that() -> None:
    models = ModelSet.load(shipped("affine")["nominal"])
    assert {"LShoulderRoll", "RElbowRoll"} <= set(models.models)  # motors of one type
    shared = shared_by_type(models, ROBOT)
    assert shared.models["RElbowRoll"] == shared.models["LShoulderRoll"]
    assert shared.threshold["RElbowRoll"] == shared.threshold["LShoulderRoll"]
    assert shared.models.keys() == models.models.keys()
    rows = [
        watch(PAPER.observer("paper-affine", episode, ROBOT), episode.recording).expected[50]
        for episode in (make_episode(suite="fit"), make_episode(suite="types"))
    ]
    elbow = ROBOT.joint_index("RElbowRoll")
    zero = (0.0, 0.0, 0.0)
    assert rows[0][elbow] == tree(models, "RElbowRoll").predict(np.array([zero]))[0]
    assert rows[1][elbow] == tree(shared, "RElbowRoll").predict(np.array([zero]))[0]


# -- the oracle on a short simulated episode: it knows what the plant does, but not who pushes ------------------------


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


def test_the_oracle_foresees_free_motion_and_nothing_else(builder: RecordingBuilder) -> None:
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


def test_the_oracle_says_when_the_residual_leaves_the_band() -> None:
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
