"""Plants that say how they differ from another one."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.config import (
    ConfigError,
    RobotIdentity,
    load_plant,
    parent_plants,
    plant_hash,
)
from support.plant_files import (
    ROBOT,
    Tree,
    nominal,
    save,
    variant,
)


def test_a_chain_of_variants_adds_up(tmp_path: Path) -> None:
    save(
        tmp_path,
        {
            "name": "old",
            "description": "first",
            "extends": "nominal",
            "factors": {"kp": 2.0, "friction.contact.motor": 3},
            "battery": {"charge": 0.5},
            "joints": {"HeadYaw": {"kd": 1.0, "friction": {"load": 0.2}}},
        },
        "old.yaml",
    )
    path = save(
        tmp_path,
        {
            "name": "older",
            "extends": "old.yaml",
            "factors": {"kp": {"HeadYaw": 0.25, "LHand": 3.0}},
            "battery": {"resistance": 0.7},
        },
    )
    first, plant = load_plant("nominal", ROBOT), load_plant(path, ROBOT)
    kp = 2.0 * first.per_joint("kp", ROBOT)
    kp[ROBOT.joint_index("HeadYaw")] *= 0.25
    kp[ROBOT.joint_index("LHand")] *= 3.0
    np.testing.assert_allclose(plant.per_joint("kp", ROBOT), kp)
    np.testing.assert_allclose(
        plant.per_joint("friction.contact.motor", ROBOT),
        3 * first.per_joint("friction.contact.motor", ROBOT),
    )
    assert (plant.name, plant.description) == ("older", "first")
    assert (plant.battery.charge, plant.battery.resistance) == (0.5, 0.7)
    assert plant.battery.energy == first.battery.energy
    head, was = plant.actuator("HeadYaw"), first.actuator("HeadYaw")
    assert (head.kd, head.friction.load) == (1.0, 0.2)
    assert head.friction.breakaway == was.friction.breakaway
    assert plant.actuator("LElbowYaw").kd == first.actuator("LElbowYaw").kd
    assert plant.physics == first.physics
    assert plant.source == path


def test_an_override_comes_after_the_factor(tmp_path: Path) -> None:
    path = variant(tmp_path, factors={"kp": 2.0}, joints={"HeadYaw": {"kp": 7.0}})
    assert load_plant(path, ROBOT).actuator("HeadYaw").kp == 7.0


def test_one_joint_can_change_while_its_twin_stays(tmp_path: Path) -> None:
    first = load_plant("nominal", ROBOT)
    plant = load_plant(variant(tmp_path, joints={"LHand": {"kp": 1.0}}), ROBOT)
    assert plant.actuator("LHand").kp == 1.0
    assert plant.actuator("RHand").kp == first.actuator("RHand").kp


@pytest.mark.parametrize("others", [("mine.yaml",), ("b.yaml", "c.yaml", "mine.yaml")])
def test_a_plant_that_extends_itself_is_refused(tmp_path: Path, others: tuple[str, ...]) -> None:
    names = ["mine.yaml", *others]
    for name, parent in pairwise(names):
        save(tmp_path, {"name": name, "extends": parent}, name)
    with pytest.raises(ConfigError, match=r"mine\.yaml line \d+: key 'extends': .*itself"):
        load_plant(str(tmp_path / "mine.yaml"), ROBOT)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"factors": {"friction.contact.moter": 2.0}}, "did you mean friction.contact.motor"),
        ({"factors": {"friction.contact": 2.0}}, "key 'factors.friction.contact': no number"),
        ({"factors": {"origin": 2.0}}, "key 'factors.origin': no number"),
        ({"factors": {"kp": "two"}}, "expected a finite number"),
        ({"factors": {"kp": True}}, "expected a finite number"),
        ({"factors": {"kp": {"HeadYow": 2.0}}}, "did you mean HeadYaw"),
        ({"factors": {"kp": {"HeadYaw": None}}}, "expected a finite number"),
        ({"factors": {"kp": -1.0}}, "must be above 0"),
        ({"factors": [2.0]}, "key 'factors': expected a mapping"),
        ({"joints": {"HeadYow": {"kp": 2.0}}}, "did you mean HeadYaw"),
        ({"joints": {"HeadYaw": {"kpp": 2.0}}}, "kpp"),
        ({"joints": {"HeadYaw": 2.0}}, "key 'joints.HeadYaw': expected a mapping"),
        ({"actuators": []}, "gives 'factors' and 'joints'"),
        ({"extends": 7}, "expected the name of a plant"),
        ({"boards": {"voltage": 3.0}}, "did you mean board"),
    ],
)
def test_a_wrong_variant_is_refused(tmp_path: Path, keys: Tree, message: str) -> None:
    with pytest.raises(ConfigError, match=r"mine\.yaml") as caught:
        load_plant(variant(tmp_path, **keys), ROBOT)
    assert message in str(caught.value)


def test_a_variant_of_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"mine\.yaml line \d+: key 'extends': .*did you mean nominal"
    ):
        load_plant(variant(tmp_path, extends="nominel"), ROBOT)
    with pytest.raises(ConfigError, match=r"absent\.yaml"):
        load_plant(variant(tmp_path, extends="absent.yaml"), ROBOT)


def test_the_parents_of_a_plant_are_what_it_extends_nearest_first(tmp_path: Path) -> None:
    assert parent_plants("nominal", ROBOT) == ()
    assert parent_plants("swaying-integral", ROBOT) == (
        identity_of("integral"),
        identity_of("nominal"),
    )
    save(tmp_path, {"name": "middle", "description": "", "extends": "worn"}, "middle.yaml")
    path = save(tmp_path, {"name": "mine", "description": "", "extends": "middle.yaml"})
    middle = RobotIdentity(name="middle", identity=identity_of("worn").identity)
    assert parent_plants(path, ROBOT) == (middle, identity_of("worn"), identity_of("nominal"))


def test_the_parents_of_a_draw_are_the_first_draw_and_what_it_extends(tmp_path: Path) -> None:
    extended, first, fifth = (
        identity_of("nominal"),
        identity_of("drift", 0),
        identity_of("drift", 5),
    )
    assert (first.name, fifth.name) == ("drift-0", "drift-5")
    assert parent_plants("drift", ROBOT) == parent_plants("drift", ROBOT, draw=0) == (extended,)
    assert parent_plants("drift", ROBOT, draw=5) == (first, extended)
    path = save(tmp_path, {"name": "mine", "extends": "drift", "battery": {"resistance": 0.3}})
    assert parent_plants(path, ROBOT, draw=5) == (identity_of(path), fifth, first, extended)


def test_a_plant_that_is_none_without_what_extends_it_is_no_parent(tmp_path: Path) -> None:
    tree = nominal()
    heat = tree.pop("heat")
    save(tmp_path, {**tree, "name": "part"}, "part.yaml")
    path = save(tmp_path, {"name": "mine", "description": "", "extends": "part.yaml", "heat": heat})
    assert load_plant(path, ROBOT).name == "mine"
    assert parent_plants(path, ROBOT) == ()


def identity_of(plant: str, draw: int | None = None) -> RobotIdentity:
    made = load_plant(plant, ROBOT, draw=draw)
    return RobotIdentity(name=made.name, identity=plant_hash(made, ROBOT))
