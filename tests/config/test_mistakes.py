"""Mistakes that pydantic finds in a file, each one line in words for people."""

from dataclasses import field
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, WrapValidator
from pydantic.dataclasses import dataclass

from pepper_driver.config import ConfigError
from pepper_driver.config.errors import MAX_SHOWN
from pepper_driver.config.loading import STRICT, one_or_more, parse, parse_part
from pepper_driver.config.mistakes import HIDDEN, as_written, keys_of
from support.yaml_values import ANYTHING, JARGON


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Joint:
    """A part of a part."""

    angle: Annotated[float, Field(ge=-2, lt=2)]
    name: Annotated[str, Field(min_length=1, max_length=5, pattern=r"^\P{Cc}+$")] = "yaw"


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Arm:
    """A part that a validator builds."""

    joints: Annotated[tuple[Joint, ...], Field(min_length=1, max_length=3)]
    side: Literal["left", "right"]
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.place[2] < 0:
            raise ValueError("'place': below the floor")


def _arm(value: object, _: object) -> object:
    return parse_part(Arm, value)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Robot:
    """A whole."""

    arms: tuple[Annotated[Arm, WrapValidator(_arm)], ...] = ()
    head: Joint | None = None
    others: dict[str, Joint] = field(default_factory=dict)
    hands: Annotated[tuple[Joint, ...], one_or_more(Joint)] = ()
    count: Annotated[int, Field(gt=0, le=9)] = 1
    moves: bool = True
    source: str = field(default="", metadata=HIDDEN)


OF_ARM, OF_JOINT = "possible: joints, place, side", "possible: angle, name"
FIVE = "must be a text of at most 5 letters"
ONE_LINE = "must be a text of one line without control characters"
ARM: dict[str, Any] = {"joints": [{"angle": 1.0}], "side": "left"}


def said(**data: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        parse(Robot, data, "robot")
    message = str(caught.value)
    assert message.startswith("robot: ")
    assert not JARGON.search(message)
    return message.removeprefix("robot: ")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"count": 0}, "key 'count': must be above 0, got 0"),
        ({"count": 10}, "key 'count': must be 9 or less, got 10"),
        ({"count": 1.5}, "key 'count': must be a whole number, got 1.5"),
        ({"count": 10**40}, f"key 'count': must be 9 or less, got {10**40}"),
        ({"count": None}, "key 'count': must be a whole number, got null"),
        ({"count": {}}, "key 'count': must be a whole number, got a mapping"),
        ({"moves": 1}, "key 'moves': must be true or false, got 1"),
        ({"head": {"angle": -3}}, "key 'head.angle': must be -2 or more, got -3"),
        ({"head": {"angle": 2.0}}, "key 'head.angle': must be below 2, got 2.0"),
        ({"head": {"angle": "up"}}, "key 'head.angle': must be a number, got \"up\""),
        ({"head": {"angle": True}}, "key 'head.angle': must be a number, got true"),
        ({"head": {"angle": float("nan")}}, "key 'head.angle': must be a finite number, got nan"),
        ({"head": {"angle": float("inf")}}, "key 'head.angle': must be a finite number, got inf"),
        ({"head": {"angle": 0, "name": ""}}, "key 'head.name': must not be empty, got \"\""),
        ({"head": {"angle": 0, "name": "a b c"}}, None),
        ({"head": {"angle": 0, "name": "abcdef"}}, f"key 'head.name': {FIVE}, got \"abcdef\""),
        ({"head": {"angle": 0, "name": "\a"}}, f"key 'head.name': {ONE_LINE}, got \"\\u0007\""),
        ({"head": {"angle": 0, "name": 3}}, "key 'head.name': must be a text, got 3"),
        ({"head": 3}, "key 'head': must be a mapping of keys to values, got 3"),
        ({"head": {}}, "key 'head.angle' is missing"),
        ({"others": 3}, "key 'others': must be a mapping of keys to values, got 3"),
        ({"others": {"a.b": {"angle": "x"}}}, "key 'others.a.b.angle': must be a number, got \"x\""),
        ({"arms": 3}, "key 'arms': must be a list, got 3"),
        ({"arms": {}}, "key 'arms': must be a list, got a mapping"),
        ({"arms": [ARM | {"side": "top"}]}, "key 'arms.0.side': must be 'left' or 'right', got \"top\""),
        ({"arms": [ARM | {"joints": []}]}, "key 'arms.0.joints': needs at least one joint"),
        ({"arms": [ARM | {"joints": [{"angle": 0}] * 4}]}, "key 'arms.0.joints': takes at most 3, has 4"),
        ({"arms": [ARM | {"place": [1.0]}]}, "key 'arms.0.place': needs at least 3 entries"),
        ({"arms": [ARM | {"place": [1, 2, 3, 4]}]}, "key 'arms.0.place': takes at most 3, has 4"),
        ({"arms": [ARM | {"place": [1, "2", 3]}]}, "key 'arms.0.place.1': must be a number, got \"2\""),
        ({"arms": [ARM | {"place": [0, 0, -1]}]}, "key 'arms.0': 'place': below the floor"),
        ({"hands": []}, "key 'hands': needs at least one hand"),
        ({"hands": {"angle": 9}}, "key 'hands.angle': must be below 2, got 9"),
        ({"hands": [{"angle": 9}]}, "key 'hands.0.angle': must be below 2, got 9"),
    ],
)  # fmt: skip
def test_a_mistake_in_words(data: dict[str, Any], message: str | None) -> None:
    if message is None:
        parse(Robot, data, "robot")
    else:
        assert said(**data) == message


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"cuont": 1}, "unknown key 'cuont' (did you mean count?; possible: arms, count, hands, head, moves, others)"),
        ({"source": "x"}, "unknown key 'source' (possible: arms, count, hands, head, moves, others)"),
        ({"head": {"angel": 1}}, "unknown key 'head.angel' (did you mean angle?; possible: angle)"),
        ({"head": {"angle": 1, "nmae": "x"}}, "unknown key 'head.nmae' (did you mean name?; possible: angle, name)"),
        ({"others": {"x": {"angle": 1, "y": 2}}}, "unknown key 'others.x.y' (possible: angle, name)"),
        ({"arms": [ARM | {"sied": "left"}]}, f"unknown key 'arms.0.sied' (did you mean side?; {OF_ARM})"),
        ({"arms": [ARM | {"joints": [{"angle": 1, "x": 1}]}]}, f"unknown key 'arms.0.joints.0.x' ({OF_JOINT})"),
        ({"hands": [{"angle": 1, "x": 1}]}, "unknown key 'hands.0.x' (possible: angle, name)"),
    ],
)  # fmt: skip
def test_an_unknown_key_is_reported_with_the_possible_ones(
    data: dict[str, Any], message: str
) -> None:
    assert said(**data) == message


