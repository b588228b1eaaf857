"""One active run of a robot: connection, log, the thread that ticks, and whoever waits for its ticks."""

from __future__ import annotations

import atexit
import gc
import logging
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import NoReturn

import numpy as np

from pepper_driver.backends import Backend, BackendError
from pepper_driver.backends.signals import check_signals, deferred_signals, immediate_signals
from pepper_driver.callbacks.dispatcher import Dispatcher
from pepper_driver.callbacks.events import (
    CueEvent,
    EndEvent,
    FaultEvent,
    PushEvent,
    StepEvent,
    TickEvent,
    Touches,
)
from pepper_driver.config import ControllerSettings, RobotConfig
from pepper_driver.controller import Tick, WholeBodyController
from pepper_driver.controller.changes import Change, Changes
from pepper_driver.controller.constraints import Constraint
from pepper_driver.controller.tasks import Task
from pepper_driver.log import LogEvent, LogWriter
from pepper_driver.loop import Labelling, Loop, TickRecord
from pepper_driver.observer import Contact, Observation, Observer
from pepper_driver.realtime import COLLECTION_PERIOD, Pacer, realtime_process, realtime_thread
from pepper_driver.reflexes import Arbiter, Reflex
from pepper_driver.safety import FaultError, FaultReason, SafetyGate

logger = logging.getLogger("pepper_driver")

CALLBACK_TIME = 2.0
"""[s] that the end of a run waits for all callbacks that are still busy."""

MAX_TICK_TIME = 1.0
"""[s] that a caller waits for a tick under way in another thread."""

MAX_CLOSE_TIME = 10.0
"""[s] that the end of a run waits for a robot to be closed in the middle of a tick."""

MAX_CALLER_SILENCE = 0.06
"""[s] without a tick after which a robot whose caller ticks is brought to rest."""

OnTick = Callable[[Tick, Observation | None], object]


class Wait:
    """Ticks that a caller waits for.

    Attributes:
        over: Set when there is nothing more to wait for.
        record: Newest tick of the wait.
        stopped: True once ``until`` has ended it.
        error: Exception for the caller's thread.
    """

    def __init__(
        self,
        ticks: int | None,
        on_tick: OnTick | None,
        until: Callable[[TickRecord], bool] | None,
    ) -> None:
        self._left, self._on_tick, self._until = ticks, on_tick, until
        self.over = threading.Event()
        self.record: TickRecord | None = None
        self.stopped = False
        self.error: BaseException | None = None
        if ticks == 0:
            self.over.set()

    def take(self, record: TickRecord, is_faulty: Callable[[], bool]) -> None:
        """Take in one tick, inside it; what the caller's functions raise ends the wait, and not the tick.

        A tick with a fault ends no wait: the fault itself does, by :meth:`fail`.
        """
        if self.over.is_set():
            return
        self.record = record
        try:
            if self._on_tick is not None:
                self._on_tick(record.tick, record.observation)
            self.stopped = self._until is not None and not is_faulty() and self._until(record)
        except BaseException as error:
            self.error = error
        if self._left is not None:
            self._left -= 1
        if self.stopped or self.error is not None or (self._left == 0 and not is_faulty()):
            self.over.set()

    def fail(self, error: BaseException) -> None:
        """End the wait with an error, unless it is over."""
        if not self.over.is_set():
            self.error = error
            self.over.set()


