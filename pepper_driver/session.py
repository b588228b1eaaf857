"""One active run of a robot: connection, log, the thread that ticks, and the callers that wait for its ticks."""

from __future__ import annotations

import atexit
import gc
import logging
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np

from pepper_driver.backends import Backend, BackendError
from pepper_driver.callbacks.dispatcher import Dispatcher
from pepper_driver.callbacks.events import EndEvent, FaultEvent, ProgramEvent, TickEvent, Touches
from pepper_driver.config import ControllerSettings, RobotConfig, SafetySettings
from pepper_driver.config.signals import (
    check_signals,
    deferred_signals,
    immediate_signals,
    raised_signals,
)
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
from pepper_driver.safety.plugins import describe_failure
from pepper_driver.telemetry import TelemetryServer

logger = logging.getLogger("pepper_driver")

OnTick = Callable[[Tick, Observation | None], object]


@dataclass(eq=False)
class TickWait:
    """Ticks that a caller waits for.

    Attributes:
        ticks: How many are left; inf for ever.
        on_tick: Called inside every tick.
        until: Asked at the end of every tick; True ends the wait.
        over: Set when there is nothing more to wait for.
        record: Newest tick of the wait.
        stopped: True once ``until`` has ended it.
        error: Exception for the caller's thread.
    """

    ticks: float
    on_tick: OnTick | None = None
    until: Callable[[], bool] | None = None
    over: threading.Event = field(default_factory=threading.Event)
    record: TickRecord | None = None
    stopped: bool = False
    error: BaseException | None = None

    def __post_init__(self) -> None:
        if self.ticks == 0:
            self.over.set()

    def take(self, record: TickRecord, is_faulty: Callable[[], bool]) -> None:
        """Take in one tick, inside it; what the caller's functions raise ends the wait, and not the tick.

        A tick with a fault ends no wait: the fault itself does, by :meth:`fail`.
        """
        if self.over.is_set():
            return
        self.record = record
        try:
            if self.on_tick is not None:
                self.on_tick(record.tick, record.observation)
            self.stopped = self.until is not None and not is_faulty() and self.until()
        except BaseException as error:
            self.error = error
        self.ticks -= 1
        if self.stopped or self.error is not None or (self.ticks == 0 and not is_faulty()):
            self.over.set()

    def fail(self, error: BaseException) -> None:
        """End the wait with an error, unless it is over."""
        if not self.over.is_set():
            self.error = error
            self.over.set()


