"""One active run of a robot: all that it takes, from the first connection to the last callback."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from pepper_driver.backends import Backend
from pepper_driver.callbacks import Dispatcher, Subscription
from pepper_driver.config import ControllerSettings, RobotConfig
from pepper_driver.controller import Tick, WholeBodyController
from pepper_driver.events import FaultEvent, ReflexEvent, TickEvent
from pepper_driver.log import LogWriter, run_metadata
from pepper_driver.loop import Loop
from pepper_driver.observer import Contact, Observation, Observer
from pepper_driver.reflexes import Reflexes
from pepper_driver.runner import Runner
from pepper_driver.safety import FaultError, SafetyGate
from pepper_driver.sensor_edges import SensorEdges

CALLBACK_TIME = 2.0
"""[s] that the end of a run waits for all callbacks that are still busy."""


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
        subscriptions: Callbacks from the first tick on.
        paced: Whether ticks wait for the wall clock.

    Attributes:
        active: Until it is closed.
        loop: Runs the ticks.
        dispatcher: Calls the callbacks.
        runner: Who runs it now.
        feels: Whether there is an observer.
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
        subscriptions: Sequence[Subscription],
        paced: bool,
    ) -> None:
        self._backend = backend
        self.cycle = robot.cycle
        self._paced = paced
        self.runner = Runner()
        self.feels = observer is not None
        self._fault_told = threading.Lock()  # taken by the first who tells, and never given back
        self._listeners: list[Callable[[Tick, Observation | None], None]] = []
        self.active = False
        self.contact_history: list[Contact] = []
        self._gate = gate
        self.dispatcher = Dispatcher()
        self._after_backend = ExitStack()  # closed when the robot is, the last first
        self._after_backend.callback(self.dispatcher.close, timeout=CALLBACK_TIME)
        try:
            self.loop = self._start(robot, controller, observer, reflexes, log)
            for subscription in subscriptions:
                self.dispatcher.subscribe(subscription)
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
    ) -> Loop:
        backend = self._backend
        measurement = backend.open()
        hold = np.clip(measurement.position, robot.lower, robot.upper)
        log: LogWriter | None = None
        if path is not None:  # only now: a robot that is not there costs no earlier log
            metadata = run_metadata(backend.info, observer)
            log = LogWriter(path, robot, metadata, lossless=not backend.info.real_time)
            self._after_backend.callback(log.close)
        measurement = backend.activate()
        controller = WholeBodyController(robot, settings)
        controller.reset(hold)
        self._gate.activate(hold)
        if observer is not None:
            observer.reset()
        reflexes.reset()
        self._sensors = SensorEdges(robot, measurement)
        return Loop(
            backend,
            robot,
            controller,
            self._gate,
            time=measurement.time,
            observer=observer,
            reflexes=reflexes,
            log=log,
            deliver=self.deliver,
        )

    def close(self) -> None:
        """End the robot's part, then the log, then the callbacks. Does nothing when closed."""
        self.active = False
        self._gate.deactivate()
        with self._after_backend:  # each is done even if the one before fails
            self._backend.close()

    def run(
        self,
        ticks: Iterable[int],
        on_tick: Callable[[Tick, Observation | None], None] | None,
        until: Callable[[Tick], bool] | None,
    ) -> bool:
        """Tick, paced if need be; where time stands still afterwards, wait until the callbacks have caught up.

        Returns:
            Whether ``until``, asked after every tick, ended it.

        Raises:
            FaultError: The safety gate stopped the robot.
            BackendError: Another thread runs it, or it is called inside a tick.
        """
        ended = False
        with self.runner:
            if on_tick is not None:
                self._listeners.append(on_tick)
            deadline = time.perf_counter()
            try:
                for _ in ticks:
                    tick = self.loop.tick()
                    ended = until is not None and until(tick)
                    if ended:
                        break
                    if self._paced:
                        deadline += self.cycle
                        time.sleep(max(0.0, deadline - time.perf_counter()))
            except FaultError:
                self.tell_fault()
                raise
            finally:
                if on_tick is not None:
                    self._listeners.remove(on_tick)
        if not (self._paced or self._backend.info.real_time):
            self.dispatcher.flush(timeout=CALLBACK_TIME)
        return ended

    def deliver(
        self,
        tick: Tick,
        observation: Observation | None,
        reflexes: Sequence[ReflexEvent] = (),
    ) -> None:
        """Take over what happened in a tick, inside it: contacts, sensors, reflexes, then the tick itself."""
        publish = self.dispatcher.publish
        if observation is not None:
            for contact in observation.contacts:
                self.contact_history.append(contact)
                publish(contact)
        for edge in self._sensors.step(tick.measurement):
            publish(edge)
        for event in reflexes:
            publish(event)
        if self.dispatcher.wants(TickEvent):
            publish(TickEvent(tick=tick, observation=observation))
        for listener in self._listeners:
            listener(tick, observation)

    def tell_fault(self) -> None:
        """Tell the callbacks that the robot was stopped, once, if it was. From any thread."""
        if self._gate.fault and self._fault_told.acquire(blocking=False):
            self.dispatcher.publish(FaultEvent(reason=self._gate.fault, time=self.loop.time))

    def check_fault(self) -> None:
        """Refuse to go on with a robot that was stopped.

        Raises:
            FaultError: It was.
        """
        if self._gate.fault:
            raise FaultError(self._gate.fault)
