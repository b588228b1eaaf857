"""Filters pick the requested events, and refuse names and numbers that no event can have."""

from collections.abc import Callable
from itertools import accumulate
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.callbacks.events import SensorEvent, TickEvent
from pepper_driver.callbacks.filters import (
    SubscriptionError,
    contact_filter,
    match,
    tick_filter,
)
from pepper_driver.config import PepperError, UnknownNameError
from pepper_driver.controller import Tick
from support.events import ROBOT, contact

LINK = ROBOT.links[-1]


@pytest.mark.parametrize(
    ("criteria", "fits", "fits_not"),
    [
        ({}, {"phase": "begin"}, {"phase": "update"}),
        ({"phase": None}, {"phase": "end"}, {"intensity_deg": -1.0}),
        ({}, {"kind": "collision"}, {"kind": "rebound"}),
        ({"phase": "end"}, {"phase": "end"}, {"phase": "begin"}),
        ({"link": LINK}, {"link": LINK}, {"link": "elsewhere"}),
        ({"joint": "RHand"}, {"joint": "RHand"}, {"joint": None}),
        ({"limb": "head"}, {"limb": "head"}, {"limb": "left_arm"}),
        ({"limb": ["head", "trunk"]}, {"limb": "trunk"}, {"limb": "left_arm"}),
        ({"link": [LINK, "Head"]}, {"link": "Head"}, {"link": "elsewhere"}),
        ({"kind": "collision"}, {"kind": "collision"}, {"kind": "contact"}),
        ({"min_torque": 2.0}, {"torque": -2.0}, {"torque": 1.9}),
        ({"min_torque": 2.0}, {"torque": 2.5}, {"torque": None}),
        ({"min_torque": 2.0}, {"torque": 2.5}, {"torque": float("nan")}),
        ({"min_force": 5.0}, {"force": (3.0, 0.0, -4.0)}, {"force": (3.0, 3.9, 0.0)}),
        ({"min_force": 5.0}, {"force": (0.0, 6.0, 0.0)}, {"force": None}),
        (  # all conditions, not any
            {"limb": "head", "kind": "collision", "min_torque": 1.0},
            {"limb": "head", "kind": "collision", "torque": 1.0},
            {"limb": "head", "kind": "contact", "torque": 1.0},
        ),
        (
            {"limb": "head", "min_torque": 1.0},
            {"limb": "head", "torque": 1.0},
            {"limb": "left_arm", "torque": 1.0},
        ),
        ({"min_intensity_deg": 2.5}, {"intensity_deg": 2.5}, {"intensity_deg": 2.4}),
        (
            {"min_intensity_deg": np.float32(2.5)},
            {"intensity_deg": 2.6},
            {"intensity_deg": float("nan")},
        ),
        (
            {"joint": "RHand", "kind": "rebound"},
            {"joint": "RHand", "kind": "rebound"},
            {"joint": "RHand"},
        ),
    ],
)
def test_contacts(criteria: dict[str, Any], fits: dict[str, Any], fits_not: dict[str, Any]) -> None:
    predicate = contact_filter(ROBOT, **criteria)
    assert predicate(contact(**fits))
    assert not predicate(contact(**fits_not))


@pytest.mark.parametrize(
    ("criteria", "later"),
    [
        ({"link": LINK}, {"link": LINK}),
        ({"joint": "RHand"}, {"joint": "RHand"}),
        ({"kind": "collision"}, {"kind": "collision"}),
        ({"min_intensity_deg": 5.0}, {"intensity_deg": 6.0}),
        ({"min_torque": 2.0}, {"torque": -2.5}),
        ({"limb": "right_arm"}, {"limb": "right_arm"}),
    ],
)
def test_a_contact_is_reported_once_it_is_as_described(
    criteria: dict[str, Any], later: dict[str, Any]
) -> None:
    """The observer finds out where it is, and how strong, after its begin."""
    predicate = contact_filter(ROBOT, **criteria)
    other = {"link": "elsewhere", "joint": None, "kind": "contact", "intensity_deg": 1.0}
    story = [
        ("begin", other, False),
        ("update", other, False),
        ("update", {**other, **later}, True),
        ("update", {**other, **later}, False),
        ("end", {**other, **later}, False),
        ("begin", {**other, **later}, True),  # a new run counts from 1 again
        ("end", {**other, **later}, False),
        ("update", {**other, **later}, False),
        ("begin", other, False),
        ("end", {**other, **later}, False),  # as described too late
    ]
    for phase, values, expected in story:
        assert predicate(contact(phase=phase, **values)) == expected