@pytest.mark.parametrize(
    ("data", "more"),
    [
        ({"head": {"angle": "x"}}, 0),
        ({"head": {"angle": "x"}, "count": 0}, 1),
        ({"head": {"angle": "x", "name": 3}, "count": 0, "moves": 1}, 3),
        ({"head": {"angel": 1}}, 0),  # misspelt, the right one is missing too: one mistake
        ({"head": {"turn": 1}}, 1),
        ({"arms": [ARM | {"joints": [{"angle": "x"}]}]}, 0),  # nothing is left of the list
        ({"arms": [ARM | {"place": []}]}, 0),  # three numbers are missing
        ({"arms": [ARM | {"place": ["a", "b"]}]}, 1),
        ({"arms": [{}, {}]}, 3),
    ],
)
def test_mistakes_are_counted_as_people_make_them(data: dict[str, Any], more: int) -> None:
    assert said(**data).endswith(f" (and {more} more)") is bool(more)


def test_an_unknown_key_is_said_first() -> None:
    assert said(count="x", head={"angle": "x"}, x=1).startswith("unknown key 'x'")


def test_a_long_value_is_cut() -> None:
    message = said(count="x" * 10_000)
    assert len(message) < 2 * MAX_SHOWN
    assert message.endswith('x..."') or message.endswith("x...")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "null"),
        (True, "true"),
        (1.0, "1.0"),
        (1e300, "1e+300"),
        (float("-inf"), "-inf"),
        ("a\nb", '"a\\nb"'),
        ("\u00e9", '"\u00e9"'),
        ([1, 2], "a list"),
        ({}, "a mapping"),
    ],
)
def test_values_are_shown_as_files_have_them(value: object, text: str) -> None:
    assert as_written(value) == text


def test_what_a_file_does_not_have_is_hidden() -> None:
    assert keys_of(Robot) == ["arms", "head", "others", "hands", "count", "moves"]
    assert parse(Robot, {}, "robot", hidden={"source": "x"}).source == "x"


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (b"a", "holds binary data, which no setting takes"),
        ({1, 2}, "holds a set, which no setting takes"),
    ],
)
def test_what_no_file_may_hold(value: object, reason: str) -> None:
    assert reason in said(count=value)
    assert "a number has too many digits" in said(count=10**5000)


@given(
    data=st.dictionaries(
        st.sampled_from([*keys_of(Robot), "source", "x"]),
        ANYTHING
        | st.just(ARM)
        | st.lists(st.just(ARM) | ANYTHING, max_size=3)
        | st.dictionaries(st.sampled_from(["angle", "name", "joints", "side", "place"]), ANYTHING),
    )
)
def test_whatever_comes_is_one_line_in_words(data: dict[str, Any]) -> None:
    try:
        parse(Robot, data, "robot")
    except ConfigError as error:
        message = str(error)
        assert len(message.splitlines()) == 1
        assert not JARGON.search(message), message
