"""One active run of a robot: all that it takes, from the first connection to the last callback."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from pepper_driver.backends import Backend
from pepper_driver.callbacks import ContactCallback, ContactPredicate, Dispatcher
from pepper_driver.config import ControllerSettings, RobotConfig
from pepper_driver.controller import Tick, WholeBodyController
from pepper_driver.log import LogWriter, run_metadata
from pepper_driver.loop import Loop
from pepper_driver.observer import Contact, Observation, Observer
from pepper_driver.reflexes import Reflex
from pepper_driver.safety import SafetyGate

CALLBACK_TIME = 2.0
"""[s] that the end of a run waits for callbacks that are still busy."""


class Session:
    """Connects, opens the log, raises the stiffness, holds the measured posture; runs ticks until it is closed.

    Args:
        backend: Closed.
        robot: Its description.
        controller: Gains, limits, feedback and solver.
        gate: What all commands pass.
        observer: Or None to feel nothing.
        reflexes: Called in this order in every tick.
        log: Where to write the MCAP log; None for no log.
        subscriptions: Callbacks from the first tick on, with what each wants.
        paced: Whether ticks wait for the wall clock.

    Attributes:
        active: Until it is closed.
        loop: Runs the ticks.
        dispatcher: Calls the callbacks.
        contacts: All contact events so far, oldest first.

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
        reflexes: Sequence[Reflex],
        log: Path | None,
        subscriptions: Sequence[tuple[ContactCallback, ContactPredicate]],
        paced: bool,
    ) -> None:
        self._backend = backend
        self._cycle = robot.cycle
        self._paced = paced
        self._listeners: list[Callable[[Tick, Observation | None], None]] = []
        self.active = False
        self.contacts: list[Contact] = []
        self._gate = gate
        self.dispatcher = Dispatcher()
        self._after_backend = ExitStack()  # closed when the robot is, the last first
        self._after_backend.callback(self.dispatcher.close, timeout=CALLBACK_TIME)
        self._after_backend.callback(self.dispatcher.flush, timeout=CALLBACK_TIME)
        try:
            self.loop = self._start(robot, controller, observer, reflexes, log)
            for callback, wanted in subscriptions:
                self.dispatcher.subscribe(callback, wanted)
            self.active = True
        except BaseException:
            self.close()
            raise

    def _start(
        self,
        robot: RobotConfig,
        settings: ControllerSettings,
        observer: Observer | None,
        reflexes: Sequence[Reflex],
        path: Path | None,
    ) -> Loop:
        backend = self._backend
        measurement = backend.open()
        self._gate.check_ready(measurement)
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
        for reflex in reflexes:
            reflex.reset()
        return Loop(
            backend,
            robot,
            controller,
            self._gate,
            time=measurement.time,
            observer=observer,
            reflexes=reflexes,
            log=log,
            deliver=self._deliver,
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
        """Tick, paced if need be, then wait until the callbacks so far have been handled.

        Returns:
            Whether ``until``, asked after every tick, ended it.

        Raises:
            FaultError: The safety gate stopped the robot.
        """
        ended = False
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
                    deadline += self._cycle
                    time.sleep(max(0.0, deadline - time.perf_counter()))
        finally:
            if on_tick is not None:
                self._listeners.remove(on_tick)
        self.dispatcher.flush(timeout=CALLBACK_TIME)
        return ended

    def _deliver(self, tick: Tick, observation: Observation | None) -> None:
        if observation is not None:
            for contact in observation.contacts:
                self.contacts.append(contact)
                self.dispatcher.publish(contact)
        for listener in self._listeners:
            listener(tick, observation)
