"""Edges of sensors, and the contacts that last."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.mock import MockBackend
from pepper_driver.callbacks.events import SensorEdges, SensorEvent, Touches
from pepper_driver.observer import Contact
from pepper_driver.testing import pressed
from support.events import ROBOT, contact


def test_what_is_pressed_at_the_start_is_reported_when_it_is_let_go() -> None:
    quiet = MockBackend().open()
    edges = SensorEdges(ROBOT, pressed("bumpers", 2)(quiet))
    assert edges.step(pressed("bumpers", 2)(quiet)) == []
    assert edges.step(quiet) == [
        SensorEvent(kind="bumper", name="Back", pressed=False, time=quiet.time)
    ]
    assert edges.step(quiet) == []


@pytest.mark.parametrize("value", [float("nan"), -1.0, 0.3, -0.0])
def test_a_sensor_that_answers_nonsense_is_not_pressed(value: float) -> None:
    quiet = MockBackend().open()
    edges = SensorEdges(ROBOT, quiet)
    assert edges.step(replace(quiet, touch=np.full(5, value))) == []


def test_touches_are_the_newest_events_of_the_contacts_that_last() -> None:
    touches = Touches()
    assert list(touches.now) == []
    touches.step([contact(1), contact(2)])
    touches.step([])
    stronger = contact(1, phase="update", intensity_deg=9.0)
    touches.step([stronger, contact(3)])
    before = touches.now
    assert before == (stronger, contact(2), contact(3))
    touches.step([contact(2, phase="end")])
    assert list(touches.now) == [stronger, contact(3)]
    assert before == (stronger, contact(2), contact(3))  # what a thread has read stays as it is
    touches.step([contact(1, phase="end"), contact(3, phase="end"), contact(4)])
    assert list(touches.now) == [contact(4)]
    touches.step([contact(4, phase="end")])
    assert list(touches.now) == []


def test_a_rebound_is_no_touch() -> None:
    touches = Touches()
    touches.step([contact(1, kind="rebound"), contact(2)])
    assert list(touches.now) == [contact(2)]
    touches.step([contact(2, phase="update", kind="rebound")])  # found out later
    assert list(touches.now) == []
    touches.step([contact(1, phase="update")])
    assert list(touches.now) == [contact(1, phase="update")]
    touches.step([contact(9, phase="end")])  # of which nothing was known
    assert list(touches.now) == [contact(1, phase="update")]


events = st.builds(
    contact,
    st.integers(0, 3),
    phase=st.sampled_from(["begin", "update", "end"]),
    kind=st.sampled_from(["contact", "collision", "rebound"]),
)


@given(st.lists(st.lists(events, max_size=4)))
def test_touches_follow_any_sequence_of_events(ticks: list[list[Any]]) -> None:
    touches = Touches()
    newest: dict[int, Contact] = {}
    for tick in ticks:
        touches.step(tick)
        newest |= {event.id: event for event in tick}
        lasting = [e for e in newest.values() if e.phase != "end" and e.kind != "rebound"]
        assert sorted(touches.now, key=lambda e: e.id) == sorted(lasting, key=lambda e: e.id)
