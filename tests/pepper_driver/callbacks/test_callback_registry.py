"""Callbacks of a robot: every kind, in order, whatever other callbacks do."""

from __future__ import annotations

import logging
import threading
import time
from functools import partial
from types import SimpleNamespace
from typing import Any, get_args

import pytest

from pepper_driver import (
    Contact,
    FaultError,
    FaultEvent,
    FollowHand,
    Hold,
    PepperError,
    Reflex,
    ReflexEvent,
    RobotState,
    SensorEvent,
    TickEvent,
)
from pepper_driver.backends import BackendError
from pepper_driver.backends.mock import MockBackend
from pepper_driver.callbacks.callback_registry import CallbackRegistry
from pepper_driver.callbacks.dispatcher import Dispatcher
from pepper_driver.callbacks.events import ReflexPhase
from pepper_driver.callbacks.filters import SubscriptionError
from pepper_driver.config import UnknownNameError, load_safety_settings
from pepper_driver.config.errors import ArgumentError
from pepper_driver.controller import Tick
from pepper_driver.loop import TickRecord
from pepper_driver.observer import Observation
from pepper_driver.safety import Fault, FaultReason
from pepper_driver.testing import aged, pressed
from support.events import LONG, ROBOT, Blocker, contact, make_pepper

CYCLE = ROBOT.cycle


def test_without_parentheses_all_contacts_come_and_the_function_stays_what_it_is() -> None:
    pepper = make_pepper({3: (contact(1),), 5: (contact(2, kind="rebound"),)})
    ids: list[int] = []

    @pepper.on_contact
    def touched(event: Contact) -> None:
        ids.append(event.id)

    touched(contact(7))
    with pepper:
        pepper.run(10 * CYCLE)
    assert ids == [7, 1]


def test_a_limb_and_a_torque_choose_contacts() -> None:
    """Both must hold; a contact that becomes so is reported then."""
    pepper = make_pepper(
        {
            3: (contact(1, torque=2.5), contact(2, limb="right_arm", torque=-9.0)),
            5: (contact(1, phase="update", torque=-3.0),),
            7: (contact(1, phase="update", torque=-4.0),),
        }
    )
    received: list[float | None] = []

    @pepper.on_contact(limb=["left_arm", "head"], min_torque=3.0)
    def touched(event: Contact) -> None:
        received.append(event.torque)

    with pepper:
        pepper.run(10 * CYCLE)
    assert received == [-3.0]


def test_ticks_come_with_the_observation() -> None:
    pepper = make_pepper({3: (contact(1),)})
    ticks: list[TickEvent] = []
    third: list[int] = []
    pepper.on_tick()(ticks.append)

    @pepper.on_tick(every=3)
    def seldom(event: TickEvent) -> None:
        third.append(event.tick.measurement.tick)

    with pepper:
        pepper.run(10 * CYCLE)
    assert [event.tick.measurement.tick for event in ticks] == list(range(1, 11))
    assert ticks[2].observation is not None
    assert ticks[2].observation.contacts == (contact(1),)
    assert third == [1, 4, 7, 10]


def test_sensors_report_when_they_are_pressed_and_let_go() -> None:
    """Bumper 1 for ticks 2 and 3, two sensors of the head in tick 5, the button, which stops the robot, in tick 7."""
    pepper = make_pepper(
        faults={
            2: pressed("bumpers", 1),
            3: pressed("bumpers", 1),
            5: pressed("touch", 0, 2),
            7: pressed("buttons", 0),
        }
    )
    touches: list[SensorEvent] = []
    rear: list[SensorEvent] = []
    bumpers: list[SensorEvent] = []
    released: list[SensorEvent] = []
    buttons: list[SensorEvent] = []
    pepper.on_touch()(touches.append)
    pepper.on_touch(sensor="Head/Touch/Rear", pressed=None)(rear.append)
    pepper.on_bumper(bumper="FrontRight")(bumpers.append)
    pepper.on_bumper(bumper="FrontLeft", pressed=None)(bumpers.append)
    pepper.on_bumper(pressed=False)(released.append)
    pepper.on_button(button="ChestBoard/Button")(buttons.append)
    with pepper, pytest.raises(FaultError):
        pepper.run(8 * CYCLE)

    def event(kind: Any, name: str, pressed: bool, tick: int) -> SensorEvent:
        return SensorEvent(kind=kind, name=name, pressed=pressed, time=tick * CYCLE)

    assert touches == [
        event("touch", "Head/Touch/Front", True, 5),
        event("touch", "Head/Touch/Rear", True, 5),
    ]
    assert rear == [
        event("touch", "Head/Touch/Rear", True, 5),
        event("touch", "Head/Touch/Rear", False, 6),
    ]
    assert bumpers == [event("bumper", "FrontRight", True, 2)]
    assert released == [event("bumper", "FrontRight", False, 4)]
    assert buttons == [event("button", "ChestBoard/Button", True, 7)]


