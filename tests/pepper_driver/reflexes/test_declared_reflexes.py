"""Reflexes as files declare them."""

from typing import Any

import pytest
from hypothesis import given, reject
from hypothesis import strategies as st

from pepper_driver.config import ConfigError, load_robot
from pepper_driver.config.contact_selector import SELECTOR_FIELDS
from pepper_driver.reflexes import Comply, FollowHand, ReflexError, Retract
from pepper_driver.reflexes.declared import make_reflexes, overlap
from support.examples import examples
from support.reflexes import touch
from support.yaml_values import ANYTHING

ROBOT = load_robot()


def make(*declared: dict[str, Any]) -> tuple[Any, ...]:
    entries = {f"reactions.{number}": entry for number, entry in enumerate(declared)}
    return make_reflexes(entries, ROBOT, "mine")


def test_arguments_are_the_fields_of_the_reflex() -> None:
    on = {"link": "LForeArm", "joint": "LElbowRoll", "kind": "collision", "min_intensity_deg": 2}
    declared = {"on": on, "do": "retract", "distance": 0.3, "priority": 5, "then": "stay"}
    (reflex,) = make({**declared, "name": "away"})
    assert isinstance(reflex, Retract)
    assert (reflex.link, reflex.joint, reflex.kind) == ("LForeArm", "LElbowRoll", "collision")
    assert (reflex.min_intensity_deg, reflex.distance, reflex.priority) == (2, 0.3, 5)
    assert (reflex.then, reflex.name) == ("stay", "away")


@pytest.mark.parametrize(
    "kind",
    ["assist", "comply", "follow_hand", "hold", "ignore", "retract", "soften", "stop_base"],
)
def test_every_kind_goes_by_its_name(kind: str) -> None:
    (reflex,) = make({"do": kind})
    assert reflex.name == kind


@pytest.mark.parametrize(
    ("declared", "where", "reason"),
    [
        ({}, "reactions.0.do", "is missing"),
        ({"do": 3}, "reactions.0.do", "is missing"),
        ({"do": "retrat"}, "reactions.0.do", "did you mean retract"),
        ({"do": "hold", "on": "LForeArm"}, "reactions.0.on", "a mapping"),
        ({"do": "hold", "on": {"lnk": "LForeArm"}}, "reactions.0.on.lnk", "did you mean link"),
        ({"do": "hold", "on": {"link": "LForeAm"}}, "reactions.0.on.link", "did you mean LForeArm"),
        ({"do": "hold", "on": {"link": []}}, "reactions.0.on.link", "at least one name"),
        ({"do": "hold", "on": {"limb": "lef_arm"}}, "reactions.0.on.limb", "did you mean left_arm"),
        (
            {"do": "hold", "on": {"limb": ["head", "arm"]}},
            "reactions.0.on.limb",
            "unknown limb 'arm'",
        ),
        (
            {"do": "hold", "on": {"limb": "head", "joint": "LElbowRoll"}},
            "reactions.0.on",
            "limb head and joint LElbowRoll",
        ),
        ({"do": "hold", "on": {"min_torque": -1}}, "reactions.0.on.min_torque", "got -1"),
        ({"do": "hold", "on": {"min_torque": "2"}}, "reactions.0.on.min_torque", 'got "2"'),
        ({"do": "hold", "on": {"joint": "LElbow"}}, "reactions.0.on.joint", "unknown joint"),
        ({"do": "hold", "on": {"kind": "shove"}}, "reactions.0.on.kind", "collision"),
        ({"do": "hold", "distance": 0.3}, "reactions.0.distance", "unknown key"),
        ({"do": "hold", "link": "LForeArm"}, "reactions.0.link", "unknown key"),
        ({"do": "retract", "distanc": 0.3}, "reactions.0.distanc", "did you mean distance"),
        ({"do": "retract", "distance": 9}, "reactions.0", "from 0.01 to 1.5, got 9"),
        ({"do": "retract", "distance": "far"}, "reactions.0", "got 'far'"),
        ({"do": "retract", "then": "run"}, "reactions.0", "'resume' or 'stay'"),
        ({"do": "hold", "name": "a\nb"}, "reactions.0.name", "up to 80 letters"),
        ({"do": "hold", "contact": 1}, "reactions.0.contact", "unknown key"),
        ({"do": "hold", "a\nb": 1}, r"reactions.0.a\nb", "unknown key"),
    ],
)
def test_a_wrong_one_is_refused(declared: dict[str, Any], where: str, reason: str) -> None:
    with pytest.raises(ConfigError) as caught:
        make(declared)
    assert f"key '{where}'" in str(caught.value)
    assert reason in str(caught.value)


