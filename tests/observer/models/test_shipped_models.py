"""The models that come with the package belong to the plants that come with it, and are as good as is said."""

import pytest

from pepper_driver.config import (
    RobotIdentity,
    load_experiment,
    load_plant,
    load_robot,
    plant_hash,
)
from pepper_driver.config.steps import Setpoints
from pepper_driver.observer import (
    MODEL_TYPES,
    ModelFileError,
    ModelKind,
    ModelSet,
    load_shipped,
    shipped,
)

ROBOT = load_robot()
KINDS = list(MODEL_TYPES)
DEMO = load_experiment("demo", ROBOT)


@pytest.mark.parametrize("kind", KINDS)
def test_there_are_models_of_the_nominal_plant_and_of_the_demonstration(kind: ModelKind) -> None:
    assert {"nominal", DEMO.plant} <= set(shipped(kind))


@pytest.mark.parametrize(("kind", "plant"), [(k, p) for k in KINDS for p in shipped(k)])
def test_shipped_models_are_of_the_shipped_plants(kind: ModelKind, plant: str) -> None:
    path = shipped(kind)[plant]
    models = ModelSet.load(path)
    now = plant_hash(load_plant(plant, ROBOT), ROBOT)
    assert models.identity == now, (
        f"the plant has changed since {path.name} was identified; identify it again: "
        f"pepper identify --backend mujoco://?plant={plant} --model-type {kind} --out observer/models/{path.name}"
    )
    assert models.kind == kind
    assert models.joint_names == ROBOT.joint_names
    assert DEMO.random_step is not None
    assert isinstance(DEMO.random_step.goals, Setpoints)
    assert set(DEMO.random_step.goals.joints) <= set(models.models)
    found = load_shipped(kind, [RobotIdentity(name=plant, identity=now)])
    assert found.models == models.models


@pytest.mark.parametrize("kind", KINDS)
def test_another_robot_has_no_shipped_models(kind: ModelKind) -> None:
    with pytest.raises(ModelFileError, match="for 'mine', only for the plants integral, nominal"):
        load_shipped(kind, [RobotIdentity(name="mine", identity="another robot")])


def test_the_affine_models_of_the_nominal_plant_fit_what_they_must() -> None:
    models = ModelSet.load(shipped("affine")["nominal"])
    for joint, fit in models.test_fit.items():
        if joint in ROBOT.chains["left_arm"] + ROBOT.chains["right_arm"]:
            assert fit >= 70.0, f"{joint}: {fit:.1f} %"


def test_the_fusion_models_of_the_nominal_plant_fit_what_they_must() -> None:
    models = ModelSet.load(shipped("fusion")["nominal"])
    assert set(models.models) == set(ROBOT.joint_names)
    estimation, test = list(models.estimation_fit.values()), list(models.test_fit.values())
    assert min(test) >= 88.0
    assert sum(estimation) / len(estimation) >= 90.0
    trees = ModelSet.load(shipped("affine")["nominal"])
    for joint, fit in models.test_fit.items():
        assert fit > trees.test_fit[joint], joint
