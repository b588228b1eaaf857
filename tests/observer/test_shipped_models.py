"""The models that come with the package belong to the plant that comes with it, and are as good as is said."""

import pytest

from pepper_driver.config import load_plant, load_robot, load_scenario, plant_hash
from pepper_driver.observer import TREE_TYPES, ModelSet, TreeKind, shipped

ROBOT = load_robot()


@pytest.mark.parametrize("kind", list(TREE_TYPES))
def test_shipped_models_are_of_the_shipped_plant(kind: TreeKind) -> None:
    models = ModelSet.load(shipped(kind))
    now = plant_hash(load_plant("nominal", ROBOT), ROBOT)
    assert models.identity == now, (
        f"the plant has changed since {shipped(kind).name} was identified; "
        f"make it anew: pepper identify --tree {kind} --out observer/models/nominal-{kind}.json"
    )
    assert models.kind == kind
    assert models.joint_names == ROBOT.joint_names
    assert set(load_scenario("demo", ROBOT).touched_joints) <= set(models.models)


def test_the_affine_models_fit_what_they_must() -> None:
    models = ModelSet.load(shipped("affine"))
    for joint, fit in models.test_fit.items():
        assert fit >= 70.0, f"{joint}: {fit:.1f} %"
