"""Callbacks: order, floods, slow and raising ones, flush and close from everywhere."""

from __future__ import annotations

import logging
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.callbacks.dispatcher import QUEUE, Dispatcher, EventSink, Subscription
from pepper_driver.callbacks.events import EndEvent, FaultEvent, SensorEvent
from pepper_driver.observer.interface import Contact
from pepper_driver.safety import Fault, FaultReason
from support.events import LONG, Blocker, contact
from support.examples import examples

STOP = Fault(reason=FaultReason.EMERGENCY_STOP, text="a test")


@pytest.fixture
def dispatcher() -> Iterator[Dispatcher]:
    dispatcher = Dispatcher()
    yield dispatcher
    dispatcher.close(LONG)


def subscribe(
    dispatcher: Dispatcher,
    callback: Callable[[Any], object],
    predicate: Callable[[Any], bool] = lambda _: True,
    event: type = Contact,
    queue: int = QUEUE,
) -> None:
    dispatcher.subscribe(callback, Subscription(event, predicate, queue))


def callback_threads() -> list[str]:
    """And the one that wakes them."""
    return [t.name for t in threading.enumerate() if t.name.startswith("callback")]


def test_each_callback_has_a_thread_of_its_own_until_the_end() -> None:
    before = callback_threads()
    dispatcher = Dispatcher()
    dispatcher.publish(contact())
    assert dispatcher.flush()
    seen: list[tuple[int, bool]] = []
    names: list[str] = []

    def first(event: Contact) -> None:
        names.append(threading.current_thread().name)
        seen.append((event.id, threading.current_thread().daemon))

    def second(event: Contact) -> None:
        first(event)

    for callback in (first, second):
        subscribe(dispatcher, callback)
    assert len(callback_threads()) == len(before) + 3
    dispatcher.publish(contact(7))
    assert dispatcher.flush(LONG)
    assert seen == [(7, True)] * 2
    assert sorted(name.rsplit(".", 1)[-1] for name in names) == ["first", "second"]
    assert dispatcher.close(LONG)
    assert callback_threads() == before
    assert [s.dropped for s in dispatcher.statistics()] == [0, 0]


def test_events_come_in_order_to_their_subscribers(dispatcher: Dispatcher) -> None:
    a, b = list[int](), list[int]()
    subscribe(dispatcher, lambda c: a.append(c.id))
    subscribe(dispatcher, lambda c: b.append(c.id), lambda c: c.id % 2 == 0)
    for number in range(200):
        dispatcher.publish(contact(number))
    assert dispatcher.flush(LONG)
    assert a == list(range(200))
    assert b == list(range(0, 200, 2))


def test_a_callback_of_several_types_is_one_thread_and_sees_them_in_order(
    dispatcher: Dispatcher,
) -> None:
    seen: list[object] = []
    events: list[object] = []
    subscribe(dispatcher, seen.append, event=Contact)
    subscribe(dispatcher, seen.append, event=SensorEvent)
    for number in range(50):
        events.append(contact(number))
        events.append(
            SensorEvent(kind="bumper", name="Back", pressed=number % 2 == 0, time=float(number))
        )
    for event in events:
        dispatcher.publish(event)
    dispatcher.publish(FaultEvent(fault=STOP, time=0.0))
    assert dispatcher.flush(LONG)
    assert seen == events
    (statistics,) = dispatcher.statistics()
    assert statistics.calls == 100


def test_only_those_subscribed_when_it_happened(dispatcher: Dispatcher) -> None:
    blocker, seen = Blocker(), list[int]()
    subscribe(dispatcher, blocker)
    dispatcher.publish(contact(0))
    dispatcher.publish(contact(1))
    subscribe(dispatcher, lambda c: seen.append(c.id))
    dispatcher.publish(contact(2))
    blocker.release.set()
    assert dispatcher.flush(LONG)
    assert blocker.ids == [0, 1, 2]
    assert seen == [2]


