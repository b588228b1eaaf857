"""Registration of callbacks, for all runs of a robot."""

from __future__ import annotations

import inspect
import threading
from collections.abc import Callable, Iterable, Sequence
from functools import wraps
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar, Unpack, cast, get_args, overload

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
    ContactArguments,
    SubscriptionError,
    check_count,
    contact_filter,
    match,
    tick_filter,
)
from pepper_driver.config import RobotConfig, UnknownNameError
from pepper_driver.config.arguments import checked_arguments, takes_arguments
from pepper_driver.config.errors import shown
from pepper_driver.observer import Contact
from pepper_driver.reflexes.reflex import Reflex, kind_of

E = TypeVar("E")
P = ParamSpec("P")
Register = Callable[[Callable[[E], object]], Callable[[E], object]]
"""Decorator for functions that take an event; it returns them as they are."""


class Registration(Protocol[P, E]):
    """Function that registers a callback: ``@robot.on_tick`` does, and so does ``@robot.on_tick(every=2)``."""

    @overload
    def __call__(  # type: ignore[overload-overlap] # a lone function is never one of the arguments
        self, callback: Callable[[E], object], /
    ) -> Callable[[E], object]: ...

    @overload
    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> Register[E]: ...


class RegistrationMethod(Protocol[P, E]):
    """Registration method of a class: called with a function, or used as a decorator."""

    def __get__(self, instance: object, owner: object = None, /) -> Registration[P, E]: ...


def registration(
    method: Callable[Concatenate[Any, P], Register[E]],
) -> RegistrationMethod[P, E]:
    """Let a method that returns a decorator also be one itself: ``@robot.on_tick`` in place of ``@robot.on_tick()``."""
    checked: Callable[..., Any] = checked_arguments(method)

    @wraps(method)
    def register(self: CallbackRegistry, *args: Any, **kwargs: Any) -> object:  # noqa: ANN401 as of the method
        if len(args) == 1 and callable(args[0]) and not kwargs:
            return checked(self)(args[0])
        return checked(self, *args, **kwargs)

    return cast("RegistrationMethod[P, E]", register)


