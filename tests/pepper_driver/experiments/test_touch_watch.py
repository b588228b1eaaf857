"""Touches become as a trigger says: how hard, for how long, how often; each counts once."""

from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config import UnknownNameError, load_robot
from pepper_driver.config.contact_selector import TouchTrigger
from pepper_driver.experiments.touch_watch import TouchWatch
from pepper_driver.observer import Contact
from support.events import contact

ROBOT = load_robot()
CYCLE = ROBOT.cycle


def met(events: Mapping[int, tuple[Contact, ...]], ticks: int = 200, **trigger: Any) -> list[int]:
    """Ticks, from 0, in which the trigger is met."""
    watch = TouchWatch(TouchTrigger(**trigger), ROBOT)
    times = [tick for tick in range(ticks) if watch.step(events.get(tick, ()), tick * CYCLE)]
    assert watch.fired == bool(times)
    return times


def begin(number: int = 1, **changes: Any) -> tuple[Contact, ...]:
    return (contact(number, **changes),)


def update(number: int = 1, **changes: Any) -> tuple[Contact, ...]:
    return (contact(number, phase="update", **changes),)


def end(number: int = 1, **changes: Any) -> tuple[Contact, ...]:
    return (contact(number, phase="end", **changes),)


def test_a_touch_counts_when_it_begins_and_then_no_more() -> None:
    assert met({5: begin(), 9: update(intensity_deg=9.0), 12: end(intensity_deg=9.0)}) == [5]


def test_each_touch_counts() -> None:
    assert met({5: begin(1), 7: begin(2), 9: (*end(1), *begin(3))}) == [5, 7, 9]


def test_what_began_before_does_not_count() -> None:
    assert met({3: update(), 4: end(), 6: begin(2)}) == [6]


def test_a_number_that_comes_again_after_its_end_is_a_new_touch() -> None:
    assert met({3: begin(), 5: end(), 8: begin()}) == [3, 8]


@pytest.mark.parametrize(
    ("trigger", "weak", "strong"),
    [
        ({"min_intensity_deg": 2.0}, {"intensity_deg": 1.9}, {"intensity_deg": 2.0}),
        ({"min_torque": 1.5}, {"torque": 1.4}, {"torque": -1.5}),
        ({"min_torque": 1.5}, {"torque": None}, {"torque": 1.5}),
        ({"limb": "left_arm"}, {"limb": "right_arm"}, {"limb": "left_arm"}),
        ({"limb": ["head", "left_arm"]}, {"limb": "trunk"}, {"limb": "head"}),
        ({"link": "LForeArm"}, {"link": "LBicep"}, {"link": "LForeArm"}),
        ({"joint": "LElbowRoll"}, {"joint": None}, {"joint": "LElbowRoll"}),
        ({"kind": "collision"}, {"kind": "contact"}, {"kind": "collision"}),
        ({}, {"kind": "rebound"}, {"kind": "collision"}),
    ],
)
def test_it_counts_when_it_has_become_as_chosen(
    trigger: dict[str, Any], weak: dict[str, Any], strong: dict[str, Any]
) -> None:
    growing = {5: begin(**weak), 9: update(**weak), 20: update(**strong), 25: update(**strong)}
    assert met(growing, **trigger) == [20]
    assert met({5: begin(**weak), 9: end(**strong)}, **trigger) == []


# -- for how long -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("lasting", "ticks"), [(0.6, 50), (0.61, 51), (0.001, 0), (1.2, 100)])
def test_a_touch_has_to_last(lasting: float, ticks: int) -> None:
    assert met({5: begin()}, lasting=lasting) == [5 + ticks]
    assert met({5: begin(), 5 + ticks + 1: end()}, lasting=lasting) == [5 + ticks]
    if ticks:
        assert met({5: begin(), 5 + ticks: end()}, lasting=lasting) == []


def test_a_touch_that_becomes_as_chosen_late_has_lasted_since_it_began() -> None:
    events = {5: begin(intensity_deg=1.0), 40: update(intensity_deg=3.0)}
    assert met(events, lasting=0.6, min_intensity_deg=2.0) == [55]
    events = {5: begin(intensity_deg=1.0), 90: update(intensity_deg=3.0)}
    assert met(events, lasting=0.6, min_intensity_deg=2.0) == [90]


