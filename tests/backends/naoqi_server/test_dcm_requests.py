"""Requests to the DCM: what the documentation shows is taken, anything else is refused in one line."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.naoqi_server.dcm import (
    RequestError,
    alias_request,
    set_alias_request,
    set_request,
)

anything: st.SearchStrategy[Any] = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**40), 2**40)
    | st.floats()
    | st.sampled_from(["", "a", "Merge", "ClearAll", "time-mixed", "time-separate"]),
    lambda inner: st.lists(inner, max_size=6),
    max_leaves=20,
)


def test_requests_as_in_the_documentation() -> None:
    assert alias_request(["ChestLeds", ["Red", "Green"]]) == ("ChestLeds", ["Red", "Green"])
    assert set_request(["Red", "Merge", [[1.0, 10000]]]) == ("Red", "Merge", [(1.0, 10000)])
    mixed = ["A", "ClearAll", "time-mixed", [[[1.0, 4000], [0.0, 6000]], [[0.25, 3000]]]]
    assert set_alias_request(mixed) == (
        "A",
        "ClearAll",
        [[(1.0, 4000), (0.0, 6000)], [(0.25, 3000)]],
    )
    separate = ["A", "ClearAfter", "time-separate", 0, [10, 20], [[1, 0], [0.5, 0.25]]]
    assert set_alias_request(separate) == (
        "A",
        "ClearAfter",
        [[(1.0, 10), (0.0, 20)], [(0.5, 10), (0.25, 20)]],
    )


def test_an_importance_is_ignored_and_no_commands_are_allowed() -> None:
    assert set_request(["Red", "Merge", [[1.0, 5, 7]]])[2] == [(1.0, 5)]
    assert set_request(["Red", "ClearAll", []])[2] == []
    assert set_alias_request(["A", "ClearAll", "time-separate", 0, [], [[], []]])[2] == [[], []]


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ("Red", "expected"),
        (["Red", "Merge"], "expected"),
        ([1, "Merge", []], "the name"),
        (["Red", "merge", []], "ClearBefore"),
        (["Red", "Merge", 1.0], "expected a list"),
        (["Red", "Merge", [1.0, 5]], r"\[value, time\], got 1.0"),
        (["Red", "Merge", [["1", 5]]], "finite number, got '1'"),
        (["Red", "Merge", [[True, 5]]], "finite number, got True"),
        (["Red", "Merge", [[float("nan"), 5]]], "got nan"),
        (["Red", "Merge", [[1.0, 5.5]]], "whole number of ms, got 5.5"),
        (["Red", "Merge", [[1.0, None]]], "whole number of ms, got None"),
        (["Red", "Merge", [[1.0, 2**31]]], "32 bits"),
    ],
)
def test_what_is_wrong_with_set(request_: object, words: str) -> None:
    with pytest.raises(RequestError, match=words):
        set_request(request_)


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ([], "time-mixed"),
        (["A", "Merge", "time-mixd", []], "time-separate"),
        (["A", "Merge", "time-mixed", [], []], "expected"),
        (["A", "Merge", "time-mixed", [[1.0, 5]]], "list 0: a command"),
        (["A", "Merge", "time-separate", [5], [[1.0]]], "expected"),
        (["A", "Merge", "time-separate", 0, 5, [[1.0]]], "the times"),
        (["A", "Merge", "time-separate", 0, [5], [1.0]], "list 0: expected a list"),
        (["A", "Merge", "time-separate", 0, [5, 6], [[1.0, 2.0], [1.0]]], "list 1 has 1 values"),
    ],
)
def test_what_is_wrong_with_set_alias(request_: object, words: str) -> None:
    with pytest.raises(RequestError, match=words):
        set_alias_request(request_)


@given(request_=anything)
def test_anything_else_is_refused(request_: object) -> None:
    for parse in (alias_request, set_request, set_alias_request):
        try:
            parse(request_)
        except RequestError as error:
            assert "\n" not in str(error)


@given(
    parts=st.tuples(
        st.just("a"), st.just("Merge"), st.just("time-separate"), st.just(0), anything, anything
    )
)
def test_what_is_taken_is_whole(parts: tuple[Any, ...]) -> None:
    try:
        _, _, lists = set_alias_request(list(parts))
    except RequestError:
        return
    for its in lists:
        assert len(its) == len(parts[4])
        assert all(isinstance(value, float) and isinstance(date, int) for value, date in its)