ARM = {"link": "LForeArm"}


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({"do": "hold"}, {"do": "retract", "priority": 20}),
        ({"do": "hold", "on": ARM}, {"do": "hold"}),
        ({"do": "comply", "on": ARM}, {"do": "assist", "on": {"joint": "LShoulderRoll"}}),
        (
            {"do": "comply", "on": {"link": "l_gripper"}},  # no joint carries it alone
            {"do": "assist", "on": {"joint": "LShoulderRoll"}},
        ),
        ({"do": "stop_base", "priority": 20}, {"do": "hold"}),
        ({"do": "follow_hand", "follow_with": "base"}, {"do": "stop_base", "priority": 30}),
        ({"do": "ignore", "priority": 10}, {"do": "soften"}),
        ({"do": "comply", "on": {"kind": "contact"}}, {"do": "comply", "on": ARM}),
        # a contact grows into a collision
        ({"do": "hold", "on": {"kind": "contact"}}, {"do": "hold", "on": {"kind": "collision"}}),
    ],
)
def test_conflicts_are_refused_and_a_priority_cures_them(
    one: dict[str, Any], other: dict[str, Any]
) -> None:
    for pair in ((one, other), (other, one)):
        with pytest.raises(ConfigError, match=r"key 'reactions\.1'.*same priority.*both claim"):
            make(*pair)
    make(one, {**other, "priority": 7})


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({"do": "hold", "on": ARM}, {"do": "hold", "on": {"link": "RForeArm"}}),
        ({"do": "comply", "on": ARM}, {"do": "comply", "on": {"joint": "RShoulderRoll"}}),
        ({"do": "retract", "priority": 10}, {"do": "soften"}),
        ({"do": "retract", "priority": 50}, {"do": "stop_base"}),
        ({"do": "follow_hand", "follow_with": "arm"}, {"do": "stop_base", "priority": 30}),
        ({"do": "ignore"}, {"do": "ignore", "name": "too"}),
        ({"do": "soften"}, {"do": "soften"}),
    ],
)
def test_what_gets_along_is_taken(one: dict[str, Any], other: dict[str, Any]) -> None:
    assert len(make(one, other)) == 2


def one_or_more(*names: str) -> st.SearchStrategy[str | list[str]]:
    several = st.lists(st.sampled_from(names), min_size=1, max_size=3)
    return st.sampled_from(names) | several


ON = st.fixed_dictionaries(
    {},
    optional={
        "limb": one_or_more("left_arm", "right_arm", "trunk"),
        "link": one_or_more("LForeArm", "RForeArm", "LBicep", "torso"),
        "joint": one_or_more("LElbowRoll", "LShoulderRoll", "RShoulderRoll"),
        "kind": st.sampled_from(["contact", "collision"]),
        "min_intensity_deg": st.floats(0.0, 5.0),
        "min_torque": st.floats(0.0, 3.0),
    },
)


@examples(200)
@given(
    ON,
    ON,
    st.sampled_from([("LForeArm", "LElbowRoll"), ("LBicep", "LShoulderRoll"), ("torso", None)]),
    st.sampled_from(["contact", "collision"]),
    st.floats(0.0, 6.0),
    st.none() | st.floats(-4.0, 4.0),
)
def test_two_that_answer_one_contact_overlap(
    one: dict[str, Any],
    other: dict[str, Any],
    place: tuple[str, str],
    kind: str,
    size: float,
    torque: float | None,
) -> None:
    reflexes = Comply(**one), FollowHand(**other)
    contact = touch(link=place[0], joint=place[1], kind=kind, intensity_deg=size, torque=torque)
    for reflex in reflexes:
        try:
            reflex.setup(ROBOT)
        except ReflexError:
            assert not reflex.matches(contact)
            reject()
    if all(reflex.matches(contact) for reflex in reflexes):
        assert overlap(*reflexes, ROBOT)
    assert overlap(*reflexes, ROBOT) == overlap(reflexes[1], reflexes[0], ROBOT)


@examples(150)
@given(
    st.sampled_from(["hold", "retract", "follow_hand", "assist", "x"]),
    st.dictionaries(
        st.sampled_from(["on", "distance", "name", "then", "follow_with", "release_delay"]),
        ANYTHING,
    ),
    st.dictionaries(st.sampled_from(SELECTOR_FIELDS), ANYTHING),
)
def test_anything_makes_a_reflex_or_one_line(
    kind: str, rest: dict[str, Any], on: dict[str, Any]
) -> None:
    try:
        make({"do": kind, "on": on, **rest})
    except ConfigError as error:
        assert len(str(error).splitlines()) == 1
