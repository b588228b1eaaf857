"""The robot as users meet it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends import Backend, BackendError, make_backend
from pepper_driver.callbacks import (
    ContactCallback,
    ContactPredicate,
    Dispatcher,
    contact_filter,
)
from pepper_driver.config import (
    ControllerSettings,
    Motion,
    RobotConfig,
    load_controller_settings,
    load_motion,
    load_robot,
    load_safety_settings,
)
from pepper_driver.config.motion import LONGEST
from pepper_driver.config.parts import FloatArray
from pepper_driver.controller import GainError, TargetError, Tick, WholeBodyController
from pepper_driver.log import LogWriter, run_metadata
from pepper_driver.loop import Loop, StageTimes
from pepper_driver.motion import OnStep, Player
from pepper_driver.motion_report import MotionReport
from pepper_driver.observer import Contact, Observation, Observer
from pepper_driver.observer.contact import Kind, Phase
from pepper_driver.reflexes import Reflex
from pepper_driver.safety import RobotState, SafetyGate
from pepper_driver.selection import make_observer

CALLBACK_TIME = 2.0
"""[s] that the end of a run waits for callbacks that are still busy."""

Posture = str | Mapping[str, float] | ArrayLike
"""A posture by name, joints by name with their angles [rad] (the others stay), or all 17 angles [rad]."""


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
        reflexes: Reactions inside the tick, in this order.
        real_time: Pace a simulation to the wall clock.
        robot: Description of the robot, by default the shipped Pepper.
        controller: Gains, limits, feedback and solver, by default those of ``controller.yaml``.

    Raises:
        PepperError: Anything that is wrong with the arguments, before anything moves.
    """

    def __init__(
        self,
        uri: str = "mujoco",
        *,
        observer: str | Observer | None = "paper",
        models: Path | str | None = None,
        log: Path | str | None = None,
        reflexes: Sequence[Reflex] = (),
        real_time: bool = False,
        robot: RobotConfig | None = None,
        controller: ControllerSettings | None = None,
    ) -> None:
        self.config = robot or load_robot()
        self.backend: Backend = make_backend(uri, self.config)
        if isinstance(observer, str):
            path = None if models is None else Path(models)
            observer = make_observer(observer, self.config, self.backend.info.identity, path)
        self._observer = observer
        self._reflexes = tuple(reflexes)
        self._log_path = None if log is None else Path(log)
        self._log: LogWriter | None = None
        self._paced = real_time and not self.backend.info.real_time
        self._controller_settings = controller or load_controller_settings(self.config)
        self._safety_settings = load_safety_settings()
        self._subscriptions: list[tuple[ContactCallback, ContactPredicate]] = []
        self._dispatcher: Dispatcher | None = None
        self._listeners: list[Callable[[Tick, Observation | None], None]] = []
        self._gate: SafetyGate | None = None
        self._loop: Loop | None = None
        self._contacts: list[Contact] = []

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
            PepperError: The robot or the log cannot be opened.
        """
        if self._loop is not None:
            raise BackendError(f"'{self.backend.info.uri}' is already active")
        try:
            self._start()
        except BaseException:
            self.close()
            raise

    def _start(self) -> None:
        measurement = self.backend.open()
        hold = np.clip(measurement.position, self.config.lower, self.config.upper)
        if self._log_path is not None:  # only now: a robot that is not there costs no earlier log
            self._log = LogWriter(
                self._log_path,
                self.config,
                run_metadata(self.backend.info, self._observer),
                lossless=not self.backend.info.real_time,
            )
        measurement = self.backend.activate()
        controller = WholeBodyController(self.config, self._controller_settings)
        controller.reset(hold)
        gate = SafetyGate(self.config, self._safety_settings, self._controller_settings)
        gate.activate(hold)
        if self._observer is not None:
            self._observer.reset()
        for reflex in self._reflexes:
            reflex.reset()
        self._gate = gate
        self._contacts.clear()
        self._dispatcher = Dispatcher()
        for callback, wanted in self._subscriptions:
            self._dispatcher.subscribe(callback, wanted)
        self._loop = Loop(
            self.backend,
            self.config,
            controller,
            gate,
            time=measurement.time,
            observer=self._observer,
            reflexes=self._reflexes,
            log=self._log,
            deliver=self._deliver,
        )

    def close(self) -> None:
        """Stop, lower the stiffness, close the log, disconnect. Does nothing when closed."""
        self._loop = None
        if self._gate is not None:
            self._gate.deactivate()
        with ExitStack() as stack:  # each is done even if the one before fails
            if self._dispatcher is not None:
                dispatcher, self._dispatcher = self._dispatcher, None
                stack.callback(dispatcher.close, timeout=CALLBACK_TIME)
                stack.callback(dispatcher.flush, timeout=CALLBACK_TIME)
            if self._log is not None:
                log, self._log = self._log, None
                stack.callback(log.close)
            self.backend.close()

    @property
    def state(self) -> RobotState:
        """INACTIVE, ACTIVE, or FAULT, which only a new start leaves."""
        return self._gate.state if self._gate is not None else RobotState.INACTIVE

    # -- motion -------------------------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Clock of the robot at the last measurement [s]."""
        return self._active().time

    @property
    def target(self) -> FloatArray:
        """(17,) where the joints were last told to go [rad], a copy."""
        return self._active().target.copy()

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
            duration: Get there along a spline within this time [s], above 0; None for a set-point, which the joints
                approach as springs do. After a reflex has held the robot, the whole time begins anew.

        Raises:
            PepperError: Unknown name, an angle that is not finite or outside the joint's limits. Nothing changes.
        """
        loop = self._active()
        target = loop.control.controller.posture.checked(self._resolve(posture, loop.target))
        # At 0 nothing would stop a joint.
        if stiffness is not None and not (np.isfinite(stiffness) and stiffness > 0):
            raise GainError("stiffness", stiffness, "a finite number above 0")
        if duration is not None and not (np.isfinite(duration) and 0 < duration <= LONGEST):
            raise TargetError(
                f"a duration is a time above 0 s and up to {LONGEST:g} s, got {duration!r}"
            )
        if stiffness is not None:
            loop.posture_stiffness = float(stiffness)
        loop.move_to(target, duration)

    def run(
        self,
        seconds: float,
        *,
        on_tick: Callable[[Tick, Observation | None], None] | None = None,
        until: Callable[[], bool] | None = None,
    ) -> bool:
        """Run for a time, then wait until the callbacks so far have been handled.

        Args:
            seconds: How long [s]; as fast as it goes in a simulation that is not paced.
            on_tick: Called inside every tick: must be quick.
            until: Asked after every tick, such as ``lambda: task.reached(0.005)``; True ends the run early.

        Returns:
            Whether ``until`` ended it.

        Raises:
            FaultError: The safety gate stopped the robot.
        """
        if not (np.isfinite(seconds) and seconds >= 0):
            raise ValueError(f"seconds must be a time that is not negative, got {seconds}")
        ticks = range(round(seconds / self.config.cycle))
        return self._run(ticks, on_tick, None if until is None else lambda _: until())

    def play(
        self,
        motion: Motion | str | Path,
        *,
        on_step: OnStep | None = None,
        on_tick: Callable[[Tick, Observation | None], None] | None = None,
    ) -> MotionReport:
        """Play a motion to its end, then wait until the callbacks so far have been handled.

        However it ends, its tasks are gone, the base is at rest, and the posture is where the motion ended or was
        broken off. While a reflex holds the posture, the motion waits.

        Args:
            motion: A motion, the name of a shipped one, or a path that ends in ``.yaml``.
            on_step: Called with each step's report as it ends, inside the tick: must be quick.
            on_tick: Called inside every tick: must be quick.

        Returns:
            What each step reached.

        Raises:
            PepperError: The motion is wrong; nothing moves.
            FaultError: The safety gate stopped the robot.
        """
        loop = self._active()
        if not isinstance(motion, Motion):
            motion = load_motion(motion, self.config)
        player = Player(motion, self.config, loop, on_step=on_step)
        try:
            player.begin()
            self._run(count(), on_tick, lambda tick: player.advance(tick.measurement))
        finally:
            player.end()
        return player.report

    def emergency_stop(self) -> None:
        """Hold the joints and stop the wheels from the next tick on; only a new start leaves this state."""
        if self._gate is not None:
            self._gate.stop("emergency stop")

    def push(
        self,
        link: str,
        force: ArrayLike,
        point: ArrayLike | None = None,
        duration: float = 0.5,
        *,
        frame: Literal["world", "link"] = "world",
        delay: float = 0.0,
    ) -> None:
        """Push a link of a simulated robot; see :meth:`pepper_driver.backends.Backend.push`."""
        self.backend.push(
            link,
            np.asarray(force, dtype=np.float64),
            None if point is None else np.asarray(point, dtype=np.float64),
            duration,
            frame=frame,
            delay=delay,
        )

    # -- touch --------------------------------------------------------------------------------------------------

    def on_contact(
        self,
        *,
        link: str | None = None,
        joint: str | None = None,
        kind: Kind | None = None,
        phase: Phase | None = "begin",
        min_intensity: float = 0.0,
    ) -> Callable[[ContactCallback], ContactCallback]:
        """Decorator: call a function when a contact is felt, on a thread of its own.

        Args:
            link: Only contacts on this link.
            joint: Only contacts felt by this joint.
            kind: Only this kind; None for contacts and collisions, but no rebounds.
            phase: ``begin``, ``update``, ``end``, or None for all.
            min_intensity: Only contacts of at least this intensity [deg].

        Raises:
            UnknownNameError: No such link or joint.
        """
        wanted = contact_filter(
            link=link,
            joint=joint,
            kind=kind,
            phase=phase,
            min_intensity=min_intensity,
            robot=self.config,
        )

        def register(callback: ContactCallback) -> ContactCallback:
            self._subscriptions.append((callback, wanted))
            if self._dispatcher is not None:
                self._dispatcher.subscribe(callback, wanted)
            return callback

        return register

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """All contact events since the start, oldest first."""
        return tuple(self._contacts)

    @property
    def observer(self) -> Observer | None:
        """The observer in use."""
        return self._observer

    @property
    def stage_times(self) -> StageTimes:
        """How long the stages of the last ticks took."""
        return self._active().times

    @property
    def controller(self) -> WholeBodyController:
        """The controller in use. Target and stiffness of its posture task belong to :meth:`set_posture`."""
        return self._active().control.controller

    # -- inside -------------------------------------------------------------------------------------------------

    def _run(
        self,
        ticks: Iterable[int],
        on_tick: Callable[[Tick, Observation | None], None] | None,
        until: Callable[[Tick], bool] | None,
    ) -> bool:
        """Tick, paced if need be; True when ``until``, asked after every tick, ended it."""
        loop, cycle = self._active(), self.config.cycle
        ended = False
        if on_tick is not None:
            self._listeners.append(on_tick)
        deadline = time.perf_counter()
        try:
            for _ in ticks:
                tick = loop.tick()
                ended = until is not None and until(tick)
                if ended:
                    break
                if self._paced:
                    deadline += cycle
                    time.sleep(max(0.0, deadline - time.perf_counter()))
        finally:
            if on_tick is not None:
                self._listeners.remove(on_tick)
        if self._dispatcher is not None:
            self._dispatcher.flush(timeout=CALLBACK_TIME)
        return ended

    def _active(self) -> Loop:
        if self._loop is None:
            raise BackendError(
                f"'{self.backend.info.uri}' is not active; use it inside 'with Pepper(...) as pepper:'"
            )
        return self._loop

    def _resolve(self, posture: Posture, current: FloatArray) -> Any:  # noqa: ANN401
        """Angles of a posture; joints that it does not name keep ``current``. Not checked yet."""
        if isinstance(posture, str):
            return self.config.posture(posture)
        if isinstance(posture, Mapping):
            angles = current.tolist()
            for name, angle in posture.items():
                angles[self.config.joint_index(name)] = angle
            return angles
        return posture

    def _deliver(self, tick: Tick, observation: Observation | None) -> None:
        if observation is not None:
            for contact in observation.contacts:
                self._contacts.append(contact)
                if self._dispatcher is not None:
                    self._dispatcher.publish(contact)
        for listener in self._listeners:
            listener(tick, observation)
