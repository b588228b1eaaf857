"""Touches that set a trigger off, and triggers that go before others: against the definition, touch by touch."""

from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config import ConfigError
from pepper_driver.config.contact_selector import TouchTrigger
from pepper_driver.config.loading import parse
from support.experiment_files import LISTEN, ROBOT, changed, experiment, load_data, refusal

LIMBS = ("left_arm", "head", "trunk")
LINKS = ("LBicep", "LForeArm", "Head", "torso")
JOINTS = ("LShoulderRoll", "LElbowRoll", "HeadYaw")
KINDS = ("contact", "collision")


def trigger(**data: Any) -> TouchTrigger:
    return parse(TouchTrigger, data, "mine.yaml")


# -- what is read -------------------------------------------------------------------------------------------------


def test_without_conditions_any_touch_sets_it_off() -> None:
    every = trigger()
    assert every == TouchTrigger()
    assert (every.lasting, every.touches, every.within) == (0.0, 1, None)
    assert str(every) == "contact"


def test_all_conditions_are_read() -> None:
    read = trigger(
        limb=["left_arm", "head"],
        kind="collision",
        min_torque=2,
        lasting=0.5,
        touches=2,
        within=1.5,
    )
    assert read.limb == ("left_arm", "head")
    assert (read.lasting, read.touches, read.within) == (0.5, 2, 1.5)
    assert str(read) == (
        "collision on left_arm or head, 2 N m and more, lasting 0.5 s, 2 times within 1.5 s"
    )


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        ({"kind": "rebound"}, "a rebound is no touch: choose contact or collision"),
        ({"touches": 2}, "'touches' above 1 and 'within' [s] belong together"),
        ({"within": 1.0}, "'touches' above 1 and 'within' [s] belong together"),
        ({"touches": 1, "within": 1.0}, "give both or none"),
        ({"touches": 0}, "'touches': must be 1 or more, got 0"),
        ({"touches": 101, "within": 1.0}, "'touches': must be 100 or less"),
        ({"touches": True}, "'touches': must be a whole number, got true"),
        ({"within": 0.0, "touches": 2}, "'within': must be above 0"),
        ({"lasting": -0.1}, "'lasting': must be 0 or more, got -0.1"),
        ({"lasting": "long"}, "'lasting': must be a number, got \"long\""),
        ({"last": 1.0}, "unknown key 'last' (did you mean lasting"),
    ],
)
def test_what_makes_no_sense_is_refused(data: dict[str, Any], reason: str) -> None:
    with pytest.raises(ConfigError) as caught:
        trigger(**data)
    assert reason in str(caught.value)


def test_a_wait_is_as_long_as_its_touch_lasts(tmp_path: Path) -> None:
    """A touch that begins at once has lasted 3 s when the wait is over: too late."""
    data = experiment(LISTEN)
    said = refusal(tmp_path, changed(data, "steps.0.wait.lasting", 3.0))
    assert "key 'steps.0.wait': 'lasting' must be shorter than 'timeout'" in said
    load_data(tmp_path, changed(data, "steps.0.wait.lasting", 2.9))


# -- which one goes first -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class DetectedPush:
    """A touch of constant strength. Times in eighths of a second."""

    begin: int
    length: int
    link: str
    joint: str
    kind: str
    intensity_deg: float
    torque: float


def is_chosen(touch: DetectedPush, on: TouchTrigger) -> bool:
    return (
        (not on.limb or ROBOT.limb_of_link(touch.link) in on.limb)
        and (not on.link or touch.link in on.link)
        and (not on.joint or touch.joint in on.joint)
        and on.kind in (None, touch.kind)
        and touch.intensity_deg >= on.min_intensity_deg
        and touch.torque >= on.min_torque
    )


def first_time(on: TouchTrigger, touches: list[DetectedPush]) -> float:
    """Time at which touches, in the order of their begins, first are as a trigger says [s / 8]; infinity for never."""
    begun = [t.begin for t in touches if is_chosen(t, on) and t.length >= 8 * on.lasting]
    times = [inf]
    for last in range(on.touches - 1, len(begun)):
        if begun[last] - begun[last - on.touches + 1] <= 8 * (on.within or 0.0):
            times.append(begun[last] + 8 * on.lasting)
    return min(times)


def some(names: tuple[str, ...]) -> st.SearchStrategy[tuple[str, ...] | None]:
    return st.none() | st.lists(st.sampled_from(names), unique=True, min_size=1).map(tuple)