def test_a_callback_sees_a_tick_from_its_contacts_to_its_end() -> None:
    pepper = make_pepper(
        {2: (contact(1), contact(2)), 4: (contact(1, phase="end"),)}, {2: pressed("bumpers", 0)}
    )
    seen: list[object] = []
    pepper.on_tick()(seen.append)
    pepper.on_bumper()(seen.append)
    pepper.on_reflex(phase=None)(seen.append)
    pepper.on_contact(phase=None)(seen.append)
    begin = reflex_event("hold")
    with pepper:
        pepper.run(4 * CYCLE)
        tick = seen[-1]
        assert isinstance(tick, TickEvent)
        session = pepper._session
        assert session is not None
        session._publish(TickRecord(tick=tick.tick, events=[begin]))
    kinds = [type(event).__name__ for event in seen]
    one = ["TickEvent"]
    assert kinds == [
        *one,
        *["Contact", "Contact", "SensorEvent"],
        *one,
        *one,
        "Contact",
        *one,
        "ReflexEvent",
        *one,
    ]
    assert pepper.contact_history == (contact(1), contact(2), contact(1, phase="end"))


def reflex_event(name: str, phase: ReflexPhase = "begin") -> ReflexEvent:
    return ReflexEvent(
        reflex=name,
        kind="some",
        number=1,
        phase=phase,
        time=1.0,
        contact_id=None,
        joints=("LShoulderRoll",),
        held_joints=(),
    )


def test_reflexes_are_reported_by_kind_name_number_object_and_phase() -> None:
    left, right = FollowHand(limb="left_arm"), FollowHand(limb="right_arm", name="right")
    reflexes = (left, right, Hold(), Hold(limb="head"))
    pepper = make_pepper(reflexes=reflexes)
    seen: dict[str, list[ReflexEvent]] = {}
    choices: dict[str, str | Reflex] = {
        "kind": "follow_hand",
        "name": "right",
        "both": "hold",
        "one": "hold 2",
        "left": left,
        "last": reflexes[3],
    }
    for key, choice in choices.items():
        pepper.on_reflex(name=choice, phase=None)(seen.setdefault(key, []).append)
    names = ["follow_hand", "right", "hold 1", "hold 2"]
    begun: list[ReflexEvent] = []
    pepper.on_reflex()(begun.append)
    events = [reflex_event(name, phase) for name in names for phase in get_args(ReflexPhase)]
    with pepper:
        session = pepper._session
        assert session is not None
        session._publish(TickRecord(tick=session.loop.tick().tick, events=events))
    received = {key: [event.reflex for event in events[::3]] for key, events in seen.items()}
    assert received == {
        "kind": ["follow_hand", "right"],
        "name": ["right"],
        "both": ["hold 1", "hold 2"],
        "one": ["hold 2"],
        "left": ["follow_hand"],
        "last": ["hold 2"],
    }
    assert [event.phase for event in seen["one"]] == list(get_args(ReflexPhase))
    assert begun == [event for event in events if event.phase == "begin"]


def test_a_reflex_that_the_robot_does_not_have_is_refused() -> None:
    pepper = make_pepper(reflexes=(Hold(), Hold()))
    with pytest.raises(UnknownNameError, match=r"unknown reflex 'hold 3' \(did you mean hold"):
        pepper.on_reflex(name="hold 3")
    with pytest.raises(SubscriptionError, match="a Hold, does not belong to this robot"):
        pepper.on_reflex(name=Hold())
    with pytest.raises(SubscriptionError, match="this robot has none"):
        make_pepper().on_reflex(name="hold")


