"""Choice of contacts: its arguments, and the limbs of the robot."""

import math
from typing import Any

import numpy as np
import pytest
from pydantic.dataclasses import dataclass

from pepper_driver.config import ConfigError, PepperError, UnknownNameError, load_robot
from pepper_driver.config.contact_selector import ContactSelector, SelectorError
from pepper_driver.config.loading import STRICT, parse
from pepper_driver.config.robot import LEGS, TRUNK

ROBOT = load_robot()


def test_every_joint_and_link_is_of_one_limb() -> None:
    assert list(ROBOT.limbs) == ["trunk", "head", "left_arm", "right_arm"]
    joints = [joint for limb in ROBOT.limbs.values() for joint in limb]
    assert sorted(joints) == sorted(ROBOT.joint_names)
    for limb, names in ROBOT.limbs.items():
        for name in names:
            assert ROBOT.limb_of(name) == limb
            assert ROBOT.limb_of_link(ROBOT.joints[ROBOT.joint_index(name)].child) == limb
    assert ROBOT.limb_of(None) == TRUNK
    assert ROBOT.limbs[TRUNK] == ROBOT.chains[LEGS]
    trunk = [link for link in ROBOT.links if ROBOT.limb_of_link(link) == TRUNK]
    wheels = [f"{wheel}_link" for wheel in ROBOT.wheels.names]
    assert set(trunk) == {"base_link", "Tibia", "Pelvis", "Hip", "torso", *wheels}


def test_a_name_stands_for_a_list_of_one_and_none_for_any() -> None:
    one = ContactSelector.from_arguments(limb="left_arm", link=None)
    assert one == ContactSelector.from_arguments(limb=["left_arm"])
    assert (one.limb, one.link) == (("left_arm",), ())
    assert ContactSelector.from_arguments() == ContactSelector()


def test_numbers_of_any_kind_are_taken() -> None:
    selector = ContactSelector.from_arguments(min_torque=np.float32(1.5), min_intensity_deg=2)
    assert (selector.min_torque, selector.min_intensity_deg) == (1.5, 2.0)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"limb": "lef_arm"}, UnknownNameError, "unknown limb 'lef_arm' (did you mean left_arm"),
        ({"limb": ["head", "legs"]}, UnknownNameError, "unknown limb 'legs'"),
        ({"link": "LForeAm"}, UnknownNameError, "did you mean LForeArm"),
        ({"joint": ["LElbowRol"]}, UnknownNameError, "did you mean LElbowRoll"),
        ({"kind": "colision"}, UnknownNameError, "did you mean collision"),
        ({"kind": 3}, SelectorError, "kind: "),
        ({"limb": []}, SelectorError, "limb: a list needs at least one name"),
        ({"limb": 3}, SelectorError, "limb: a name or a list of names is needed, got 3"),
        ({"link": ["LForeArm", 3]}, SelectorError, "link: a name or a list of names"),
        ({"limbs": "left_arm"}, SelectorError, "'limbs' (did you mean limb"),
        ({"min_intensity": 3.0}, SelectorError, "did you mean min_intensity_deg"),
        ({"min_intensity_deg": 181}, SelectorError, "min_intensity_deg: "),
        ({"min_torque": -0.1}, SelectorError, "min_torque: "),
        ({"min_torque": math.nan}, SelectorError, "min_torque: "),
        ({"min_torque": True}, SelectorError, "min_torque: "),
        ({"min_torque": None}, SelectorError, "min_torque: "),
        (
            {"limb": "head", "joint": "LElbowRoll"},
            SelectorError,
            "no contact is on limb head and joint LElbowRoll",
        ),
        ({"link": "LForeArm", "joint": "RHand"}, SelectorError, "different limbs"),
    ],
)
def test_what_makes_no_sense_is_one_line(
    arguments: dict[str, Any], error: type[PepperError], message: str
) -> None:
    with pytest.raises(error) as caught:
        ContactSelector.from_arguments(**arguments).check(ROBOT)
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_limbs_where_a_contact_can_meet_all_conditions() -> None:
    def limbs(**arguments: Any) -> set[str]:
        return set(ContactSelector.from_arguments(**arguments).limbs_in(ROBOT))

    assert limbs() == set(ROBOT.limbs)
    assert limbs(limb=["left_arm", "head"]) == {"left_arm", "head"}
    assert limbs(limb=["left_arm", "head"], link=["Head", "RBicep"]) == {"head"}
    assert limbs(joint="KneePitch", link="base_link") == {"trunk"}
    assert limbs(limb="head", joint="RHand") == set()


def test_it_says_what_it_chooses() -> None:
    selector = ContactSelector.from_arguments(
        limb=["left_arm", "head"], joint="LHand", kind="collision", min_torque=2
    )
    text = "collision on left_arm or head turning LHand, 2 N m and more"
    assert str(selector) == text
    assert str(ContactSelector()) == "contact"


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Holder(ContactSelector):
    """A part of a file that has the keys of a selector."""

    timeout: float


def test_files_have_its_fields_as_keys() -> None:
    data = {"limb": ["left_arm", "head"], "joint": "LHand", "min_torque": 2, "timeout": 1.0}
    holder = parse(Holder, data, "a.yaml")
    assert (holder.limb, holder.joint, holder.min_torque) == (("left_arm", "head"), ("LHand",), 2)
    for key, value, reason in (
        ("limb", [], "at least one name"),
        ("limb", [1], "a name or a list of names"),
        ("min_torque", "2", 'must be a number, got "2"'),
        ("limbs", "head", "did you mean limb"),
    ):
        with pytest.raises(ConfigError, match=reason) as caught:
            parse(Holder, {"timeout": 1.0, key: value}, "a.yaml")
        assert f"key '{key}'" in str(caught.value)