@st.composite
def conditions(draw: st.DrawFn) -> dict[str, Any]:
    touches = draw(st.integers(1, 3))
    return {
        "limb": draw(some(LIMBS)),
        "link": draw(some(LINKS)),
        "joint": draw(some(JOINTS)),
        "kind": draw(st.sampled_from([None, "contact", "collision"])),
        "min_intensity_deg": draw(st.sampled_from([0.0, 1.0, 2.0])),
        "min_torque": draw(st.sampled_from([0.0, 1.0, 2.0])),
        "lasting": draw(st.sampled_from([0.0, 0.5, 1.0])),
        "touches": touches,
        "within": None if touches == 1 else draw(st.sampled_from([0.5, 1.0, 2.0])),
    }


@st.composite
def looser(draw: st.DrawFn, on: dict[str, Any]) -> dict[str, Any]:
    """Conditions that choose more, or need less."""
    touches = draw(st.integers(1, on["touches"]))
    more = {"limb": "right_arm", "link": "RBicep", "joint": "HeadPitch"}
    wider = {
        key: draw(st.sampled_from([None, on[key] and (*on[key], name)]))
        for key, name in more.items()
    }
    less = {
        key: draw(st.sampled_from([0.0, on[key]]))
        for key in ("min_intensity_deg", "min_torque", "lasting")
    }
    return {
        **wider,
        **less,
        "kind": draw(st.sampled_from([None, on["kind"]])),
        "touches": touches,
        "within": None if touches == 1 else on["within"] + draw(st.sampled_from([0.0, 1.0])),
    }


TOUCHES = st.lists(
    st.builds(
        DetectedPush,
        begin=st.integers(0, 40),
        length=st.integers(1, 12),
        link=st.sampled_from(LINKS),
        joint=st.sampled_from(JOINTS),
        kind=st.sampled_from(KINDS),
        intensity_deg=st.sampled_from([0.5, 1.0, 3.0]),
        torque=st.sampled_from([0.5, 1.0, 3.0]),
    ),
    max_size=6,
).map(lambda contacts: sorted(contacts, key=lambda touch: touch.begin))


@given(data=st.data(), given_on=conditions(), touches=TOUCHES)
def test_a_looser_trigger_is_set_off_first(
    data: st.DataObject, given_on: dict[str, Any], touches: list[DetectedPush]
) -> None:
    on, loose = TouchTrigger(**given_on), TouchTrigger(**data.draw(looser(given_on)))
    assert loose.includes(on, ROBOT)
    assert first_time(loose, touches) <= first_time(on, touches)


@given(one=conditions(), other=conditions(), touches=TOUCHES)
def test_what_includes_another_is_never_set_off_later(
    one: dict[str, Any], other: dict[str, Any], touches: list[DetectedPush]
) -> None:
    first, second = TouchTrigger(**one), TouchTrigger(**other)
    if first.includes(second, ROBOT):
        assert first_time(first, touches) <= first_time(second, touches)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({"limb": "left_arm"}, {}),
        ({"limb": "left_arm"}, {"limb": ["left_arm", "head"]}),
        ({"limb": "head"}, {"link": "LBicep"}),
        ({"link": "LBicep"}, {"limb": "left_arm"}),
        ({"link": "LBicep"}, {"joint": "LShoulderRoll"}),
        ({"joint": "LShoulderRoll"}, {"link": "LBicep"}),
        ({"kind": "collision"}, {}),
        ({"kind": "collision"}, {"kind": "contact"}),
        ({"min_intensity_deg": 2.0}, {"min_intensity_deg": 1.0}),
        ({"min_torque": 1.0}, {"min_intensity_deg": 90.0}),
        ({"lasting": 0.5}, {"lasting": 0.4}),
        ({"touches": 2, "within": 1.0}, {}),
        ({"touches": 2, "within": 1.0}, {"touches": 2, "within": 2.0}),
        ({"touches": 3, "within": 9.0}, {"touches": 2, "within": 1.0}),
    ],
)
def test_what_may_be_set_off_later_includes_nothing(
    one: dict[str, Any], other: dict[str, Any]
) -> None:
    assert not trigger(**one).includes(trigger(**other), ROBOT)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({"limb": "left_arm"}, {"link": "LBicep"}),
        ({"limb": "left_arm"}, {"joint": "LHand"}),
        ({"limb": "trunk"}, {"link": "base_link"}),
        ({"limb": ["left_arm", "head"]}, {"link": ["LBicep", "Head"]}),
        ({"touches": 2, "within": 2.0}, {"touches": 3, "within": 1.0}),
        ({}, {"touches": 3, "within": 1.0, "lasting": 2.0}),
    ],
)
def test_a_limb_includes_its_links_and_one_touch_the_first_of_many(
    one: dict[str, Any], other: dict[str, Any]
) -> None:
    assert trigger(**one).includes(trigger(**other), ROBOT)
