"""Changes between two ticks: in the order given, a group of them together or not at all, never inside a tick."""

from __future__ import annotations

import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config import PepperError
from pepper_driver.controller import Changes, ChangesError

TIMEOUT = 20.0
"""[s] For what happens at once unless something is wrong."""


class BlockError(Exception):
    """Raised inside a block by these tests."""


def test_a_change_is_made_at_once_where_no_tick_runs() -> None:
    made: list[int] = []
    Changes().make(lambda: made.append(1))
    assert made == [1]


def test_the_thread_of_a_tick_makes_changes_inside_it() -> None:
    changes, made = Changes(), list[int]()
    with changes.tick(), changes.tick():
        changes.make(lambda: changes.make(lambda: made.append(1)))
        assert made == [1]
        with changes.together():
            changes.make(lambda: made.append(2))
            assert made == [1]
        assert made == [1, 2]


@pytest.mark.parametrize("together", [False, True])
def test_a_change_of_another_thread_waits_for_the_end_of_the_tick(together: bool) -> None:
    changes, made = Changes(), list[int]()

    def work() -> None:
        if together:
            with changes.together():
                changes.make(lambda: made.append(1))
        else:
            changes.make(lambda: made.append(1))

    thread = threading.Thread(target=work, daemon=True)
    with changes.tick():
        thread.start()
        thread.join(0.05)
        assert thread.is_alive()
        assert made == []
    thread.join(TIMEOUT)
    assert made == [1]


def test_a_group_holds_up_neither_ticks_nor_other_threads() -> None:
    changes, made = Changes(), list[str]()

    def work() -> None:
        with changes.tick():
            made.append("tick")
        changes.make(lambda: made.append("other"))

    with changes.together():
        changes.make(lambda: made.append("group"))
        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        thread.join(TIMEOUT)
        assert made == ["tick", "other"]
    assert made == ["tick", "other", "group"]


def test_no_tick_runs_inside_a_group() -> None:
    changes, made = Changes(), list[int]()

    def group() -> None:
        with changes.together():
            changes.make(lambda: made.append(1))
            changes.tick()

    with pytest.raises(ChangesError, match="end the block first"):
        group()
    assert made == []
    assert issubclass(ChangesError, PepperError)
    with changes.tick():
        changes.make(lambda: made.append(2))
    assert made == [2]


def test_groups_of_two_keepers_are_apart() -> None:
    one, other, made = Changes(), Changes(), list[str]()
    with one.together():
        one.make(lambda: made.append("one"))
        other.make(lambda: made.append("other"))
        with other.tick():
            assert made == ["other"]
    assert made == ["other", "one"]


def test_what_a_change_raises_comes_out_where_it_is_made() -> None:
    changes, made = Changes(), list[int]()

    def refuse(text: str) -> None:
        raise PepperError(text)

    def group() -> None:
        with changes.together():
            changes.make(lambda: made.append(1))
            changes.make(lambda: refuse("first"))
            changes.make(lambda: refuse("second"))
            changes.make(lambda: made.append(2))
            made.append(0)

    with pytest.raises(PepperError, match="at once"):
        changes.make(lambda: refuse("at once"))
    with pytest.raises(PepperError, match="first"):
        group()
    assert made == [0, 1, 2]  # one that is refused keeps no other from being made
    with changes.tick():
        changes.make(lambda: made.append(3))
    assert made[-1] == 3


Plan = list["int | tuple[bool, Plan]"]
"""Changes by number, and blocks: whether one raises at its end, and what is in it."""

PLANS: st.SearchStrategy[Plan] = st.recursive(
    st.lists(st.integers(0, 99), max_size=4),
    lambda inner: st.lists(
        st.one_of(st.integers(0, 99), st.tuples(st.booleans(), inner)), max_size=4
    ),
    max_leaves=12,
)


def expected(plan: Plan) -> list[int]:
    """Numbers of the changes that count, in their order: all but those of blocks that raise."""
    numbers = []
    for part in plan:
        if isinstance(part, int):
            numbers.append(part)
        elif not part[0]:
            numbers.extend(expected(part[1]))
    return numbers


def follow(plan: Plan, changes: Changes, made: list[int]) -> None:
    for part in plan:
        if isinstance(part, int):
            changes.make(lambda number=part: made.append(number))  # type: ignore[misc]
            continue
        fails, inner = part
        try:
            with changes.together():
                follow(inner, changes, made)
                if fails:
                    raise BlockError
        except BlockError:
            assert fails


@given(plan=PLANS, inside=st.booleans())
def test_blocks_keep_the_order_and_drop_what_raises(plan: Plan, inside: bool) -> None:
    changes, made = Changes(), list[int]()
    if inside:
        with changes.together():
            follow(plan, changes, made)
            assert made == []
    else:
        follow(plan, changes, made)
    assert made == expected(plan)


def test_groups_of_many_threads_are_never_mixed() -> None:
    changes, made = Changes(), list[int]()

    def work(number: int) -> None:
        for _ in range(300):
            with changes.together():
                for _ in range(3):
                    changes.make(lambda: made.append(number))

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(TIMEOUT)
    assert len(made) == 4 * 300 * 3
    assert all(len(set(made[i : i + 3])) == 1 for i in range(0, len(made), 3))