class CallbackRegistry:
    """Callbacks of a robot. Each runs on a thread of its own and disturbs neither the ticks nor other callbacks.

    Each method ``on_...`` is a decorator, with arguments or without: ``@robot.on_contact``. All names are checked when
    a callback is registered, and what is registered stays so for all runs.
    ``docs/callbacks.md`` says the rest.

    Args:
        config: Description of the robot.
        reflexes: Those it has, prepared.

    Attributes:
        config: The same.
    """

    def __init__(self, config: RobotConfig, reflexes: Sequence[Reflex]) -> None:
        self.config, self._reflexes = config, reflexes
        self._callbacks: list[tuple[Callable[[Any], object], Subscription]] = []
        self._dispatcher: Dispatcher | None = None  # of the current run, or of the last one
        self._lock = threading.RLock()

    def _make_dispatcher(self) -> Dispatcher:
        """Return a dispatcher for a new run, which calls the callbacks, those that are registered later too."""
        with self._lock:
            self._dispatcher = Dispatcher()
            for callback, subscription in self._callbacks:
                self._dispatcher.subscribe(callback, subscription)
            return self._dispatcher

    @registration
    def on_contact(self, **selector: Unpack[ContactArguments]) -> Register[Contact]:
        """Call the decorated function with each contact.

        Args:
            **selector: Which contacts: those that meet all of these. ``limb``, ``link``, ``joint``: a name, or a list
                of which any will do. ``kind``: ``contact``, ``collision`` or ``rebound``; None, the default, for
                contacts and collisions. ``min_intensity_deg`` [deg]. ``min_torque`` [N m]. ``min_force`` [N].
                ``phase``: ``begin``, the default: once for each contact, as soon as it is as described; ``update``;
                ``end``; None for all.

        Raises:
            UnknownNameError: No such limb, link, joint, kind or phase.
            SubscriptionError: Another wrong argument, or a choice that no contact can meet.
        """
        return self._register(Subscription(Contact, contact_filter(self.config, **selector)))

    @registration
    def on_tick(self, *, every: int = 1, queue: int = QUEUE) -> Register[TickEvent]:
        """Call the decorated function after the ticks. What must happen inside them is for ``run(on_tick=...)``.

        Args:
            every: Only one tick in so many.
            queue: Ticks that may wait for the function; those that come then are dropped. Few for one that is slow
                and uses only the newest.

        Raises:
            SubscriptionError: A number that is not from 1 up.
        """
        check_count("queue", queue)
        return self._register(Subscription(TickEvent, tick_filter(every), queue))

    @registration
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

    @registration
    def on_bumper(
        self, *, bumper: str | None = None, pressed: bool | None = True
    ) -> Register[SensorEvent]:
        """Call the decorated function when a bumper of the base is pressed; otherwise as :meth:`on_touch`."""
        return self._on_sensor("bumper", bumper, self.config.sensors.bumpers, pressed)

    @registration
    def on_button(
        self, *, button: str | None = None, pressed: bool | None = True
    ) -> Register[SensorEvent]:
        """Call the decorated function when the button on the chest is pressed; otherwise as :meth:`on_touch`."""
        return self._on_sensor("button", button, self.config.sensors.buttons, pressed)

    @registration
    def on_fault(self) -> Register[FaultEvent]:
        """Call the decorated function when the robot is stopped, once in a run."""
        return self._register(Subscription(FaultEvent))

    @registration
    def on_reflex(
        self, *, name: str | Reflex | None = None, phase: ReflexPhase | None = "begin"
    ) -> Register[ReflexEvent]:
        """Call the decorated function when a reflex begins or ceases to act, or is given other joints.

        Args:
            name: Only these of the robot's reflexes: a kind, such as ``follow_hand``, or a name, for all that have it;
                a name with a number, such as ``follow_hand 2``, or the reflex itself, for one of them.
            phase: ``begin``; ``update``, when it is given other joints; ``end``; None for all.

        Raises:
            UnknownNameError: No such reflex or phase.
            SubscriptionError: The robot has no reflexes, or not this one.
        """
        in_phase = match(phase=("phase of a reflex", phase, get_args(ReflexPhase)))
        names = None if name is None else self._find_reflexes(name)

        def predicate(event: ReflexEvent) -> bool:
            return in_phase(event) and (names is None or event.reflex in names)

        return self._register(Subscription(ReflexEvent, predicate))

    @registration
    def on_step(self) -> Register[StepEvent]:
        """Call the decorated function when a step of a motion or an experiment begins."""
        return self._register(Subscription(StepEvent))

    @registration
    def on_cue(self, *, kind: CueKind | None = None) -> Register[CueEvent]:
        """Call the decorated function when an experiment has something said or shown.

        Args:
            kind: Only ``say`` or only ``leds``; None for both.

        Raises:
            UnknownNameError: No such kind.
        """
        predicate = match(kind=("kind of cue", kind, get_args(CueKind)))
        return self._register(Subscription(CueEvent, predicate))

    @registration
    def on_push(self) -> Register[PushEvent]:
        """Call the decorated function when an experiment has a simulated robot pushed."""
        return self._register(Subscription(PushEvent))

    def _find_reflexes(self, name: str | Reflex) -> frozenset[str]:
        """Return the full names of the reflexes that a kind, a name or a reflex stands for."""
        if not self._reflexes:
            raise SubscriptionError(
                f"there is no reflex {shown(name)}: this robot has none; give it some with Pepper(reflexes=[...])"
            )
        if isinstance(name, Reflex):
            if not any(reflex is name for reflex in self._reflexes):
                raise SubscriptionError(
                    f"the reflex given, {shown(name)}, does not belong to this robot"
                )
            return frozenset({name.full_name})
        names_of = {
            reflex.full_name: (kind_of(type(reflex)), reflex.name, reflex.full_name)
            for reflex in self._reflexes
        }
        found = frozenset(full_name for full_name, names in names_of.items() if name in names)
        if not found:
            known = dict.fromkeys(known for names in names_of.values() for known in names)
            raise UnknownNameError("reflex", name, known)
        return found

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
            if inspect.iscoroutinefunction(callback) or not takes_arguments(callback, 1):
                raise SubscriptionError(
                    f"a callback must be a function that takes the event, and not a coroutine, got {shown(callback)};"
                    " for asyncio there is 'async for contact in pepper.contacts()'"
                )
            with self._lock:
                self._callbacks.append((callback, subscription))
                if self._dispatcher is not None:
                    self._dispatcher.subscribe(callback, subscription)
            return callback

        return register