def test_a_fault_in_a_tick_is_reported_once() -> None:
    pepper = make_pepper(faults={3: aged(0.2)})
    faults: list[FaultEvent] = []
    pepper.on_fault()(faults.append)
    with pepper:
        for _ in range(3):
            with pytest.raises(FaultError):
                pepper.run(1.0)
        pepper.emergency_stop()
    fault = Fault(reason=FaultReason.STALE_SAMPLE, text="the newest sample is 200 ms old")
    assert faults == [FaultEvent(fault=fault, time=3 * CYCLE)]


def test_an_emergency_stop_is_reported_before_the_first_tick() -> None:
    pepper = make_pepper()
    received = threading.Event()
    faults: list[FaultEvent] = []

    @pepper.on_fault()
    def stopped(event: FaultEvent) -> None:
        faults.append(event)
        received.set()

    for _ in range(2):  # a new run has faults of its own
        received.clear()
        pepper.start()
        pepper.run(2 * CYCLE)
        pepper.emergency_stop()
        assert received.wait(LONG)
        with pytest.raises(FaultError, match="emergency stop"):
            pepper.stop()
    assert [event.fault.reason for event in faults] == [FaultReason.EMERGENCY_STOP] * 2


def test_callbacks_that_hang_raise_or_flood_cost_no_tick_and_no_contact(
    caplog: pytest.LogCaptureFixture,
) -> None:
    pepper = make_pepper({tick: (contact(tick),) for tick in range(1, 2001)})
    blocker, seen = Blocker(), list[int]()
    ticks: list[int] = []
    done = threading.Event()
    pepper.on_contact()(blocker)

    @pepper.on_contact()
    def broken(event: Contact) -> None:
        raise ValueError("a user's mistake")

    @pepper.on_tick()
    def flooded(event: TickEvent) -> None:
        blocker.release.wait(LONG)

    @pepper.on_contact()
    def fine(event: Contact) -> None:
        seen.append(event.id)
        if event.id == 2000:
            done.set()

    def keep_up(tick: Tick, observation: Observation | None) -> None:
        """Without physics time flies: ``fine`` would lose contacts for its own slowness."""
        ticks.append(tick.measurement.tick)
        while len(seen) < len(ticks) - 500:
            time.sleep(0.001)

    with caplog.at_level(logging.CRITICAL, "pepper_driver"), pepper:
        pepper.run(2000 * CYCLE, on_tick=keep_up)
        assert done.wait(LONG)
        statistics = {s.name.rsplit(".", 1)[-1]: s for s in pepper.callback_statistics}
        blocker.release.set()
    assert ticks == list(range(1, 2001))
    assert seen == list(range(1, 2001))
    assert statistics["fine"].dropped == 0
    assert statistics["Blocker"].dropped >= 2000 - 1001  # one is being handled, a thousand wait
    assert statistics["flooded"].dropped >= 2000 - 1001
    assert statistics["broken"].failures == statistics["broken"].calls > 0


def test_a_tick_callback_gets_the_room_it_asks_for() -> None:
    registry = CallbackRegistry(ROBOT, ())
    entered, release = threading.Event(), threading.Event()

    @registry.on_tick(queue=2)
    def slow(event: TickEvent) -> None:
        entered.set()
        release.wait(LONG)

    dispatcher = registry._make_dispatcher()
    for number in range(1, 11):
        tick: Any = SimpleNamespace(measurement=SimpleNamespace(tick=number))
        dispatcher.publish(TickEvent(tick=tick, observation=None))
        assert entered.wait(LONG)
    release.set()
    assert dispatcher.close(LONG)
    (statistics,) = dispatcher.statistics()
    assert (statistics.calls, statistics.dropped) == (3, 7)


def test_what_is_registered_late_is_called_from_then_on() -> None:
    pepper = make_pepper({1: (contact(1),), 3: (contact(3),)})
    seen: list[int] = []
    with pepper:
        pepper.run(2 * CYCLE)

        @pepper.on_contact()
        def late(event: Contact) -> None:
            seen.append(event.id)

        pepper.run(2 * CYCLE)
    assert seen == [3]
    assert late(contact(9)) is None  # the decorator returns the function


