"""Waiting for contacts: in the thread that runs the robot, in others, and in asyncio."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace
from typing import Any, Never

import pytest

from pepper_driver import Contact, FaultError, Pepper
from pepper_driver.backends import BackendError
from pepper_driver.callbacks.dispatcher import QUEUE, Dispatcher, Subscription
from pepper_driver.callbacks.events import FaultEvent, TickEvent
from pepper_driver.callbacks.filters import SubscriptionError
from pepper_driver.callbacks.waiting import stream_contacts, wait_for_contact
from pepper_driver.config import UnknownNameError
from pepper_driver.safety import Fault, FaultReason
from pepper_driver.testing import aged, pressed
from support.events import LONG, ROBOT, contact, make_pepper

CYCLE = ROBOT.cycle


class Waiting:
    """Another thread that waits; ``result`` is what it got or the error raised."""

    def __init__(self, pepper: Pepper, **which: Any) -> None:
        self.result: Contact | BaseException | None = None
        self._pepper = pepper
        self._which = which
        self.thread = threading.Thread(target=self._wait)
        self.thread.start()
        assert pepper._session is not None
        attached = pepper._session.dispatcher
        while self.thread.is_alive() and not attached.has_receiver(Contact):
            time.sleep(0.001)

    def _wait(self) -> None:
        try:
            self.result = self._pepper.wait_for_contact(**self._which)
        except BaseException as error:
            self.result = error

    def join(self) -> Contact | BaseException | None:
        self.thread.join(LONG)
        assert not self.thread.is_alive()
        return self.result


def test_it_runs_the_robot_up_to_the_contact() -> None:
    pepper = make_pepper({5: (contact(1),), 8: (contact(2, link="RForeArm"), contact(3))})
    with pepper:
        assert pepper.wait_for_contact(timeout=1.0) == contact(1)
        assert pepper.time == pytest.approx(5 * CYCLE)
        assert pepper.wait_for_contact(link="LForeArm") == contact(3)
        assert pepper.time == pytest.approx(8 * CYCLE)


def test_it_waits_for_any_of_several_limbs_and_for_a_torque() -> None:
    pepper = make_pepper(
        {
            3: (contact(1, joint="LElbowRoll", torque=1.0), contact(2, joint="RHand", torque=9.0)),
            5: (contact(1, phase="update", torque=-2.0),),
        }
    )
    with pepper:
        picked = pepper.wait_for_contact(limb=["left_arm", "head"], min_torque=2.0, timeout=1.0)
        assert picked == contact(1, phase="update", torque=-2.0)
        with pytest.raises(SubscriptionError, match="limb head and link LForeArm"):
            pepper.wait_for_contact(limb="head", link="LForeArm")


def test_it_waits_no_longer_than_its_timeout_on_the_robots_clock() -> None:
    pepper = make_pepper({10: (contact(1),), 21: (contact(2),)})
    with pepper:
        assert pepper.wait_for_contact(timeout=10 * CYCLE) == contact(1)  # in the last tick
        assert pepper.wait_for_contact(timeout=10 * CYCLE) is None
        assert pepper.time == pytest.approx(20 * CYCLE)
        assert pepper.wait_for_contact(timeout=0) is None
        assert pepper.time == pytest.approx(20 * CYCLE)


def test_it_takes_what_is_asked_for_and_nothing_from_before() -> None:
    pepper = make_pepper(
        {
            2: (contact(1),),
            4: (contact(2, kind="rebound"), contact(1, phase="update", intensity_deg=9.0)),
            6: (contact(1, phase="end"),),
        }
    )
    with pepper:
        pepper.run(3 * CYCLE)
        assert pepper.wait_for_contact(timeout=20 * CYCLE, phase="end") == contact(1, phase="end")
        assert pepper.wait_for_contact(timeout=20 * CYCLE) is None


def test_another_thread_waits_for_the_one_that_runs() -> None:
    pepper = make_pepper({5: (contact(1),), 17: (contact(2),), 27: (contact(3),)})
    with pepper:
        waiting = Waiting(pepper, timeout=1.0)
        pepper.run(3 * CYCLE)
        assert waiting.thread.is_alive()  # nothing yet, and it goes on over several runs
        pepper.run(3 * CYCLE)
        assert waiting.join() == contact(1)
        assert pepper.time == pytest.approx(6 * CYCLE)  # it has run nothing itself
        waiting = Waiting(pepper, timeout=10 * CYCLE)
        pepper.run(11 * CYCLE)
        assert waiting.join() is None  # the second contact came a tick too late
        waiting = Waiting(pepper, timeout=10 * CYCLE)
        pepper.run(20 * CYCLE)
        assert waiting.join() == contact(3)  # in the last tick


def until_a_thread_waits(pepper: Pepper) -> None:
    end = time.monotonic() + LONG
    while not pepper._active().dispatcher.has_receiver(Contact):
        assert time.monotonic() < end
        time.sleep(0.001)


def test_its_own_thread_waits_while_another_runs() -> None:
    pepper = make_pepper({10: (contact(1),)})
    inside = threading.Event()

    def hold_up(*_: object) -> None:
        if not inside.is_set():
            inside.set()
            until_a_thread_waits(pepper)

    with pepper:
        runner = threading.Thread(target=lambda: pepper.run(50 * CYCLE, on_tick=hold_up))
        runner.start()
        assert inside.wait(LONG)
        assert pepper.wait_for_contact(timeout=20 * CYCLE) == contact(1)
        runner.join(LONG)
        assert pepper.time == pytest.approx(50 * CYCLE)


def test_a_callback_may_wait() -> None:
    pepper = make_pepper({10: (contact(1),)}, {1: pressed("bumpers", 0)})
    found: list[Contact | None] = []
    ticks: list[object] = []

    @pepper.on_bumper()
    def hit(_: object) -> None:
        found.append(pepper.wait_for_contact(timeout=20 * CYCLE))

    def hold_up(tick: object, _: object) -> None:
        ticks.append(tick)
        if len(ticks) == 2:
            until_a_thread_waits(pepper)

    with pepper:
        pepper.run(50 * CYCLE, on_tick=hold_up)
    assert found == [contact(1)]


def test_it_does_not_wait_for_a_robot_that_does_not_run() -> None:
    with make_pepper() as pepper:
        start = time.monotonic()
        waiting = Waiting(pepper, timeout=0.1)
        assert waiting.join() is None
        assert time.monotonic() - start < LONG / 2


def test_closing_the_robot_ends_the_wait() -> None:
    with make_pepper() as pepper:
        waiting = Waiting(pepper)
        pepper.run(3 * CYCLE)
        assert waiting.thread.is_alive()
    assert waiting.join() is None


@pytest.mark.parametrize("stop", [lambda p: p.emergency_stop(), lambda p: p.run(1.0)])
def test_a_fault_ends_the_wait_of_all(stop: Callable[[Pepper], object]) -> None:
    pepper = make_pepper(faults={3: aged(0.2)})
    with pepper:
        waiting = Waiting(pepper)
        with suppress(FaultError):
            stop(pepper)
        assert isinstance(waiting.join(), FaultError)
        with pytest.raises(FaultError):
            pepper.wait_for_contact(timeout=1.0)
        assert isinstance(Waiting(pepper).join(), FaultError)


def test_a_fault_while_it_runs_the_robot_is_raised() -> None:
    pepper = make_pepper(faults={3: aged(0.2)})
    with pepper, pytest.raises(FaultError, match="200 ms old"):
        pepper.wait_for_contact(timeout=1.0)


@pytest.mark.parametrize("timeout", [-1.0, float("nan"), float("inf"), "1", [1.0]])
def test_a_timeout_that_is_none_is_refused(timeout: Any) -> None:
    with make_pepper() as pepper, pytest.raises(SubscriptionError, match="timeout"):
        pepper.wait_for_contact(timeout=timeout)


def test_what_can_never_come_is_not_waited_for() -> None:
    pepper = make_pepper()
    with pytest.raises(BackendError, match="with Pepper"):
        pepper.wait_for_contact(timeout=1.0)
    with pepper, pytest.raises(UnknownNameError, match="LForeArm"):
        pepper.wait_for_contact(link="LForearm")
    numb = Pepper("mujoco", observer=None)
    with numb, pytest.raises(SubscriptionError, match="without an observer"):
        numb.wait_for_contact()


def test_a_waiter_leaves_nothing_behind() -> None:
    with make_pepper() as pepper:
        pepper.wait_for_contact(timeout=3 * CYCLE)
        assert not pepper._active().dispatcher.has_receiver(Contact)


class Ticking:
    """A session whose loop thread ticks when a test says so."""

    cycle = CYCLE

    def __init__(self) -> None:
        self.loop = SimpleNamespace(observer=object(), time=0.0)
        self.dispatcher = Dispatcher()
        self.fault: Fault | None = None

    def ticks_here(self) -> bool:
        return False

    def run(self, ticks: float, *, until: Callable[[], bool]) -> Never:
        raise AssertionError("the loop thread ticks, and no other")

    def check_fault(self) -> None:
        if self.fault is not None:
            raise FaultError(self.fault)

    def tick(self, *events: object) -> None:
        self.loop.time += self.cycle
        tick: Any = SimpleNamespace(measurement=SimpleNamespace(time=self.loop.time))
        for event in (*events, TickEvent(tick=tick, observation=None)):
            self.dispatcher.publish(event)

    def stop(self) -> None:
        self.fault = Fault(reason=FaultReason.EMERGENCY_STOP, text="a test")
        self.dispatcher.publish(FaultEvent(fault=self.fault, time=self.loop.time))


@pytest.mark.parametrize(
    ("act", "result"),
    [
        (lambda s: s.tick(contact(1), contact(2)), contact(1)),
        (lambda s: [s.tick(contact(n, kind="rebound")) for n in range(200)], None),  # time is over
        (lambda s: s.dispatcher.close(), None),
        (lambda s: s.stop(), FaultError),
        (lambda s: (s.tick(contact(1)), s.stop()), contact(1)),  # came first
    ],
)
def test_where_a_loop_thread_ticks_every_thread_only_waits(
    act: Callable[[Ticking], object], result: object
) -> None:
    session: Any = Ticking()
    results: list[object] = []

    def wait() -> None:
        try:
            touch = wait_for_contact(session, lambda c: c.kind != "rebound", 200 * CYCLE)
            results.append(touch)
        except FaultError:
            results.append(FaultError)

    waiting = threading.Thread(target=wait)
    waiting.start()
    while not session.dispatcher.has_receiver(Contact):
        time.sleep(0.001)
    act(session)
    waiting.join(LONG)
    assert results == [result]
    session.dispatcher.close()


# -- asyncio ----------------------------------------------------------------------------------------------------------


async def collect(pepper: Pepper, **which: float) -> list[int]:
    return [event.id async for event in pepper.contacts(**which)]  # type: ignore[arg-type]


async def started(pepper: Pepper) -> None:
    while not pepper._active().dispatcher.has_receiver(Contact):
        await asyncio.sleep(0.001)


def test_contacts_come_until_the_robot_is_closed() -> None:
    pepper = make_pepper(
        {tick: (contact(tick, intensity_deg=float(tick)),) for tick in range(1, 31)}
    )

    async def main() -> tuple[list[int], list[int]]:
        with pepper:
            every = asyncio.create_task(collect(pepper))
            strong = asyncio.create_task(collect(pepper, min_intensity_deg=25.0))
            await started(pepper)
            await asyncio.sleep(0.01)
            await asyncio.to_thread(pepper.run, 20 * CYCLE)
            await asyncio.to_thread(pepper.run, 10 * CYCLE)
        return await every, await strong

    every, strong = asyncio.run(asyncio.wait_for(main(), LONG))
    assert every == list(range(1, 31))
    assert strong == list(range(25, 31))


def test_the_loop_reacts_while_the_robot_runs() -> None:
    """A contact is seen long before the run is over: the run ends because it was."""
    pepper = make_pepper({20: (contact(1),)})
    seen = threading.Event()

    async def main() -> bool:
        with pepper:

            async def listen() -> None:
                async for _ in pepper.contacts():
                    seen.set()
                    break

            listener = asyncio.create_task(listen())
            await started(pepper)
            ended = await asyncio.to_thread(pepper.run, 1e5 * CYCLE, until=seen.is_set)
            await listener
            return ended

    assert asyncio.run(asyncio.wait_for(main(), LONG))


def test_a_fault_ends_it_behind_the_last_contact() -> None:
    pepper = make_pepper({2: (contact(1),), 3: (contact(2),)}, {3: aged(0.2)})

    async def main() -> list[int]:
        with pepper:
            listener = asyncio.create_task(collect(pepper))
            await started(pepper)
            with pytest.raises(FaultError):
                await asyncio.to_thread(pepper.run, 1.0)
            return await listener

    assert asyncio.run(asyncio.wait_for(main(), LONG)) == [1, 2]


def test_one_that_is_left_or_cancelled_leaves_nothing_behind() -> None:
    pepper = make_pepper()

    async def main() -> None:
        with pepper:
            dispatcher = pepper._active().dispatcher
            listener = asyncio.create_task(collect(pepper))
            await started(pepper)
            listener.cancel()
            with pytest.raises(asyncio.CancelledError):
                await listener
            assert not dispatcher.has_receiver(Contact)
            contacts = pepper.contacts()
            step = asyncio.ensure_future(anext(contacts))
            await started(pepper)
            dispatcher.publish(contact(5))
            assert (await step).id == 5
            await contacts.aclose()
            assert not dispatcher.has_receiver(Contact)

    asyncio.run(asyncio.wait_for(main(), LONG))


def test_an_event_loop_that_is_held_up_loses_the_newest_and_says_so(
    caplog: pytest.LogCaptureFixture,
) -> None:
    dispatcher = Dispatcher()

    async def main() -> list[int]:
        contacts = stream_contacts(dispatcher, lambda _: True)
        first = asyncio.ensure_future(anext(contacts))
        await asyncio.sleep(0)
        for number in range(QUEUE + 500):  # the loop gets no turn meanwhile
            dispatcher.publish(contact(number))
        dispatcher.publish(
            FaultEvent(fault=Fault(reason=FaultReason.EMERGENCY_STOP, text="a test"), time=0.0)
        )
        return [(await first).id, *[event.id async for event in contacts]]

    with caplog.at_level(logging.WARNING, "pepper_driver"):
        assert asyncio.run(asyncio.wait_for(main(), LONG)) == list(range(QUEUE))
    assert caplog.text.count("too slow") == 1


def test_many_threads_lose_nothing() -> None:
    dispatcher = Dispatcher()

    async def main() -> list[int]:
        contacts = stream_contacts(dispatcher, lambda _: True)
        first = asyncio.ensure_future(anext(contacts))
        await asyncio.sleep(0)

        def publish() -> None:
            for number in range(200):
                dispatcher.publish(contact(number))

        threads = [threading.Thread(target=publish) for _ in range(4)]
        for thread in threads:
            thread.start()

        async def close() -> None:
            for thread in threads:
                await asyncio.to_thread(thread.join)
            dispatcher.close()

        closing = asyncio.create_task(close())
        seen = [(await first).id, *[event.id async for event in contacts]]
        await closing
        return seen

    seen = asyncio.run(asyncio.wait_for(main(), LONG))
    assert sorted(seen) == sorted(list(range(200)) * 4)


def test_an_event_loop_that_has_ended_disturbs_no_other_caller() -> None:
    dispatcher = Dispatcher()
    loop = asyncio.new_event_loop()
    contacts = stream_contacts(dispatcher, lambda _: True)
    step = loop.create_task(contacts.__anext__())
    loop.run_until_complete(asyncio.sleep(0))
    step.cancel()  # never gets to know
    loop.close()
    seen: list[Contact] = []
    dispatcher.subscribe(seen.append, Subscription(Contact))
    for number in range(3):
        dispatcher.publish(contact(number))
    assert dispatcher.close(LONG)
    assert seen == [contact(0), contact(1), contact(2)]


def test_mistakes_are_reported_when_it_is_called() -> None:
    pepper = make_pepper()
    with pytest.raises(BackendError, match="with Pepper"):
        pepper.contacts()
    with pepper:
        with pytest.raises(UnknownNameError, match="LForeArm"):
            pepper.contacts(link="LForearm")
        late = pepper.contacts()

    async def ended() -> list[int]:
        return [event.id async for event in late]

    assert asyncio.run(ended()) == []  # closed before the first step
