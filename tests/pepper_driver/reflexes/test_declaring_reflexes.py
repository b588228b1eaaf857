"""Reflexes as text and back: the log keeps every argument, and what is in a file is a reflex or one error."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import fields
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config import ConfigError, load_robot
from pepper_driver.config.contact_selector import SELECTOR_FIELDS
from pepper_driver.reflexes import (
    Assist,
    Comply,
    FollowHand,
    Hold,
    Ignore,
    Reflex,
    Retract,
    Soften,
    StopBase,
    prepare_reflexes,
)
from pepper_driver.reflexes.declared import declare, make_reflex
from support.examples import examples

ROBOT = load_robot()
ALL: list[type[Reflex]] = [Assist, Comply, FollowHand, Hold, Ignore, Retract, Soften, StopBase]


def again(entry: dict[str, Any]) -> Reflex:
    """From the text that a log holds."""
    return make_reflex(json.loads(json.dumps(entry)), ROBOT, "a log", "reflexes.0")


@pytest.mark.parametrize("kind", ALL)
@examples(20)
@given(
    on=st.sampled_from(
        [
            {},
            {"limb": "left_arm"},
            {"limb": ["head", "trunk"], "link": "base_link"},
            {"link": ("LForeArm", "LBicep"), "joint": "LWristYaw", "min_torque": 0.5},
        ]
    ),
    touch=st.sampled_from([None, "contact", "collision"]),
    least=st.floats(0.0, 180.0),
    priority=st.integers(-1000, 1000),
    release_delay=st.floats(0.0, 3600.0),
    then=st.sampled_from(["resume", "stay"]),
    name=st.sampled_from(["", "gives way"]),
)
def test_it_comes_back_with_all_its_arguments(
    kind: type[Reflex],
    on: dict[str, Any],
    touch: Any,
    least: float,
    priority: int,
    release_delay: float,
    then: Any,
    name: str,
) -> None:
    reflex = kind(
        **on,
        kind=touch,
        min_intensity_deg=least,
        priority=priority,
        release_delay=release_delay,
        then=then,
        name=name,
    )
    made = again(declare(reflex))
    assert type(made) is kind
    assert made.selector == reflex.selector
    for field in fields(reflex):
        if field.init and field.name not in SELECTOR_FIELDS:
            assert getattr(made, field.name) == getattr(reflex, field.name), field.name


def test_arguments_of_their_own_come_back() -> None:
    made = again(declare(FollowHand(follow_with="base", base_damping=12.5, speed=0.1)))
    assert isinstance(made, FollowHand)
    assert (made.follow_with, made.base_damping, made.speed) == ("base", 12.5, 0.1)


def test_all_of_a_robot_come_back_in_their_order_with_their_names() -> None:
    reflexes = prepare_reflexes(
        [Hold(), Retract(), Hold(link="LForeArm"), Ignore(link="Head")], ROBOT
    )
    made = prepare_reflexes([again(declare(reflex)) for reflex in reflexes], ROBOT)
    names = [reflex.full_name for reflex in reflexes]
    assert names == ["ignore", "retract", "hold 1", "hold 2"]
    assert [reflex.full_name for reflex in made] == names


def test_an_unregistered_class_differs_from_one_of_the_same_name() -> None:
    mine = type("Hold", (Hold,), {})
    assert declare(Hold()).get("class") is None
    assert declare(mine())["class"] == "Hold"


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)
KEYS = (
    st.sampled_from(["do", "on", "name", "gain", "release_delay", "then", "follow_with", "class"])
    | st.text()
)


@given(entry=st.dictionaries(KEYS, VALUES), kind=st.sampled_from(["hold", "comply", "follow_hand"]))
def test_whatever_stands_there_is_a_reflex_or_one_error(entry: dict[str, Any], kind: str) -> None:
    for candidate in (entry, {**entry, "do": kind}):
        with suppress(ConfigError):
            assert isinstance(make_reflex(candidate, ROBOT, "a.yaml", "reflexes.0"), Reflex)