def test_a_callback_that_hangs_or_floods_costs_the_others_nothing(
    dispatcher: Dispatcher, caplog: pytest.LogCaptureFixture
) -> None:
    blocker, seen = Blocker(), list[int]()
    done = threading.Event()

    def other(event: Contact) -> None:
        seen.append(event.id)
        if event.id == 100:
            done.set()

    subscribe(dispatcher, blocker, queue=10)
    subscribe(dispatcher, other)
    dispatcher.publish(contact(0))
    assert blocker.entered.wait(LONG)
    for number in range(1, 101):
        dispatcher.publish(contact(number))
    assert done.wait(LONG)  # while the other still hangs
    assert seen == list(range(101))
    assert [s.dropped for s in dispatcher.statistics()] == [90, 0]
    assert not dispatcher.flush(0.01)  # does not take a place in the queue either
    assert [s.dropped for s in dispatcher.statistics()] == [90, 0]
    with caplog.at_level(logging.WARNING, "pepper_driver"):
        blocker.release.set()
        assert dispatcher.flush(LONG)
    assert blocker.ids == list(range(11))  # the newest are lost
    warned = [r.getMessage() for r in caplog.records if "too slow" in r.getMessage()]
    assert warned == ["callback Blocker is too slow: it has lost events"]
    dispatcher.publish(contact(200))
    assert dispatcher.flush(LONG)
    assert blocker.ids[-1] == 200


def test_a_callback_gets_the_room_each_subscription_asks_for(dispatcher: Dispatcher) -> None:
    blocker = Blocker()
    subscribe(dispatcher, blocker, lambda c: c.kind == "contact", queue=3)
    subscribe(dispatcher, blocker, lambda c: c.kind == "collision", queue=6)
    dispatcher.publish(contact(0))
    assert blocker.entered.wait(LONG)
    for number in range(1, 11):
        dispatcher.publish(contact(number, kind="contact"))
    for number in range(11, 21):
        dispatcher.publish(contact(number, kind="collision"))
    blocker.release.set()
    assert dispatcher.flush(LONG)
    assert blocker.ids == [0, 1, 2, 3, 11, 12, 13]


def test_every_event_of_many_threads_is_handled_or_counted() -> None:
    dispatcher = Dispatcher()
    seen: list[int] = []
    subscribe(dispatcher, lambda c: seen.append(c.id), queue=5)

    def flood() -> None:
        for number in range(500):
            dispatcher.publish(contact(number))

    threads = [threading.Thread(target=flood) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert dispatcher.close(LONG)
    (statistics,) = dispatcher.statistics()
    assert len(seen) == statistics.calls
    assert statistics.calls + statistics.dropped == 2000


def collector(ids: list[int]) -> Callable[[Contact], None]:
    return lambda event: ids.append(event.id)


def at_least(rest: int) -> Callable[[Contact], bool]:
    return lambda event: event.id % 4 >= rest


@examples(60)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["publish", "flush", "subscribe"]), st.integers(0, 3), st.integers(1, 9)
        ),
        max_size=60,
    )
)
def test_whatever_happens_events_are_handled_in_order_or_counted(
    steps: list[tuple[str, int, int]],
) -> None:
    dispatcher = Dispatcher()
    seen: list[list[int]] = []
    expected: list[list[int]] = []
    for number, (step, rest, queue) in enumerate(steps):
        if step == "subscribe":
            mine = list[int]()
            seen.append(mine)
            expected.append([rest])
            subscribe(dispatcher, collector(mine), at_least(rest), queue=queue)
        elif step == "flush":
            assert dispatcher.flush(LONG)
        else:
            dispatcher.publish(contact(number))
            for hoped in expected:
                if number % 4 >= hoped[0]:
                    hoped.append(number)
    assert dispatcher.close(LONG)
    for mine, hoped, statistics in zip(seen, expected, dispatcher.statistics(), strict=True):
        assert mine == sorted(mine)
        assert set(mine) <= set(hoped[1:])
        assert len(mine) + statistics.dropped == len(hoped) - 1


@pytest.mark.parametrize("error", [ValueError("too bad"), SystemExit(1), KeyboardInterrupt()])
def test_raising_callback_is_logged_and_disturbs_nothing(
    dispatcher: Dispatcher, caplog: pytest.LogCaptureFixture, error: BaseException
) -> None:
    seen: list[int] = []

    def broken_callback(event: Contact) -> None:
        raise error

    subscribe(dispatcher, broken_callback)
    subscribe(dispatcher, lambda c: seen.append(c.id))
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