class Session:
    """Connects, opens the log, raises the stiffness, holds the measured posture; ticks until it is closed.

    Without a pacer that waits, time passes only inside :meth:`run`. Else a thread ticks from the start to the end; or,
    with ``loop_thread`` False, it ticks whenever the caller has not done so for ``caller_silence`` of ``safety.yaml``:
    base and joints then come to rest, and the robot is watched on.

    Args:
        backend: Closed.
        robot: Its description.
        controller: Gains, limits, feedback and solver of the controller.
        safety: Limits of the safety gate.
        dispatcher: Calls the callbacks.
        pacer: Says when ticks begin.
        changes: Lock of what other threads change.
        metadata: Makes what a log says of its run, once it is known which robot this is.
        loop_thread: True where a thread of the session makes all ticks.

    Attributes:
        active: True until it is closed.
        dispatcher: The same.
        gate: Passed by all commands.
        loop: Runs the ticks, once started.
        log: Of the run; None without one.
        raises_signals: True where SIGTERM and SIGHUP are exceptions until it is closed, and were not before.
        cycle: Period of the ticks [s].
        contact_history: All contact events so far, oldest first.
        touches: Contacts that last now.
    """

    loop: Loop

    def __init__(
        self,
        backend: Backend,
        robot: RobotConfig,
        controller: ControllerSettings,
        safety: SafetySettings,
        *,
        dispatcher: Dispatcher,
        pacer: Pacer,
        changes: Changes,
        metadata: Callable[[], Mapping[str, str]],
        loop_thread: bool,
    ) -> None:
        self._backend, self._robot, self._settings = backend, robot, controller
        self._pacer, self._changes, self._loop_thread = pacer, changes, loop_thread
        self._metadata = metadata
        self.gate, self._safety = SafetyGate(robot, safety, controller), safety
        self.dispatcher, self.cycle = dispatcher, robot.cycle
        self.active = False
        self.log: LogWriter | None = None
        self.contact_history: list[Contact] = []
        self.touches = Touches()
        self._failure: BaseException | None = None  # what ended the ticks
        self._failure_raised = False  # to a caller
        self._wait = TickWait(0)  # the newest; over while no call waits
        # Held by the thread that ticks or waits for ticks.
        self._turn = threading.RLock()
        self._runner: threading.Thread | None = None
        self._ticking: threading.Thread | None = None
        self._home = threading.current_thread()
        self._callers: set[threading.Thread] = set()  # that have the turn, or wait for it
        self._ticks = 0
        self._ticked = 0  # when the last tick was over [ns of the pacer's clock]
        self._thread: threading.Thread | None = None
        self._ending = threading.Event()
        self._closed = False
        self._closing = threading.RLock()  # re-entrant, for signal handlers
        self._fault_lock = threading.Lock()  # acquired for good by the first fault
        self._rest = ExitStack()  # closed after the robot, the last first
        self.raises_signals = self._rest.enter_context(raised_signals())
        self._rest.callback(dispatcher.close, timeout=safety.callback_time)

    # -- begin and end --------------------------------------------------------------------------------------------

    @deferred_signals(checked=True)
    def start(
        self,
        *,
        observer: Callable[[], Observer | None],
        reflexes: tuple[Reflex, ...],
        parts: Iterable[Task | Constraint],
        log: Path | None,
        telemetry: TelemetryServer | None = None,
        attentive: bool = False,
    ) -> None:
        """Take the robot over and begin to tick; what fails leaves it closed.

        Args:
            observer: Makes the observer, or None, once it is known which robot this is.
            reflexes: In the order in which they are asked.
            parts: Tasks and constraints from the first tick on.
            log: File of the log, or None.
            telemetry: Streams the run from its first tick on; or None.
            attentive: True to oscillate by a little on top of any motion.

        Raises:
            PepperError: The robot or the log cannot be opened, or the robot is not ready to move.
        """
        backend, robot = self._backend, self._robot
        atexit.register(self.close)  # a program may forget to stop the robot
        self._rest.callback(atexit.unregister, self.close)
        try:
            with immediate_signals():  # it may wait for long, and nothing moves
                measurement = backend.open()
            self.gate.check_ready(measurement)
            measured, watching = measurement.position, observer()
            check_signals()
            if log is not None:  # only now: a robot that is not there costs no earlier log
                self._open_log(log)
            controller = WholeBodyController(robot, self._settings, changes=self._changes)
            if self.gate.fault:  # stopped meanwhile: nothing gets stiff
                raise FaultError(self.gate.fault)
            measurement = backend.activate()
            held = measured if backend.hold_position is None else backend.hold_position
            hold = np.clip(held, robot.lower, robot.upper)
            controller.reset(hold)
            self.gate.activate(hold)
            arbiter = Arbiter(controller, robot, reflexes)
            for part in parts:
                arbiter.add(part)
            self.loop = Loop(
                backend,
                robot,
                arbiter,
                self.gate,
                first=measurement,
                observer=watching,
                publish=self._publish,
            )
            if self.log is not None:
                self.loop.start_log(self.log)
            if telemetry is not None:
                self.start_telemetry(telemetry)
            self.loop.set_attentive(attentive)
            with self._closing:
                if self._ending.is_set():
                    raise BackendError("the robot was stopped while it started")
                self.active = True
                if self._pacer.paced:
                    self._ticked = self._pacer.clock.now()
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
    def start_log(self, path: Path, label: Labelling | None) -> LogWriter:
        """Log from the next tick on; see :meth:`pepper_driver.Pepper.start_log`."""
        if self.log is not None:
            raise BackendError(f"this run is logged already, to '{self.log.path}'")
        log = self._open_log(path)
        self._changes.make(lambda: self.loop.start_log(log, label))
        return log

    def start_telemetry(self, telemetry: TelemetryServer) -> None:
        """Stream every tick from the next one on; see :meth:`pepper_driver.Pepper.show`."""
        backend = self._backend
        truth = backend.truth if "truth" in backend.info.capabilities else None
        telemetry.begin(truth, self._robot, self._metadata(), self._status)
        self._changes.make(lambda: self.loop.start_telemetry(telemetry))

    def _status(self) -> dict[str, object]:
        """Return what telemetry says of the run, from any thread."""
        loop, fault = self.loop, self.gate.fault
        return {
            "state": self.gate.state.value,
            "fault": "" if fault is None else f"{fault.reason.value}: {fault.text}",
            "reflexes": [r.full_name for r in loop.arbiter.reflexes if r.active],
            "attentive": loop.arbiter.attentive,
            "withheld": loop.arbiter.watch.withheld,
            "stages": loop.times.recent(),
            "missed": loop.times.missed,
        }

    def _open_log(self, path: Path) -> LogWriter:
        lossless = not self._backend.real_time
        self.log = LogWriter(path, self._robot, self._metadata(), lossless=lossless)
        self._rest.callback(self.log.close)
        return self.log

    @deferred_signals()
    def close(self) -> None:
        """End the ticks, the robot's part, the log, the callbacks. Does nothing when closed. From any thread.

        Raises:
            PepperError: The robot or the log cannot be closed. Everything else is closed.
        """
        was_active, self.active, hangs = self.active, False, False
        with self._closing:  # by one thread at a time, and not into another's tick
            if self._closed:
                return
            self._ending.set()
            self._wait.fail(self._closed_error())
            with self._rest:  # each is done even if the one before fails
                try:
                    hangs = not self._wait_for_tick()
                finally:
                    if was_active and not hangs and self._failure is None and self.gate.fault:
                        self._failure = FaultError(self.gate.fault)  # came after the last tick
                        self.loop.halt()
                    self.gate.deactivate()
                    if hangs:
                        self._close_hanging_backend()
                    else:
                        self._backend.close()
            self._closed = True

    def _wait_for_tick(self) -> bool:
        """Wait until another thread has ended its tick; return False when it does not end."""
        current, thread = threading.current_thread(), self._thread
        if current is self._ticking:
            return True
        ended = self._turn.acquire(timeout=self._safety.tick_time)
        if ended:
            self._turn.release()
        if thread is not None and thread is not current:
            thread.join(self._safety.tick_time)
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
        thread.join(self._safety.close_time)
        if thread.is_alive():
            raise BackendError(
                f"'{self._backend.uri}' answers neither in a tick nor when it is closed: it may still be stiff"
            )
        for error in errors:
            raise error

    # -- ticks ----------------------------------------------------------------------------------------------------

    def run(
        self,
        ticks: float,
        on_tick: OnTick | None = None,
        until: Callable[[], bool] | None = None,
        *,
        begin: Change | None = None,
        end: Change | None = None,
    ) -> TickWait:
        """Wait for some ticks, and make them where no thread does.

        A tick that is missed is made up for at the end: motions count ticks and must not jump. Where time stands still
        afterwards, this waits until the callbacks have caught up.

        Args:
            ticks: How many; inf for ever.
            on_tick: Called inside every tick.
            until: Asked at the end of every tick; True ends the wait.
            begin: Changes the loop before the first tick, once no other thread runs it.
            end: Called after the last one in every case, even if ``begin`` fails.

        Raises:
            FaultError: The safety gate stopped the robot.
            BackendError: Another thread runs it or has closed it, or it is called inside a tick or a callback.
            ChangesError: It is called inside a group of changes.
        """
        wait = TickWait(ticks, on_tick, until)
        outer = self._wait  # not over where a signal handler runs the robot inside a run

        def start_wait() -> None:
            self._wait = wait
            if begin is not None:
                begin()

        with self._take_turn():
            try:
                self._changes.make(start_wait)
                # An error that ended the ticks before that did not end this wait.
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
            self.dispatcher.flush(timeout=self._safety.callback_time)
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
        return not self._loop_thread and self._runner is None and self._home is current

    @contextmanager
    def _take_turn(self) -> Iterator[None]:
        self.check_free()
        current = threading.current_thread()
        try:
            # The session's thread gives the turn back after its tick.
            self._callers.add(current)
            if not self._turn.acquire(timeout=self._safety.tick_time):
                self.check_free()
                raise BackendError("the robot's loop does not answer")
            self._runner = current
            yield
        finally:  # Ctrl-C may come at any line
            if self._runner is current:
                self._runner = None
            self._callers -= {current}
            try:  # noqa: SIM105 each call is a place where Ctrl-C can come
                self._turn.release()
            except RuntimeError:  # it was not taken
                pass

    def _tick_until(self, over: threading.Event) -> None:
        """Wait, and tick where no thread does. An exception of a tick stops the robot and ends the wait."""
        if self._loop_thread:
            over.wait()
            return
        try:
            with realtime_thread() if self._pacer.paced else nullcontext():
                while not over.is_set():
                    self._tick()
        except Exception as error:
            self._fail(error)

    def _tick(self) -> None:
        """Make one tick when it is due."""
        missed = self._pacer.wait()
        self._changes.give_way()
        with self._changes.tick():
            self._ticking = threading.current_thread()
            try:
                self.loop.tick(self._pacer.due, missed)
            finally:
                self._ticking = None
                self._ticked = self._pacer.clock.now()
        self._ticks += 1
        if self._pacer.paced and self._ticks % COLLECTION_PERIOD == 0:
            gc.collect(1)  # what callers and callbacks leave behind

    def _tick_in_thread(self) -> None:
        """Make all ticks, or those that the caller leaves out."""
        try:
            with realtime_thread():
                if self._loop_thread:
                    while not self._ending.is_set():
                        self._tick()
                else:
                    self._tick_for_silent_caller()
        except BaseException as error:  # such as SystemExit of a reflex
            self._fail(error)

    def _tick_for_silent_caller(self) -> None:
        """Tick whenever the caller has not done so for some time, with the robot at rest, until it does again."""
        max_silence = self._safety.caller_silence
        while self._failure is None and not self._ending.is_set():
            # A waiting caller gets the turn meanwhile.
            self._ending.wait(max(max_silence - self._silence, 0.001))
            if not self._turn.acquire(timeout=max_silence):  # or it would not end
                continue
            try:
                if self._silence < max_silence or self._failure is not None:
                    continue
                self.loop.arbiter.paused = True
                while not (self._callers or self._ending.is_set()):
                    self._tick()
                self.loop.arbiter.paused = False
            finally:
                self._turn.release()

    @property
    def _silence(self) -> float:
        """Time since the last tick [s]."""
        return 1e-9 * (self._pacer.clock.now() - self._ticked)

    def _fail(self, error: BaseException) -> None:
        """Stop the robot after an exception in a tick; report it to callbacks and to callers that wait for ticks."""
        if self._ending.is_set() and not isinstance(error, FaultError):
            logger.warning("the robot was closed in the middle of a tick, which failed: %s", error)
            return
        if not isinstance(error, FaultError | EOFError):  # EOFError: the end of a recording
            self.gate.stop(FaultReason.LOST, describe_failure(error))
            self._changes.make(self.loop.halt)
        self._failure = error if self._failure is None else self._failure
        self.publish_fault()
        if self.gate.fault is None:
            self.dispatcher.publish(EndEvent())
        self._wait.fail(error)

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
        self._wait.take(record, lambda: self.gate.fault is not None)

    def publish(self, event: ProgramEvent) -> None:
        """Publish and log what belongs to no stage of a tick."""
        self.dispatcher.publish(event)
        self._changes.make(lambda: self.loop.log_event(LogEvent.of(event)))

    def publish_fault(self) -> None:
        """Report to the callbacks, once, that the robot was stopped. Any thread may call."""
        if self.gate.fault and self._fault_lock.acquire(blocking=False):
            time = self.loop.time if self.active else 0.0
            self.dispatcher.publish(FaultEvent(fault=self.gate.fault, time=time))

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
        if self.gate.fault is not None:
            self._raise(FaultError(self.gate.fault))
