"""One active run of a robot: all that it takes, from the first connection to the last callback."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from pepper_driver.backends import Backend, BackendError
from pepper_driver.callbacks.dispatcher import Dispatcher
from pepper_driver.callbacks.events import (
    CueEvent,
    FaultEvent,
    PushEvent,
    ReflexEvent,
    SensorEvent,
    StepEvent,
    TickEvent,
)
from pepper_driver.config import ControllerSettings, RobotConfig
from pepper_driver.controller import Tick, WholeBodyController
from pepper_driver.log import LogEvent, LogWriter
from pepper_driver.loop import Labelling, Loop
from pepper_driver.observer import Contact, Observation, Observer
from pepper_driver.pacing import Pacer
from pepper_driver.reflexes import Reflexes
from pepper_driver.runner import Runner
from pepper_driver.safety import FaultError, SafetyGate

CALLBACK_TIME = 2.0
"""[s] that the end of a run waits for all callbacks that are still busy."""
LONGEST_TICK = 1.0
"""[s] that closing waits for a tick under way in another thread."""


class Session:
    """Connects, opens the log, raises the stiffness, holds the measured posture; runs ticks until it is closed.

    Args:
        backend: Closed.
        robot: Its description.
        controller: Gains, limits, feedback and solver.
        gate: What all commands pass.
        observer: Or None to feel nothing.
        reflexes: Asked in every tick.
        log: Where to write the MCAP log; None for no log.
        metadata: What the log says of the run.
        dispatcher: Calls the callbacks; the session closes it.
        pacer: Says when ticks begin.

    Attributes:
        active: Until it is closed.
        loop: Runs the ticks.
        dispatcher: Publishes the events of the run.
        runner: Who runs it now.
        has_observer: Whether contacts can be detected.
        cycle: Period of the ticks [s].
        contact_history: All contact events so far, oldest first.

    Raises:
        PepperError: The robot or the log cannot be opened. What was open is closed again.
    """

    def __init__(
        self,
        backend: Backend,
        robot: RobotConfig,
        controller: ControllerSettings,
        gate: SafetyGate,
        *,
        observer: Observer | None,
        reflexes: Reflexes,
        log: Path | None,
        metadata: Mapping[str, str],
        dispatcher: Dispatcher,
        pacer: Pacer,
    ) -> None:
        self._backend = backend
        self._robot = robot
        self._log: LogWriter | None = None
        self._pacer = pacer
        self.cycle = robot.cycle
        self.runner = Runner()
        self._closing = threading.RLock()  # re-entrant, for signal handlers
        self.has_observer = observer is not None
        self._fault_told = threading.Lock()  # taken by the first who tells, and never given back
        self._listeners: list[Callable[[Tick, Observation | None], None]] = []
        self.active = False
        self.contact_history: list[Contact] = []
        self._gate = gate
        self.dispatcher = dispatcher
        self._after_backend = ExitStack()  # closed when the robot is, the last first
        self._after_backend.callback(self.dispatcher.close, timeout=CALLBACK_TIME)
        try:
            self.loop = self._start(robot, controller, observer, reflexes, log, metadata)
            self.active = True
        except BaseException:
            self.close()
            raise

    def _start(
        self,
        robot: RobotConfig,
        settings: ControllerSettings,
        observer: Observer | None,
        reflexes: Reflexes,
        path: Path | None,
        metadata: Mapping[str, str],
    ) -> Loop:
        backend = self._backend
        measurement = backend.open()
        self._gate.check_ready(measurement)
        measured = measurement.position
        log: LogWriter | None = None
        if path is not None:  # only now: a robot that is not there costs no earlier log
            log = self._open_log(path, metadata)
        controller = WholeBodyController(robot, settings)  # takes long, and a real robot would wait
        measurement = backend.activate()
        hold = np.clip(measured if backend.held is None else backend.held, robot.lower, robot.upper)
        controller.reset(hold)
        self._gate.activate(hold)
        if observer is not None:
            observer.reset()
        reflexes.reset()
        return Loop(
            backend,
            robot,
            controller,
            self._gate,
            first=measurement,
            observer=observer,
            reflexes=reflexes,
            log=log,
            deliver=self.deliver,
        )

    def _open_log(self, path: Path, metadata: Mapping[str, str]) -> LogWriter:
        lossless = not self._backend.info.real_time
        self._log = LogWriter(path, self._robot, metadata, lossless=lossless)
        self._after_backend.callback(self._log.close)
        return self._log

    def start_log(
        self, path: Path, metadata: Mapping[str, str], label: Labelling | None
    ) -> LogWriter:
        """Log from the next tick on; see :meth:`pepper_driver.Pepper.start_log`."""
        self.runner.check_free()
        if self._log is not None:
            raise BackendError(f"this run is logged already, to '{self._log.path}'")
        log = self._open_log(path, metadata)
        self.loop.start_log(log, label)
        return log

    def close(self) -> None:
        """End the robot's part, then the log, then the callbacks. Does nothing when closed. From any thread."""
        self.active = False
        with self._closing:  # by one thread at a time, and not into another's tick
            self.runner.wait_until_free(LONGEST_TICK)
            self._gate.deactivate()
            with self._after_backend:  # each is done even if the one before fails
                self._backend.close()

    @property
    def time(self) -> float:
        """Clock of the robot at the last measurement [s]."""
        return self.loop.time

    def ticks_here(self) -> bool:
        """Return whether the calling thread is to tick while it waits: no other thread does.

        Raises:
            BackendError: The thread is inside a tick.
        """
        return self.runner.is_mine()

    def run(
        self,
        ticks: Iterable[int],
        on_tick: Callable[[Tick, Observation | None], None] | None,
        until: Callable[[Tick], bool] | None,
    ) -> bool:
        """Tick when the pacer says so; where time stands still afterwards, wait until the callbacks have caught up.

        A tick that is missed is made up for at the end: motions count ticks and must not jump.

        Returns:
            Whether ``until``, asked at the end of every tick, ended it.

        Raises:
            FaultError: The safety gate stopped the robot.
            BackendError: Another thread runs it or has closed it, or it is called inside a tick.
        """
        ended = False

        def listener(tick: Tick, observation: Observation | None) -> None:
            nonlocal ended
            if on_tick is not None:
                on_tick(tick, observation)
            ended = until is not None and not self._gate.fault and until(tick)

        pacer = self._pacer
        with self.runner:
            self._listeners.append(listener)
            try:
                with pacer.running():
                    for _ in ticks:
                        if not self.active:
                            raise BackendError("the robot was closed while it ran")
                        missed = pacer.wait()
                        self.loop.tick(pacer.due, missed)
                        if ended:
                            break
            finally:
                self._listeners.remove(listener)
                self.tell_fault()  # whatever was raised beside it
        if pacer.due is None:  # a real robot would stand without ticks meanwhile
            self.dispatcher.flush(timeout=CALLBACK_TIME)
        return ended

    def deliver(
        self,
        tick: Tick,
        observation: Observation | None,
        events: Sequence[ReflexEvent | SensorEvent] = (),
    ) -> None:
        """Take over what happened in a tick, inside it: contacts, sensors and reflexes, then the tick itself."""
        publish = self.dispatcher.publish
        if observation is not None:
            for contact in observation.contacts:
                self.contact_history.append(contact)
                publish(contact)
        for event in events:
            publish(event)
        if self.dispatcher.has_receiver(TickEvent):
            publish(TickEvent(tick=tick, observation=observation))
        for listener in self._listeners:
            listener(tick, observation)

    def tell(self, event: StepEvent | CueEvent | PushEvent) -> None:
        """Tell callbacks and log of something that belongs to no stage of a tick."""
        self.dispatcher.publish(event)
        self.loop.note(LogEvent.of(event))

    def tell_fault(self) -> None:
        """Tell the callbacks that the robot was stopped, once, if it was. From any thread."""
        if self._gate.fault and self._fault_told.acquire(blocking=False):
            self.dispatcher.publish(FaultEvent(fault=self._gate.fault, time=self.loop.time))

    def check_fault(self) -> None:
        """Refuse to go on with a robot that was stopped.

        Raises:
            FaultError: It was.
        """
        if self._gate.fault:
            raise FaultError(self._gate.fault)
