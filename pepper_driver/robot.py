"""The robot as users meet it."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from functools import wraps
from itertools import count
from numbers import Real
from pathlib import Path
from types import TracebackType
from typing import Concatenate, Literal, ParamSpec, Self, TypeVar, Unpack

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends import Backend, BackendError, make_backend
from pepper_driver.callbacks.callback_registry import CallbackRegistry
from pepper_driver.callbacks.dispatcher import CallbackStatistics
from pepper_driver.callbacks.events import CueEvent, PushEvent, StepEvent
from pepper_driver.callbacks.filters import ContactSelector, contact_filter
from pepper_driver.callbacks.waiting import stream_contacts, wait_for_contact
from pepper_driver.config import (
    ControllerSettings,
    Motion,
    RobotConfig,
    SafetySettings,
    load_controller_settings,
    load_motion,
    load_robot,
    load_safety_settings,
)
from pepper_driver.config.motion import LONGEST, SHORTEST
from pepper_driver.config.parts import FloatArray
from pepper_driver.controller import GainError, TargetError, Tick, WholeBodyController
from pepper_driver.controller.tasks import checked_stiffness
from pepper_driver.extras import RobotExtras
from pepper_driver.log import LogWriter, run_metadata
from pepper_driver.loop import Labelling
from pepper_driver.motion import Conductor, OnStep, Player
from pepper_driver.motion_report import MotionReport
from pepper_driver.observer import Contact, Observation, Observer
from pepper_driver.pacing import Pacer, RealTimePacer
from pepper_driver.reflexes import Reflex, Reflexes
from pepper_driver.safety import FaultReason, RobotState, SafetyGate
from pepper_driver.selection import make_observer
from pepper_driver.session import Session
from pepper_driver.timing import Statistics

Posture = str | Mapping[str, float] | ArrayLike
"""A posture by name, joints by name with their angles [rad] (the others stay), or all 17 angles [rad]."""

P = ParamSpec("P")
R = TypeVar("R")


def _registers(
    method: Callable[Concatenate[CallbackRegistry, P], R],
) -> Callable[Concatenate[Pepper, P], R]:
    """Return a method of the registry as one of the robot, with its signature and docstring."""

    @wraps(method)
    def register(self: Pepper, /, *args: P.args, **kwargs: P.kwargs) -> R:
        return method(self._callbacks, *args, **kwargs)

    return register


class Pepper:
    """A Pepper, real or simulated, that feels where it is touched.

    >>> with Pepper("mujoco") as pepper:
    ...     pepper.set_posture({"LShoulderRoll": 0.6})
    ...     pepper.run(3.0)

    Entering the block connects, raises the stiffness and starts to hold the posture; leaving it, for whatever reason,
    stops the wheels, lowers the stiffness, closes the log and disconnects.

    Args:
        uri: Which robot: ``mujoco``, ``mujoco://?plant=nominal&seed=3``, ...
        observer: Name of an observer, an observer, or None to feel nothing.
        models: Model file of the observer, by default the one shipped for this robot.
        log: Where to write the MCAP log; None for no log.
        reflexes: Reactions inside the tick, asked in the order of their priority.
        real_time: Pace a simulation to the wall clock.
        robot: Description of the robot, by default the shipped Pepper.
        controller: Gains, limits, feedback and solver, by default those of ``controller.yaml``.
        safety: Limits of the safety gate, by default those of ``safety.yaml``.
        about: More that the log shall say of its runs.

    Attributes:
        extras: Speech, lights, tablet, postures, wake-up and rest, where the robot has them.
        paced: Whether ticks wait for the wall clock: on a real robot, or with ``real_time``.

    Raises:
        PepperError: Anything that is wrong with the arguments, before anything moves.
    """

    def __init__(
        self,
        uri: str = "mujoco",
        *,
        observer: str | Observer | None = "fusion",
        models: Path | str | None = None,
        log: Path | str | None = None,
        reflexes: Sequence[Reflex] = (),
        real_time: bool = False,
        robot: RobotConfig | None = None,
        controller: ControllerSettings | None = None,
        safety: SafetySettings | None = None,
        about: Mapping[str, str] | None = None,
    ) -> None:
        self.config = robot or load_robot()
        self._reflexes = Reflexes(reflexes, self.config)
        self._callbacks = CallbackRegistry(self.config, self._reflexes.names)
        self._session: Session | None = None  # the one that runs, or the last one
        self.backend: Backend = make_backend(uri, self.config)
        self.extras = RobotExtras(self.backend, self._is_active)
        self._observer_name = observer if isinstance(observer, str) else None
        if isinstance(observer, str):
            path = None if models is None else Path(models)
            observer = make_observer(observer, self.config, self.backend.info.identity, path)
        self._observer = observer
        self._log_path = None if log is None else Path(log)
        self.paced = real_time or self.backend.info.real_time
        off_beat = self.backend.off_beat
        self._pacer = RealTimePacer(self.config.cycle, off_beat=off_beat) if self.paced else Pacer()
        self._about = dict(about or {})
        self._controller_settings = controller or load_controller_settings(self.config)
        self._safety_settings = safety or load_safety_settings()
        self._gate: SafetyGate | None = (
            None  # there before the session, so that a stop finds it while that starts
        )

    # -- life ---------------------------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        self.activate()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def activate(self) -> None:
        """Connect, open the log, raise the stiffness, hold the measured posture.

        Raises:
            PepperError: The robot or the log cannot be opened, the robot is not fit to move (``NotReadyError``), or an
                emergency stop came meanwhile.
        """
        if self._is_active():
            raise BackendError(f"'{self.backend.info.uri}' is already active")
        self._gate = SafetyGate(self.config, self._safety_settings, self._controller_settings)
        self._session = Session(
            self.backend,
            self.config,
            self._controller_settings,
            self._gate,
            observer=self._observer,
            reflexes=self._reflexes,
            log=self._log_path,
            metadata={} if self._log_path is None else self.run_metadata(),
            dispatcher=self._callbacks.make_dispatcher(),
            pacer=self._pacer,
        )

    def close(self) -> None:
        """Stop, lower the stiffness, close the log, disconnect. Does nothing when closed."""
        if self._session is not None:
            self._session.close()
        else:
            self.backend.close()

    def start_log(self, path: Path | str, label: Labelling | None = None) -> LogWriter:
        """Log from the next tick on, where ``log`` would also log how the robot got ready; it ends with the run.

        Args:
            path: An existing file is replaced.
            label: Makes the labels of each tick, inside it: must be quick.

        Raises:
            PepperError: The robot is not active or runs, the file cannot be opened, or there is a log already.
        """
        return self._active().start_log(Path(path), self.run_metadata(), label)

    def run_metadata(self) -> dict[str, str]:
        """What a log says of a run that begins now: robot, observer, reflexes, settings, versions, as text."""
        known = run_metadata(
            self.backend.info,
            self._observer,
            self.config,
            self._controller_settings,
            self._safety_settings,
            observer_name=self._observer_name,
            reflexes=self._reflexes.declarations,
        )
        return {**self._about, **known}

    @property
    def state(self) -> RobotState:
        """INACTIVE, ACTIVE, or FAULT, which only a new start leaves."""
        return self._gate.state if self._gate is not None else RobotState.INACTIVE

    # -- motion -------------------------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Clock of the robot at the last measurement [s]."""
        return self._active().loop.time

    @property
    def target(self) -> FloatArray:
        """(17,) where the joints were last told to go [rad], a copy."""
        return self._active().loop.target.copy()

    def set_posture(
        self,
        posture: Posture,
        *,
        stiffness: float | None = None,
        duration: float | None = None,
    ) -> None:
        """Set where the joints shall go from the next tick on; returns at once.

        Args:
            posture: Name, joints with angles [rad], or all 17 angles [rad].
            stiffness: Of the posture task [1/s2], above 0; None leaves it.
            duration: Get there along a spline within this time [s], from a millisecond up; None for a set-point, which
                the joints approach as springs do. After a reflex has held the robot, the whole time begins anew.

        Raises:
            PepperError: Unknown name, an angle that is not finite or outside the joint's limits, a stiffness or
                duration that is none. Nothing changes.
        """
        loop = self._active().loop
        target = loop.control.controller.posture.checked(self._resolve(posture, loop.target))
        if stiffness is not None and checked_stiffness(stiffness) == 0:
            # Nothing would stop a joint.
            raise GainError("stiffness", stiffness, "above 0 for a posture")
        if duration is not None and not (
            isinstance(duration, Real) and SHORTEST <= duration <= LONGEST
        ):
            raise TargetError(
                f"a duration is a time from {SHORTEST:g} s to {LONGEST:g} s, got {duration!r}"
            )
        if stiffness is not None:
            loop.posture_stiffness = float(stiffness)
        loop.move_to(target, None if duration is None else float(duration))

    def run(
        self,
        seconds: float,
        *,
        on_tick: Callable[[Tick, Observation | None], None] | None = None,
        until: Callable[[], bool] | None = None,
    ) -> bool:
        """Run for a time.

        In a simulation that is not paced, callbacks then get up to 2 s to catch up before the robot's time goes on.

        Args:
            seconds: How long [s]; as fast as it goes in a simulation that is not paced. Each missed tick adds a cycle.
            on_tick: Called inside every tick: must be quick.
            until: Asked after every tick, such as ``lambda: task.reached(0.005)``; True ends the run early.

        Returns:
            Whether ``until`` ended it.

        Raises:
            TargetError: That is no time; nothing runs.
            FaultError: The safety gate stopped the robot.
            BackendError: Another thread runs it, or this is inside a tick.
        """
        if not (isinstance(seconds, Real) and 0 <= seconds < np.inf):
            raise TargetError(f"seconds must be a time that is not negative, got {seconds!r}")
        ticks = range(round(seconds / self.config.cycle))
        return self._active().run(ticks, on_tick, None if until is None else lambda _: until())

    def play(
        self,
        motion: Motion | str | Path,
        *,
        on_step: OnStep | None = None,
        on_tick: Callable[[Tick, Observation | None], None] | None = None,
        conductor: Conductor | None = None,
    ) -> MotionReport:
        """Play a motion to its end; callbacks then catch up as after :meth:`run`.

        However it ends, its tasks are gone, the base is at rest, and the posture is where the motion ended or was
        broken off. While a reflex holds the posture, the motion waits.

        Args:
            motion: A motion, the name of a shipped one, or a path that ends in ``.yaml``.
            on_step: Called with each step's report as it ends, inside the tick: must be quick.
            on_tick: Called inside every tick: must be quick.
            conductor: Says which step follows which; by default as the motion is written.

        Returns:
            What each step reached.

        Raises:
            PepperError: The motion is wrong, or another thread runs the robot; nothing moves.
            FaultError: The safety gate stopped the robot.
        """
        session = self._active()
        session.runner.check_free()
        if not isinstance(motion, Motion):
            motion = load_motion(motion, self.config)
        player = Player(
            motion,
            self.config,
            session.loop,
            on_step=on_step,
            on_begin=session.tell,
            conductor=conductor,
        )
        try:
            player.begin()
            session.run(count(), on_tick, lambda tick: player.advance(tick.measurement))
        finally:
            player.end()
        return player.report

    def tell(self, event: StepEvent | CueEvent | PushEvent) -> None:
        """Have the log and the callbacks that want it learn of something that a program does with the robot."""
        self._active().tell(event)

    def emergency_stop(self, text: str = "emergency stop") -> None:
        """Hold the joints and stop the wheels from the next tick on; only a new start leaves this state.

        May come from any thread. While the robot starts it makes the start fail with a FaultError.

        Args:
            text: Why, for people: part of the FaultError.
        """
        if self._gate is not None:
            self._gate.stop(FaultReason.EMERGENCY_STOP, text)
        if self._session is not None:
            self._session.tell_fault()

    def push(
        self,
        link: str,
        force: ArrayLike,
        point: ArrayLike | None = None,
        duration: float = 0.5,
        *,
        frame: Literal["world", "link"] = "world",
        delay: float = 0.0,
        rise: float = 0.1,
    ) -> None:
        """Push a link of a simulated robot; see :meth:`pepper_driver.backends.Backend.push`."""
        self.backend.push(
            link,
            np.asarray(force, dtype=np.float64),
            None if point is None else np.asarray(point, dtype=np.float64),
            duration,
            frame=frame,
            delay=delay,
            rise=rise,
        )

    # -- callbacks ----------------------------------------------------------------------------------------------

    on_contact = _registers(CallbackRegistry.on_contact)
    on_tick = _registers(CallbackRegistry.on_tick)
    on_touch = _registers(CallbackRegistry.on_touch)
    on_bumper = _registers(CallbackRegistry.on_bumper)
    on_button = _registers(CallbackRegistry.on_button)
    on_fault = _registers(CallbackRegistry.on_fault)
    on_reflex = _registers(CallbackRegistry.on_reflex)
    on_step = _registers(CallbackRegistry.on_step)
    on_cue = _registers(CallbackRegistry.on_cue)
    on_push = _registers(CallbackRegistry.on_push)

    @property
    def callback_statistics(self) -> tuple[CallbackStatistics, ...]:
        """Calls and lost events of each callback in the run that is under way, or in the last one."""
        return () if self._session is None else self._session.dispatcher.statistics()

    def wait_for_contact(
        self, *, timeout: float | None = None, **selector: Unpack[ContactSelector]
    ) -> Contact | None:
        """Wait for the next contact.

        The thread that activated the robot runs it meanwhile. Any other thread, and that one too while another runs the
        robot, waits for the ticks of the thread that runs it.

        Args:
            timeout: Longest wait [s] on the robot's clock, or on the wall's while no thread ticks; None waits for ever.
            **selector: ``link``, ``joint``, ``kind``, ``phase``, ``min_intensity`` as in :meth:`on_contact`.

        Returns:
            The contact; None after the timeout, or when the robot was closed meanwhile.

        Raises:
            UnknownNameError: No such link, joint, kind or phase.
            SubscriptionError: A number that is none, or a robot without an observer.
            FaultError: The robot was stopped.
            BackendError: The robot is not active, or this is inside a tick.
        """
        return wait_for_contact(self._active(), contact_filter(self.config, **selector), timeout)

    def contacts(self, **selector: Unpack[ContactSelector]) -> AsyncGenerator[Contact, None]:
        """Return contacts for ``async for``, until the robot is closed or stopped.

        Another thread has to run the robot: ``await asyncio.to_thread(pepper.run, 10)``.

        Args:
            **selector: ``link``, ``joint``, ``kind``, ``phase``, ``min_intensity`` as in :meth:`on_contact`.

        Raises:
            UnknownNameError: No such link, joint, kind or phase.
            SubscriptionError: An intensity that is none.
            BackendError: The robot is not active.
        """
        predicate = contact_filter(self.config, **selector)
        return stream_contacts(self._active().dispatcher, predicate)

    @property
    def contact_history(self) -> tuple[Contact, ...]:
        """All contact events since the start, oldest first."""
        return () if self._session is None else tuple(self._session.contact_history)

    # -- parts --------------------------------------------------------------------------------------------------

    @property
    def observer(self) -> Observer | None:
        """The observer in use."""
        return self._observer

    @property
    def reflexes(self) -> tuple[Reflex, ...]:
        """The reflexes, in the order in which they are asked."""
        return self._reflexes.all

    @property
    def statistics(self) -> Statistics:
        """How long the stages of the ticks took, and how many ticks were late or missed, since the start."""
        session = self._session if self._session is not None else self._active()
        return session.loop.times.statistics

    def clear_statistics(self) -> None:
        """Let the statistics begin anew with the next tick."""
        self._active().loop.times.clear()

    @property
    def controller(self) -> WholeBodyController:
        """The controller in use. Target and stiffness of its posture task belong to :meth:`set_posture`."""
        return self._active().loop.control.controller

    # -- inside -------------------------------------------------------------------------------------------------

    def _active(self) -> Session:
        if self._session is None or not self._session.active:
            raise BackendError(
                f"'{self.backend.info.uri}' is not active; use it inside 'with Pepper(...) as pepper:'"
            )
        return self._session

    def _is_active(self) -> bool:
        return self._session is not None and self._session.active

    def _resolve(self, posture: Posture, current: FloatArray) -> ArrayLike:
        """Angles of a posture; joints that it does not name keep ``current``. Not checked yet."""
        if isinstance(posture, str):
            return self.config.posture(posture)
        if isinstance(posture, Mapping):
            angles: list[float] = current.tolist()
            for name, angle in posture.items():
                angles[self.config.joint_index(name)] = angle
            return angles
        return posture