@pytest.mark.parametrize(
    ("criteria", "hint"),
    [
        ({"limb": "left"}, "limb 'left' .*left_arm"),
        ({"joint": "LElbowRol"}, "joint 'LElbowRol' .*LElbowRoll"),
        ({"link": ROBOT.links[3] + "x"}, f"link .*did you mean .*{ROBOT.links[3]}"),
        ({"kind": "colision"}, "did you mean collision"),
        ({"phase": "start"}, "begin, end, update"),
    ],
)
def test_names_of_contacts_are_checked(criteria: dict[str, Any], hint: str) -> None:
    with pytest.raises(UnknownNameError, match=hint):
        contact_filter(ROBOT, **criteria)


@pytest.mark.parametrize("intensity_deg", [-0.1, float("nan"), None, "3", [1.0]])
def test_intensities_are_checked(intensity_deg: Any) -> None:
    with pytest.raises(SubscriptionError, match="min_intensity_deg") as caught:
        contact_filter(ROBOT, min_intensity_deg=intensity_deg)
    assert isinstance(caught.value, PepperError)


def test_what_no_contact_can_be_is_refused() -> None:
    with pytest.raises(SubscriptionError, match="limb head and link LForeArm"):
        contact_filter(ROBOT, limb="head", link="LForeArm")
    with pytest.raises(SubscriptionError, match="did you mean limb"):
        contact_filter(ROBOT, limbs="head")


def after(number: int) -> TickEvent:
    tick = SimpleNamespace(measurement=SimpleNamespace(tick=number))
    return TickEvent(tick=cast("Tick", tick), observation=None)


@given(st.integers(1, 20), st.integers(1, 50), st.integers(0, 100))
def test_one_tick_in_so_many(every: int, first: int, ticks: int) -> None:
    predicate = tick_filter(every)
    for _ in range(2):  # a new run counts from the beginning
        numbers = range(first, first + ticks)
        picked = [number for number in numbers if predicate(after(number))]
        assert picked == list(numbers)[::every]


@given(st.integers(1, 10), st.lists(st.integers(1, 30), min_size=1))
def test_ticks_that_were_missed_delay_no_call(every: int, steps: list[int]) -> None:
    predicate = tick_filter(every)
    picked = 0
    for number in accumulate(steps):
        assert predicate(after(number)) == (picked == 0 or number - picked >= every)
        if picked == 0 or number - picked >= every:
            picked = number


@pytest.mark.parametrize("every", [0, -1, 1.5, True, "2", None])
def test_numbers_of_ticks_are_checked(every: Any) -> None:
    with pytest.raises(SubscriptionError, match="every must be a whole number"):
        tick_filter(every)


def edge(kind: Any = "touch", name: str = "Head/Touch/Front", pressed: bool = True) -> SensorEvent:
    return SensorEvent(kind=kind, name=name, pressed=pressed, time=0.0)


def test_events_are_matched_by_the_fields_that_are_given() -> None:
    kinds, names = ("touch", "bumper"), tuple(ROBOT.sensors.touch)

    def sensors(kind: str | None, name: str | None, pressed: bool | None) -> Callable[[Any], bool]:
        return match(
            kind=("kind of sensor", kind, kinds),
            name=("touch sensor", name, names),
            pressed=("value of pressed", pressed, (True, False)),
        )

    front = sensors("touch", "Head/Touch/Front", True)
    assert front(edge())
    assert not front(edge(name="Head/Touch/Rear"))
    assert not front(edge(pressed=False))
    assert not front(edge(kind="bumper"))
    released = sensors("touch", None, False)
    assert released(edge(name="Head/Touch/Rear", pressed=False))
    assert not released(edge())
    both = sensors(None, None, None)
    assert both(edge())
    assert both(edge(kind="bumper", pressed=False))
    with pytest.raises(
        UnknownNameError, match=r"touch sensor 'Head/Touch/Frnt' .*Head/Touch/Front"
    ):
        sensors("touch", "Head/Touch/Frnt", None)
