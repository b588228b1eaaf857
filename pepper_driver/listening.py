"""The part of a robot that tells what happens to it: callbacks, waiting, asyncio."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from numbers import Real
from typing import Any, TypeVar, Unpack

from pepper_driver.callback_thread import CallbackStatistics
from pepper_driver.callbacks import QUEUE, Subscription
from pepper_driver.config import RobotConfig
from pepper_driver.contact_stream import stream_contacts
from pepper_driver.events import (
    CueEvent,
    CueKind,
    Event,
    FaultEvent,
    PushEvent,
    ReflexEvent,
    ReflexPhase,
    SensorEvent,
    SensorKind,
    StepEvent,
    TickEvent,
)
from pepper_driver.filters import (
    ContactChoice,
    ListeningError,
    check_count,
    contact_filter,
    cue_filter,
    reflex_filter,
    sensor_filter,
    tick_filter,
)
from pepper_driver.observer.contact import Contact, Kind, Phase
from pepper_driver.session import Session
from pepper_driver.waiting import wait_for_contact

E = TypeVar("E")
Register = Callable[[Callable[[E], object]], Callable[[E], object]]
"""A decorator for functions that take an event; it returns them as they are."""


class Listening(ABC):
    """Registers callbacks. Each runs on a thread of its own and disturbs neither the ticks nor other callbacks.

    All names are checked when a callback is registered, and what is registered stays so for all runs.
    ``docs/callbacks.md`` says the rest.

    Args:
        config: Description of the robot.
        reflexes: Names of the reflexes it has.
    """

    def __init__(self, config: RobotConfig, reflexes: Sequence[str]) -> None:
        self.config = config
        self._reflex_names = tuple(reflexes)
        self._subscriptions: list[Subscription] = []
        self._session: Session | None = None  # the one that runs, or the last one

    # -- callbacks ----------------------------------------------------------------------------------------------

    def on_contact(
        self,
        *,
        link: str | None = None,
        joint: str | None = None,
        kind: Kind | None = None,
        phase: Phase | None = "begin",
        min_intensity: float = 0.0,
    ) -> Register[Contact]:
        """Decorator: call a function with each contact felt.

        Args:
            link: Only contacts on this link.
            joint: Only contacts felt by this joint.
            kind: Only this kind; None for contacts and collisions, but no rebounds.
            phase: ``begin``, once for each contact, as soon as it is as described; ``update``; ``end``; None for all.
            min_intensity: Only contacts of at least this intensity [deg].

        Raises:
            UnknownNameError: No such link, joint, kind or phase.
            ListeningError: An intensity that is none.
        """
        wanted = contact_filter(
            self.config,
            link=link,
            joint=joint,
            kind=kind,
            phase=phase,
            min_intensity=min_intensity,
        )
        return self._register(Contact, wanted)

    def on_tick(self, *, every: int = 1, queue: int = QUEUE) -> Register[TickEvent]:
        """Decorator: call a function after the ticks. What must happen inside them is for ``run(on_tick=...)``.

        Args:
            every: Only one tick in so many.
            queue: How many ticks may wait for the function; those that come then are dropped. Few for one that is slow
                and wants the newest.

        Raises:
            ListeningError: A number that is not from 1 up.
        """
        check_count("queue", queue)
        return self._register(TickEvent, tick_filter(every), queue)

    def on_touch(
        self, *, sensor: str | None = None, pressed: bool | None = True
    ) -> Register[SensorEvent]:
        """Decorator: call a function when a touch sensor of the head or the hands answers.

        Args:
            sensor: Only this one, such as ``Head/Touch/Front``.
            pressed: True when it is touched, False when it is let go, None for both.

        Raises:
            UnknownNameError: No such sensor.
            ListeningError: ``pressed`` is none of these.
        """
        return self._on_sensor("touch", sensor, self.config.sensors.touch, pressed)

    def on_bumper(
        self, *, bumper: str | None = None, pressed: bool | None = True
    ) -> Register[SensorEvent]:
        """Decorator: call a function when a bumper of the base is pressed; otherwise as :meth:`on_touch`."""
        return self._on_sensor("bumper", bumper, self.config.sensors.bumpers, pressed)

    def on_button(
        self, *, button: str | None = None, pressed: bool | None = True
    ) -> Register[SensorEvent]:
        """Decorator: call a function when the button on the chest is pressed; otherwise as :meth:`on_touch`."""
        return self._on_sensor("button", button, self.config.sensors.buttons, pressed)

    def on_fault(self) -> Register[FaultEvent]:
        """Decorator: call a function when the robot is stopped, once in a run."""
        return self._register(FaultEvent, lambda _: True)

    def on_reflex(
        self, *, name: str | None = None, phase: ReflexPhase | None = "begin"
    ) -> Register[ReflexEvent]:
        """Decorator: call a function when a reflex begins or ceases to act.

        Args:
            name: Only this one of the robot's reflexes.
            phase: ``begin``, ``end``, or None for both.

        Raises:
            UnknownNameError: No such reflex or phase.
            ListeningError: The robot has no reflexes.
        """
        return self._register(ReflexEvent, reflex_filter(name, self._reflex_names, phase))

    def on_step(self) -> Register[StepEvent]:
        """Decorator: call a function when a step of a motion or an experiment begins."""
        return self._register(StepEvent, lambda _: True)

    def on_cue(self, *, kind: CueKind | None = None) -> Register[CueEvent]:
        """Decorator: call a function when an experiment wants something said or shown.

        Args:
            kind: Only ``say`` or only ``leds``; None for both.

        Raises:
            UnknownNameError: No such kind.
        """
        return self._register(CueEvent, cue_filter(kind))

    def on_push(self) -> Register[PushEvent]:
        """Decorator: call a function when an experiment has a simulated robot pushed."""
        return self._register(PushEvent, lambda _: True)

    @property
    def callback_statistics(self) -> tuple[CallbackStatistics, ...]:
        """What each callback has cost and lost in the run that is under way, or in the last one."""
        return () if self._session is None else self._session.dispatcher.statistics()

    # -- contacts in other ways ---------------------------------------------------------------------------------

    def wait_for_contact(
        self, *, timeout: float | None = None, **which: Unpack[ContactChoice]
    ) -> Contact | None:
        """Wait for the next contact.

        The thread that activated the robot runs it meanwhile. Any other thread, and that one too while another runs the
        robot, waits for the ticks that somebody runs.

        Args:
            timeout: Longest wait [s] on the robot's clock, or on the wall's while nobody runs it; None waits for ever.
            **which: ``link``, ``joint``, ``kind``, ``phase``, ``min_intensity`` as in :meth:`on_contact`.

        Returns:
            The contact; None after the timeout, or when the robot was closed meanwhile.

        Raises:
            UnknownNameError: No such link, joint, kind or phase.
            ListeningError: A number that is none, or a robot without an observer.
            FaultError: The robot was stopped.
            BackendError: The robot is not active, or this is inside a tick.
        """
        if timeout is not None and not (isinstance(timeout, Real) and 0 <= timeout < float("inf")):
            raise ListeningError(
                f"timeout must be a time [s] that is not negative, or None, got {timeout!r}"
            )
        return wait_for_contact(self._active(), contact_filter(self.config, **which), timeout)

    def contacts(self, **which: Unpack[ContactChoice]) -> AsyncGenerator[Contact, None]:
        """Contacts for ``async for``, until the robot is closed or stopped.

        Somebody has to run the robot, in another thread: ``await asyncio.to_thread(pepper.run, 10)``.

        Args:
            **which: ``link``, ``joint``, ``kind``, ``phase``, ``min_intensity`` as in :meth:`on_contact`.

        Raises:
            UnknownNameError: No such link, joint, kind or phase.
            ListeningError: An intensity that is none.
            BackendError: The robot is not active.
        """
        wanted = contact_filter(self.config, **which)
        return stream_contacts(self._active().dispatcher, wanted)

    @property
    def contact_history(self) -> tuple[Contact, ...]:
        """All contact events since the start, oldest first."""
        return () if self._session is None else tuple(self._session.contact_history)

    # -- inside -------------------------------------------------------------------------------------------------

    @abstractmethod
    def _active(self) -> Session:
        """The session under way.

        Raises:
            BackendError: There is none.
        """

    def _on_sensor(
        self, kind: SensorKind, name: str | None, known: Mapping[str, Any], pressed: bool | None
    ) -> Register[SensorEvent]:
        return self._register(SensorEvent, sensor_filter(kind, name, known, pressed))

    def _register(
        self, event: type[Event], wanted: Callable[[Any], bool], queue: int = QUEUE
    ) -> Callable[[Callable[[Any], object]], Callable[[Any], object]]:
        def register(callback: Callable[[Any], object]) -> Callable[[Any], object]:
            _check_callback(callback)
            subscription = Subscription(callback=callback, event=event, wanted=wanted, queue=queue)
            self._subscriptions.append(subscription)
            if self._session is not None and self._session.active:
                self._session.dispatcher.subscribe(subscription)
            return callback

        return register


def _check_callback(callback: object) -> None:
    """Refuse what could be called, if at all, without doing anything."""
    if inspect.iscoroutinefunction(callback):
        raise ListeningError(
            f"{callback!r} is a coroutine, which nobody would await; for asyncio there is"
            " 'async for contact in pepper.contacts()'"
        )
    if not callable(callback):
        raise ListeningError(
            f"a callback must be a function that takes the event, got {callback!r}"
        )
