"""Registration of callbacks, for all runs of a robot."""

from __future__ import annotations

import inspect
import threading
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar, Unpack, get_args

from pepper_driver.callbacks.dispatcher import QUEUE, Dispatcher, Subscription
from pepper_driver.callbacks.events import (
    CueEvent,
    CueKind,
    FaultEvent,
    PushEvent,
    ReflexEvent,
    ReflexPhase,
    SensorEvent,
    SensorKind,
    StepEvent,
    TickEvent,
)
from pepper_driver.callbacks.filters import (
    ContactSelector,
    SubscriptionError,
    check_count,
    contact_filter,
    match,
    tick_filter,
)
from pepper_driver.config import RobotConfig
from pepper_driver.observer import Contact

E = TypeVar("E")
Register = Callable[[Callable[[E], object]], Callable[[E], object]]
"""Decorator for functions that take an event; it returns them as they are."""


class CallbackRegistry:
    """Callbacks of a robot. Each runs on a thread of its own and disturbs neither the ticks nor other callbacks.

    All names are checked when a callback is registered, and what is registered stays so for all runs.
    ``docs/callbacks.md`` says the rest.

    Args:
        config: Description of the robot.
        reflexes: Names of the reflexes it has.

    Attributes:
        config: The same.
    """

    def __init__(self, config: RobotConfig, reflexes: Sequence[str]) -> None:
        self.config, self._reflexes = config, reflexes
        self._callbacks: list[tuple[Callable[[Any], object], Subscription]] = []
        self._dispatcher: Dispatcher | None = None  # of the run under way, or of the last one
        self._lock = threading.RLock()

    def _make_dispatcher(self) -> Dispatcher:
        """Return a dispatcher for a new run, which calls the callbacks, those that are registered later too."""
        with self._lock:
            self._dispatcher = Dispatcher()
            for callback, subscription in self._callbacks:
                self._dispatcher.subscribe(callback, subscription)
            return self._dispatcher

    def on_contact(self, **selector: Unpack[ContactSelector]) -> Register[Contact]:
        """Call the decorated function with each contact.

        Args:
            **selector: Which contacts: ``link``, ``joint``, ``kind`` (``contact``, ``collision`` or ``rebound``; None,
                the default, for contacts and collisions), ``phase`` (``begin``, the default: once for each contact, as
                soon as it is as described; ``update``; ``end``; None for all), ``min_intensity`` [deg].

        Raises:
            UnknownNameError: No such link, joint, kind or phase.
            SubscriptionError: An intensity that is negative or not a number.
        """
        return self._register(Subscription(Contact, contact_filter(self.config, **selector)))

    def on_tick(self, *, every: int = 1, queue: int = QUEUE) -> Register[TickEvent]:
        """Call the decorated function after the ticks. What must happen inside them is for ``run(on_tick=...)``.

        Args:
            every: Only one tick in so many.
            queue: Ticks that may wait for the function; those that come then are dropped. Few for one that is slow
                and wants the newest.

        Raises:
            SubscriptionError: A number that is not from 1 up.
        """
        check_count("queue", queue)
        return self._register(Subscription(TickEvent, tick_filter(every), queue))

    def on_touch(
        self, *, sensor: str | None = None, pressed: bool | None = True
    ) -> Register[SensorEvent]:
        """Call the decorated function when a touch sensor of the head or the hands is touched.

        Args:
            sensor: Only this one, such as ``Head/Touch/Front``.
            pressed: True when it is touched, False when it is released, None for both.

        Raises:
            UnknownNameError: No such sensor, or another value of ``pressed``.
        """
        return self._on_sensor("touch", sensor, self.config.sensors.touch, pressed)

    def on_bumper(
        self, *, bumper: str | None = None, pressed: bool | None = True
    ) -> Register[SensorEvent]:
        """Call the decorated function when a bumper of the base is pressed; otherwise as :meth:`on_touch`."""
        return self._on_sensor("bumper", bumper, self.config.sensors.bumpers, pressed)

    def on_button(
        self, *, button: str | None = None, pressed: bool | None = True
    ) -> Register[SensorEvent]:
        """Call the decorated function when the button on the chest is pressed; otherwise as :meth:`on_touch`."""
        return self._on_sensor("button", button, self.config.sensors.buttons, pressed)

    def on_fault(self) -> Register[FaultEvent]:
        """Call the decorated function when the robot is stopped, once in a run."""
        return self._register(Subscription(FaultEvent))

    def on_reflex(
        self, *, name: str | None = None, phase: ReflexPhase | None = "begin"
    ) -> Register[ReflexEvent]:
        """Call the decorated function when a reflex begins or ceases to act.

        Args:
            name: Only this one of the robot's reflexes.
            phase: ``begin``, ``end``, or None for both.

        Raises:
            UnknownNameError: No such reflex or phase.
            SubscriptionError: The robot has no reflexes.
        """
        if name is not None and not self._reflexes:
            raise SubscriptionError(
                f"there is no reflex '{name}': this robot has none; give it some with Pepper(reflexes=[...])"
            )
        predicate = match(
            reflex=("reflex", name, self._reflexes),
            phase=("phase of a reflex", phase, get_args(ReflexPhase)),
        )
        return self._register(Subscription(ReflexEvent, predicate))

    def on_step(self) -> Register[StepEvent]:
        """Call the decorated function when a step of a motion or an experiment begins."""
        return self._register(Subscription(StepEvent))

    def on_cue(self, *, kind: CueKind | None = None) -> Register[CueEvent]:
        """Call the decorated function when an experiment has something said or shown.

        Args:
            kind: Only ``say`` or only ``leds``; None for both.

        Raises:
            UnknownNameError: No such kind.
        """
        predicate = match(kind=("kind of cue", kind, get_args(CueKind)))
        return self._register(Subscription(CueEvent, predicate))

    def on_push(self) -> Register[PushEvent]:
        """Call the decorated function when an experiment has a simulated robot pushed."""
        return self._register(Subscription(PushEvent))

    def _on_sensor(
        self, kind: SensorKind, name: str | None, known: Iterable[str], pressed: bool | None
    ) -> Register[SensorEvent]:
        predicate = match(
            kind=("kind of sensor", kind, get_args(SensorKind)),
            name=("touch sensor" if kind == "touch" else kind, name, known),
            pressed=("value of pressed", pressed, (True, False)),
        )
        return self._register(Subscription(SensorEvent, predicate))

    def _register(self, subscription: Subscription) -> Register[Any]:
        def register(callback: Callable[[Any], object]) -> Callable[[Any], object]:
            if inspect.iscoroutinefunction(callback) or not callable(callback):
                raise SubscriptionError(
                    f"a callback must be a function that takes the event, and not a coroutine, got {callback!r};"
                    " for asyncio there is 'async for contact in pepper.contacts()'"
                )
            with self._lock:
                self._callbacks.append((callback, subscription))
                if self._dispatcher is not None:
                    self._dispatcher.subscribe(callback, subscription)
            return callback

        return register
