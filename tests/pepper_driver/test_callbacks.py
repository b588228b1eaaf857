"""Callbacks: order, filters, floods, slow and raising ones, flush and close from everywhere."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from pepper_driver.callbacks import Dispatcher, DispatcherClosedError, contact_filter
from pepper_driver.config import PepperError, UnknownNameError, load_robot
from pepper_driver.observer.contact import Contact

ROBOT = load_robot()
LONG = 30.0  # [s] only a failing test waits this long


def contact(number: int = 0, **changes: Any) -> Contact:
    values: dict[str, Any] = {
        "id": number,
        "phase": "begin",
        "kind": "contact",
        "joint": "LElbowRoll",
        "link": "LForeArm",
        "direction": 1,
        "intensity": 3.0,
        "torque": None,
        "torque_std": None,
        "onset_time": 0.0,
        "detection_time": 0.1,
        "time": 0.1,
    }
    return Contact(**(values | changes))


@pytest.fixture
def dispatcher() -> Iterator[Dispatcher]:
    dispatcher = Dispatcher()
    yield dispatcher
    dispatcher.close(LONG)


class Blocker:
    """A callback that hangs until released."""

    def __init__(self) -> None:
        self.entered = threading.Event()
        self.release = threading.Event()
        self.ids: list[int] = []

    def __call__(self, event: Contact) -> None:
        self.entered.set()
        assert self.release.wait(LONG)
        self.ids.append(event.id)


def callback_threads() -> list[threading.Thread]:
    return [t for t in threading.enumerate() if t.name == "pepper_driver.callbacks"]


def test_thread_starts_with_the_first_subscription_and_ends_at_close() -> None:
    before = len(callback_threads())
    dispatcher = Dispatcher()
    dispatcher.publish(contact())
    assert dispatcher.flush()
    assert len(callback_threads()) == before
    seen: list[tuple[int, str, bool]] = []
    for _ in range(2):
        dispatcher.subscribe(
            lambda c: seen.append(
                (c.id, threading.current_thread().name, threading.current_thread().daemon)
            )
        )
    assert len(callback_threads()) == before + 1
    dispatcher.publish(contact(7))
    assert dispatcher.flush(LONG)
    assert seen == [(7, "pepper_driver.callbacks", True)] * 2
    assert dispatcher.close(LONG)
    assert len(callback_threads()) == before
    assert dispatcher.dropped == 0


def test_events_come_in_order(dispatcher: Dispatcher) -> None:
    seen: list[tuple[str, int]] = []
    dispatcher.subscribe(lambda c: seen.append(("a", c.id)))
    dispatcher.subscribe(lambda c: seen.append(("b", c.id)), lambda c: c.id % 2 == 0)
    for number in range(200):
        dispatcher.publish(contact(number))
    assert dispatcher.flush(LONG)
    assert [i for name, i in seen if name == "a"] == list(range(200))
    assert [i for name, i in seen if name == "b"] == list(range(0, 200, 2))
    assert seen[:3] == [("a", 0), ("b", 0), ("a", 1)]


def test_only_those_subscribed_when_it_happened(dispatcher: Dispatcher) -> None:
    blocker, seen = Blocker(), list[int]()
    dispatcher.subscribe(blocker)
    dispatcher.publish(contact(0))
    dispatcher.publish(contact(1))
    dispatcher.subscribe(lambda c: seen.append(c.id))
    dispatcher.publish(contact(2))
    blocker.release.set()
    assert dispatcher.flush(LONG)
    assert blocker.ids == [0, 1, 2]
    assert seen == [2]


def test_unsubscribed_is_called_no_more(dispatcher: Dispatcher) -> None:
    blocker, seen = Blocker(), list[int]()

    def listen(event: Contact) -> None:
        seen.append(event.id)

    dispatcher.subscribe(blocker)
    dispatcher.subscribe(listen)
    dispatcher.publish(contact(0))
    assert blocker.entered.wait(LONG)
    dispatcher.unsubscribe(listen)
    dispatcher.unsubscribe(listen)
    dispatcher.publish(contact(1))
    blocker.release.set()
    assert dispatcher.flush(LONG)
    assert (blocker.ids, seen) == ([0, 1], [])
    assert [s.name for s in dispatcher.statistics()] == ["Blocker"]


def test_flood_drops_the_newest_and_counts() -> None:
    dispatcher = Dispatcher(maxsize=10)
    blocker = Blocker()
    dispatcher.subscribe(blocker)
    dispatcher.publish(contact(0))
    assert blocker.entered.wait(LONG)
    for number in range(1, 101):
        dispatcher.publish(contact(number))
    assert dispatcher.dropped == 90
    assert not dispatcher.flush(0.01)  # does not take a place in the queue either
    assert dispatcher.dropped == 90
    blocker.release.set()
    assert dispatcher.flush(LONG)
    assert blocker.ids == list(range(11))
    dispatcher.publish(contact(200))
    assert dispatcher.close(LONG)
    assert blocker.ids[-1] == 200
    with pytest.raises(ValueError, match="maxsize 0"):
        Dispatcher(maxsize=0)


def test_every_event_of_many_threads_is_handled_or_counted() -> None:
    dispatcher = Dispatcher(maxsize=5)
    seen: list[int] = []
    dispatcher.subscribe(lambda c: seen.append(c.id))

    def flood() -> None:
        for number in range(500):
            dispatcher.publish(contact(number))

    threads = [threading.Thread(target=flood) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert dispatcher.close(LONG)
    assert len(seen) + dispatcher.dropped == 2000


@pytest.mark.parametrize("error", [ValueError("too bad"), SystemExit(1), KeyboardInterrupt()])
def test_raising_callback_is_logged_and_disturbs_nothing(
    dispatcher: Dispatcher, caplog: pytest.LogCaptureFixture, error: BaseException
) -> None:
    seen: list[int] = []

    def broken_callback(event: Contact) -> None:
        raise error

    dispatcher.subscribe(broken_callback)
    dispatcher.subscribe(lambda c: seen.append(c.id))
    with caplog.at_level(logging.ERROR, "pepper_driver"):
        for number in range(3):
            dispatcher.publish(contact(number))
        assert dispatcher.flush(LONG)
    assert seen == [0, 1, 2]
    records = [r for r in caplog.records if r.name == "pepper_driver"]
    assert len(records) == 3
    assert "broken_callback" in records[0].getMessage()
    assert records[0].exc_info is not None
    assert records[0].exc_info[1] is error
    assert "in broken_callback" in caplog.text
    failed, fine = dispatcher.statistics()
    assert (failed.calls, failed.failures) == (3, 3)
    assert (fine.calls, fine.failures) == (3, 0)


def test_raising_predicate_is_logged(
    dispatcher: Dispatcher, caplog: pytest.LogCaptureFixture
) -> None:
    seen: list[int] = []
    dispatcher.subscribe(lambda c: seen.append(c.id), lambda c: 1 // c.id > 0)
    dispatcher.publish(contact(0))
    dispatcher.publish(contact(1))
    assert dispatcher.flush(LONG)
    assert seen == [1]
    assert "ZeroDivisionError" in caplog.text
    (statistics,) = dispatcher.statistics()
    assert (statistics.calls, statistics.failures) == (1, 1)


def test_statistics_count_calls_and_time(
    dispatcher: Dispatcher, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter([10.0, 10.5, 20.0, 22.0, 30.0, 30.25])
    monkeypatch.setattr("pepper_driver.callbacks.time.perf_counter", lambda: next(clock))

    def tired(event: Contact) -> None:
        pass

    dispatcher.subscribe(tired, lambda c: c.id < 3)
    for number in range(5):
        dispatcher.publish(contact(number))
    assert dispatcher.flush(LONG)
    (statistics,) = dispatcher.statistics()
    assert statistics.name.endswith("tired")
    assert (statistics.calls, statistics.failures) == (3, 0)
    assert (statistics.total_time, statistics.longest_time) == (2.75, 2.0)


def test_callback_may_publish_subscribe_and_flush(dispatcher: Dispatcher) -> None:
    seen: list[object] = []

    def first(event: Contact) -> None:
        if event.id == 0:
            seen.append(dispatcher.flush())
            dispatcher.subscribe(lambda c: seen.append(("late", c.id)))
            dispatcher.publish(contact(1))
        seen.append(event.id)

    dispatcher.subscribe(first)
    dispatcher.publish(contact(0))
    assert dispatcher.flush(LONG)
    assert dispatcher.flush(LONG)  # the first may have come before event 1
    assert seen == [False, 0, 1, ("late", 1)]


def test_callback_may_close() -> None:
    dispatcher = Dispatcher()
    seen: list[object] = []
    dispatcher.subscribe(lambda c: seen.append((c.id, dispatcher.close())))
    go = threading.Event()
    dispatcher.subscribe(lambda c: go.wait(LONG))
    dispatcher.publish(contact(0))
    go.set()
    assert dispatcher.close(LONG)
    assert seen == [(0, False)]


def test_close_handles_what_waits() -> None:
    dispatcher = Dispatcher()
    blocker = Blocker()
    dispatcher.subscribe(blocker)
    for number in range(50):
        dispatcher.publish(contact(number))
    blocker.release.set()
    assert dispatcher.close(LONG)
    assert blocker.ids == list(range(50))
    assert dispatcher.close()
    assert dispatcher.flush()
    dispatcher.publish(contact(50))
    assert dispatcher.dropped == 1
    with pytest.raises(DispatcherClosedError) as caught:
        dispatcher.subscribe(blocker)
    assert isinstance(caught.value, PepperError)
    assert Dispatcher().close()


def test_close_gives_up_on_a_callback_that_hangs() -> None:
    dispatcher = Dispatcher()
    blocker, second = Blocker(), list[int]()
    dispatcher.subscribe(blocker)
    dispatcher.subscribe(lambda c: second.append(c.id))
    for number in range(5):
        dispatcher.publish(contact(number))
    assert blocker.entered.wait(LONG)
    flushed: list[bool] = []
    waiting = threading.Thread(target=lambda: flushed.append(dispatcher.flush(LONG)))
    waiting.start()
    while not dispatcher._queue or isinstance(dispatcher._queue[-1], tuple):
        time.sleep(0.001)  # until flush waits
    assert not dispatcher.close(0.01)
    waiting.join(LONG)
    assert flushed == [False]
    assert not dispatcher.close(0.01)
    assert dispatcher.dropped == 4
    assert not dispatcher.flush()
    blocker.release.set()
    assert dispatcher.close(LONG)
    assert blocker.ids == [0]
    assert second == []
    assert not dispatcher.flush()
    assert dispatcher.dropped == 4


def test_flush_and_close_race() -> None:
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        for _ in range(200):
            dispatcher = Dispatcher()
            dispatcher.subscribe(lambda c: None)
            dispatcher.publish(contact())
            closing = threading.Thread(target=dispatcher.close)
            closing.start()
            assert dispatcher.flush(LONG)
            closing.join(LONG)
            assert not closing.is_alive()
    finally:
        sys.setswitchinterval(interval)


LINK = ROBOT.links[-1]


@pytest.mark.parametrize(
    ("wanted", "fits", "fits_not"),
    [
        ({}, {"phase": "begin"}, {"phase": "update"}),
        ({"phase": None}, {"phase": "end"}, {"intensity": -1.0}),
        ({"phase": "end"}, {"phase": "end"}, {"phase": "begin"}),
        ({"link": LINK}, {"link": LINK}, {"link": "elsewhere"}),
        ({"joint": "RHand"}, {"joint": "RHand"}, {"joint": None}),
        ({"kind": "collision"}, {"kind": "collision"}, {"kind": "contact"}),
        ({"min_intensity": 2.5}, {"intensity": 2.5}, {"intensity": 2.4}),
        ({"min_intensity": 2.5}, {"intensity": 2.6}, {"intensity": float("nan")}),
        (
            {"joint": "RHand", "kind": "rebound"},
            {"joint": "RHand", "kind": "rebound"},
            {"joint": "RHand"},
        ),
    ],
)
def test_filter(wanted: dict[str, Any], fits: dict[str, Any], fits_not: dict[str, Any]) -> None:
    predicate = contact_filter(ROBOT, **wanted)
    assert predicate(contact(**fits))
    assert not predicate(contact(**fits_not))


@pytest.mark.parametrize(
    ("wanted", "hint"),
    [
        ({"joint": "LElbowRol"}, "joint 'LElbowRol' .*LElbowRoll"),
        ({"link": ROBOT.links[3] + "x"}, f"link .*did you mean .*{ROBOT.links[3]}"),
        ({"kind": "colision"}, "did you mean collision"),
        ({"phase": "start"}, "begin, end, update"),
    ],
)
def test_filter_checks_names_when_made(wanted: dict[str, Any], hint: str) -> None:
    with pytest.raises(UnknownNameError, match=hint):
        contact_filter(ROBOT, **wanted)


@pytest.mark.parametrize("intensity", [-0.1, float("nan")])
def test_filter_checks_intensity(intensity: float) -> None:
    make: Callable[..., object] = contact_filter
    with pytest.raises(ValueError, match="min_intensity"):
        make(ROBOT, min_intensity=intensity)