def test_statistics_count_calls_and_time(
    dispatcher: Dispatcher, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter([10.0, 10.5, 20.0, 22.0, 30.0, 30.25])
    monkeypatch.setattr("pepper_driver.callbacks.dispatcher.time.perf_counter", lambda: next(clock))

    def tired(event: Contact) -> None:
        pass

    subscribe(dispatcher, tired, lambda c: c.id < 3)
    for number in range(5):
        dispatcher.publish(contact(number))
    assert dispatcher.flush(LONG)
    (statistics,) = dispatcher.statistics()
    assert statistics.name.endswith("tired")
    assert (statistics.calls, statistics.failures) == (3, 0)
    assert (statistics.total_time, statistics.max_time) == (2.75, 2.0)


def test_callback_may_publish_subscribe_and_flush(dispatcher: Dispatcher) -> None:
    seen: list[object] = []

    def first(event: Contact) -> None:
        if event.id == 0:
            seen.append(dispatcher.flush())
            subscribe(dispatcher, lambda c: seen.append(("late", c.id)))
            dispatcher.publish(contact(1))
        seen.append(event.id)

    subscribe(dispatcher, first)
    dispatcher.publish(contact(0))
    assert dispatcher.flush(LONG)
    assert dispatcher.flush(LONG)  # the first may have come before event 1
    assert sorted(map(str, seen)) == ["('late', 1)", "0", "1", "False"]
    assert seen.index(0) < seen.index(1)


def test_callback_may_close() -> None:
    dispatcher = Dispatcher()
    seen: list[object] = []
    subscribe(dispatcher, lambda c: seen.append((c.id, dispatcher.close())))
    go = threading.Event()
    subscribe(dispatcher, lambda c: go.wait(LONG))
    dispatcher.publish(contact(0))
    go.set()
    assert dispatcher.close(LONG)
    assert seen == [(0, False)]


def test_close_handles_what_waits() -> None:
    dispatcher = Dispatcher()
    blocker = Blocker()
    subscribe(dispatcher, blocker)
    for number in range(50):
        dispatcher.publish(contact(number))
    blocker.release.set()
    assert dispatcher.close(LONG)
    assert blocker.ids == list(range(50))
    assert dispatcher.close()
    late: list[Contact] = []
    subscribe(dispatcher, late.append)
    dispatcher.publish(contact(50))
    assert not dispatcher.flush()
    assert len(dispatcher.statistics()) == 1
    assert (blocker.ids[-1], late) == (49, [])
    assert Dispatcher().close()


def test_close_gives_up_on_a_callback_that_hangs() -> None:
    dispatcher = Dispatcher()
    blocker, second = Blocker(), list[int]()
    subscribe(dispatcher, blocker)
    subscribe(dispatcher, lambda c: second.append(c.id))
    for number in range(5):
        dispatcher.publish(contact(number))
    assert blocker.entered.wait(LONG)
    assert not dispatcher.flush(0.01)
    assert not dispatcher.close(0.01)
    assert not dispatcher.close(0.01)
    assert [s.dropped for s in dispatcher.statistics()] == [4, 0]
    assert second == list(range(5))  # the other was not held up
    blocker.release.set()
    assert dispatcher.close(LONG)
    assert blocker.ids == [0]
    assert [s.dropped for s in dispatcher.statistics()] == [4, 0]


def test_flush_and_close_have_one_limit_for_all_callbacks(
    dispatcher: Dispatcher, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a time that passes by waiting for them alone."""
    blockers, now = [Blocker() for _ in range(8)], 0.0
    for blocker in blockers:
        subscribe(dispatcher, blocker)
    dispatcher.publish(contact())

    def acquire(*_: object, timeout: float) -> bool:
        nonlocal now
        now += max(timeout, 0.0)
        return False

    def join(thread: threading.Thread, timeout: float) -> None:
        if thread.is_alive():
            acquire(timeout=timeout)

    with monkeypatch.context() as patch:
        patch.setattr("pepper_driver.callbacks.dispatcher.time.monotonic", lambda: now)
        patch.setattr(threading.Semaphore, "acquire", acquire)
        patch.setattr(threading.Thread, "join", join)
        for number, wait in enumerate((dispatcher.flush, dispatcher.close), 1):
            assert not wait(0.5)
            assert now == pytest.approx(0.5 * number)
    for blocker in blockers:
        blocker.release.set()
    assert dispatcher.close(LONG)


def test_flush_and_close_race() -> None:
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        for _ in range(200):
            dispatcher = Dispatcher()
            subscribe(dispatcher, lambda c: None)
            dispatcher.publish(contact())
            closing = threading.Thread(target=dispatcher.close)
            closing.start()
            dispatcher.flush(0.1)  # whatever comes first
            closing.join(LONG)
            assert not closing.is_alive()
            assert dispatcher.statistics()[0].calls == 1
    finally:
        sys.setswitchinterval(interval)


def test_signal_handlers_may_publish_and_flush_while_the_interrupted_thread_does() -> None:
    dispatcher = Dispatcher()
    published, over = 0, False

    def handler(*_: object) -> None:
        nonlocal published
        published += 1
        dispatcher.publish(contact())
        dispatcher.flush(0.0)
        dispatcher.statistics()
        if not over:  # and only now: handlers do not interrupt each other
            signal.setitimer(signal.ITIMER_REAL, 1e-4)

    subscribe(dispatcher, lambda _: None, queue=3)
    before = signal.signal(signal.SIGALRM, handler)
    signal.setitimer(signal.ITIMER_REAL, 1e-4)
    try:
        for _ in range(20_000):
            dispatcher.publish(contact())
            dispatcher.flush(0.0)
    finally:
        over = True
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert dispatcher.close(LONG)
    (statistics,) = dispatcher.statistics()
    assert published
    assert statistics.calls + statistics.dropped == 20_000 + published


def test_it_distinguishes_its_callbacks_from_other_threads(dispatcher: Dispatcher) -> None:
    inside: list[bool] = []
    other = Dispatcher()
    for one in (dispatcher, other):
        subscribe(one, lambda _: inside.append(dispatcher.inside_callback()))
        one.publish(contact())
        assert one.flush(LONG)
    assert inside == [True, False]
    assert not dispatcher.inside_callback()
    other.close()


def test_sinks_take_events_at_once_while_they_are_attached(dispatcher: Dispatcher) -> None:
    woken = threading.Semaphore(0)
    early, late = (EventSink("a test", woken.release) for _ in range(2))
    fault = FaultEvent(fault=STOP, time=1.0)
    strong = Subscription(Contact, lambda c: c.intensity_deg > 1.0, 2)
    with dispatcher.attached(late, strong, Subscription(FaultEvent), Subscription(EndEvent)):
        with dispatcher.attached(early, Subscription(FaultEvent)):
            assert dispatcher.has_receiver(Contact)
            assert not dispatcher.has_receiver(SensorEvent)
            dispatcher.publish(fault)
        for number in range(3):
            dispatcher.publish(contact(number))
            dispatcher.publish(contact(number, intensity_deg=0.5))
        assert [early.take(), early.take()] == [fault, None]
        assert list(late.events) == [fault, contact(0)]  # two may wait when a contact comes
        assert (early.dropped, late.dropped) == (0, 2)
        for _ in range(3):
            assert woken.acquire(timeout=LONG)
        dispatcher.close()
        dispatcher.close()
        assert list(late.events) == [fault, contact(0), EndEvent()]
        assert woken.acquire(timeout=LONG)
    assert not dispatcher.has_receiver(Contact)
    with dispatcher.attached(early, Subscription(EndEvent)):
        assert early.take() == EndEvent()


def test_what_a_predicate_raises_costs_the_others_nothing(
    dispatcher: Dispatcher, caplog: pytest.LogCaptureFixture
) -> None:
    seen: list[int] = []
    subscribe(dispatcher, print, lambda c: c.id < 1 / 0)
    subscribe(dispatcher, lambda c: seen.append(c.id))
    dispatcher.publish(contact(1))
    assert dispatcher.flush(LONG)
    assert seen == [1]
    assert "ZeroDivisionError" in caplog.text