@pytest.mark.parametrize(
    ("register", "error", "hint"),
    [
        (lambda p: p.on_contact(link="LForearm"), UnknownNameError, "LForeArm"),
        (lambda p: p.on_tick(every=0), SubscriptionError, "every"),
        (lambda p: p.on_tick(queue=0), SubscriptionError, "queue"),
        (lambda p: p.on_touch(sensor="Head"), UnknownNameError, "Head/Touch/Front"),
        (lambda p: p.on_bumper(bumper="Front"), UnknownNameError, "FrontLeft"),
        (lambda p: p.on_button(button="Chest"), UnknownNameError, "ChestBoard/Button"),
        (lambda p: p.on_button(pressed="yes"), ArgumentError, "pressed must be True or False"),
        (lambda p: p.on_reflex(name="hold"), SubscriptionError, "reflexes="),
        (lambda p: p.on_reflex(phase="start"), UnknownNameError, "begin"),
        (lambda p: p.on_cue(kind="sing"), UnknownNameError, "leds, say"),
        (lambda p: p.on_fault()(3), SubscriptionError, "got 3"),
        (lambda p: p.on_contact()(_coroutine), SubscriptionError, "async for contact in"),
        (lambda p: p.on_contact()(partial(_coroutine)), SubscriptionError, "async for contact in"),
    ],
)
def test_mistakes_are_refused_when_registered(
    register: Any, error: type[PepperError], hint: str
) -> None:
    pepper = make_pepper()
    with pytest.raises(error, match=hint):
        register(pepper)
    with pepper:
        assert pepper.callback_statistics == ()


async def _coroutine(event: Contact) -> None:
    pass


def test_only_one_thread_runs_the_robot_and_no_tick_runs_ticks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def no_motion(*_: object, **__: object) -> None:
        raise AssertionError(
            "a motion began, and would have changed the tasks of the one that runs"
        )

    monkeypatch.setattr("pepper_driver.experiments.player.Player.begin", no_motion)
    pepper = make_pepper()
    inside, go = threading.Event(), threading.Event()
    errors: list[BaseException] = []

    def hold_up(*_: object) -> None:
        inside.set()
        assert go.wait(LONG)

    def nested(*_: object) -> None:
        for wrong in (
            lambda: pepper.run(CYCLE),
            lambda: pepper.play("wave"),
            lambda: pepper.wait_for_contact(timeout=1.0),
        ):
            try:
                wrong()
            except BackendError as error:
                errors.append(error)

    with pepper:
        pepper.run(CYCLE, on_tick=nested)
        assert len(errors) == 3
        assert all("inside a tick" in str(error) for error in errors)
        runner = threading.Thread(
            target=lambda: pepper.run(CYCLE, on_tick=hold_up), name="the first"
        )
        runner.start()
        assert inside.wait(LONG)
        with pytest.raises(BackendError, match="'the first' runs the robot already"):
            pepper.run(CYCLE)
        with pytest.raises(BackendError, match="'the first' runs the robot already"):
            pepper.play("wave")
        go.set()
        runner.join(LONG)
        pepper.run(CYCLE)


class Noting(MockBackend):
    """Notes when it is closed."""

    def __init__(self, order: list[str]) -> None:
        super().__init__()
        self.order = order

    def close(self) -> None:
        self.order.append("close")


def test_a_callback_may_close_the_robot() -> None:
    """The tick under way ends first, and its thread gets the error."""
    pepper = make_pepper({3: (contact(1),)})
    order: list[str] = []
    closed = threading.Event()

    @pepper.on_contact()
    def enough(event: Contact) -> None:
        pepper.stop()
        closed.set()

    def slow(tick: Tick, observation: Observation | None) -> None:
        order.append("tick begins")
        time.sleep(0.02)
        order.append("tick ends")

    pepper.backend = Noting(order)
    with pepper:
        with pytest.raises(BackendError, match="closed while it ran"):
            pepper.run(1e4 * CYCLE, on_tick=slow)
        assert closed.wait(LONG)
    assert pepper.state is RobotState.INACTIVE
    assert order.index("close") == len(order) - order.count("close")
    assert order[order.index("close") - 1] == "tick ends"


@pytest.mark.parametrize(("real_time", "waits"), [(True, 0), (False, 10)])
def test_real_time_does_not_wait_for_callbacks_between_runs(
    real_time: bool, waits: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    waited: list[float] = []
    monkeypatch.setattr(Dispatcher, "flush", lambda _, timeout: waited.append(timeout))
    with make_pepper(real_time=real_time) as pepper:
        for _ in range(10):
            pepper.run(CYCLE)
    assert waited == [load_safety_settings().callback_time] * waits
