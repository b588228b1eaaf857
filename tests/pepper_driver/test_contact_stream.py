"""Contacts for asyncio, while another thread runs the robot."""

from __future__ import annotations

import asyncio
import logging
import threading

import pytest

from pepper_driver import Contact, FaultError, Pepper
from pepper_driver.backends import BackendError
from pepper_driver.callbacks import QUEUE, Dispatcher
from pepper_driver.config import UnknownNameError
from pepper_driver.contact_stream import stream_contacts
from pepper_driver.events import FaultEvent
from pepper_driver.safety import Fault, FaultReason

from event_cases import LONG, ROBOT, contact, make_pepper  # isort: skip
from fakes import aged  # isort: skip

CYCLE = ROBOT.cycle


async def collect(pepper: Pepper, **which: float) -> list[int]:
    return [event.id async for event in pepper.contacts(**which)]  # type: ignore[arg-type]


async def started(pepper: Pepper) -> None:
    while not pepper._active().dispatcher.wants(Contact):
        await asyncio.sleep(0.001)


def test_contacts_come_until_the_robot_is_closed() -> None:
    pepper = make_pepper({tick: (contact(tick, intensity=float(tick)),) for tick in range(1, 31)})

    async def main() -> tuple[list[int], list[int]]:
        with pepper:
            every = asyncio.create_task(collect(pepper))
            strong = asyncio.create_task(collect(pepper, min_intensity=25.0))
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
            assert not dispatcher.wants(Contact)
            contacts = pepper.contacts()
            step = asyncio.ensure_future(anext(contacts))
            await started(pepper)
            dispatcher.publish(contact(5))
            assert (await step).id == 5
            await contacts.aclose()
            assert not dispatcher.wants(Contact)

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


def test_an_event_loop_that_is_gone_disturbs_nobody() -> None:
    dispatcher = Dispatcher()
    loop = asyncio.new_event_loop()
    contacts = stream_contacts(dispatcher, lambda _: True)
    step = loop.create_task(contacts.__anext__())
    loop.run_until_complete(asyncio.sleep(0))
    step.cancel()  # never gets to know
    loop.close()
    dispatcher.publish(contact(1))
    assert dispatcher.close()


def test_mistakes_are_told_when_it_is_called() -> None:
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