def test_a_touch_that_turns_out_to_be_elsewhere_does_not_count() -> None:
    """The place of a contact may be revised; a rebound may be recognised late."""
    moved = {5: begin(), 20: update(link="LBicep")}
    assert met(moved, lasting=0.6, link="LForeArm") == []
    assert met(moved, lasting=0.6, link="LBicep") == [55]
    assert met({5: begin(), 20: update(kind="rebound")}, lasting=0.6) == []
    there_and_back = {5: begin(), 20: update(link="LBicep"), 30: update()}
    assert met(there_and_back, lasting=0.6, link="LForeArm") == [55]


# -- how often --------------------------------------------------------------------------------------------------------


def taps(*ticks: int, length: int = 3) -> dict[int, tuple[Contact, ...]]:
    """Touches that begin in these ticks, one after the other."""
    events: dict[int, tuple[Contact, ...]] = {}
    for number, tick in enumerate(ticks):
        events[tick] = (*events.get(tick, ()), *begin(number))
        events[tick + length] = (*events.get(tick + length, ()), *end(number))
    return events


def test_several_touches_within_a_time() -> None:
    assert met(taps(10, 40, 70), touches=3, within=0.72) == [70]
    assert met(taps(10, 40, 71), touches=3, within=0.72) == []
    assert met(taps(10, 40, 71, 80), touches=3, within=0.72) == [80], "the oldest is forgotten"


def test_touches_that_have_counted_are_not_counted_again() -> None:
    assert met(taps(10, 20, 30, 40, 50), touches=2, within=0.6) == [20, 40]


def test_touches_at_once_count_each() -> None:
    assert met(taps(10, 10), touches=2, within=0.1) == [10]


def test_only_touches_as_chosen_are_counted() -> None:
    events = taps(10, 20, 30)
    events[20] = (*begin(1, link="LBicep"), *events[20][1:])
    assert met(events, touches=2, within=0.5, link="LForeArm") == [30]


def test_touches_that_last_count_by_when_they_began() -> None:
    """The first began long before the others, and became strong last of all."""
    strong = {"intensity_deg": 3.0}
    events = {
        10: begin(1, intensity_deg=1.0),
        90: begin(2, **strong),
        95: begin(3, **strong),
        99: update(1, **strong),
    }
    several: dict[str, Any] = {"touches": 3, "min_intensity_deg": 2.0}
    assert met(events, **several, within=0.6) == []
    assert met(events, **several, within=1.02) == [99]
    assert met(taps(10, 20, length=80), touches=2, within=0.3, lasting=0.6) == [70]


def test_a_tap_within_one_tick_is_one() -> None:
    assert met({5: (*begin(), *end())}) == [5]
    assert met({5: (*begin(), *end())}, lasting=0.1) == []


def test_names_that_there_are_not_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="did you mean LForeArm"):
        TouchWatch(TouchTrigger(link=("LForeAm",)), ROBOT)


EVENTS = st.lists(
    st.tuples(
        st.integers(0, 60),
        st.integers(0, 3),
        st.sampled_from(["begin", "update", "end"]),
        st.sampled_from([1.0, 3.0]),
        st.sampled_from(["LForeArm", "LBicep"]),
    ),
    max_size=25,
)


@given(events=EVENTS, lasting=st.sampled_from([0.0, 0.06, 0.3]), touches=st.integers(1, 3))
def test_it_fires_no_oftener_than_touches_come(
    events: list[Any], lasting: float, touches: int
) -> None:
    script: dict[int, tuple[Contact, ...]] = {}
    for tick, number, phase, size, link in events:
        event = contact(number, phase=phase, intensity_deg=size, link=link)
        script[tick] = (*script.get(tick, ()), event)
    begun = sum(event.phase == "begin" for contacts in script.values() for event in contacts)
    several: dict[str, Any] = {"touches": touches, "within": 0.5} if touches > 1 else {}
    fired = met(script, lasting=lasting, min_intensity_deg=2.0, link="LForeArm", **several)
    assert len(fired) * touches <= begun