class Session:
    """Connects, opens the log, raises the stiffness, holds the measured posture; ticks until it is closed.

    Without a pacer that waits, time passes only inside :meth:`run`. Else a thread ticks from the start to the end; or,
    with ``loop_thread`` False, it ticks whenever the caller has not done so for ``MAX_CALLER_SILENCE``: base and joints
    then come to rest, and the robot is watched on.

    Args:
        backend: Closed.
        robot: Its description.
        gate: Passed by all commands.
        dispatcher: Calls the callbacks.
        pacer: Says when ticks begin.
        changes: Lock of what other threads change.
        loop_thread: True where a thread of the session makes all ticks.

    Attributes:
        active: True until it is closed.
        dispatcher: The same.
        loop: Runs the ticks, once started.
        ticks_itself: True where a thread of the session makes all ticks.
        has_observer: True where contacts can be detected.
        cycle: Period of the ticks [s].
        contact_history: All contact events so far, oldest first.
        touches: Contacts that last now.
    """

    loop: Loop

    def __init__(
        self,
        backend: Backend,
        robot: RobotConfig,
        gate: SafetyGate,
        *,
        dispatcher: Dispatcher,
        pacer: Pacer,
        changes: Changes,
        loop_thread: bool,
    ) -> None:
        self._backend, self._robot, self._gate = backend, robot, gate
        self._pacer, self._changes = pacer, changes
        self.ticks_itself, self.cycle = loop_thread, robot.cycle
        self.active = self.has_observer = False
        self.contact_history: list[Contact] = []
        self.touches = Touches()
        self._failure: BaseException | None = None  # what ended the ticks
        self._failure_raised = False  # where somebody sees it
        self._log: LogWriter | None = None
        self._wait: Wait | None = None
        self._turn = threading.RLock()  # of who ticks, or waits for ticks; knows who has it
        self._runner: threading.Thread | None = None
        self._ticking: threading.Thread | None = None
        self._home = threading.current_thread()
        self._callers: set[threading.Thread] = set()  # that want the turn
        self._ticks = 0
        self._ticked = 0  # when the last tick was over [ns of the pacer's clock]
        self._thread: threading.Thread | None = None
        self._ending = threading.Event()
        self._closed = False
        self._closing = threading.RLock()  # re-entrant, for signal handlers
        self._fault_lock = threading.Lock()  # taken by the first who publishes a fault, for good
        self.dispatcher = dispatcher
        self._rest = ExitStack()  # closed after the robot, the last first
        self._rest.callback(self.dispatcher.close, timeout=CALLBACK_TIME)

    # -- begin and end --------------------------------------------------------------------------------------------

    @deferred_signals(checked=True)
    def start(
        self,
        settings: ControllerSettings,
        *,
        observer: Callable[[], Observer | None],
        reflexes: tuple[Reflex, ...],
        parts: Iterable[Task | Constraint],
        log: Callable[[], tuple[Path, Mapping[str, str]] | None],
    ) -> None:
        """Take the robot over and begin to tick; what fails leaves it closed.

        Args:
            settings: Gains, limits, feedback and solver of the controller.
            observer: Makes the observer, or None, once it is known which robot this is.
            reflexes: In the order in which they are asked.
            parts: Tasks and constraints from the first tick on.
            log: Returns file and metadata of the log, or None, once the observer is made.

        Raises:
            PepperError: The robot or the log cannot be opened, or the robot is not ready to move.
        """
        backend, robot = self._backend, self._robot
        atexit.register(self.close)  # a program may forget to stop the robot
        self._rest.callback(atexit.unregister, self.close)
        try:
            with immediate_signals():  # it may wait for long, and nothing moves
                measurement = backend.open()
            self._gate.check_ready(measurement)
            measured, watching, logged = measurement.position, observer(), log()
            check_signals()
            if logged is not None:  # only now: a robot that is not there costs no earlier log
                self._open_log(*logged)
            controller = WholeBodyController(robot, settings, changes=self._changes)
            measurement = backend.activate()
            held = measured if backend.held is None else backend.held
            hold = np.clip(held, robot.lower, robot.upper)
            controller.reset(hold)
            self._gate.activate(hold)
            if watching is not None:
                self.has_observer = True
                watching.reset()
            arbiter = Arbiter(controller, robot, reflexes)
            for part in parts:
                arbiter.add(part)
            self.loop = Loop(
                backend,
                robot,
                arbiter,
                self._gate,
                first=measurement,
                observer=watching,
                publish=self._publish,
            )
            if self._log is not None:
                self.loop.start_log(self._log)
            with self._closing:
                if self._ending.is_set():
                    raise BackendError("the robot was stopped while it started")
                self.active = True
                if self._pacer.paced:
                    self._ticked = self._pacer.clock()
                    self._rest.enter_context(realtime_process())
                    self._thread = threading.Thread(
                        target=self._tick_in_thread, name="loop", daemon=True
                    )
                    self._thread.start()
            check_signals()
        except BaseException:
            self._closed = False  # by another thread, before all was open
            self.close()
            raise

    @deferred_signals()
    def start_log(
        self, path: Path, metadata: Mapping[str, str], label: Labelling | None
    ) -> LogWriter:
        """Log from the next tick on; see :meth:`pepper_driver.Pepper.start_log`."""
        if self._log is not None:
            raise BackendError(f"this run is logged already, to '{self._log.path}'")
        log = self._open_log(path, metadata)
        self._changes.make(lambda: self.loop.start_log(log, label))
        return log

    @property
    def log_path(self) -> Path | None:
        """File of the log; None without one."""
        return None if self._log is None else self._log.path

    def _open_log(self, path: Path, metadata: Mapping[str, str]) -> LogWriter:
        lossless = not self._backend.real_time
        self._log = LogWriter(path, self._robot, metadata, lossless=lossless)
        self._rest.callback(self._log.close)
        return self._log

    @deferred_signals()
    def close(self) -> None:
        """End the ticks, the robot's part, the log, the callbacks. Does nothing when closed. From any thread.

        Raises:
            PepperError: The robot or the log cannot be closed. All else is.
        """
        was_active, self.active, hangs = self.active, False, False
        with self._closing:  # by one thread at a time, and not into another's tick
            if self._closed:
                return
            self._ending.set()
            if (wait := self._wait) is not None:
                wait.fail(self._closed_error())
            with self._rest:  # each is done even if the one before fails
                try:
                    hangs = not self._wait_for_tick()
                finally:
                    if was_active and not hangs and self._failure is None and self._gate.fault:
                        self._failure = FaultError(self._gate.fault)  # came after the last tick
                        self.loop.halt()
                    self._gate.deactivate()
                    if hangs:
                        self._close_hanging_backend()
                    else:
                        self._backend.close()
            self._closed = True

    def _wait_for_tick(self) -> bool:
        """Wait for the end of a tick under way in another thread, and return True, unless it does not end."""
        current, thread, ended = threading.current_thread(), self._thread, True
        if current not in (self._ticking, self._runner):
            ended = self._turn.acquire(timeout=MAX_TICK_TIME)
            if ended:
                self._turn.release()
        if thread is not None and current not in (self._ticking, thread):
            thread.join(MAX_TICK_TIME)
            ended &= not thread.is_alive()
        return ended

    def _close_hanging_backend(self) -> None:
        """Close a backend whose tick does not end: if that is its fault, closing does not end either."""
        logger.warning("the robot is closed in the middle of a tick that does not end")
        errors: list[BaseException] = []

        def close() -> None:
            try:
                self._backend.close()
            except BaseException as error:
                errors.append(error)

        thread = threading.Thread(target=close, name="closing", daemon=True)
        thread.start()
        thread.join(MAX_CLOSE_TIME)
        if thread.is_alive():
            raise BackendError(
                f"'{self._backend.uri}' answers neither in a tick nor when it is closed: it may still be stiff"
            )
        for error in errors:
            raise error

    # -- ticks ----------------------------------------------------------------------------------------------------

    def run(
        self,
        ticks: int | None,
        on_tick: OnTick | None = None,
        until: Callable[[TickRecord], bool] | None = None,
        *,
        begin: Change | None = None,
        end: Change | None = None,
    ) -> Wait:
        """Wait for some ticks, None for ever, and make them where no thread does.

        A tick that is missed is made up for at the end: motions count ticks and must not jump. Where time stands still
        afterwards, this waits until the callbacks have caught up.

        Args:
            ticks: How many.
            on_tick: Called inside every tick.
            until: Asked at the end of every tick; True ends the wait.
            begin: Changes the loop before the first tick, once no other thread runs it.
            end: The same after the last one, whatever happens, even if ``begin`` fails.

        Raises:
            FaultError: The safety gate stopped the robot.
            BackendError: Another thread runs it or has closed it, or it is called inside a tick or a callback.
            ChangesError: It is called inside a group of changes.
        """
        wait = Wait(ticks, on_tick, until)

        outer = self._wait  # None, unless a signal handler runs the robot inside a run

        def start_wait() -> None:
            self._wait = wait
            if begin is not None:
                begin()

        with self._take_turn():
            try:
                self._changes.make(start_wait)
                # Whatever ended the ticks before that did not see this wait.
                self.check_failure()
                if not self.active:
                    raise self._closed_error()
                self._tick_until(wait.over)
            finally:
                self._wait = outer
                if end is not None:
                    self._changes.make(end)
        if wait.error is not None:
            self._raise(wait.error)
        if not self._pacer.paced:  # a real robot would stand without ticks meanwhile
            self.dispatcher.flush(timeout=CALLBACK_TIME)
        return wait

    def check_free(self) -> None:
        """Refuse to run a robot that runs, or from inside of what would then wait for itself.

        Raises:
            BackendError: Another thread runs it, or this is inside a tick or a callback.
            ChangesError: This is inside a group of changes.
        """
        if self._ticking is threading.current_thread():
            raise BackendError("this is inside a tick: it cannot wait for further ticks")
        if self.dispatcher.inside_callback():
            raise BackendError(
                "this is inside a callback: it cannot run the robot, nor wait for its ticks"
            )
        runner = self._runner
        if runner not in (None, threading.current_thread()):
            raise BackendError(
                f"thread '{runner.name}' runs the robot already: only one can do so at a time"
            )
        self._changes.tick()  # raises, and is not entered

    def ticks_here(self) -> bool:
        """Return True where the calling thread is to tick while it waits: the one that made this, if no other does.

        Raises:
            BackendError: The thread is inside a tick, and would wait for itself.
        """
        current = threading.current_thread()
        if self._ticking is current:
            self.check_free()
        return not self.ticks_itself and self._runner is None and self._home is current

    @contextmanager
    def _take_turn(self) -> Iterator[None]:
        self.check_free()
        current = threading.current_thread()
        try:
            try:
                self._callers.add(
                    current
                )  # the session's thread gives the turn back after its tick
                taken = self._turn.acquire(timeout=MAX_TICK_TIME)
            finally:
                self._callers.discard(current)
            if not taken:
                self.check_free()
                raise BackendError("the robot's loop does not answer")
            self._runner = current
            yield
        finally:  # whenever Ctrl-C comes
            if self._runner is current:
                self._runner = None
            try:  # noqa: SIM105 each call is a place where Ctrl-C can come
                self._turn.release()
            except RuntimeError:  # it was not taken
                pass

    def _tick_until(self, over: threading.Event) -> None:
        """Wait, and tick where no thread does."""
        if self.ticks_itself:
            over.wait()
            return
        with realtime_thread() if self._pacer.paced else nullcontext():
            while not over.is_set():
                self._tick()

    def _tick(self) -> None:
        """Make one tick when it is due. Whatever it raises stops the robot and ends the wait for its ticks."""
        try:
            missed = self._pacer.wait()
            self._changes.give_way()
            with self._changes.tick():
                self._ticking = threading.current_thread()
                try:
                    self.loop.tick(self._pacer.due, missed)
                finally:
                    self._ticking = None
                    self._ticked = self._pacer.clock()
        except Exception as error:
            self._fail(error)
        self._ticks += 1
        if self._pacer.paced and self._ticks % COLLECTION_PERIOD == 0:
            gc.collect(1)  # what callers and callbacks leave behind

    def _tick_in_thread(self) -> None:
        """Make all ticks, or those that the caller leaves out."""
        try:
            with realtime_thread():
                if self.ticks_itself:
                    while self._goes_on():
                        self._tick()
                else:
                    self._tick_for_silent_caller()
        except BaseException as error:  # such as SystemExit of a reflex
            self._fail(error)

    def _tick_for_silent_caller(self) -> None:
        """Tick whenever the caller has not done so for some time, with the robot at rest, until it does again."""
        while self._goes_on():
            silence = 1e-9 * (self._pacer.clock() - self._ticked)
            # A caller that wants the turn gets it meanwhile.
            self._ending.wait(max(MAX_CALLER_SILENCE - silence, 0.001))
            if not self._turn.acquire(timeout=MAX_CALLER_SILENCE):
                continue
            try:
                silence = 1e-9 * (self._pacer.clock() - self._ticked)
                if silence < MAX_CALLER_SILENCE or self._callers:
                    continue
                self.loop.arbiter.paused = True
                while self._goes_on() and not self._callers:
                    self._tick()
                self.loop.arbiter.paused = False
            finally:
                self._turn.release()

    def _goes_on(self) -> bool:
        return self._failure is None and not self._ending.is_set()

    def _fail(self, error: BaseException) -> None:
        """Stop the robot for what a tick has raised; have callbacks, and whoever waits for ticks, learn of it."""
        if self._ending.is_set() and not isinstance(error, FaultError):
            logger.warning("the robot was closed in the middle of a tick, which failed: %s", error)
            return
        if not isinstance(error, FaultError | EOFError):  # EOFError: the end of a recording
            self._gate.stop(FaultReason.LOST, f"{type(error).__name__}: {error}")
            self._changes.make(self.loop.halt)
        self._failure = error if self._failure is None else self._failure
        self.publish_fault()
        if self._gate.fault is None:
            self.dispatcher.publish(EndEvent())
        if (wait := self._wait) is not None:
            wait.fail(error)

    def _closed_error(self) -> BackendError:
        return BackendError("the robot was closed while it ran")

    # -- what happens ---------------------------------------------------------------------------------------------

    def _publish(self, record: TickRecord) -> None:
        """Hand over a tick, inside it: contacts, sensors and reflexes, then the tick itself."""
        publish, observation = self.dispatcher.publish, record.observation
        if observation is not None and observation.contacts:
            self.contact_history += observation.contacts
            self.touches.step(observation.contacts)
            for contact in observation.contacts:
                publish(contact)
        for event in record.events:
            publish(event)
        if self.dispatcher.has_receiver(TickEvent):
            publish(TickEvent(tick=record.tick, observation=observation))
        if (wait := self._wait) is not None:
            wait.take(record, lambda: self._gate.fault is not None)

    def publish(self, event: StepEvent | CueEvent | PushEvent) -> None:
        """Publish and log what belongs to no stage of a tick."""
        self.dispatcher.publish(event)
        self._changes.make(lambda: self.loop.log_event(LogEvent.of(event)))

    def publish_fault(self) -> None:
        """Tell the callbacks that the robot was stopped, once, if it was. From any thread."""
        if self._gate.fault and self._fault_lock.acquire(blocking=False):
            time = self.time if self.active else 0.0
            self.dispatcher.publish(FaultEvent(fault=self._gate.fault, time=time))

    @property
    def time(self) -> float:
        """Clock of the robot at the last measurement [s]."""
        return self.loop.time

    def check_failure(self, *, again: bool = True) -> None:
        """Raise what ended the ticks; unless ``again``, only outside of callbacks and if it was not raised there."""
        if self._failure is None or (not again and self._failure_raised):
            return
        if again or not self.dispatcher.inside_callback():
            self._raise(self._failure)

    def _raise(self, error: BaseException) -> NoReturn:
        if isinstance(error, FaultError) or error is self._failure:
            self._failure_raised |= not self.dispatcher.inside_callback()
        raise error

    def check_fault(self) -> None:
        """Raise what ended the ticks, or why the robot was stopped."""
        self.check_failure()
        if self._gate.fault is not None:
            self._raise(FaultError(self._gate.fault))
